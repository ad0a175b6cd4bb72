"""Computes the vibration that coding errors cause to a hand: one that slides along the surface of a field, or
one that rests while frames change.

A mask bounds the error of each sample. A moving hand meets one sample after another, so that an error that
differs between neighbouring samples becomes vibration: e(t) = F_decoded(x(t)) - F_source(x(t)), both
interpolated as in the receiver. e is computed along seeded paths at three speeds and measured in the band
from 40 to 400 Hz (Butterworth of order 4, forwards and backwards; third-octave levels from the power spectrum
with a Hann window). For comparison, the same is measured for the source itself and, if the exact field is
known, for the error of the source's lattice relative to it.

A path starts at a random sample of the support, which is moved along the force to the level |F| = 1 N. It
then steps along the surface by one spacing at a time and is moved back to the level after each step; its
direction changes at random where the surface ends. Points 50 ms apart are kept and joined by a cubic spline,
so that the path itself contains almost nothing above 20 Hz.

A hand at rest feels the changes between frames. Where nothing moves, the source makes no step, but a coder
whose errors differ from frame to frame does. Points are seeded on the surface of a frame and stay until the
next points are seeded; the forces at each point are recorded for the source and for the output of a receiver.
A step is the change from one frame to the next; for the band the frames are interpolated linearly to 1000
samples per second, as the receiver does. A level is a figure beside a threshold; it does not prove that
nobody notices an error.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Bools, Float64s, Int64s, lengths_of
from touchfield.compute.native import native
from touchfield.errors import InvalidArgument, require_between
from touchfield.medium.field import brick_keys
from touchfield.perception.human import THIRDS_HZ, VibrationThreshold, vibration_threshold
from touchfield.perception.mask import Weber, mask_n

if TYPE_CHECKING:
    from touchfield.medium import ForceField

Forces = Callable[["Float64s"], "NDArray[Any]"]
"""``forces(points_m [n, 3]) -> newtons [n, 3]``: forces at points, for example `ForceField.sample_n`."""

SPEEDS_MM_S: Final = (50.0, 100.0, 200.0)

NO_STEP_N: Final = 1e-3
"""A change of the source by at most this force counts as no step, newtons."""

BAND_HZ: Final = (40.0, 400.0)
LEVEL_N: Final = 1.0
MARGIN_S: Final = 0.1  # on either side, filtered but not counted; the slowest pole decays to 1e-4 in it
MIN_DURATION_S: Final = 0.25  # a signal shorter than this, without its margins, is not measured

_KNOT_S: Final = 0.05
_TRIES: Final = 32  # number of candidates for each requested start
_TURNS: Final = 24  # number of directions that a path tries where the surface ends
_PARTS: Final = 4
_PART_S: Final = 0.5
_MAX_FRAMES: Final = 4096
_SERVO_HZ: Final = 1000.0
_AT_ONCE: Final = 1 << 17  # number of samples of signals that are filtered together


# -- paths -------------------------------------------------------------------------------------------------
class SurfaceWalks(NamedTuple):
    """Points along the surface, one spacing apart."""

    points_m: Float64s  # float64 [steps, walks, 3]
    steps: Int64s  # int64 [walks]; number of points of each walk; the last point is repeated
    step_m: float


def level_of(field: ForceField) -> float:
    """The amplitude of the force at which a hand slides, newtons.

    1 N, or half the largest force of the field if that is less.
    """
    square = (field.forces_n.astype(np.float64) ** 2).sum(axis=-1).max(initial=0.0)
    return min(LEVEL_N, float(np.sqrt(square)) / 2)


def points_on_surface(field: ForceField, count: int, rng: np.random.Generator) -> Float64s:
    """Up to `count` random points at the level (`level_of`), metres, float64 [n, 3].

    There are none if no sample leads to such a point.
    """
    positions = field.positions()
    if not len(positions):
        return np.zeros((0, 3))
    samples = positions[rng.integers(len(positions), size=_TRIES * count)]
    start_m = field.grid.to_m(samples + rng.uniform(-0.25, 0.25, samples.shape))
    points_m, met = _move_to_level(field, start_m, level_of(field), 48)
    return points_m[met][:count]


def surface_walks(field: ForceField, length_m: float, count: int, rng: np.random.Generator) -> SurfaceWalks:
    """Walk along the surface from `count` random points, `length_m` each.

    A walk that finds no further point is shorter.
    """
    level, step_m = level_of(field), min(field.grid.spacing_m)
    starts = points_on_surface(field, count, rng)
    steps = max(1, round(length_m / step_m)) + 1
    points = np.empty((steps, len(starts), 3))
    points[0] = starts
    point_counts = np.ones(len(starts), np.int64)
    heading = rng.normal(size=starts.shape)
    stuck = np.zeros(len(starts), np.int64)
    while len(starts) and (active := np.flatnonzero((point_counts < steps) & (stuck < _TURNS))).size:
        positions = points[point_counts[active] - 1, active]
        normal = _unit(field.sample_n(positions).astype(np.float64))
        directions = _unit(heading[active] - (heading[active] * normal).sum(axis=1, keepdims=True) * normal)
        found, met = _move_to_level(field, positions + step_m * directions, level, 6)
        moved = lengths_of(found - positions)
        met &= (moved > 0.5 * step_m) & (moved < 2 * step_m)
        points[point_counts[active][met], active[met]] = found[met]
        heading[active] = np.where(met[:, None], directions, rng.normal(size=directions.shape))
        point_counts[active] += met
        stuck[active] = np.where(met, 0, stuck[active] + 1)
    for walk, last in enumerate(point_counts):
        points[last:, walk] = points[last - 1, walk]
    return SurfaceWalks(points, point_counts, step_m)


def slide_m(
    walks: SurfaceWalks, speed_m_per_s: float, duration_s: float, rate_hz: float
) -> Iterator[Float64s]:
    """Yield positions of hands that slide along the walks, grouped by duration.

    Metres, float64 [samples, hands, 3]. Walks of fewer than four knots are omitted.
    """
    from scipy.interpolate import CubicSpline

    per_step_s = walks.step_m / speed_m_per_s
    knots = np.ceil((np.minimum(duration_s, (walks.steps - 1) * per_step_s) + 1e-9) / _KNOT_S).astype(
        np.int64
    )
    for count in np.unique(knots[knots >= 4]):
        knots_s, points = _KNOT_S * np.arange(count), walks.points_m[:, knots == count]
        at = knots_s / per_step_s
        low = np.minimum(at.astype(np.int64), len(points) - 1)
        high = np.minimum(low + 1, len(points) - 1)
        points = (at - low)[:, None, None] * (points[high] - points[low]) + points[low]
        times_s = np.arange(0.0, knots_s[-1], 1 / rate_hz)
        at_once = max(1, _AT_ONCE // len(times_s))
        for first in range(0, points.shape[1], at_once):
            yield np.asarray(CubicSpline(knots_s, points[:, first : first + at_once])(times_s))


def _move_to_level(
    field: ForceField, points_m: Float64s, level_n: float, rounds: int
) -> tuple[Float64s, Bools]:
    """Move points along the force to where its amplitude is `level_n`.

    Also returns bool [n], True for points that came within 2 % of the level.
    """
    grid, points, met = field.grid, points_m.copy(), np.empty(len(points_m), np.bool_)
    max_move_m, keys = 0.5 * min(grid.spacing_m), brick_keys(grid, field.bricks)
    native.move_to_level(
        *(points, grid.shape, grid.spacing_m, grid.origin_m, keys, field.forces_n),
        *(level_n, max_move_m, rounds, met),
    )
    return points, met


def _unit(vectors: Float64s) -> Float64s:
    size = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(np.divide(vectors, size, out=np.zeros_like(vectors), where=size > 0))


# -- what lies in the band ---------------------------------------------------------------------------------
def in_band(signal: Float64s, rate_hz: float) -> Float64s:
    """The part of a signal from 40 to 400 Hz, without its margins.

    `signal`: [samples, ...]; the result is float64 [samples - 2 margin, ...]. Raises `InvalidArgument` if the
    rate is below 1000 samples per second, or the signal is too short.
    """
    from scipy.signal import sosfiltfilt

    margin = round(MARGIN_S * rate_hz)
    _check(len(signal) - 2 * margin, rate_hz)
    filtered: Float64s = sosfiltfilt(_band_sections(rate_hz), signal, axis=0)
    return filtered[margin : len(signal) - margin]


@lru_cache(maxsize=8)
def _band_sections(rate_hz: float) -> Float64s:
    from scipy.signal import butter

    return np.asarray(butter(4, BAND_HZ, "bandpass", fs=rate_hz, output="sos"))


def third_octave_power(signal: Float64s, rate_hz: float) -> Float64s:
    """Mean square of a signal in each third of an octave of `THIRDS_HZ`, float64 [11].

    `signal`: [samples, ...]; the squares of all components are added.
    """
    from scipy.signal import periodogram

    n = len(signal)
    _check(n, rate_hz)
    frequency_hz, density = periodogram(signal, rate_hz, np.hanning(n), axis=0)
    power = density.reshape(len(density), -1).sum(axis=1) * rate_hz / n
    edges = np.searchsorted(frequency_hz, np.outer(THIRDS_HZ, [10**-0.05, 10**0.05]))
    return np.array([power[a:b].sum() for a, b in edges])


def _check(samples: int, rate_hz: float) -> None:
    if not rate_hz >= _SERVO_HZ:
        raise InvalidArgument("rate_hz", repr(rate_hz), f"{_SERVO_HZ:g} or more")
    if samples < MIN_DURATION_S * rate_hz:
        raise InvalidArgument("signal", f"{samples / rate_hz:.3g} s", f"{MIN_DURATION_S:g} s or more")


class BandSums:
    """Sums over signals in the band from 40 to 400 Hz.

    Power and peaks are kept for each of several kinds; third-octave powers are summed with weights, for one
    kind.
    """

    def __init__(self, kinds: int) -> None:
        self.samples, self._power, self._peak = np.zeros((3, kinds))
        self._weight, self._thirds = 0, np.zeros(len(THIRDS_HZ))

    def add(self, kind: int, signals: Float64s, rate_hz: float, weight: int = 0) -> None:
        """Add signals, newtons [samples, signals, 3].

        Their third-octave powers count with `weight`; with 0 they are omitted.
        """
        squares = (in_band(signals, rate_hz) ** 2).sum(axis=2)
        self.samples[kind] += squares.size
        self._power[kind] += squares.sum()
        self._peak[kind] = max(self._peak[kind], squares.max())
        if weight:
            self._weight += weight * signals.shape[1]
            self._thirds += weight * third_octave_power(signals, rate_hz)

    def mn(self, kind: int) -> tuple[float, float]:
        """Rms value and largest value, millinewtons."""
        power = self._power[kind] / max(1, self.samples[kind])
        return 1e3 * math.sqrt(power), 1e3 * math.sqrt(self._peak[kind])

    def thirds_mn(self) -> Float64s:
        """Rms in each third of an octave, millinewtons."""
        return np.asarray(1e3 * np.sqrt(self._thirds / max(1, self._weight)))


# -- a hand that slides ------------------------------------------------------------------------------------
@dataclass(frozen=True)
class SlideSpec:
    """Settings of the slides to measure."""

    paths: int = 16  # number of paths per frame, 1 to 1024
    duration_s: float = 0.5  # duration of a slide without its margins, 0.25 s or more
    rate_hz: float = 1000.0  # samples per second, 1000 or more; frequencies above half of it are aliased
    seed: int = 0

    def __post_init__(self) -> None:
        require_between(1, 1024, paths=self.paths)
        require_between(MIN_DURATION_S, 60, duration_s=self.duration_s)
        require_between(1000, 1e5, rate_hz=self.rate_hz)


class Slide(NamedTuple):
    """The slides at one speed: rms and largest value in the band from 40 to 400 Hz.

    All values are in millinewtons and taken over all paths.
    """

    speed_mm_s: float
    paths: int  # 0 if no surface was long enough; all figures are then 0
    seconds: float  # total duration without margins
    error_mn: float  # of decoded minus source
    error_peak_mn: float
    source_mn: float
    source_peak_mn: float
    lattice_mn: float | None  # of the source minus the field that it samples; None if that is not known
    error_thirds_mn: Float64s  # float64 [11]; in each third of an octave of `THIRDS_HZ`

    def summary(self) -> dict[str, Any]:
        """Stable keys for people and programs."""
        return self._asdict() | {"error_thirds_mn": self.error_thirds_mn.tolist()}


class Margin(NamedTuple):
    """Smallest margin of a level below the threshold of a hand.

    `db`: decibels. `third_hz`: the third of an octave in which it occurs.
    """

    db: float
    third_hz: float


def margin_of(levels_mn: Float64s, threshold: VibrationThreshold | None = None) -> Margin:
    """Smallest margin of third-octave levels below a threshold.

    `levels_mn`: rms millinewtons, float64 [11]. The margin is +inf dB if all levels are 0. `threshold` is by
    default that of `vibration_threshold`.
    """
    limit_mn = (threshold or vibration_threshold()).force_rms_mn()
    with np.errstate(divide="ignore"):
        margins_db = 20 * np.log10(limit_mn / levels_mn)
    worst = int(np.argmin(margins_db))
    return Margin(float(margins_db[worst]), THIRDS_HZ[worst])


class SlideMeter:
    """Measurement of slides over the frames of a medium; each frame has its own paths."""

    def __init__(self, spec: SlideSpec | None = None) -> None:
        self._spec = spec or SlideSpec()
        self._sums = {speed: BandSums(3) for speed in SPEEDS_MM_S}  # error, source, lattice
        self._paths = dict.fromkeys(SPEEDS_MM_S, 0)
        self._rng = np.random.default_rng(self._spec.seed)

    def add(self, surface: ForceField, source: Forces, decoded: Forces, exact: Forces | None = None) -> None:
        """Measure one frame; a frame without a surface adds nothing.

        surface : ForceField; of the source. The paths follow it, so that they are the same for several
            codings.
        exact : callable, optional; the field that the source samples.
        """
        spec = self._spec
        total_s = spec.duration_s + 2 * MARGIN_S + 0.05
        walks = surface_walks(surface, total_s * max(self._sums) * 1e-3, spec.paths, self._rng)
        for speed, total in self._sums.items():
            for points in slide_m(walks, speed * 1e-3, total_s, spec.rate_hz):
                if len(points) < (MIN_DURATION_S + 2 * MARGIN_S) * spec.rate_hz:
                    continue
                flat = points.reshape(-1, 3)
                source_n, decoded_n = (
                    np.asarray(forces(flat), np.float64).reshape(points.shape) for forces in (source, decoded)
                )
                total.add(0, decoded_n - source_n, spec.rate_hz, len(points))
                total.add(1, source_n, spec.rate_hz)
                if exact is not None:
                    total.add(2, source_n - np.reshape(exact(flat), points.shape), spec.rate_hz)
                self._paths[speed] += points.shape[1]

    def slides(self) -> tuple[Slide, ...]:
        """The results, one for each speed."""
        results = []
        for speed, total in self._sums.items():
            error, source, lattice = (total.mn(kind) for kind in range(3))
            seconds = float(total.samples[0]) / self._spec.rate_hz
            lattice_mn = lattice[0] if total.samples[2] else None
            results.append(
                Slide(speed, self._paths[speed], seconds, *error, *source, lattice_mn, total.thirds_mn())
            )
        return tuple(results)


def slides(
    source: ForceField, decoded: ForceField, spec: SlideSpec | None = None, exact: Forces | None = None
) -> tuple[Slide, ...]:
    """Measure the slides of one frame at 50, 100 and 200 mm/s; see `SlideMeter`."""
    meter = SlideMeter(spec)
    meter.add(source, source.sample_n, decoded.sample_n, exact)
    return meter.slides()


# -- both, and a hand that holds still ---------------------------------------------------------------------
@dataclass(frozen=True)
class HandMotion:
    """Error of a decoded medium that reaches a moving hand and a hand at rest.

    The error is decoded minus source. `hold` is None for a single frame.
    """

    slides: tuple[Slide, ...]
    hold: Hold | None
    threshold: VibrationThreshold

    @property
    def measured(self) -> list[Slide | Hold]:
        """The slides and the hold for which something was measured."""
        holds = () if self.hold is None or self.hold.error_mn is None else (self.hold,)
        return [*(s for s in self.slides if s.paths), *holds]

    @property
    def loudest(self) -> Slide | Hold | None:
        """The slides or the hold with the largest rms error; None if nothing was measured."""
        return max(self.measured, key=lambda part: part.error_mn or 0.0, default=None)

    @property
    def margin(self) -> Margin:
        """The smallest margin below the threshold, over slides and hold."""
        margins = (margin_of(part.error_thirds_mn, self.threshold) for part in self.measured)
        return min(margins, default=Margin(math.inf, THIRDS_HZ[0]))

    def summary(self) -> dict[str, Any]:
        """Stable keys for people and programs; None for figures that were not measured."""
        part, margin = self.loudest, self.margin
        return {
            "hand_vibration_mn": part.error_mn if part else None,
            "hand_vibration_peak_mn": part.error_peak_mn if part else None,
            "hand_vibration_source_mn": part.source_mn if part else None,
            "hand_vibration_lattice_mn": part.lattice_mn if isinstance(part, Slide) else None,
            "hand": self.threshold.name,
            "threshold_verified": self.threshold.impedance_verified,
            "threshold_margin_db": margin.db if math.isfinite(margin.db) else None,
            "threshold_margin_third_hz": margin.third_hz if math.isfinite(margin.db) else None,
            "slides": [s.summary() for s in self.slides],
            "hold": None if self.hold is None else self.hold.summary(),
        }


class Hold(NamedTuple):
    """Forces on a hand at rest over the frames of a medium, millinewtons."""

    points: int
    steps: int  # changes from a frame to the next, summed over all points
    step_mn: float  # the largest step of the output, and the step of the source there
    step_source_mn: float
    start_step_mn: float  # the same, of steps at the start of a segment
    start_step_source_mn: float
    start_error_mn: float  # step of output minus source, rms: at the start of a segment, and elsewhere
    error_step_mn: float
    # the largest step, and the largest step over max(F_0, k |F|), where the source makes no step
    # (`NO_STEP_N`)
    still_step_mn: float
    still_step_ratio: float
    # error from 40 to 400 Hz, rms and largest value; None for a medium below 0.25 s
    error_mn: float | None
    error_peak_mn: float | None
    source_mn: float | None
    error_thirds_mn: Float64s  # float64 [11]; in each third of an octave

    def summary(self) -> dict[str, Any]:
        """Stable keys for people and programs."""
        return self._asdict() | {"error_thirds_mn": self.error_thirds_mn.tolist()}


class HoldMeter:
    """Measurement of the steps that a hand at rest feels over the frames of a medium.

    Steps are compared with the mask max(F_0, k |F|), with F_0 positive. The frames are divided into parts,
    each with its own points. Forces of a part are float64 [source and output, frames, points, 3].
    """

    def __init__(self, frame_count: int, rate_hz: float, k: Weber, f0_n: float, points: int = 64) -> None:
        self._rate_hz, self._k, self._f0_n, self._count = rate_hz, k, f0_n, points
        part = max(math.ceil(frame_count / _PARTS), math.ceil(_PART_S * rate_hz))
        self._part, self._frames_remaining = min(part, _MAX_FRAMES), frame_count
        self._rng = np.random.default_rng(0)
        self._points_m = np.zeros((0, 3))
        self._forces: list[Float64s] = []
        self._starts: list[bool] = []
        self._points = self._steps = 0
        self._largest = {"any": (0.0, 0.0), "start": (0.0, 0.0)}
        self._errors = {True: (0.0, 0), False: (0.0, 0)}
        self._without_source_step = 0.0, 0.0
        self._band = BandSums(2)  # error, source

    def add(self, surface: ForceField, source: Forces, played: Forces, starts_segment: bool) -> None:
        """Add the next frame.

        `surface` is the field of the source, on which points are seeded; `played` is the output of the
        receiver.
        """
        forces = (source, played)
        self._sample_forces(forces, starts_segment)
        self._frames_remaining -= 1
        # the last frame of a part is the first of the next one, so that no step is missed; a short rest joins
        # the part before
        if (len(self._starts) > self._part and self._frames_remaining >= self._part // 2) or not self._starts:
            self._close()
            self._points_m = points_on_surface(surface, self._count, self._rng)
            self._sample_forces(forces, starts_segment)

    def hold(self) -> Hold:
        """The result of all frames."""
        self._close()
        start, other = (1e3 * math.sqrt(p / max(1, n)) for p, n in (self._errors[True], self._errors[False]))
        (step, source_step), (step_at_start, source_step_at_start) = (
            self._largest["any"],
            self._largest["start"],
        )
        (rms, peak), (source, _) = self._band.mn(0), self._band.mn(1)
        has_band = self._band.samples[0] > 0
        return Hold(
            self._points, self._steps, 1e3 * step, 1e3 * source_step, 1e3 * step_at_start, 1e3 *
            source_step_at_start, start, other, 1e3 * self._without_source_step[0],
            self._without_source_step[1], rms if has_band else None, peak if has_band else None, source if
            has_band else None, self._band.thirds_mn(),
        )  # fmt: skip

    def _sample_forces(self, sources: tuple[Forces, Forces], starts_segment: bool) -> None:
        if len(self._points_m):
            self._forces.append(
                np.stack([np.asarray(forces(self._points_m), np.float64) for forces in sources])
            )
            self._starts.append(starts_segment)

    def _close(self) -> None:
        if len(self._starts) > 1:
            forces_n = np.stack(self._forces, axis=1)
            self._add_steps(forces_n, np.array(self._starts[1:]))
            self._add_band(forces_n)
        self._points += len(self._points_m)
        self._forces, self._starts, self._points_m = [], [], np.zeros((0, 3))

    def _add_steps(self, forces_n: Float64s, starts: Bools) -> None:
        """Count the steps of a part."""
        change = np.diff(forces_n, axis=1)
        source, decoded = lengths_of(change)
        error = ((change[1] - change[0]) ** 2).sum(axis=-1)
        self._steps += decoded.size
        for name, selected in (("any", slice(None)), ("start", starts)):
            if decoded[selected].size:
                worst = int(np.argmax(decoded[selected]))
                step = float(decoded[selected].flat[worst]), float(source[selected].flat[worst])
                self._largest[name] = max(self._largest[name], step)
        for is_start in (True, False):
            power, count = self._errors[is_start]
            errors = error[starts == is_start]
            self._errors[is_start] = power + float(errors.sum()), count + errors.size
        is_constant = source <= NO_STEP_N
        allowed_n = mask_n(lengths_of(forces_n[0]), self._k, self._f0_n)
        ratio = decoded / np.minimum(allowed_n[1:], allowed_n[:-1])
        largest, worst_ratio = (float(values[is_constant].max(initial=0.0)) for values in (decoded, ratio))
        self._without_source_step = (
            max(self._without_source_step[0], largest),
            max(self._without_source_step[1], worst_ratio),
        )

    def _add_band(self, forces_n: Float64s) -> None:
        """Add the band of a part; a part below 0.25 s is omitted."""
        from scipy.interpolate import make_interp_spline

        frames = forces_n.shape[1]
        servo_hz = max(_SERVO_HZ, self._rate_hz)
        at = np.arange(0.0, frames - 1 + 1e-9, self._rate_hz / servo_hz)
        if len(at) < MIN_DURATION_S * servo_hz:
            return
        margin, at_once = ((round(MARGIN_S * servo_hz),) * 2, (0, 0), (0, 0)), max(1, _AT_ONCE // len(at))
        for first in range(0, forces_n.shape[2], at_once):
            chunk = forces_n[:, :, first : first + at_once]
            source, decoded = make_interp_spline(np.arange(frames), chunk, k=1, axis=1)(at)
            self._band.add(0, np.pad(decoded - source, margin, "edge"), servo_hz, len(at))
            self._band.add(1, np.pad(source, margin, "edge"), servo_hz)
