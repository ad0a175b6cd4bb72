"""Forces as small whole numbers for the general-purpose coders of `rate.py`, all in their favour.

Uniform in newtons, for an equal mean error; and three lattices that keep the promise |e| <= max(F_0, k |F|):

* *log-polar* (the direct one): a ladder of amplitudes whose steps are F_0 long up to F_0 / k and grow by k beyond,
  and an octahedral map of directions, of one fineness, or as fine at each amplitude as it must be there;
* *companded*: y = F g(|F|) / |F| with g(a) = a / F_0 up to F_0 / k and (1 + ln(a k / F_0)) / k beyond, rounded on a
  cubic lattice. All error balls of the mask become balls of radius 1 or more;
* *uniform*, with the step that F_0 allows.

What is at most F_0 long is dropped. Each takes the coarsest step with no violation, found on the field itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from touchfield.perception import violations

Forces = NDArray[np.float32]
Symbols = NDArray[np.int32]

SHARE = 3**-0.5
"""Of the mask to the amplitude: the cell of greatest volume in the ball (0.45 and 0.7 take as many bytes)."""


@dataclass(frozen=True)
class Quantised:
    """Symbols [..., 3], all three 0 where there is no force, and what they decode to."""

    name: str
    symbols: Symbols
    decoded: Forces


def uniform(forces_n: Forces, step_n: float) -> Quantised:
    """Each component a multiple of `step_n`, the nearest."""
    symbols = np.rint(forces_n / np.float32(step_n)).astype(np.int32)
    return Quantised("uniform", symbols, (symbols * np.float32(step_n)).astype(np.float32))


def is_kept(forces_n: Forces, decoded_n: Forces, k: float, f0_n: float) -> bool:
    """Whether no sample is beyond the mask."""
    x, y = (np.ascontiguousarray(a.reshape(-1, 3), np.float32) for a in (forces_n, decoded_n))
    return violations(x, y, k, f0_n).count == 0


def promised(forces_n: Forces, k: float, f0_n: float) -> list[Quantised]:
    """The field on every lattice, each as coarse as the promise allows."""
    dropped = np.linalg.norm(forces_n, axis=-1) <= f0_n

    def lattice(name: str, quantise: Callable[[float], Quantised], low: float, high: float) -> Quantised:
        def tried(scale: float) -> Quantised:
            made = quantise(scale)
            symbols, decoded = made.symbols.copy(), made.decoded.copy()
            symbols[dropped], decoded[dropped] = 0, 0
            return Quantised(name, symbols, decoded)

        best = tried(low)
        while not is_kept(forces_n, best.decoded, k, f0_n):
            low *= 0.9
            best = tried(low)
        for _ in range(4):
            middle = (low + high) / 2
            made = tried(middle)
            if is_kept(forces_n, made.decoded, k, f0_n):
                low, best = middle, made
            else:
                high = middle
        return best

    polar = [
        lattice(
            f"log-polar, {'a map a level' if by_level else 'one map'}",
            lambda scale, b=by_level: log_polar(forces_n, k, f0_n, scale, b),
            0.95,
            1.1,
        )
        for by_level in (False, True)
    ]
    return [
        *polar,
        lattice("companded", lambda scale: companded(forces_n, k, f0_n, scale), 1.0, 1.4),
        lattice("uniform", lambda scale: uniform(forces_n, scale * f0_n), 1.0, 1.4),
    ]


# -- companded ------------------------------------------------------------------------------------------------


def compand(forces_n: Forces, k: float, f0_n: float) -> NDArray[np.float64]:
    """F to y: balls of the mask to balls of radius 1, about."""
    knee = f0_n / k
    a = np.linalg.norm(forces_n.astype(np.float64), axis=-1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        g = np.where(a <= knee, a / f0_n, (1 + np.log(np.maximum(a, knee) / knee)) / k)
        return np.where(a > 0, forces_n * (g / a), 0.0)


def expand(companded_: NDArray[np.float64], k: float, f0_n: float) -> Forces:
    """The inverse of `compand`."""
    knee = f0_n / k
    g = np.linalg.norm(companded_, axis=-1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        a = np.where(g * k <= 1, g * f0_n, knee * np.exp(np.maximum(g * k, 1) - 1))
        return np.where(g > 0, companded_ * (a / g), 0.0).astype(np.float32)


def companded(forces_n: Forces, k: float, f0_n: float, step: float) -> Quantised:
    """The companded field on a cubic lattice."""
    symbols = np.rint(compand(forces_n, k, f0_n) / step).astype(np.int32)
    return Quantised("companded", symbols, expand(symbols * step, k, f0_n))


# -- log-polar ------------------------------------------------------------------------------------------------


def ladder(top_n: float, k: float, f0_n: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Borders [n + 1] and levels [n] of amplitude from F_0 up to `top_n`: errors of `SHARE` of the mask."""
    borders, levels = [f0_n], []
    while borders[-1] < top_n or not levels:
        level = borders[-1] + SHARE * max(f0_n, k * borders[-1])
        levels.append(level)
        borders.append(max(level + SHARE * f0_n, level / (1 - SHARE * k)))
    return np.array(borders), np.array(levels)


def allowed_angle(low: float, level: float, high: float, k: float, f0_n: float) -> float:
    """Radians a direction may be off where amplitudes from `low` to `high` become `level`."""
    a = np.append(np.linspace(low, high, 9), np.clip(f0_n / k, low, high))
    left = np.maximum(f0_n, k * a) ** 2 - (a - level) ** 2
    return float(2 * np.arcsin(np.sqrt(np.clip(left / (4 * a * level), 0, 1)).min()))


def log_polar(forces_n: Forces, k: float, f0_n: float, scale: float, by_level: bool) -> Quantised:
    """Amplitude level from 1 on, and the two coordinates of the octahedral map of the direction."""
    a = np.linalg.norm(forces_n.astype(np.float64), axis=-1)
    held = a > f0_n
    size, unit = a[held], forces_n[held] / a[held][:, None]
    borders, levels = ladder(float(a.max(initial=f0_n)), k, f0_n)
    level = np.clip(np.searchsorted(borders, size, side="right") - 1, 0, len(levels) - 1)
    angles = [allowed_angle(*edges, k, f0_n) for edges in zip(borders[:-1], levels, borders[1:])]
    sides = np.array([octahedral_side(round(scale * angle, 4)) for angle in angles])
    side = sides[level] if by_level else np.full(len(level), sides.max())
    u, v, direction = octahedral(unit, side)
    symbols, decoded = np.zeros(forces_n.shape, np.int32), np.zeros(forces_n.shape, np.float32)
    symbols[held] = np.stack([level + 1, u, v], axis=-1)
    decoded[held] = levels[level][:, None] * direction
    return Quantised("log-polar", symbols, decoded)


def octahedral(unit: NDArray[np.float64], side: NDArray[np.int64]) -> tuple[Symbols, Symbols, NDArray[np.float64]]:
    """The nearest of the four points about each direction [m, 3] on its own `side` x `side` octahedral map."""
    p = unit / np.abs(unit).sum(axis=1, keepdims=True)
    x, y = p[:, 0].copy(), p[:, 1].copy()
    below = p[:, 2] < 0
    x[below] = (1 - np.abs(p[below, 1])) * np.where(p[below, 0] < 0, -1, 1)
    y[below] = (1 - np.abs(p[below, 0])) * np.where(p[below, 1] < 0, -1, 1)
    scale = (side - 1) / 2
    fx, fy = np.floor((x + 1) * scale), np.floor((y + 1) * scale)
    best = np.full(len(unit), -2.0)
    u, v, direction = np.zeros(len(unit), np.int32), np.zeros(len(unit), np.int32), np.zeros(unit.shape)
    for dx in (0, 1):
        for dy in (0, 1):
            cu, cv = np.minimum(fx + dx, side - 1), np.minimum(fy + dy, side - 1)
            d = _direction(cu / scale - 1, cv / scale - 1)
            near = (d * unit).sum(axis=1)
            better = near > best
            best[better], direction[better] = near[better], d[better]
            u[better], v[better] = cu[better], cv[better]
    return u, v, direction


def _direction(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    z = 1 - np.abs(x) - np.abs(y)
    folded = z < 0
    fx = np.where(folded, (1 - np.abs(y)) * np.where(x < 0, -1, 1), x)
    fy = np.where(folded, (1 - np.abs(x)) * np.where(y < 0, -1, 1), y)
    d = np.stack([fx, fy, z], axis=-1)
    result: NDArray[np.float64] = d / np.linalg.norm(d, axis=-1, keepdims=True)
    return result


@cache
def _cover(side: int) -> float:
    """Largest angle found between a direction and its point on the map, radians."""
    rng = np.random.default_rng(0)
    unit = rng.normal(size=(20_000, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    _, _, direction = octahedral(unit, np.full(len(unit), side))
    return float(2 * np.arcsin(np.clip(np.linalg.norm(direction - unit, axis=1).max() / 2, 0, 1)))


@cache
def octahedral_side(angle: float) -> int:
    """The smallest side whose map leaves at most `angle`, radians."""
    for side in range(3, 400):
        if _cover(side) <= angle:
            return side
    raise ValueError(f"no map for {angle} rad")
