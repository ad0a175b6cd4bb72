"""Forces as small integers for the general-purpose coders of `rate.py`, in their favour.

Uniform in newtons, for an equal mean error; and two lattices that keep the promise |e| <= max(F_0, k |F|), of
which each was best on some field:

* *log-polar* (the direct one): a ladder of amplitudes whose steps are F_0 long up to F_0 / k and grow by k
  beyond, and an octahedral map of directions (as fine at each amplitude as it must be there, it took more
  bytes);
* *companded*: y = F g(|F|) / |F| with g(a) = a / F_0 up to F_0 / k and (1 + ln(a k / F_0)) / k beyond,
  rounded on a cubic lattice. All error balls of the mask become balls of radius 1 or more.

What is at most F_0 long is dropped. Each takes the coarsest step with no violation, found on the field
itself.
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
"""Of the mask to the amplitude: the cell of greatest volume in the ball (0.45 and 0.7 take as many bytes)."""


class Quantised(NamedTuple):
    """Symbols [..., 3], all three 0 where there is no force, and what they decode to."""

    symbols: Symbols
    decoded: Forces


def uniform(forces_n: Forces, step_n: float) -> Quantised:
    """Each component a multiple of `step_n`, the nearest."""
    symbols = np.rint(forces_n / np.float32(step_n)).astype(np.int32)
    return Quantised(symbols, (symbols * np.float32(step_n)).astype(np.float32))


def is_within_bound(forces_n: Forces, decoded_n: Forces) -> bool:
    """Whether no sample is beyond the mask."""
    x, y = (np.ascontiguousarray(a.reshape(-1, 3), np.float32) for a in (forces_n, decoded_n))
    return violations(x, y, K, F0_N).count == 0


def dropped(quantised: Quantised, forces_n: Forces) -> Quantised:
    """The same without forces of at most F_0."""
    supported = (np.linalg.norm(forces_n, axis=-1) > F0_N)[..., None]
    return Quantised(quantised.symbols * supported, quantised.decoded * supported)


def coarsest(
    make: Callable[[float], Candidate],
    is_good: Callable[[Candidate], bool],
    low: float,
    high: float,
    trials: int = 10,
) -> Candidate | None:
    """The one of the greatest step that is good, by halving the ratio of `high` to `low`;
    None where none is.
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
    """Quantised at a scale, without forces that the mask does not need."""
    return dropped(quantise(forces_n, scale), forces_n)


def promised(forces_n: Forces) -> list[Quantised]:
    """The field on both lattices, each as coarse as the error bound allows."""
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
    """F to y: balls of the mask to balls of radius 1, about."""
    a = np.linalg.norm(forces_n.astype(np.float64), axis=-1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        g = np.where(a <= KNEE_N, a / F0_N, (1 + np.log(np.maximum(a, KNEE_N) / KNEE_N)) / K)
        return np.where(a > 0, forces_n * (g / a), 0.0)


def expand(y: NDArray[np.floating[Any]]) -> Forces:
    """The inverse of `compand`."""
    g = np.linalg.norm(y, axis=-1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        a = np.where(g * K <= 1, g * F0_N, KNEE_N * np.exp(np.maximum(g * K, 1) - 1))
        return np.where(g > 0, y * (a / g), 0.0).astype(np.float32)


def companded(forces_n: Forces, step: float) -> Quantised:
    """The companded field on a cubic lattice."""
    symbols = np.rint(compand(forces_n) / step).astype(np.int32)
    return Quantised(symbols, expand(symbols * step))


# -- log-polar ---------------------------------------------------------------------------------------------


def ladder(top_n: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Borders [n + 1] and levels [n] of amplitude from F_0 up to `top_n`: errors of `SHARE` of the mask."""
    borders, levels = [F0_N], list[float]()
    while borders[-1] < top_n or not levels:
        level = borders[-1] + CELL_FRACTION * max(F0_N, K * borders[-1])
        levels.append(level)
        borders.append(max(level + CELL_FRACTION * F0_N, level / (1 - CELL_FRACTION * K)))
    return np.array(borders), np.array(levels)


def allowed_angle(low: float, level: float, high: float) -> float:
    """Radians a direction may be off where amplitudes from `low` to `high` become `level`."""
    a = np.append(np.linspace(low, high, 9), np.clip(KNEE_N, low, high))
    margin = np.maximum(F0_N, K * a) ** 2 - (a - level) ** 2
    return float(2 * np.arcsin(np.sqrt(np.clip(margin / (4 * a * level), 0, 1)).min()))


def log_polar(forces_n: Forces, scale: float) -> Quantised:
    """Amplitude level from 1 on, and the two coordinates of the octahedral map of the direction."""
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
    """The nearest of the four points about each direction [m, 3] on the `side` x `side` octahedral map."""
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
    """The smallest side whose map leaves at most `angle`, radians, of 20,000 random directions."""
    for side in range(3, 400):
        if _widest(side) <= angle:
            return side
    raise ValueError(f"no map for {angle} rad")


@cache
def _widest(side: int) -> float:
    """Largest angle between a direction and the map, radians."""
    unit = np.random.default_rng(0).normal(size=(20_000, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    off = np.linalg.norm(octahedral(unit, side)[2] - unit, axis=1).max()
    return float(2 * np.arcsin(np.clip(off / 2, 0, 1)))
