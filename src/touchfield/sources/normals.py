"""Tangent planes of a depth map: where its surface is and how it is turned, robust to noise and edges.

The paper gives no method (its [21] has no formula). Ours rests on one fact of the pinhole camera: over the pixels
of a plane n . p = c the inverse depth w = 1/z is a linear function of the pixel, because n . (x/z, y/z, 1) = c w.
So a straight line fit to w is exact on a plane, with one-sided support too, and its slopes give the normal::

    n / c = (fx w_u, fy w_v, w - (u - cx) w_u - (v - cy) w_v)

Noise of disparity sensors is moreover constant in w (it grows with z^2 in depth). The steps for each pixel:

1. *Links.* Two neighbours lie on one surface if their w differ by at most a step g, or if the difference goes on
   as the one before or after it (within g) and is no steeper than `SLOPE_LIMIT_PX` pixels of depth per pixel.
   Nothing is ever linked across a pixel without depth.
2. *Rows.* A least-squares line through the up to 4 pixels on each side that an unbroken chain of links reaches.
3. *Columns.* The same down the columns, over the results of the rows, whose slopes are averaged with the weight
   of their support. The plane goes through the fitted w, not through the noisy pixel.
4. A pixel has no plane where too few pixels support it (less than three in line), or where the ray meets the
   surface at more than 84 degrees.

A step edge thus ends the support and never tilts a normal, as long as it is higher than g (in w) and than
`SLOPE_LIMIT_PX` pixel footprints. The step g is taken from the sensor's own noise: see `noise_step_per_m`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.sources.camera import Intrinsics

    Float32s = NDArray[np.float32]

__all__ = ["SurfacePlanes", "noise_step_per_m", "surface_planes"]

SLOPE_LIMIT_PX = 5.0
"""Steepest slope along an image row or column, footprints of a pixel in depth per pixel: about 79 degrees."""

STEP_RANGE_PER_M = (5e-4, 2e-2)
"""Bounds of the noise step g, 1/m: 0.5 mm to 2 cm at a depth of 1 m."""


@dataclass(frozen=True)
class SurfacePlanes:
    """The planes of a depth map, in camera axes.

    Attributes
    ----------
    size_px : (int, int)
        Height and width.
    camera_px : float32 [4]
        fx, fy, cx, cy.
    planes : float32 [height * width + 1, 4]
        Unit normal n towards the camera and offset c, metres, with n . p = c on the plane; all zero where there is
        no plane, and in the last row.
    tiles : float32 [m, 3]
        Bounds for culling, of tiles of 8 x 8 pixels, then of 16 x 16 and so on up to one tile: the largest and
        smallest inverse depth of the planes over their pixels, 1/m, and the least |c|, metres; (0, 1e30, 1e30)
        where there is no plane.
    places : int64 [levels, 2]
        Where each size begins in `tiles`, and how many columns it has.
    """

    size_px: tuple[int, int]
    camera_px: Float32s
    planes: Float32s
    tiles: Float32s
    places: NDArray[np.int64]

    @property
    def normals(self) -> Float32s:
        """Unit normals towards the camera, float32 [height, width, 3]; zero where there is none."""
        return self.planes[:-1, :3].reshape(*self.size_px, 3)

    @property
    def offsets_m(self) -> Float32s:
        """c of n . p = c, metres, float32 [height, width]; zero where there is no plane."""
        return self.planes[:-1, 3].reshape(self.size_px)


def noise_step_per_m(depth_m: Float32s) -> float:
    """The step g, 1/m, up to which neighbouring inverse depths are taken for one surface.

    2.5 times the upper quartile of the second differences of w along about 16 rows. Measured, that
    is 0.0073 for a Kinect (TUM fr1; its quantum is 0.0029) and 0.0005 for rendered depth in millimetres (ICL-NUIM);
    edges begin at the 98th percentile and hardly move it. The smoother a sensor, the lower the steps that are seen.
    """
    depth = depth_m[:: max(1, depth_m.shape[0] // 16)]
    known = depth > 0
    inverse = np.divide(1.0, depth, out=np.zeros(depth.shape, np.float32), where=known)
    inside = known[:, :-2] & known[:, 1:-1] & known[:, 2:]
    bends = np.abs(inverse[:, :-2] - 2 * inverse[:, 1:-1] + inverse[:, 2:])[inside]
    at = 3 * bends.size // 4
    quartile = float(np.partition(bends, at)[at]) if bends.size else 0.0
    return float(np.clip(2.5 * quartile, *STEP_RANGE_PER_M))


def surface_planes(depth_m: Float32s, intrinsics: Intrinsics, step_per_m: float) -> SurfacePlanes:
    """The planes of one depth map.

    Parameters
    ----------
    depth_m : float32 [height, width], C-contiguous
        Depth along the optical axis, metres; not positive (or not finite) where unknown.
    intrinsics : Intrinsics
    step_per_m : float
        The noise step g, 1/m.
    """
    from touchfield.sources.kernels import planes as kernels

    camera = np.array([intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy], np.float32)
    planes, tiles, places = kernels.fit_planes(depth_m, camera, step_per_m, SLOPE_LIMIT_PX)
    return SurfacePlanes((depth_m.shape[0], depth_m.shape[1]), camera, planes, tiles, places)
