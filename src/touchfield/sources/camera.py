"""A pinhole camera; depth sequences, whatever their layout on disk; and a sequence at another rate.

The paper (section 5.1, scene 2) makes 800 frames at 1 kHz of 20 depth maps by linear interpolation and gives
no formula. Here frame j shows the source at t = j / rate, and a source frame i stands at t = i / source rate,
so that 20 frames at 25 Hz are 20 / 25 s * 1000 Hz = 800 frames. There are only 19 intervals: from the last
picture on, it is held (the last 40 of those 800).

Depth maps are interpolated pixel by pixel, without regard to motion. Between a near and a far thing that take
turns at a pixel, a linear rule gives depths at which there is nothing: a surface that floats between the two,
which "nearest" avoids. A lower rate than the source's picks and interpolates in the same way, without a
low-pass.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Float32s, Float64s
from touchfield.errors import InvalidArgument, require_one_of, require_positive
from touchfield.medium.pose_track import quaternions_of, rotation_matrices
from touchfield.sources.poses import checked_poses, poses_between

DEFAULT_RATE_HZ: Final = 30.0

INTERPOLATIONS: Final = ("linear", "nearest")

STEP_RANGE_PER_M: Final = (5e-4, 2e-2)  # bounds of the noise step g, 1/m: 0.5 mm to 2 cm at a depth of 1 m
MAX_FRAMES: Final = 1 << 20  # frames of the longest interpolated sequence: 17 minutes at 1 kHz
_SNAP_FRAMES: Final = 1e-6  # times this close to a source frame, in frames, show that frame and no mixture
_KEPT = 3  # decoded source frames: two neighbours, and one more for a pass backwards


@dataclass(frozen=True)
class Intrinsics:
    """A pinhole camera, all in pixels: u = fx x / z + cx, v = fy y / z + cy; pixel centres are whole numbers."""

    fx: float
    fy: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        for name in ("fx", "fy", "cx", "cy"):
            value = float(getattr(self, name))
            if not math.isfinite(value) or (name[0] == "f" and value <= 0):
                raise InvalidArgument(
                    "intrinsics", f"{name} = {value}", "finite pixels, focal lengths positive"
                )


def require_frame(frame: int, count: int, name: str = "") -> None:
    """`InvalidArgument` unless there is a frame of that number."""
    if not 0 <= frame < count:
        raise InvalidArgument(f"{name}, frame" if name else "frame", str(frame), f"0 to {count - 1}")


class DepthSequence(ABC):
    """Depth frames of one camera, read when they are asked for."""

    name: str  # to call it in messages (the path)
    frame_count: int
    width: int  # pixels, the same for every frame
    height: int
    intrinsics: Intrinsics
    rate_hz: float
    poses: Float64s | None = None  # [frame_count, 4, 4], camera to world, metres
    is_captured = False  # a frame is taken when it is asked for: none is there ahead, and old ones are gone
    notes: tuple[str, ...] = ()  # what the user should be told

    @abstractmethod
    def depth_m(self, frame: int) -> Float32s:
        """Depth along the optical axis, metres, float32 [height, width], C-contiguous; 0 where unknown."""

    def key_frames(self) -> Sequence[int]:
        """Frames that show between them what all show: those that are not interpolated."""
        return range(self.frame_count)


def noise_step_per_m(depth_m: Float32s) -> float:
    """The step g, 1/m, up to which neighbouring inverse depths are taken for one surface.

    2.5 times the upper quartile of the second differences of w along about 16 rows. Measured, that
    is 0.0073 for a Kinect (TUM fr1; its quantum is 0.0029) and 0.0005 for rendered depth in millimetres
    (ICL-NUIM); edges begin at the 98th percentile and hardly move it. The smoother a sensor, the lower the
    steps that are seen.
    """
    depth = depth_m[:: max(1, depth_m.shape[0] // 16)]
    known = depth > 0
    inverse = np.divide(1.0, depth, out=np.zeros(depth.shape, np.float32), where=known)
    inside = known[:, :-2] & known[:, 1:-1] & known[:, 2:]
    bends = np.abs(inverse[:, :-2] - 2 * inverse[:, 1:-1] + inverse[:, 2:])[inside]
    at = 3 * bends.size // 4
    quartile = float(np.partition(bends, at)[at]) if bends.size else 0.0
    return float(np.clip(2.5 * quartile, *STEP_RANGE_PER_M))


class Frames(Protocol):
    """Stored numbers over time; `size` is width and height."""

    frame_count: int
    size: tuple[int, int]

    def values(self, frame: int) -> NDArray[Any]:
        """The numbers of one frame, [height, width]."""


@dataclass(frozen=True)
class DepthCode:
    """How a stored value becomes metres: `units_per_m` stored units are one.

    `is_rotated` means SUN3D's bits: value = (v >> 3) | (v << 13) in 16 bits.
    """

    units_per_m: float
    is_rotated: bool = False

    def __call__(self, values: NDArray[Any]) -> Float32s:
        """Depth in metres, float32, of stored values of any numeric type; 0 where unknown.

        Unknown are 0, negative values and what is not finite; and 65535 in 16 bits, by the 7-Scenes and
        3DMatch convention and as the end of the scale elsewhere.
        """
        if self.is_rotated:
            values = ((values >> 3) | (values << 13)).astype(np.uint16)
        with np.errstate(over="ignore"):  # what float32 cannot hold becomes inf, and so unknown
            depth: Float32s = np.divide(values, self.units_per_m, dtype=np.float64).astype(
                np.float32, order="C"
            )
        depth[~(np.isfinite(depth) & (depth > 0))] = 0
        if values.dtype == np.uint16:
            depth[values == 0xFFFF] = 0
        return depth


class CodedSequence(DepthSequence):
    """Depth frames that are stored as other numbers, which `metres` makes depth of."""

    def __init__(
        self,
        name: str,
        frames: Frames,
        metres: Callable[[NDArray[Any]], Float32s],
        intrinsics: Intrinsics,
        rate_hz: float,
        notes: tuple[str, ...] = (),
    ) -> None:
        self.name, self.frames, self.metres, self.notes = name, frames, metres, notes
        self.intrinsics, self.rate_hz, self.frame_count = intrinsics, rate_hz, frames.frame_count
        self.width, self.height = frames.size

    def depth_m(self, frame: int) -> Float32s:
        require_frame(frame, self.frame_count, self.name)
        return self.metres(self.frames.values(frame))


class InterpolatedSequence(DepthSequence):
    """A depth sequence at another rate; frame j shows the source at t = j / rate.

    It has round(count / source rate * rate) frames, at least one; one that is past the last picture shows
    that picture. A sequence of a single picture has no duration: it stays one frame. Positions are
    interpolated linearly and rotations along the shortest arc at constant speed (slerp), whatever the rule
    for depth. A pass in order decodes each source frame once. `positions`, float64 [frame_count], is where
    each lies in source frames.
    """

    def __init__(self, source: DepthSequence, rate_hz: float, interpolation: str = "linear") -> None:
        require_one_of("interpolation", interpolation, INTERPOLATIONS)
        require_positive(rate_hz=rate_hz)
        frames = 1.0 if source.frame_count == 1 else source.frame_count / source.rate_hz * rate_hz
        if frames > MAX_FRAMES:
            found = f"{rate_hz:g} Hz: {frames:.3g} frames of {source.frame_count} at {source.rate_hz:.4g} Hz"
            raise InvalidArgument(
                "rate_hz", found, f"at most {MAX_FRAMES} frames", "Ask for a lower --rate-hz."
            )
        self.source, self.interpolation = source, interpolation
        self.name, self.intrinsics = source.name, source.intrinsics
        self.width, self.height = source.width, source.height
        self.frame_count, self.rate_hz = max(1, round(frames)), float(rate_hz)
        at = np.arange(self.frame_count) * source.rate_hz / self.rate_hz
        whole, last = np.rint(at), source.frame_count - 1.0
        self.positions = np.minimum(np.where(np.abs(at - whole) < _SNAP_FRAMES, whole, at), last)
        self._decoded = lru_cache(maxsize=_KEPT)(source.depth_m)
        if source.poses is not None:
            known = checked_poses(np.asarray(source.poses, np.float64), f"{self.name}, poses")
            turns, positions_m = poses_between(
                quaternions_of(known[:, :3, :3]), known[:, :3, 3], self.positions
            )
            self.poses = np.tile(np.eye(4), (self.frame_count, 1, 1))
            self.poses[:, :3, :3], self.poses[:, :3, 3] = rotation_matrices(turns), positions_m
            self.poses.flags.writeable = False
        self.notes = source.notes
        if source.frame_count > 1:
            still = int((self.positions == last).sum())
            hold = f"; the last {still} hold the last picture" if still > 1 else ""
            self.notes += (
                f"{source.frame_count} depth frames at {source.rate_hz:.4g} Hz are interpolated in time "
                f"({interpolation}) to {self.frame_count} at {self.rate_hz:.6g} Hz{hold}.",
            )

    def depth_m(self, frame: int) -> Float32s:
        require_frame(frame, self.frame_count, self.name)
        before, share = divmod(float(self.positions[frame]), 1.0)
        if share == 0.0:
            return self._decoded(int(before)).copy()
        if self.interpolation == "nearest":
            return self._decoded(int(before) + (share >= 0.5)).copy()
        return blend(self._decoded(int(before)), self._decoded(int(before) + 1), share)

    def key_frames(self) -> Sequence[int]:
        """See `DepthSequence.key_frames`: the frame nearest to each of the source."""
        wanted = np.asarray(self.source.key_frames()) * self.rate_hz / self.source.rate_hz
        frames: list[int] = np.unique(np.clip(np.rint(wanted), 0, self.frame_count - 1).astype(int)).tolist()
        return frames


def blend(before_m: Float32s, after_m: Float32s, share: float) -> Float32s:
    """Depth between two frames, as in the paper: before + share (after - before), float32 [height, width],
    metres.

    A pixel that is unknown (0) in either frame is unknown.
    """
    mixed = after_m - before_m
    mixed *= np.float32(share)
    mixed += before_m
    mixed[np.minimum(before_m, after_m) <= 0] = 0
    return mixed


def at_rate(sequence: DepthSequence, rate_hz: float | None, interpolation: str = "linear") -> DepthSequence:
    """A sequence at the rate asked for; the sequence itself where nothing was asked, or it has that rate
    already.
    """
    if rate_hz is None or rate_hz == sequence.rate_hz:
        return sequence
    return InterpolatedSequence(sequence, rate_hz, interpolation)
