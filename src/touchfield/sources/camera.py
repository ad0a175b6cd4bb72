"""Pinhole cameras and sequences of depth images, and their resampling to another frame rate. All sources of
depth use it.

The paper (section 5.1, scene 2) makes 800 frames at 1 kHz from 20 depth maps by linear interpolation, without
a formula. Here frame j shows the source at t = j / rate, and source frame i lies at t = i / source rate, so
that 20 frames at 25 Hz become 20 / 25 s * 1000 Hz = 800 frames. These span 19 intervals only: after the last
picture, that picture is repeated (the last 40 of the 800 frames).

Depth maps are interpolated pixel by pixel, without motion estimation. Where a pixel changes between a near
and a far object, linear interpolation yields depths in between, a surface that does not exist; "nearest"
avoids this. A rate below that of the source takes samples in the same way, without a low-pass filter.
"""

from __future__ import annotations

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
from touchfield.sources.poses import checked_poses, interpolate_poses

DEFAULT_RATE_HZ: Final = 30.0

INTERPOLATIONS: Final = ("linear", "nearest")

STEP_RANGE_PER_M: Final = (5e-4, 2e-2)  # limits of the noise step g, 1/m: 0.5 mm to 2 cm at a depth of 1 m
_MIN_DEPTH_M: Final = 1e-18  # float32 holds its inverse, and products of that
MAX_PX: Final = 1e12  # of a focal length, its inverse and a centre: float32 holds products of two
MAX_FRAMES: Final = 1 << 20  # frames of the longest interpolated sequence: 17 minutes at 1 kHz
_SNAP_FRAMES: Final = 1e-6
"""Times this close to a source frame, in frames, show that frame without interpolation."""
_STORED_BYTES: Final = 32 << 20  # of decoded pictures: 54 of 640 x 480 with 16 bits
_CACHED_FRAMES = 3  # decoded source frames: two neighbours, and one more for a backward pass


@dataclass(frozen=True)
class Intrinsics:
    """A pinhole camera, in pixels: u = fx x / z + cx, v = fy y / z + cy.

    Pixel centres are whole numbers.
    """

    fx: float
    fy: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        for name in ("fx", "fy", "cx", "cy"):
            value = float(getattr(self, name))
            is_focal = name[0] == "f"
            if not abs(value) <= MAX_PX or (is_focal and value < 1 / MAX_PX):
                least = f"{1 / MAX_PX:g}" if is_focal else f"-{MAX_PX:g}"
                raise InvalidArgument("intrinsics", f"{name} = {value}", f"{least} to {MAX_PX:g} pixels")


def require_frame(frame: int, count: int, name: str = "") -> None:
    """Raise `InvalidArgument` unless there is a frame of that number."""
    if not 0 <= frame < count:
        raise InvalidArgument(f"{name}, frame" if name else "frame", str(frame), f"0 to {count - 1}")


class DepthSequence(ABC):
    """Depth frames of one camera, read on demand."""

    name: str  # its name in messages (the path)
    frame_count: int
    width: int  # pixels, the same for every frame
    height: int
    intrinsics: Intrinsics
    rate_hz: float
    poses: Float64s | None = None  # [frame_count, 4, 4], camera to world, metres
    frame_names: tuple[str, ...] = ()  # names of the files of the frames, if each has one
    has_quaternions = False  # the file of poses has quaternions, whose order may be another
    has_wrong_poses = False  # poses and depth disagree (see `depth.pose_check`)
    is_unit_assumed = False  # neither a file nor an option gives the unit of depth
    is_captured = False  # live source: a frame is captured on request, and old frames are gone
    notes: tuple[str, ...] = ()  # messages for the user

    @abstractmethod
    def depth_m(self, frame: int) -> Float32s:
        """Return depth along the optical axis, metres, float32 [height, width].

        Unknown pixels are 0. The array is C-contiguous.
        """

    def skip_frame(self, frame: int) -> None:  # noqa: B027  (stored frames are read in any order)
        """Take notice that a live sender leaves out a frame. By default nothing changes."""

    def key_frames(self) -> Sequence[int]:
        """Return the frames that hold all information: those that are not interpolated."""
        return range(self.frame_count)


def noise_step_per_m(depth_m: Float32s) -> float:
    """Estimate the noise step g, 1/m, of a depth map.

    Neighbouring inverse depths that differ by at most g belong to one surface.

    2.5 times the upper quartile of the second differences of w = 1/z along about 16 rows. Measured: 0.0073
    for a Kinect (TUM fr1; its quantum is 0.0029) and 0.0005 for rendered depth in millimetres (ICL-NUIM);
    edges start at the 98th percentile and hardly change it. The smoother the sensor, the smaller the steps
    detected.
    """
    depth = depth_m[:: max(1, depth_m.shape[0] // 16)]
    is_known = depth > 0
    inverse = np.divide(1.0, depth, out=np.zeros(depth.shape, np.float32), where=is_known)
    is_inside = is_known[:, :-2] & is_known[:, 1:-1] & is_known[:, 2:]
    bends = np.abs(inverse[:, :-2] - 2 * inverse[:, 1:-1] + inverse[:, 2:])[is_inside]
    rank = 3 * bends.size // 4
    quartile = float(np.partition(bends, rank)[rank]) if bends.size else 0.0
    return float(np.clip(2.5 * quartile, *STEP_RANGE_PER_M))


class Frames(Protocol):
    """Stored values over time; `size` is width and height."""

    frame_count: int
    size: tuple[int, int]

    def values(self, frame: int) -> NDArray[Any]:
        """Return the values of one frame, [height, width]."""


@dataclass(frozen=True)
class DepthCode:
    """Conversion of stored values to metres: `units_per_m` stored units are one metre.

    `is_rotated` selects SUN3D's bit order: value = (v >> 3) | (v << 13) in 16 bits.
    """

    units_per_m: float
    is_rotated: bool = False

    def __call__(self, values: NDArray[Any]) -> Float32s:
        """Convert stored values of any numeric type to depth in metres, float32.

        Unknown values become 0. 0, negative, non-finite and vanishing values are unknown, and so is 65535 in
        16 bits: by convention in 7-Scenes and 3DMatch, elsewhere as the end of the scale.
        """
        if self.is_rotated:
            values = ((values >> 3) | (values << 13)).astype(np.uint16)
        with np.errstate(over="ignore", invalid="ignore"):  # inf and NaN are unknown
            depth: Float32s = np.divide(values, self.units_per_m, dtype=np.float64).astype(
                np.float32, order="C"
            )
        depth[~(np.isfinite(depth) & (depth > _MIN_DEPTH_M))] = 0
        if values.dtype == np.uint16:
            depth[values == 0xFFFF] = 0
        return depth


class CodedSequence(DepthSequence):
    """Depth frames stored as other values, which `metres` converts to depth.

    The first frames that are requested stay in memory as stored, up to `_STORED_BYTES`: checks, placement and
    encoding read the same ones.
    """

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
        self._stored: dict[int, NDArray[Any]] = {}

    def stored_values(self, frame: int) -> NDArray[Any]:
        """Return the stored values of a frame, [height, width], which must not be changed."""
        require_frame(frame, self.frame_count, self.name)
        values = self._stored.get(frame)
        if values is None:
            values = self.frames.values(frame)
            if (len(self._stored) + 1) * values.nbytes <= _STORED_BYTES:
                self._stored[frame] = values
        return values

    def depth_m(self, frame: int) -> Float32s:
        return self.metres(self.stored_values(frame))


class InterpolatedSequence(DepthSequence):
    """A depth sequence at another rate; frame j shows the source at t = j / rate.

    It has round(count / source rate * rate) frames, at least one; a frame after the last picture shows that
    picture. A sequence of a single picture has no duration and stays one frame. Positions of poses are
    interpolated linearly and rotations along the shortest arc at constant speed (slerp), whatever the method
    for depth. A pass in order decodes each source frame once. `positions`, float64 [frame_count], are the
    times of the frames in units of source frames.
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
        positions = np.arange(self.frame_count) * source.rate_hz / self.rate_hz
        nearest, last = np.rint(positions), source.frame_count - 1.0
        self.positions = np.minimum(
            np.where(np.abs(positions - nearest) < _SNAP_FRAMES, nearest, positions), last
        )
        self._decoded = lru_cache(maxsize=_CACHED_FRAMES)(source.depth_m)
        if source.poses is not None:
            poses = checked_poses(np.asarray(source.poses, np.float64), f"{self.name}, poses")
            quaternions, positions_m = interpolate_poses(
                quaternions_of(poses[:, :3, :3]), poses[:, :3, 3], self.positions
            )
            self.poses = np.tile(np.eye(4), (self.frame_count, 1, 1))
            self.poses[:, :3, :3], self.poses[:, :3, 3] = rotation_matrices(quaternions), positions_m
            self.poses.flags.writeable = False
        self.notes = source.notes
        if source.frame_count > 1:
            repeat_count = int((self.positions == last).sum())
            repeat_note = f"; the last {repeat_count} repeat the last picture" if repeat_count > 1 else ""
            self.notes += (
                f"{source.frame_count} depth frames at {source.rate_hz:.4g} Hz are interpolated in time "
                f"({interpolation}) to {self.frame_count} at {self.rate_hz:.6g} Hz{repeat_note}.",
            )

    def depth_m(self, frame: int) -> Float32s:
        require_frame(frame, self.frame_count, self.name)
        before, fraction = divmod(float(self.positions[frame]), 1.0)
        if fraction == 0.0:
            return self._decoded(int(before)).copy()
        if self.interpolation == "nearest":
            return self._decoded(int(before) + (fraction >= 0.5)).copy()
        return interpolate_depth(self._decoded(int(before)), self._decoded(int(before) + 1), fraction)

    def key_frames(self) -> Sequence[int]:
        """See `DepthSequence.key_frames`: the frame nearest to each key frame of the source."""
        positions = np.asarray(self.source.key_frames()) * self.rate_hz / self.source.rate_hz
        frames: list[int] = np.unique(
            np.clip(np.rint(positions), 0, self.frame_count - 1).astype(int)
        ).tolist()
        return frames


def interpolate_depth(before_m: Float32s, after_m: Float32s, fraction: float) -> Float32s:
    """Interpolate depth maps, metres: before + fraction (after - before).

    All are float32 [height, width].

    As in the paper. A pixel that is unknown (0) in either frame is unknown.
    """
    mixed = after_m - before_m
    mixed *= np.float32(fraction)
    mixed += before_m
    mixed[np.minimum(before_m, after_m) <= 0] = 0
    return mixed


def change_rate(
    sequence: DepthSequence, rate_hz: float | None, interpolation: str = "linear"
) -> DepthSequence:
    """Return a sequence at another rate.

    Returns the sequence itself if no rate is given or it has that rate.
    """
    if rate_hz is None or rate_hz == sequence.rate_hz:
        return sequence
    return InterpolatedSequence(sequence, rate_hz, interpolation)
