"""What a hand that holds still feels of a coder: steps where a frame or a segment starts, and what lies in the band.

The source makes no step where nothing moves; a coder whose errors differ from frame to frame does. Points are seeded
on the surface of a frame and held until the next points are, and the force at each is kept for source and for what a
receiver plays, which may go over from segment to segment; beside it for what is decoded. A step is the change from
one frame to the next; for the band from 40 to 400 Hz the frames are blended linearly up to 1000 samples a second, as
the receiver does.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from touchfield.perception.force_band import LEAST_S, MARGIN_S, in_band, third_octave_power
from touchfield.perception.slides import points_on_surface
from touchfield.perception.vibration_threshold import THIRDS_HZ

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.medium import ForceField
    from touchfield.perception.slides import Forces

    Float64s = NDArray[np.float64]

__all__ = ["STILL_N", "Hold", "HoldMeter"]

STILL_N: Final = 1e-3
"""A source that changes by no more than this makes no step, newtons."""

_PARTS: Final = 4
_PART_S: Final = 0.5
_MOST_FRAMES: Final = 4096
_SERVO_HZ: Final = 1000.0


class Hold(NamedTuple):
    """A hand held still over the frames of a medium; forces in millinewtons.

    points, steps : int; points held, and changes from a frame to the next, summed over all points.
    step_mn, step_source_mn : float; the largest step of the force that is played, and what the source does at that
        point and time.
    start_step_mn, start_step_source_mn : float; the same where a segment starts.
    start_error_mn, error_step_mn : float; step of the error, played less source, rms over points: where a segment
        starts, and elsewhere.
    still_step_mn, still_step_ratio : float; the largest step, and the largest |step| / max(F_0, k |F|), where the
        source makes none (`STILL_N`).
    decoded_start_error_mn, decoded_error_step_mn, decoded_still_step_mn, decoded_still_step_ratio : float; as those
        without "decoded", of the frames as they are decoded.
    error_mn, error_peak_mn, source_mn : float or None; from 40 to 400 Hz: rms and largest of the error, rms of the
        source; None for a medium below 0.25 s.
    error_thirds_mn : float64 [11]; in each third of an octave, rms.
    """

    points: int
    steps: int
    step_mn: float
    step_source_mn: float
    start_step_mn: float
    start_step_source_mn: float
    start_error_mn: float
    error_step_mn: float
    still_step_mn: float
    still_step_ratio: float
    decoded_start_error_mn: float
    decoded_error_step_mn: float
    decoded_still_step_mn: float
    decoded_still_step_ratio: float
    error_mn: float | None
    error_peak_mn: float | None
    source_mn: float | None
    error_thirds_mn: Float64s

    def summary(self) -> dict[str, Any]:
        """Stable keys for people and programs."""
        return self._asdict() | {"error_thirds_mn": [float(v) for v in self.error_thirds_mn]}


class HoldMeter:
    """The holds over the frames of a medium, given one after another.

    rate_hz : float; frames a second.
    k, f0_n : float; the mask max(F_0, k |F|) that steps are measured by; F_0 positive.
    points : int; held at a time.
    """

    def __init__(
        self, frame_count: int, rate_hz: float, k: float, f0_n: float, points: int = 64, seed: int = 0
    ) -> None:
        self._rate_hz, self._k, self._f0_n, self._count = rate_hz, k, f0_n, points
        part = max(math.ceil(frame_count / _PARTS), math.ceil(_PART_S * rate_hz))
        self._part, self._left = min(part, _MOST_FRAMES), frame_count
        self._rng = np.random.default_rng(seed)
        self._points_m = np.zeros((0, 3))
        self._forces: list[Float64s] = []
        self._starts: list[bool] = []
        self._sum, self._decoded_sum = _Sum(), _Sum()

    def add(
        self,
        surface: ForceField,
        source: Forces,
        decoded: Forces,
        starts_segment: bool,
        played: Forces | None = None,
    ) -> None:
        """Feel the next frame.

        surface : ForceField; of the source, to find points on.
        source, decoded : callable; ``forces(points_m [n, 3]) -> newtons [n, 3]``.
        played : callable, optional; what a receiver makes of the frame; by default `decoded`.
        """
        felt = (source, played or decoded, decoded)
        self._feel(felt, starts_segment)
        self._left -= 1
        # the last of a part is the first of the next one, so that no step is missed; a rest too short joins the part
        if (len(self._starts) > self._part and self._left >= self._part // 2) or not self._starts:
            self._close()
            self._points_m = points_on_surface(surface, self._count, self._rng)
            self._feel(felt, starts_segment)

    def hold(self) -> Hold:
        """What was found."""
        self._close()
        return self._sum.hold(self._decoded_sum)

    def _feel(self, felt: tuple[Forces, Forces, Forces], starts_segment: bool) -> None:
        if len(self._points_m):
            self._forces.append(np.stack([np.asarray(forces(self._points_m), np.float64) for forces in felt]))
            self._starts.append(starts_segment)

    def _close(self) -> None:
        if len(self._starts) > 1:
            forces_n, starts = np.stack(self._forces, axis=1), np.array(self._starts[1:])
            self._sum.add_steps(forces_n[:2], starts, self._k, self._f0_n)
            self._decoded_sum.add_steps(forces_n[::2], starts, self._k, self._f0_n)
            self._sum.add_band(forces_n[:2], self._rate_hz)
        self._sum.points += len(self._points_m)
        self._forces, self._starts, self._points_m = [], [], np.zeros((0, 3))


class _Sum:
    """Sums over the parts of a medium; forces float64 [source and what is felt, frames, points, 3]."""

    def __init__(self) -> None:
        self.points = self._steps = self._samples = 0
        self._largest = {"any": (0.0, 0.0), "start": (0.0, 0.0)}
        self._errors = {True: (0.0, 0), False: (0.0, 0)}
        self._still = 0.0, 0.0
        self._power, self._peak = np.zeros(2), 0.0
        self._thirds = np.zeros(len(THIRDS_HZ))

    def add_steps(self, forces_n: Float64s, starts: NDArray[np.bool_], k: float, f0_n: float) -> None:
        """Count the steps of a part."""
        change = np.diff(forces_n, axis=1)
        source, decoded = np.linalg.norm(change, axis=-1)
        error = ((change[1] - change[0]) ** 2).sum(axis=-1)
        self._steps += decoded.size
        for name, which in (("any", slice(None)), ("start", starts)):
            if decoded[which].size:
                worst = int(np.argmax(decoded[which]))
                found = float(decoded[which].flat[worst]), float(source[which].flat[worst])
                self._largest[name] = max(self._largest[name], found)
        for is_start in (True, False):
            power, count = self._errors[is_start]
            some = error[starts == is_start]
            self._errors[is_start] = power + float(some.sum()), count + some.size
        still = source <= STILL_N
        if still.any():
            mask_n = np.maximum(f0_n, k * np.linalg.norm(forces_n[0], axis=-1))
            ratio = decoded / np.minimum(mask_n[1:], mask_n[:-1])
            self._still = (
                max(self._still[0], float(decoded[still].max())),
                max(self._still[1], float(ratio[still].max())),
            )

    def add_band(self, forces_n: Float64s, rate_hz: float) -> None:
        """Add what of a part lies in the band; a part below 0.25 s tells nothing."""
        frames = forces_n.shape[1]
        servo_hz = max(_SERVO_HZ, rate_hz)
        at = np.arange(0.0, frames - 1 + 1e-9, rate_hz / servo_hz)
        if len(at) < LEAST_S * servo_hz:
            return
        low = np.minimum(at.astype(np.int64), frames - 2)
        share = (at - low)[:, None]
        margin = ((round(MARGIN_S * servo_hz),) * 2, (0, 0))
        for point in range(forces_n.shape[2]):
            source, decoded = ((1 - share) * f[low, point] + share * f[low + 1, point] for f in forces_n)
            error = np.pad(decoded - source, margin, "edge")
            squares = (in_band(error, servo_hz) ** 2).sum(axis=1)
            own = (in_band(np.pad(source, margin, "edge"), servo_hz) ** 2).sum()
            self._power += squares.sum(), own
            self._peak = max(self._peak, float(squares.max()))
            self._thirds += len(squares) * third_octave_power(error, servo_hz)
            self._samples += len(squares)

    def error_steps(self) -> tuple[float, float, float, float]:
        """Where a segment starts and elsewhere, rms in millinewtons; the largest at rest, and over the mask."""
        start, other = (1e3 * math.sqrt(p / max(1, n)) for p, n in (self._errors[True], self._errors[False]))
        return start, other, 1e3 * self._still[0], self._still[1]

    def hold(self, decoded: _Sum) -> Hold:
        """All parts together, of what is played; `decoded` are the sums of what is decoded."""
        rms = 1e3 * np.sqrt(self._power / max(1, self._samples))
        (step, own), (at_start, own_at_start) = self._largest["any"], self._largest["start"]
        is_known = self._samples > 0
        return Hold(
            self.points,
            self._steps,
            1e3 * step,
            1e3 * own,
            1e3 * at_start,
            1e3 * own_at_start,
            *self.error_steps(),
            *decoded.error_steps(),
            float(rms[0]) if is_known else None,
            1e3 * math.sqrt(self._peak) if is_known else None,
            float(rms[1]) if is_known else None,
            1e3 * np.sqrt(self._thirds / max(1, self._samples)),
        )
