"""What a hand that slides along a surface feels of the difference between two fields.

A mask bounds the error of each sample. A hand that moves meets one sample after another, so that an error that
differs from one to the next becomes vibration: e(t) = F_decoded(x(t)) - F_source(x(t)), both interpolated as the
receiver does, along seeded paths at three speeds (`slides`), in the band from 40 to 400 Hz (`force_band`). Beside it
stand what the source itself has in that band on the same paths, and what its lattice adds to the field that it
samples, where that field can be evaluated. Nothing here tells that an error cannot be felt: a threshold is of one
sine, of some people, under some conditions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.perception.force_band import LEAST_S, MARGIN_S, in_band, third_octave_power
from touchfield.perception.holds import Hold
from touchfield.perception.slides import slide_m, surface_walks
from touchfield.perception.vibration_threshold import THIRDS_HZ, VibrationThreshold, vibration_threshold

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.medium import ForceField
    from touchfield.perception.slides import Forces

    Float64s = NDArray[np.float64]

__all__ = ["SPEEDS_MM_S", "HandMotion", "Margin", "Slide", "SlideMeter", "SlideSpec", "margin_of", "slides"]

SPEEDS_MM_S: Final = (50.0, 100.0, 200.0)


@dataclass(frozen=True)
class SlideSpec:
    """Which slides are measured.

    paths : int; of each frame, 1 to 1024.
    duration_s : float; of a slide, its margins left out; at least 0.25 s.
    rate_hz : float; samples a second, 1000 or more: what lies above half of it is felt below, as with a device that
        is driven at this rate.
    """

    paths: int = 16
    duration_s: float = 0.5
    rate_hz: float = 1000.0
    seed: int = 0

    def __post_init__(self) -> None:
        if not 1 <= self.paths <= 1024:
            raise InvalidArgument("paths", repr(self.paths), "1 to 1024")
        if not LEAST_S <= self.duration_s <= 60:
            raise InvalidArgument("duration_s", repr(self.duration_s), f"{LEAST_S:g} to 60 s")
        if not 1000 <= self.rate_hz <= 1e5:
            raise InvalidArgument("rate_hz", repr(self.rate_hz), "1000 to 100000 Hz")


class Slide(NamedTuple):
    """The slides at one speed, in the band from 40 to 400 Hz; means are of the square, over all paths.

    paths : int; measured; 0 where no surface was long enough, and all figures are then 0.
    seconds : float; together, margins left out.
    error_mn, error_peak_mn : float; of decoded less source, millinewtons: rms and largest length of the vector.
    source_mn, source_peak_mn : float; of the source alone.
    lattice_mn : float or None; of the source less the field that it samples; None where that is not known.
    error_thirds_mn, source_thirds_mn : float64 [11]; in each third of an octave of `THIRDS_HZ`, rms.
    """

    speed_mm_s: float
    paths: int
    seconds: float
    error_mn: float
    error_peak_mn: float
    source_mn: float
    source_peak_mn: float
    lattice_mn: float | None
    error_thirds_mn: Float64s
    source_thirds_mn: Float64s

    def summary(self) -> dict[str, Any]:
        """Stable keys for people and programs."""
        told = {name: value for name, value in self._asdict().items() if not name.endswith("thirds_mn")}
        return told | {"error_thirds_mn": [float(v) for v in self.error_thirds_mn]}


class Margin(NamedTuple):
    """How far a level stays below the threshold of a hand, decibels, in the third of an octave where it is least."""

    db: float
    third_hz: float


def margin_of(levels_mn: Float64s, threshold: VibrationThreshold | None = None) -> Margin:
    """Least margin of rms levels in millinewtons, float64 [11], to a threshold; +inf dB for none at all."""
    limit_mn = (threshold or vibration_threshold()).force_rms_mn()
    with np.errstate(divide="ignore"):
        margins_db = 20 * np.log10(limit_mn / levels_mn)
    worst = int(np.argmin(margins_db))
    return Margin(float(margins_db[worst]), THIRDS_HZ[worst])


class SlideMeter:
    """The slides over the frames of a medium, one after another; each frame has paths of its own."""

    def __init__(self, spec: SlideSpec | None = None, speeds_mm_s: tuple[float, ...] = SPEEDS_MM_S) -> None:
        self._spec = spec or SlideSpec()
        self._sums = {speed: _Sum() for speed in speeds_mm_s}
        self._rng = np.random.default_rng(self._spec.seed)

    def add(self, surface: ForceField, source: Forces, decoded: Forces, exact: Forces | None = None) -> None:
        """Measure one frame; without a surface in it nothing is added.

        surface : ForceField; of the source, which the paths follow: several codings of it are compared on the same
            ones.
        source, decoded : callable; ``forces(points_m [n, 3]) -> newtons [n, 3]``.
        exact : callable, optional; the field that the source samples.
        """
        spec = self._spec
        whole_s = spec.duration_s + 2 * MARGIN_S + 0.05
        walks = surface_walks(surface, whole_s * max(self._sums) * 1e-3, spec.paths, self._rng)
        for speed, total in self._sums.items():
            for walk in range(len(walks.steps)):
                points = slide_m(walks, walk, speed * 1e-3, whole_s, spec.rate_hz)
                if len(points) < (LEAST_S + 2 * MARGIN_S) * spec.rate_hz:
                    continue
                ours, theirs = (np.asarray(forces(points), np.float64) for forces in (source, decoded))
                lattice = None if exact is None else ours - exact(points)
                total.add(theirs - ours, ours, lattice, spec.rate_hz)

    def slides(self) -> tuple[Slide, ...]:
        """What was found, one for each speed."""
        return tuple(total.slide(speed, self._spec.rate_hz) for speed, total in self._sums.items())


def slides(
    source: ForceField, decoded: ForceField, spec: SlideSpec | None = None, exact: Forces | None = None
) -> tuple[Slide, ...]:
    """Measure the slides of one frame at 50, 100 and 200 mm/s; see `SlideMeter`."""
    meter = SlideMeter(spec)
    meter.add(source, source.sample_n, decoded.sample_n, exact)
    return meter.slides()


@dataclass(frozen=True)
class HandMotion:
    """What a hand that moves, and one that holds still, feels of decoded less source.

    hold : Hold or None; None for a medium of one frame.
    """

    slides: tuple[Slide, ...]
    hold: Hold | None
    threshold: VibrationThreshold

    @property
    def loudest(self) -> Slide | Hold | None:
        """The slides or the hold whose error is the largest rms; None where nothing was measured."""
        parts: list[Slide | Hold] = [s for s in self.slides if s.paths]
        if self.hold is not None and self.hold.error_mn is not None:
            parts.append(self.hold)
        return max(parts, key=lambda part: part.error_mn or 0.0, default=None)

    @property
    def margin(self) -> Margin:
        """The least margin to the threshold, over slides and hold."""
        every = [margin_of(part.error_thirds_mn, self.threshold) for part in self.slides]
        if self.hold is not None:
            every.append(margin_of(self.hold.error_thirds_mn, self.threshold))
        return min(every, default=Margin(math.inf, THIRDS_HZ[0]))

    def summary(self) -> dict[str, Any]:
        """Stable keys for people and programs; a figure is None where nothing was measured."""
        part, margin = self.loudest, self.margin
        return {
            "hand_vibration_mn": part.error_mn if part else None,
            "hand_vibration_peak_mn": part.error_peak_mn if part else None,
            "hand_vibration_source_mn": part.source_mn if part else None,
            "hand_vibration_lattice_mn": part.lattice_mn if isinstance(part, Slide) else None,
            "hand": self.threshold.name,
            "threshold_margin_db": margin.db if math.isfinite(margin.db) else None,
            "threshold_margin_third_hz": margin.third_hz if math.isfinite(margin.db) else None,
            "slides": [s.summary() for s in self.slides],
            "hold": None if self.hold is None else self.hold.summary(),
        }


class _Sum:
    """Sums of squares over the slides at one speed: error, source, lattice."""

    def __init__(self) -> None:
        self._paths = self._samples = self._whole = self._known = 0
        self._power, self._peak = np.zeros(3), np.zeros(3)
        self._thirds = np.zeros((2, len(THIRDS_HZ)))

    def add(self, error: Float64s, source: Float64s, lattice: Float64s | None, rate_hz: float) -> None:
        for i, signal in enumerate((error, source, lattice)):
            if signal is None:
                continue
            squares = (in_band(signal, rate_hz) ** 2).sum(axis=1)
            self._power[i] += squares.sum()
            self._peak[i] = max(self._peak[i], squares.max())
            if i < 2:
                self._thirds[i] += len(signal) * third_octave_power(signal, rate_hz)
            else:
                self._known += len(squares)
        self._paths += 1
        self._samples += len(squares)
        self._whole += len(error)

    def slide(self, speed_mm_s: float, rate_hz: float) -> Slide:
        counts = np.maximum([self._samples, self._samples, self._known], 1)
        rms, peak = 1e3 * np.sqrt(self._power / counts), 1e3 * np.sqrt(self._peak)
        thirds = 1e3 * np.sqrt(self._thirds / max(1, self._whole))
        return Slide(
            speed_mm_s,
            self._paths,
            self._samples / rate_hz,
            float(rms[0]),
            float(peak[0]),
            float(rms[1]),
            float(peak[1]),
            float(rms[2]) if self._known else None,
            thirds[0],
            thirds[1],
        )
