"""A pinhole camera and what a depth sequence is, whatever its layout on disk."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from touchfield.errors import InvalidArgument

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["DepthSequence", "Intrinsics"]


@dataclass(frozen=True)
class Intrinsics:
    """A pinhole camera: pixel u = fx x / z + cx, v = fy y / z + cy; pixel centres are whole numbers.

    Attributes
    ----------
    fx, fy : float
        Focal lengths, pixels.
    cx, cy : float
        Principal point, pixels.
    """

    fx: float
    fy: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        for name in ("fx", "fy", "cx", "cy"):
            value = float(getattr(self, name))
            if not math.isfinite(value) or (name[0] == "f" and value <= 0):
                raise InvalidArgument("intrinsics", f"{name} = {value}", "finite pixels, focal lengths positive")


class DepthSequence(ABC):
    """Depth frames of one camera, read when they are asked for.

    Attributes
    ----------
    name : str
        What to call it in messages (the path).
    frame_count : int
    width, height : int
        Pixels, the same for every frame.
    intrinsics : Intrinsics
    rate_hz : float
    poses : float64 [frame_count, 4, 4] or None
        Camera-to-world matrices, metres; None where there are none.
    notes : tuple of str
        What the user should be told.
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
    def depth_m(self, frame: int) -> NDArray[np.float32]:
        """Depth along the optical axis, metres, float32 [height, width], C-contiguous; 0 where unknown.

        Raises
        ------
        SourceError
            If the frame cannot be read, or its size differs from that of the first one.
        """

    def key_frames(self) -> Sequence[int]:
        """Frames that show between them what all show: those that are not interpolated."""
        return range(self.frame_count)
