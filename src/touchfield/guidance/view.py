"""Points of a depth picture, on every few pixels, and what of the picture is known.

A picture is reduced to about 160 x 120 pixels: at 2 m these are 1.5 cm apart, and a frame is evaluated in a
few milliseconds. Pixels are selected and not averaged: a mean across an edge is a surface that is not there.
"""

from __future__ import annotations

from functools import cached_property
from typing import Final

import numpy as np

from touchfield.arrays import Bools, Float32s
from touchfield.errors import InvalidArgument
from touchfield.sources.camera import Intrinsics

REDUCED_WIDTH_PX: Final = 160
MIN_SIDE_PX: Final = 24
"""A smaller picture has too few points for a plane of the ground and eight directions."""


class DepthView:
    """The reduced pixels of a camera, whose picture has `width` x `height` pixels.

    Attributes
    ----------
    stride : int
        Every how many pixels one is used, along both axes.
    size_px : (int, int)
        Height and width of the reduced picture.
    intrinsics : Intrinsics
        Camera of the reduced picture.

    Raises `InvalidArgument` if the picture is smaller than 24 pixels along one side.
    """

    def __init__(self, intrinsics: Intrinsics, width: int, height: int) -> None:
        if min(width, height) < MIN_SIDE_PX:
            expected = f"at least {MIN_SIDE_PX} pixels along each side"
            raise InvalidArgument("depth pictures", f"{width} x {height} pixels", expected)
        self.stride = max(1, min(round(width / REDUCED_WIDTH_PX), min(width, height) // MIN_SIDE_PX))
        self._first = self.stride // 2
        self.size_px = tuple(len(range(self._first, side, self.stride)) for side in (height, width))
        self.intrinsics = Intrinsics(
            intrinsics.fx / self.stride,
            intrinsics.fy / self.stride,
            (intrinsics.cx - self._first) / self.stride,
            (intrinsics.cy - self._first) / self.stride,
        )

    @cached_property
    def rays(self) -> Float32s:
        """Directions of the pixels, row after row, with z = 1: float32 [pixels, 3], camera axes."""
        k, (height, width) = self.intrinsics, self.size_px
        v, u = np.mgrid[:height, :width].astype(np.float32).reshape(2, -1)
        return np.stack([(u - k.cx) / k.fx, (v - k.cy) / k.fy, np.ones_like(u)], axis=1).astype(np.float32)

    def reduced_m(self, depth_m: Float32s) -> Float32s:
        """Return the depth of the reduced picture, metres, float32 [height, width]; 0 is unknown."""
        depth = depth_m[self._first :: self.stride, self._first :: self.stride]
        return np.ascontiguousarray(np.where(np.isfinite(depth) & (depth > 0), depth, 0), np.float32)


def known_points(view: DepthView, reduced_m: Float32s) -> tuple[Float32s, Bools]:
    """Return the points of the known pixels, float32 [known, 3], camera axes, and which pixels these are."""
    depth = reduced_m.reshape(-1)
    is_known = depth > 0
    return view.rays[is_known] * depth[is_known, None], is_known
