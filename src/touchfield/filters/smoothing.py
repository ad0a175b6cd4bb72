"""Smooths a field by a Gaussian, and removes from an image what an array of actuators is too coarse to show
(paper section 3.2).

The Gaussian has the kernel of `scipy.ndimage.gaussian_filter` and acts on each component alone; the paper's
force shading smooths direction and amplitude separately (`touchfield.filters.shading`).

Actuators a pitch d apart can show waves up to 1/(2d). Finer waves must be removed before the field is sampled
there, or they alias to coarse ones. The paper prints the cut-off 2/d for its T-shirt, four times too high: a
wave of 0.8/d passes it and appears as one of 0.2/d. Both cut-offs are available, "nyquist" (default) and
"literal". For samples a distance delta apart the cut-off is pi delta/d radians a sample, or four times that.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from touchfield.arrays import Float64s
from touchfield.errors import (
    InvalidArgument,
    is_finite,
    require_not_negative,
    require_one_of,
    require_positive,
)
from touchfield.filters.fir import checked_signal, direct_sums, filter_dense, without_overflow
from touchfield.filters.registry import Claims, FieldFilter
from touchfield.filters.resample import LOW_PASSES, axis_weights, low_pass
from touchfield.filters.separable import BOUNDARIES, AxisTaps, filter_field, reach_of
from touchfield.medium import ForceField, Grid

if TYPE_CHECKING:
    from touchfield.filters.separable import Axes

MAX_RADIUS_SAMPLES: Final = 1 << 15

CUTOFFS: Final = {"nyquist": 0.5, "literal": 2.0}  # cut-off times pitch


def gaussian_taps(sigma_samples: float) -> Float64s:
    """Return the taps of one axis, unit sum, float64 [2 r + 1], with r = floor(4 sigma + 1/2).

    sigma_samples : float; standard deviation in samples, 0 or more; 0 gives the identity, a single tap.
    Raises `InvalidArgument` if it is negative, not finite, or the radius exceeds 2^15 samples.
    """
    require_not_negative(sigma_samples=sigma_samples)
    radius = math.floor(min(4.0 * sigma_samples, 1e9) + 0.5)
    if radius > MAX_RADIUS_SAMPLES:
        expected = f"a radius of up to {MAX_RADIUS_SAMPLES} samples"
        raise InvalidArgument("sigma_samples", f"{sigma_samples:g}", expected)
    if not radius:
        return np.ones(1)
    taps: Float64s = np.exp(-0.5 * (np.arange(-radius, radius + 1) / sigma_samples) ** 2)
    return np.asarray(taps / taps.sum())


def gaussian(
    signal: ArrayLike, sigma_samples: float | Sequence[float], *, boundary: str = "zero"
) -> NDArray[Any]:
    """Smooth a dense array by a Gaussian.

    signal : float32, else converted to float64, N-D; a field [nx, ny, nz, 3], or scalars with any axes.
    sigma_samples : float or one for each leading axis; standard deviation in samples. One number applies to
        every axis but the components of a field (the last axis, of length 3, of a 4-D array).
    boundary : {"zero", "nearest", "reflect", "wrap"}; see `touchfield.filters.separable`.
    Returns float32 or float64: Of the signal's shape; the same bits for any number of threads.
    Raises `InvalidArgument` if a number is out of range or not finite, or the kernel is larger than the
    signal.
    """
    x = checked_signal(signal, boundary)
    if isinstance(sigma_samples, int | float | np.integer | np.floating):
        sigmas = [float(sigma_samples)] * (3 if x.ndim == 4 and x.shape[3] == 3 else x.ndim)
    else:
        sigmas = [float(s) for s in sigma_samples]
    if not 1 <= len(sigmas) <= x.ndim:
        raise InvalidArgument(
            "sigma_samples", f"{len(sigmas)} for an array {x.shape}", "one for each leading axis"
        )
    axes = [AxisTaps(gaussian_taps(s)) for s in sigmas]
    for axis, row in enumerate(axes):
        row.check_fits(x.shape[axis], f"sigma_samples of axis {axis}")
    return without_overflow(
        direct_sums(x, [a.taps for a in axes], [a.reach for a in axes], boundary), "signal"
    )


class _LowPass(FieldFilter):
    """A filter of one centred row of taps an axis, each of unit sum."""

    @abstractmethod
    def taps(self, grid: Grid) -> Axes:
        """The taps along each axis of a grid; `InvalidArgument` if an axis has fewer samples."""

    def claims(self, grid: Grid) -> Claims:
        """Linear, unit gain for a constant; a local mean of the forces where no tap is negative."""
        axes = self.taps(grid)
        is_mean = all((row.taps >= 0).all() for row in axes)
        return Claims(reach_of(axes), linear=True, dc_gain=1.0, keeps_mean=True, max_principle=is_mean)

    def __call__(self, field: ForceField) -> ForceField:
        """See `FieldFilter`."""
        axes = self.taps(field.grid)
        boundary = getattr(self, "boundary", None)
        if boundary not in (None, "zero"):
            return filter_dense(field, [a.taps for a in axes], [a.reach for a in axes], boundary)
        smooth, is_finite = filter_field(field, axes)
        if not is_finite:
            without_overflow(smooth.forces_n, f"--{self.name} forces")
        return smooth


@dataclass(frozen=True)
class GaussianFilter(_LowPass):
    """Each component of the force smoothed by a Gaussian, cut off at 4 sigma, on sparse bricks.

    sigma_m : float; standard deviation, metres, positive; an axis of a single sample is left as it is.
    boundary : str, optional; how the field continues beyond its border, "zero" (default), "nearest",
        "reflect" or "wrap" (`touchfield.filters.separable`); all but "zero" filter a dense copy.
    Raises `InvalidArgument` if it is not positive; on use, if the kernel or a sum does not fit the field.
    """

    name: ClassVar[str] = "gaussian"
    summary: ClassVar[str] = "smooth by a Gaussian of this standard deviation: 2mm, or 2mm,boundary=nearest"
    example: ClassVar[str] = "2mm"

    sigma_m: float
    boundary: str | None = None

    def __post_init__(self) -> None:
        require_one_of("--gaussian boundary", self.boundary or "zero", BOUNDARIES)
        if not (is_finite(self.sigma_m) and self.sigma_m > 0):
            raise InvalidArgument("--gaussian sigma", f"{self.sigma_m!r} m", "a positive length")

    def taps(self, grid: Grid) -> Axes:
        """The taps along each axis of a grid."""
        rows = []
        for axis, count, spacing_m in zip("xyz", grid.shape, grid.spacing_m, strict=True):
            rows.append(AxisTaps(gaussian_taps(0.0 if count == 1 else self.sigma_m / spacing_m)))
            rows[-1].check_fits(count, f"--gaussian sigma {self.sigma_m:g} m along {axis}")
        return rows[0], rows[1], rows[2]


def cutoff_per_m(pitch_m: float, cutoff: str = "nyquist") -> float:
    """Return the cut-off for a pitch d, cycles per metre: "nyquist", 1/(2d), or "literal", the paper's 2/d.

    Raises `InvalidArgument` if the pitch is not positive, or the name is unknown.
    """
    require_positive(pitch_m=pitch_m)
    require_one_of("cutoff", cutoff, CUTOFFS)
    return CUTOFFS[cutoff] / pitch_m


def actuator_taps(
    spacing_m: float, pitch_m: float, cutoff: str = "nyquist", kernel: str = "sinc"
) -> Float64s:
    """Return the centred taps of one axis, unit sum, float64 [odd].

    spacing_m, pitch_m : float; distance between the field's samples, and between neighbouring actuators,
        metres.
    cutoff : {"nyquist", "literal"}; see `cutoff_per_m`.
    kernel : str; of `touchfield.filters.LOW_PASSES`. "sinc" has negative lobes: next to a contact they leave
        up to a few per cent of its force reversed.
    Raises `InvalidArgument` if the cut-off lies above the field's own Nyquist rate, or a value is out of
    range.
    """
    require_positive(spacing_m=spacing_m)
    target_per_m, nyquist_per_m = cutoff_per_m(pitch_m, cutoff), 0.5 / spacing_m
    if target_per_m > nyquist_per_m * (1 + 1e-9):
        found = f"{pitch_m:g} m, whose {cutoff} cut-off is {target_per_m:g} cycles/m"
        expected = (
            f"a cut-off up to {nyquist_per_m:g} cycles/m, the Nyquist rate of samples {spacing_m:g} m apart"
        )
        mend = f"Take a pitch of at least {CUTOFFS[cutoff] / nyquist_per_m:g} m, or a finer field."
        raise InvalidArgument("pitch_m", found, expected, mend)
    if target_per_m > nyquist_per_m * (1 - 1e-9):
        return np.ones(1)  # the samples are as far apart as the actuators: there is nothing finer
    first, weights = axis_weights((0, spacing_m, 0.0), (1, pitch_m, 0.0), low_pass(kernel), target_per_m)
    taps = weights[0, : 1 - 2 * first[0]].astype(np.float64)
    return np.asarray(taps / taps.sum())


@dataclass(frozen=True)
class ActuatorLowPass(_LowPass):
    """Low-pass a field to what an array of actuators of this pitch along x and y can show.

    pitch_m : float; distance between neighbouring actuators, metres, positive.
    cutoff : {"nyquist", "literal"}; 1/(2d), or the paper's 2/d, which aliases.
    kernel : str; of `touchfield.filters.LOW_PASSES`: "spline" spans 2.6 pitches for "nyquist", "sinc" 8. An
        axis of a single sample is left as it is.
    Raises `InvalidArgument` if a value is out of range; on use, for a cut-off or a kernel beyond the field's
    own.
    """

    name: ClassVar[str] = "lowpass"
    summary: ClassVar[str] = "what actuators this far apart can show: pitch=35mm, or pitch=35mm,kernel=sinc"
    example: ClassVar[str] = "pitch=20mm"

    pitch_m: float
    cutoff: str = "nyquist"
    kernel: str = "spline"

    def __post_init__(self) -> None:
        cutoff_per_m(self.pitch_m, self.cutoff)
        require_one_of("--lowpass kernel", self.kernel, LOW_PASSES)

    def taps(self, grid: Grid) -> Axes:
        """The taps along each axis of a grid; `InvalidArgument` also for a cut-off above its Nyquist rate."""
        rows = []
        for axis, count, spacing_m in zip("xyz", grid.shape, grid.spacing_m, strict=True):
            is_unfiltered = axis == "z" or count == 1
            taps = (
                np.ones(1)
                if is_unfiltered
                else actuator_taps(spacing_m, self.pitch_m, self.cutoff, self.kernel)
            )
            rows.append(AxisTaps(taps))
            rows[-1].check_fits(count, f"--lowpass pitch {self.pitch_m:g} m along {axis}")
        return rows[0], rows[1], rows[2]
