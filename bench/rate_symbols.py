"""Quantises forces to integers for the lossless coders of `rate_peers`.

Forces are quantised uniformly in newtons for an equal mean error. For the error bound |e| <= max(F_0, k |F|)
there are two quantisers, each of which was best on some field:

* *log-polar*: a ladder of amplitudes whose steps are proportional to F_0 up to F_0 / k and to the amplitude
  beyond, and an octahedral map of directions. A map whose fineness depends on the amplitude took more bytes.
* *companded*: y = F g(|F|) / |F| with g(a) = a / F_0 up to F_0 / k and (1 + ln(a k / F_0)) / k beyond,
  rounded on a cubic lattice. All error balls of the mask become balls of radius 1 or more.

Forces of at most F_0 are dropped. Each quantiser takes the coarsest step without a violation, which is found
on the field itself; this favours the peers.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from touchfield.perception import violations

Forces = NDArray[np.float32]
Symbols = NDArray[np.int32]
Candidate = TypeVar("Candidate")

K, F0_N = 0.1, 0.05
"""Parameters of the error bound."""
KNEE_N = F0_N / K
CELL_FRACTION = 3**-0.5
"""Fraction of the mask that is given to the amplitude.

It is that of the cell of greatest volume in the ball; 0.45 and 0.7 take as many bytes.
"""


class Quantised(NamedTuple):
    """Symbols [..., 3], all three 0 where there is no force, and their decoded forces."""

    symbols: Symbols
    decoded: Forces


def uniform(forces_n: Forces, step_n: float) -> Quantised:
    """Round each component to the nearest multiple of `step_n`."""
    symbols = np.rint(forces_n / np.float32(step_n)).astype(np.int32)
    return Quantised(symbols, (symbols * np.float32(step_n)).astype(np.float32))


def is_within_bound(forces_n: Forces, decoded_n: Forces) -> bool:
    """Return whether no sample is beyond the mask."""
    x, y = (np.ascontiguousarray(a.reshape(-1, 3), np.float32) for a in (forces_n, decoded_n))
    return violations(x, y, K, F0_N).count == 0


def dropped(quantised: Quantised, forces_n: Forces) -> Quantised:
    """Return the same without forces of at most F_0."""
    supported = (np.linalg.norm(forces_n, axis=-1) > F0_N)[..., None]
    return Quantised(quantised.symbols * supported, quantised.decoded * supported)


def coarsest(
    make: Callable[[float], Candidate],
    is_good: Callable[[Candidate], bool],
    low: float,
    high: float,
    trials: int = 10,
) -> Candidate | None:
    """Return the good candidate of the greatest step found by bisection; None if none.

    Bisection is on the logarithm of the step between `low` and `high`.
    """
    best = None
    for _ in range(trials):
        middle = (low * high) ** 0.5
        candidate = make(middle)
        if is_good(candidate):
            low, best = middle, candidate
        else:
            high = middle
    return best


def without_small(
    quantise: Callable[[Forces, float], Quantised], forces_n: Forces, scale: float
) -> Quantised:
    """Quantise at a scale, without forces that the mask does not need."""
    return dropped(quantise(forces_n, scale), forces_n)


def promised(forces_n: Forces) -> list[Quantised]:
    """Quantise the field by both quantisers, each as coarsely as the bound allows."""
    candidates = (
        coarsest(
            partial(without_small, quantise, forces_n),
            lambda quantised: is_within_bound(forces_n, quantised.decoded), 0.5, 1.5, 6,
        )
        for quantise in (log_polar, companded)
    )  # fmt: skip
    return [found for found in candidates if found is not None]


# -- companded ---------------------------------------------------------------------------------------------


def compand(forces_n: Forces) -> NDArray[np.float64]:
    """Map F to y, and so balls of the mask to balls of radius about 1."""
    a = np.linalg.norm(forces_n.astype(np.float64), axis=-1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        g = np.where(a <= KNEE_N, a / F0_N, (1 + np.log(np.maximum(a, KNEE_N) / KNEE_N)) / K)
        return np.where(a > 0, forces_n * (g / a), 0.0)


def expand(y: NDArray[np.floating[Any]]) -> Forces:
    """Invert `compand`."""
    g = np.linalg.norm(y, axis=-1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        a = np.where(g * K <= 1, g * F0_N, KNEE_N * np.exp(np.maximum(g * K, 1) - 1))
        return np.where(g > 0, y * (a / g), 0.0).astype(np.float32)


def companded(forces_n: Forces, step: float) -> Quantised:
    """Quantise the companded field on a cubic lattice."""
    symbols = np.rint(compand(forces_n) / step).astype(np.int32)
    return Quantised(symbols, expand(symbols * step))


# -- log-polar ---------------------------------------------------------------------------------------------


def ladder(top_n: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return borders [n + 1] and levels [n] of amplitude from F_0 up to `top_n`.

    Errors are at most `CELL_FRACTION` of the mask.
    """
    borders, levels = [F0_N], list[float]()
    while borders[-1] < top_n or not levels:
        level = borders[-1] + CELL_FRACTION * max(F0_N, K * borders[-1])
        levels.append(level)
        borders.append(max(level + CELL_FRACTION * F0_N, level / (1 - CELL_FRACTION * K)))
    return np.array(borders), np.array(levels)


def allowed_angle(low: float, level: float, high: float) -> float:
    """Return the largest allowed error of a direction, radians.

    Amplitudes from `low` to `high` are decoded as `level`.
    """
    a = np.append(np.linspace(low, high, 9), np.clip(KNEE_N, low, high))
    margin = np.maximum(F0_N, K * a) ** 2 - (a - level) ** 2
    return float(2 * np.arcsin(np.sqrt(np.clip(margin / (4 * a * level), 0, 1)).min()))


def log_polar(forces_n: Forces, scale: float) -> Quantised:
    """Quantise to an amplitude level and two octahedral coordinates of the direction.

    Levels begin at 1.
    """
    a = np.linalg.norm(forces_n.astype(np.float64), axis=-1)
    supported = a > F0_N
    borders, levels = ladder(float(a.max(initial=F0_N)))
    level = np.clip(np.searchsorted(borders, a[supported], side="right") - 1, 0, len(levels) - 1)
    angle = min(allowed_angle(*edges) for edges in zip(borders[:-1], levels, borders[1:]))
    u, v, direction = octahedral(
        forces_n[supported] / a[supported][:, None], octahedral_side(round(scale * angle, 4))
    )
    symbols, decoded = np.zeros(forces_n.shape, np.int32), np.zeros(forces_n.shape, np.float32)
    symbols[supported] = np.stack([level + 1, u, v], axis=-1)
    decoded[supported] = levels[level][:, None] * direction
    return Quantised(symbols, decoded)


def octahedral(unit: NDArray[np.float64], side: int) -> tuple[Symbols, Symbols, NDArray[np.float64]]:
    """Return the nearest point on the octahedral map for each direction [m, 3].

    The map has `side` x `side` points; the four around each direction are tried. Returns both coordinates and
    the decoded directions.
    """
    p = unit / np.abs(unit).sum(axis=1, keepdims=True)
    xy = np.where(p[:, 2:] < 0, (1 - np.abs(p[:, 1::-1])) * np.where(p[:, :2] < 0, -1, 1), p[:, :2])
    scale = (side - 1) / 2
    corner, best = np.floor((xy + 1) * scale), np.full(len(unit), -2.0)
    coordinates, direction = np.zeros((len(unit), 2), np.int32), np.zeros(unit.shape)
    for shift in ((0, 0), (0, 1), (1, 0), (1, 1)):
        at = np.minimum(corner + shift, side - 1)
        d = _direction(at / scale - 1)
        cosine = (d * unit).sum(axis=1)
        better = cosine > best
        best[better], direction[better], coordinates[better] = cosine[better], d[better], at[better]
    return coordinates[:, 0], coordinates[:, 1], direction


def _direction(xy: NDArray[np.float64]) -> NDArray[np.float64]:
    z = 1 - np.abs(xy).sum(axis=1, keepdims=True)
    folded = np.where(z < 0, (1 - np.abs(xy[:, ::-1])) * np.where(xy < 0, -1, 1), xy)
    d = np.concatenate([folded, z], axis=1)
    result: NDArray[np.float64] = d / np.linalg.norm(d, axis=-1, keepdims=True)
    return result


def octahedral_side(angle: float) -> int:
    """Return the smallest side whose map has a largest error of at most `angle`, rad.

    The error is that of 20,000 random directions.
    """
    for side in range(3, 400):
        if _widest(side) <= angle:
            return side
    raise ValueError(f"no map for {angle} rad")


@cache
def _widest(side: int) -> float:
    """Return the largest angle between a direction and its point of the map, radians."""
    unit = np.random.default_rng(0).normal(size=(20_000, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    off = np.linalg.norm(octahedral(unit, side)[2] - unit, axis=1).max()
    return float(2 * np.arcsin(np.clip(off / 2, 0, 1)))
