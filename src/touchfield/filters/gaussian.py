"""Gaussian smoothing of a field (paper section 3.2, "force shading").

Componentwise, so that it is linear and can be undone on paper; the paper's force shading, where direction and
amplitude are smoothed apart, is another filter. The kernel is that of `scipy.ndimage.gaussian_filter`: the Gaussian
at the samples, cut off at `truncate` standard deviations and scaled to unit sum.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.filters.fir import all_finite, without_overflow
from touchfield.filters.registry import Claims, FieldFilter
from touchfield.filters.separable import SCIPY_MODES, AxisTaps, checked_boundary, filter_array, filter_field

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from touchfield.medium import ForceField, Grid

MAX_RADIUS_SAMPLES = 1 << 15


def gaussian_taps(sigma_samples: float, truncate: float = 4.0) -> NDArray[np.float64]:
    """The taps of one axis, unit sum, float64 [2 r + 1], with r = floor(truncate * sigma + 1/2).

    sigma_samples : float; standard deviation in samples, 0 or more; 0 gives the one tap that changes nothing.
    truncate : float; where the kernel is cut off, in standard deviations.
    Raises `InvalidArgument` if either is negative, not finite, or the radius exceeds 2^15 samples.
    """
    if not (math.isfinite(sigma_samples) and sigma_samples >= 0):
        raise InvalidArgument("sigma_samples", repr(sigma_samples), "0 or a positive number of samples")
    if not (math.isfinite(truncate) and truncate > 0):
        raise InvalidArgument("truncate", repr(truncate), "a positive number of standard deviations")
    radius = math.floor(min(truncate * sigma_samples, 1e9) + 0.5)
    if radius > MAX_RADIUS_SAMPLES:
        raise InvalidArgument(
            "sigma_samples", f"{sigma_samples:g}", f"a radius of up to {MAX_RADIUS_SAMPLES} samples"
        )
    if not radius:
        return np.ones(1)
    taps: NDArray[np.float64] = np.exp(-0.5 * (np.arange(-radius, radius + 1) / sigma_samples) ** 2)
    taps /= taps.sum()
    return taps


def gaussian(
    signal: ArrayLike, sigma_samples: float | Sequence[float], *, truncate: float = 4.0, boundary: str = "zero"
) -> NDArray[Any]:
    """A dense array smoothed by a Gaussian.

    signal : float32 or float64, N-D; a field [nx, ny, nz, 3], or scalars of any number of axes; whole numbers are
        taken as float64.
    sigma_samples : float or one for each axis; standard deviation in samples. One number holds for every axis, except
        for the components of a field: those are the last axis, of length 3, of an array of four. Of several numbers
        each holds for one leading axis, and the axes that follow are components.
    truncate : float; where the kernel is cut off, in standard deviations.
    boundary : {"zero", "nearest", "reflect", "wrap"}; see `touchfield.filters.separable`.
    Returns float32 or float64: Of the signal's shape; the same bits for any number of threads.
    Raises `InvalidArgument` if a number is out of range, the kernel is larger than the signal, the signal is not
    finite, or a sum of two of its numbers is beyond its type.
    float32 fields go through compiled passes in float32; everything else goes through `scipy.ndimage`.
    """
    x = np.asarray(signal)
    x = x if x.dtype in (np.float32, np.float64) else x.astype(np.float64)
    checked_boundary(boundary)
    axes = _axes(x.shape, sigma_samples, truncate)
    if x.dtype == np.float32 and len(axes) == 3 and x.size:
        fast = filter_array(x.reshape(*x.shape[:3], -1), (axes[0], axes[1], axes[2]), boundary)
        # a number that is not finite leaves others behind: the input is looked at only then
        if not all_finite(fast):
            if not all_finite(x):
                raise InvalidArgument("signal", "a number that is not finite", "finite numbers")
            without_overflow(fast, "signal")
        return fast.reshape(x.shape)
    if not all_finite(x):
        raise InvalidArgument("signal", "a number that is not finite", "finite numbers")
    from scipy import ndimage

    for axis, row in enumerate(axes):
        x = ndimage.correlate1d(x, row.taps, axis=axis, mode=SCIPY_MODES[boundary])
    return without_overflow(np.asarray(x), "signal")


def _axes(shape: tuple[int, ...], sigma_samples: float | Sequence[float], truncate: float) -> list[AxisTaps]:
    if isinstance(sigma_samples, int | float | np.integer | np.floating):
        count = 3 if len(shape) == 4 and shape[3] == 3 else len(shape)
        sigmas = [float(sigma_samples)] * count
    else:
        sigmas = [float(s) for s in sigma_samples]
    if not 1 <= len(sigmas) <= len(shape):
        raise InvalidArgument("sigma_samples", f"{len(sigmas)} for an array {shape}", "one for each leading axis")
    axes = [AxisTaps.centred(gaussian_taps(s, truncate)) for s in sigmas]
    for axis, row in enumerate(axes):
        row.check_fits(shape[axis], f"sigma_samples of axis {axis}")
    return axes


@dataclass(frozen=True)
class GaussianFilter(FieldFilter):
    """Each component of the force smoothed by a Gaussian, on sparse bricks.

    sigma_m : float; standard deviation, metres, positive; an axis of a single sample is left as it is.
    truncate : float; where the kernel is cut off, in standard deviations.
    boundary : {"zero", "nearest", "reflect", "wrap"}; what lies beyond the grid, see `touchfield.filters.separable`.
    Raises `InvalidArgument` if a number is out of range; on use, if the kernel is larger than the field, or a sum is
    beyond float32.
    """

    name: ClassVar[str] = "gaussian"
    summary: ClassVar[str] = "smooth by a Gaussian of this standard deviation: 2mm, or sigma=2mm,truncate=3"
    example: ClassVar[str] = "2mm"

    sigma_m: float
    truncate: float = 4.0
    boundary: str = "zero"

    def __post_init__(self) -> None:
        if not (math.isfinite(self.sigma_m) and self.sigma_m > 0):
            raise InvalidArgument("--gaussian sigma", f"{self.sigma_m!r} m", "a positive length")
        if not 0 < self.truncate <= 16:
            raise InvalidArgument("--gaussian truncate", repr(self.truncate), "above 0 and up to 16 deviations")
        checked_boundary(self.boundary, "--gaussian boundary")

    def axes(self, grid: Grid) -> tuple[AxisTaps, AxisTaps, AxisTaps]:
        """The taps along each axis of a grid.

        Raises `InvalidArgument` if there are more taps than samples along an axis of more than one sample.
        """
        rows = []
        for axis, (count, spacing_m) in enumerate(zip(grid.shape, grid.spacing_m, strict=True)):
            sigma = 0.0 if count == 1 else self.sigma_m / spacing_m
            row = AxisTaps.centred(gaussian_taps(sigma, self.truncate))
            row.check_fits(count, f"--gaussian sigma {self.sigma_m:g} m along {'xyz'[axis]}")
            rows.append(row)
        return rows[0], rows[1], rows[2]

    def claims(self, grid: Grid) -> Claims:
        """Linear, unit gain for a constant, and a mean of the forces around: no force grows."""
        x, y, z = (a.reach for a in self.axes(grid))
        return Claims(reach=(x, y, z), linear=True, dc_gain=1.0, keeps_mean=True, max_principle=True)

    def __call__(self, field: ForceField) -> ForceField:
        """See `FieldFilter`."""
        made, finite = filter_field(field, self.axes(field.grid), self.boundary)
        if not finite:
            without_overflow(made.forces_n, "--gaussian forces")
        return made


FILTER = GaussianFilter
