"""Measures false alarms and detections of the test of `touchfield correlate` on smooth pictures.

    python bench/bench_correlation.py [--quick] [--pairs N]

Pairs of normal noise of 64 x 64 pixels, smoothed by 1.5 to 12 pixels, are independent ("false alarms") or
share half of their variance ("detected"); one of each pair is known within a disc only, as the forces of a
body are. The figures are the fractions of the pairs with p <= 0.05 of those where p is given; "p given" is
their fraction. The comparisons are the shuffling of square blocks of four correlation lengths, as long as
there are 16 of them, and the shuffling of single pixels.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from machine import Bar, Figures, at_least, at_most, bench, column
from touchfield.measure import mutual_information, picture_correlation
from touchfield.measure.similarity import correlation_length_px, quantile_classes

SIDE, RADIUS, CLASSES, DRAWS, LEVEL = 64, 26, 8, 39, 0.05
SIGMAS = (1.5, 3.0, 6.0, 12.0)
Float64s = NDArray[np.float64]


def pair(seed: int, sigma: float, shared: float) -> tuple[Float64s, Float64s]:
    """Return two pictures that share a fraction of their variance; the second is known within a disc."""
    margin = math.ceil(3 * sigma)
    noise = np.random.default_rng([seed, round(10 * sigma)]).normal(size=(3, *[SIDE + 2 * margin] * 2))
    common, *own = ndimage.gaussian_filter(noise, (0, sigma, sigma))[
        :, margin : margin + SIDE, margin : margin + SIDE
    ]
    first, second = (math.sqrt(shared) * common + math.sqrt(1 - shared) * other for other in own)
    y, x = np.mgrid[:SIDE, :SIDE] - SIDE / 2
    return first, np.where(x**2 + y**2 < RADIUS**2, second, np.nan)


def p_by_blocks(first: Float64s, second: Float64s, side: int) -> float:
    """Return p of the information of two pictures against shuffled blocks of the second."""
    count = SIDE // side
    x, y = (
        quantile_classes(picture, CLASSES)[: count * side, : count * side]
        .reshape(count, side, count, side).transpose(0, 2, 1, 3).reshape(count**2, -1)
        for picture in (first, second)
    )  # fmt: skip

    def bits(other: NDArray[np.int64]) -> float:
        both = (x >= 0) & (other >= 0)
        return float(mutual_information(x[both], other[both], estimator="miller-madow", interval=False))

    rng, measured = np.random.default_rng(0), bits(y)
    return (1 + sum(bits(y[rng.permutation(len(y))]) >= measured for _ in range(DRAWS))) / (1 + DRAWS)


def block_side(first: Float64s, second: Float64s) -> int:
    """Return the power of two of at least four correlation lengths, of which 16 fit."""
    side = 1
    while side < 4 * correlation_length_px(first, second) and SIDE // (2 * side) >= 4:
        side *= 2
    return side


def row(pairs: int, sigma: float) -> Figures:
    """Return the fractions of significant pairs of one smoothness."""
    independent, dependent = ([pair(n, sigma, shared) for n in range(pairs)] for shared in (0.0, 0.5))
    p, p_dependent = (
        np.array([picture_correlation(a, b, surrogates=DRAWS, interval=False).p for a, b in every])
        for every in (independent, dependent)
    )
    blocks = [p_by_blocks(a, b, block_side(a, b)) for a, b in independent]
    pixels = [p_by_blocks(a, b, 1) for a, b in independent[: pairs // 4]]
    is_given, is_given_dependent = ~np.isnan(p), ~np.isnan(p_dependent)
    return {
        "length_px": float(np.mean([correlation_length_px(a, b) for a, b in independent])),
        "p given": float(is_given.mean()),
        "false alarms": float((p <= LEVEL).sum() / is_given.sum()) if is_given.any() else None,
        "detected": float((p_dependent <= LEVEL).sum() / is_given_dependent.sum())
        if is_given_dependent.any()
        else None,
        "false alarms, blocks": float(np.mean(np.array(blocks) <= LEVEL)),
        "false alarms, pixels": float(np.mean(np.array(pixels) <= LEVEL)),
    }


def measure(pairs: int) -> Figures:
    """Measure every smoothness."""
    return {"pairs": pairs, "smoothed": {f"{sigma:g} px": row(pairs, sigma) for sigma in SIGMAS}}


def bars(figures: Figures) -> list[Bar]:
    """Require few false alarms where p is mostly given, and detections in pictures of many patches."""
    rows = figures["smoothed"]
    given = [row for row in rows.values() if row["false alarms"] is not None and row["p given"] >= 0.2]
    rough = [rows[f"{sigma:g} px"] for sigma in SIGMAS[:2]]
    return [
        at_most("false alarms at p <= 0.05, worst", max(column(given, "false alarms")), 0.1),
        at_least(
            "half of the variance in common, detected, 1.5 and 3 px", min(column(rough, "detected")), 0.8
        ),
        at_least("p given, 1.5 and 3 px", min(column(rough, "p given")), 1.0),
    ]


if __name__ == "__main__":
    bench("correlation", __doc__, measure, bars, pairs=(100, 4))
