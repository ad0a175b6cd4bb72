"""Paths of a hand that slides along what it touches, and what of a force over time lies between 40 and 400 Hz.

A path starts at a random sample of the support and is brought to the level |F| = 1 N along the force, then steps
along the surface by one spacing at a time and is brought back each time; its direction turns at random where the
surface ends. Of these points one every 50 ms is kept, and a cubic spline runs through them, so that the path itself
holds next to nothing above 20 Hz. The band: Butterworth of order 4, forwards and backwards; thirds of an octave: the
power of a Hann window's spectrum.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Bools, Float64s, Int64s
from touchfield.errors import InvalidArgument
from touchfield.perception.human import THIRDS_HZ

if TYPE_CHECKING:
    from touchfield.medium import ForceField

Forces = Callable[["Float64s"], "NDArray[Any]"]
"""``forces(points_m [n, 3]) -> newtons [n, 3]``: what a hand meets, for example `ForceField.sample_n`."""

LEVEL_N: Final = 1.0

_KNOT_S: Final = 0.05
_TRIES: Final = 32
"""Candidates for each start that is asked for."""

_TURNS: Final = 24
"""Directions that a path tries where the surface ends."""


class SurfaceWalks(NamedTuple):
    """Points along the surface, one spacing apart.

    points_m : float64 [steps, walks, 3]
    steps : int64 [walks]; points that each walk has; those beyond stand still.
    """

    points_m: Float64s
    steps: Int64s
    step_m: float


def level_of(field: ForceField) -> float:
    """The force at which a hand slides, newtons: 1 N, or half the largest of the field where that is less."""
    if not len(field.forces_n):
        return 0.0
    largest = float(np.sqrt((field.forces_n.astype(np.float64) ** 2).sum(axis=-1).max()))
    return min(LEVEL_N, largest / 2)


def points_on_surface(field: ForceField, count: int, rng: np.random.Generator) -> Float64s:
    """Up to `count` random points at the level, metres, float64 [n, 3]; none where no sample leads to one."""
    positions = field.positions()
    if not len(positions):
        return np.zeros((0, 3))
    chosen = positions[rng.integers(len(positions), size=_TRIES * count)]
    start_m = field.grid.to_m(chosen + rng.uniform(-0.25, 0.25, chosen.shape))
    points_m, met = _to_level(field, start_m, level_of(field), 48)
    return points_m[met][:count]


def surface_walks(field: ForceField, length_m: float, count: int, rng: np.random.Generator) -> SurfaceWalks:
    """Walk along the surface from `count` random points, `length_m` each; one that finds no way on is shorter."""
    level, step_m = level_of(field), min(field.grid.spacing_m)
    at = points_on_surface(field, count, rng)
    steps = max(1, round(length_m / step_m)) + 1
    points = np.empty((steps, len(at), 3))
    points[0] = at
    done = np.ones(len(at), np.int64)
    heading = rng.normal(size=at.shape)
    stuck = np.zeros(len(at), np.int64)
    while len(at) and (going := np.flatnonzero((done < steps) & (stuck < _TURNS))).size:
        here = points[done[going] - 1, going]
        normal = _unit(field.sample_n(here).astype(np.float64))
        ahead = _unit(heading[going] - (heading[going] * normal).sum(axis=1, keepdims=True) * normal)
        found, met = _to_level(field, here + step_m * ahead, level, 6)
        moved = np.linalg.norm(found - here, axis=1)
        met &= (moved > 0.5 * step_m) & (moved < 2 * step_m)
        points[done[going][met], going[met]] = found[met]
        heading[going] = np.where(met[:, None], ahead, rng.normal(size=ahead.shape))
        done[going] += met
        stuck[going] = np.where(met, 0, stuck[going] + 1)
    for walk, last in enumerate(done):
        points[last:, walk] = points[last - 1, walk]
    return SurfaceWalks(points, done, step_m)


def slide_m(walks: SurfaceWalks, walk: int, speed_m_per_s: float, duration_s: float, rate_hz: float) -> Float64s:
    """Where a hand is that slides along one walk, metres, float64 [samples, 3]; none of a walk below four knots."""
    from scipy.interpolate import CubicSpline

    per_step_s = walks.step_m / speed_m_per_s
    knots_s = np.arange(0.0, min(duration_s, (walks.steps[walk] - 1) * per_step_s) + 1e-9, _KNOT_S)
    if len(knots_s) < 4:
        return np.zeros((0, 3))
    index = knots_s / per_step_s
    low = np.minimum(index.astype(np.int64), walks.steps[walk] - 2)
    share = (index - low)[:, None]
    points = (1 - share) * walks.points_m[low, walk] + share * walks.points_m[low + 1, walk]
    return np.asarray(CubicSpline(knots_s, points)(np.arange(0.0, knots_s[-1], 1 / rate_hz)))


def _to_level(field: ForceField, points_m: Float64s, level_n: float, rounds: int) -> tuple[Float64s, Bools]:
    """Points moved along the force to where it is `level_n`; where that came within 2 %."""
    most_m = 0.5 * min(field.grid.spacing_m)
    points = points_m.copy()
    for _ in range(rounds):
        forces = field.sample_n(points).astype(np.float64)
        size = np.linalg.norm(forces, axis=1)
        outwards = _unit(forces)
        deeper = np.linalg.norm(field.sample_n(points - most_m * outwards), axis=1)
        per_m = np.maximum((deeper - size) / most_m, 1e-9)  # in a saturated depth the way out is the only one
        points -= outwards * np.clip((level_n - size) / per_m, -most_m, most_m)[:, None]
    forces = field.sample_n(points).astype(np.float64)
    return points, np.abs(np.linalg.norm(forces, axis=1) - level_n) <= 0.02 * level_n


def _unit(vectors: Float64s) -> Float64s:
    size = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(np.divide(vectors, size, out=np.zeros_like(vectors), where=size > 0))


BAND_HZ: Final = (40.0, 400.0)

MARGIN_S: Final = 0.1
"""Filtered and not counted, on either side: the slowest pole has fallen to 1e-4."""

LEAST_S: Final = 0.25
"""A signal shorter than this, its margins beside, is not measured."""

_LEAST_RATE_HZ: Final = 1000.0


def in_band(signal: Float64s, rate_hz: float) -> Float64s:
    """The part of a signal [samples, ...] from 40 to 400 Hz, without its margins, float64 [samples - 2 margin, ...].

    Raises `InvalidArgument` if the rate is below 1000 samples a second or the signal too short.
    """
    from scipy.signal import butter, sosfiltfilt

    margin = round(MARGIN_S * rate_hz)
    _check(len(signal) - 2 * margin, rate_hz)
    sections = butter(4, BAND_HZ, "bandpass", fs=rate_hz, output="sos")
    filtered: Float64s = sosfiltfilt(sections, signal, axis=0)
    return filtered[margin : len(signal) - margin]


def third_octave_power(signal: Float64s, rate_hz: float) -> Float64s:
    """Mean square of a signal [samples, components] in each third of `THIRDS_HZ`, components added, float64 [11]."""
    n = len(signal)
    _check(n, rate_hz)
    window = np.hanning(n)
    power = np.abs(np.fft.rfft(window[:, None] * (signal - signal.mean(axis=0)), axis=0)) ** 2
    power = 2 * power.sum(axis=1) / (n * (window**2).sum())
    frequency_hz = np.fft.rfftfreq(n, 1 / rate_hz)
    edges = np.searchsorted(frequency_hz, np.outer(THIRDS_HZ, [10**-0.05, 10**0.05]))
    return np.array([power[a:b].sum() for a, b in edges])


class BandSums:
    """Signals of some kinds from 40 to 400 Hz: sums of squares, peaks, and thirds of an octave by weight."""

    def __init__(self, kinds: int) -> None:
        self.samples, self._power, self._peak, self._weight = np.zeros((4, kinds))
        self._thirds = np.zeros((kinds, len(THIRDS_HZ)))

    def add(self, kind: int, signal: Float64s, rate_hz: float, weight: int = 0) -> None:
        """Count a signal in newtons [samples, 3]; a `weight` of 0 leaves its thirds out."""
        squares = (in_band(signal, rate_hz) ** 2).sum(axis=1)
        self.samples[kind] += len(squares)
        self._power[kind] += squares.sum()
        self._peak[kind] = max(self._peak[kind], squares.max())
        if weight:
            self._weight[kind] += weight
            self._thirds[kind] += weight * third_octave_power(signal, rate_hz)

    def mn(self, kind: int) -> tuple[float, float]:
        """Rms and largest, millinewtons."""
        power = self._power[kind] / max(1, self.samples[kind])
        return 1e3 * math.sqrt(power), 1e3 * math.sqrt(self._peak[kind])

    def thirds_mn(self, kind: int) -> Float64s:
        """Rms in each third of an octave, millinewtons."""
        return np.asarray(1e3 * np.sqrt(self._thirds[kind] / max(1, self._weight[kind])))


def _check(samples: int, rate_hz: float) -> None:
    if not rate_hz >= _LEAST_RATE_HZ:
        raise InvalidArgument("rate_hz", repr(rate_hz), f"{_LEAST_RATE_HZ:g} or more")
    if samples < LEAST_S * rate_hz:
        raise InvalidArgument("signal", f"{samples / rate_hz:.3g} s", f"{LEAST_S:g} s or more")
