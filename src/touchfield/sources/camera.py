"""A pinhole camera and what a depth sequence is, whatever its layout on disk."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Final, Protocol

import numpy as np

from touchfield.errors import InvalidArgument

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Float32s = NDArray[np.float32]

__all__ = ["DEFAULT_RATE_HZ", "CodedSequence", "DepthCode", "DepthSequence", "Frames", "Intrinsics", "require_frame"]

DEFAULT_RATE_HZ: Final = 30.0


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
                raise InvalidArgument("intrinsics", f"{name} = {value}", "finite pixels, focal lengths positive")


def require_frame(frame: int, count: int, name: str = "") -> None:
    """`InvalidArgument` unless there is a frame of that number."""
    if not 0 <= frame < count:
        raise InvalidArgument(f"{name}, frame" if name else "frame", str(frame), f"0 to {count - 1}")


class DepthSequence(ABC):
    """Depth frames of one camera, read when they are asked for.

    Attributes
    ----------
    name : str; What to call it in messages (the path).
    width, height : int; Pixels, the same for every frame.
    poses : float64 [frame_count, 4, 4] or None; Camera-to-world matrices, metres.
    notes : tuple of str; What the user should be told.
    """

    name: str
    frame_count: int
    width: int
    height: int
    intrinsics: Intrinsics
    rate_hz: float
    poses: NDArray[np.float64] | None = None
    notes: tuple[str, ...] = ()

    @abstractmethod
    def depth_m(self, frame: int) -> Float32s:
        """Depth along the optical axis, metres, float32 [height, width], C-contiguous; 0 where unknown.

        Raises `SourceError` if the frame cannot be read, or its size differs from that of the first one.
        """

    def key_frames(self) -> Sequence[int]:
        """Frames that show between them what all show: those that are not interpolated."""
        return range(self.frame_count)


class Frames(Protocol):
    """Stored numbers over time, ``values(frame)`` [height, width]; `size` is width and height."""

    @property
    def frame_count(self) -> int: ...

    @property
    def size(self) -> tuple[int, int]: ...

    def values(self, frame: int) -> NDArray[Any]: ...


@dataclass(frozen=True)
class StoredFrame:
    """One array, [height, width], as the only frame."""

    array: NDArray[Any]
    frame_count: int = 1

    @property
    def size(self) -> tuple[int, int]:
        return self.array.shape[1], self.array.shape[0]

    def values(self, frame: int) -> NDArray[Any]:
        return self.array


@dataclass(frozen=True)
class DepthCode:
    """How a stored value becomes metres: `units_per_m` stored units are one.

    `is_rotated` means SUN3D's bits: value = (v >> 3) | (v << 13) in 16 bits.
    """

    units_per_m: float
    is_rotated: bool = False

    def __call__(self, values: NDArray[Any]) -> Float32s:
        """Depth in metres, float32, of stored values of any numeric type; 0 where unknown.

        Unknown are 0, negative values and what is not finite; and 65535 in 16 bits, by the 7-Scenes and 3DMatch
        convention and as the end of the scale elsewhere.
        """
        if values.dtype == np.uint16:
            depth: Float32s = _table(self)[values]
            return depth
        with np.errstate(over="ignore"):  # what float32 cannot hold becomes inf, and so unknown
            depth = (values.astype(np.float64) / self.units_per_m).astype(np.float32, order="C")
        depth[~(np.isfinite(depth) & (depth > 0))] = 0
        return depth


@lru_cache(maxsize=16)
def _table(code: DepthCode) -> Float32s:
    """Metres of all 65536 values: one look-up a pixel is the fastest way in numpy."""
    values = np.arange(1 << 16, dtype=np.uint16)
    if code.is_rotated:
        values = ((values >> 3) | (values << 13)).astype(np.uint16)
    with np.errstate(over="ignore"):
        table = (values / code.units_per_m).astype(np.float32)
    table[(values == 0xFFFF) | ~np.isfinite(table)] = 0
    table.flags.writeable = False
    return table


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
        """See `DepthSequence.depth_m`."""
        require_frame(frame, self.frame_count, self.name)
        return self.metres(self.frames.values(frame))
