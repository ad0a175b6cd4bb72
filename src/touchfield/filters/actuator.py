"""The low-pass of an array of actuators (paper section 3.2, the tactile T-shirt).

Actuators a pitch d apart can show waves up to 1/(2d), the Nyquist rate of their lattice; what is finer must be taken
away before the field is sampled there, or it comes back as a false coarse wave. The paper prints the cut-off 2/d,
four times too high: a wave of 0.8/d passes it and appears as one of 0.2/d. Both are here, "nyquist" by default and
"literal". For samples a distance delta apart the cut-off is pi delta/d radians per sample, or four times that.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Final

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.filters.registry import Claims, FieldFilter
from touchfield.filters.resample import LOW_PASSES
from touchfield.filters.separable import AxisTaps, checked_boundary, filter_field

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.medium import ForceField, Grid

CUTOFFS: Final = {"nyquist": 0.5, "literal": 2.0}
"""Cut-off times pitch."""

KERNELS: Final = ("firwin", *LOW_PASSES)
AUTO: Final = "auto"
"""Not a kernel, but the choice of one by the grid: see `ActuatorLowPass`."""

_FIRWIN_HALF_WIDTH: Final = 3.75  # over the cut-off in Nyquist rates: 31 taps at a quarter
_MAX_TAPS: Final = 1 << 16


def cutoff_per_m(pitch_m: float, cutoff: str = "nyquist") -> float:
    """The cut-off for a pitch, cycles per metre.

    pitch_m : float; distance between neighbouring actuators, metres.
    cutoff : {"nyquist", "literal"}; 1/(2d), or the paper's 2/d.
    Raises `InvalidArgument` if the pitch is not positive, or the word is unknown.
    """
    if not (math.isfinite(pitch_m) and pitch_m > 0):
        raise InvalidArgument("pitch_m", f"{pitch_m!r} m", "a positive length")
    if cutoff not in CUTOFFS:
        raise InvalidArgument("cutoff", repr(cutoff), f"one of {', '.join(CUTOFFS)}")
    return CUTOFFS[cutoff] / pitch_m


def actuator_taps(
    spacing_m: float, pitch_m: float, cutoff: str = "nyquist", kernel: str = "firwin"
) -> NDArray[np.float64]:
    """The centred taps of one axis, unit sum, float64 [odd].

    spacing_m : float; distance between the field's samples, metres.
    pitch_m : float; distance between neighbouring actuators, metres.
    cutoff : {"nyquist", "literal"}; see `cutoff_per_m`.
    kernel : str; "firwin" (a Hamming window, -6 dB at the cut-off, -54 dB at 1.5 times it, 31 taps where the cut-off
        is a quarter of the field's Nyquist rate), or one of `touchfield.filters.LOW_PASSES`.
    Raises `InvalidArgument` if the cut-off lies above the field's own Nyquist rate, or a number or word is out of
    range.
    The Hamming window and "sinc" have negative lobes: beside a contact they leave up to some per cent of its force
    turned round. The others are never negative.
    """
    if not (math.isfinite(spacing_m) and spacing_m > 0):
        raise InvalidArgument("spacing_m", f"{spacing_m!r} m", "a positive length")
    if kernel not in KERNELS:
        raise InvalidArgument("kernel", repr(kernel), f"one of {', '.join(KERNELS)}")
    ratio = cutoff_per_m(pitch_m, cutoff) * 2 * spacing_m
    if ratio > 1 + 1e-9:
        raise InvalidArgument(
            "pitch_m", f"{pitch_m:g} m, whose {cutoff} cut-off is {ratio / (2 * spacing_m):g} cycles/m",
            f"a cut-off up to {0.5 / spacing_m:g} cycles/m, the Nyquist rate of samples {spacing_m:g} m apart",
            f"Take a pitch of at least {CUTOFFS[cutoff] * 2 * spacing_m:g} m, or a finer field.",
        )  # fmt: skip
    if ratio > 1 - 1e-9:
        return np.ones(1)  # the samples are as far apart as the actuators: there is nothing finer
    if _FIRWIN_HALF_WIDTH / ratio > _MAX_TAPS:
        raise InvalidArgument("pitch_m", f"{pitch_m / spacing_m:g} samples", f"up to {_MAX_TAPS // 8} samples")
    taps = _firwin(ratio) if kernel == "firwin" else _sampled(kernel, ratio)
    taps /= taps.sum()
    return taps


def _firwin(ratio: float) -> NDArray[np.float64]:
    from scipy import signal

    half = math.ceil(_FIRWIN_HALF_WIDTH / ratio - 1e-9)
    return np.asarray(signal.firwin(2 * half + 1, ratio), np.float64)


def _sampled(kernel: str, ratio: float) -> NDArray[np.float64]:
    """A kernel of `lowpass` at the samples, which lie ratio/2 apart in units of 1 over the cut-off."""
    chosen, step = LOW_PASSES[kernel], ratio / 2
    radius = math.floor(chosen.half_width / step + (0.5 if kernel == "box" else 0.0))
    taps = chosen.shape(np.arange(-radius, radius + 1, dtype=np.float64) * step, step)
    return np.asarray(taps[1:-1] if radius and not taps[0] else taps, np.float64)


@dataclass(frozen=True)
class ActuatorLowPass(FieldFilter):
    """The part of a field that an array of actuators of this pitch can show, on the field's own lattice.

    pitch_m : float; distance between neighbouring actuators, metres, positive.
    cutoff : {"nyquist", "literal"}; 1/(2d), or the paper's 2/d, which aliases.
    kernel : str; "firwin", or one of `touchfield.filters.LOW_PASSES`, see `actuator_taps`; or "auto":
        "firwin" where its taps fit along every filtered axis (7.5 pitches, for "nyquist"), and else "spline", which
        needs 2.6.
    axes : str; the axes to filter: "xy", the plane that an array lies in, or "xyz" for actuators in space. An axis of
        a single sample is left as it is.
    boundary : {"zero", "nearest", "reflect", "wrap"}; what lies beyond the grid, see `touchfield.filters.separable`.
    Raises `InvalidArgument` if a number or word is out of range; on use, if the cut-off lies above the field's
    Nyquist rate or the kernel is larger than the field.
    """

    name: ClassVar[str] = "lowpass"
    summary: ClassVar[str] = (
        "what actuators this far apart can show: pitch=35mm, or pitch=35mm,axes=xyz,kernel=firwin"
    )
    example: ClassVar[str] = "pitch=20mm"

    pitch_m: float
    cutoff: str = "nyquist"
    kernel: str = "auto"
    axes: str = "xy"
    boundary: str = "zero"

    def __post_init__(self) -> None:
        cutoff_per_m(self.pitch_m, self.cutoff)
        if self.kernel not in (AUTO, *KERNELS):
            raise InvalidArgument("--lowpass kernel", repr(self.kernel), f"one of {', '.join((AUTO, *KERNELS))}")
        if not self.axes or len(set(self.axes)) != len(self.axes) or not set(self.axes) <= set("xyz"):
            raise InvalidArgument("--lowpass axes", repr(self.axes), "some of x, y and z, each once")
        checked_boundary(self.boundary, "--lowpass boundary")

    def taps(self, grid: Grid) -> tuple[AxisTaps, AxisTaps, AxisTaps]:
        """The taps along each axis of a grid.

        Raises `InvalidArgument` if the cut-off lies above the grid's Nyquist rate, or there are more taps than
        samples.
        """
        kernel = self.kernel
        if kernel == AUTO:
            firwin = self._rows(grid, "firwin")
            fits = all(len(row) <= count for row, count in zip(firwin, grid.shape, strict=True))
            kernel = "firwin" if fits else "spline"
        rows = self._rows(grid, kernel)
        for axis, count in enumerate(grid.shape):
            if len(rows[axis]) > count:
                raise InvalidArgument(
                    f"--lowpass pitch {self.pitch_m:g} m along {'xyz'[axis]}",
                    f"{len(rows[axis])} taps along an axis of {count} samples", f"at most {count} taps",
                    self._mend(grid, axis, len(rows[axis])),
                )  # fmt: skip
        x, y, z = (AxisTaps.centred(row) for row in rows)
        return x, y, z

    def _rows(self, grid: Grid, kernel: str) -> list[NDArray[np.float64]]:
        """The taps of a kernel along each axis, whether or not they fit."""
        return [
            actuator_taps(spacing_m, self.pitch_m, self.cutoff, kernel) if name in self.axes and count > 1
            else np.ones(1)
            for name, count, spacing_m in zip("xyz", grid.shape, grid.spacing_m, strict=True)
        ]  # fmt: skip

    def _mend(self, grid: Grid, axis: int, taps: int) -> str:
        """The way out for a kernel of so many taps, more than the axis has samples."""
        spline = len(self._rows(grid, "spline")[axis])
        if spline <= grid.shape[axis] and spline < taps:
            return f"kernel=spline needs only {spline} taps."
        return "Take a smaller pitch or a larger field, or name the other axes only (axes=xy)."

    def claims(self, grid: Grid) -> Claims:
        """Linear, unit gain for a constant; a mean of the forces around where the kernel is never negative."""
        rows = self.taps(grid)
        positive = all((row.taps >= 0).all() for row in rows)
        x, y, z = (row.reach for row in rows)
        return Claims(reach=(x, y, z), linear=True, dc_gain=1.0, keeps_mean=True, max_principle=positive)

    def __call__(self, field: ForceField) -> ForceField:
        """See `FieldFilter`."""
        return filter_field(field, self.taps(field.grid), self.boundary)[0]


FILTER = ActuatorLowPass
