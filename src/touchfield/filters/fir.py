"""Equation 4: the finite impulse response filter of a haptic medium (paper section 3.2).

y[n] = sum over k of h[k] x[n - k], componentwise, along any number of axes of space and time. Printed like this,
with k = 0 .. N - 1, it is causal and moves the field by (N - 1)/2 samples; that is ``anchor="causal"``. The default,
``anchor="centred"``, puts the middle tap over the sample, and needs an odd number of taps along each axis. What lies
beyond the border is said by name (`touchfield.filters.separable`), which the paper leaves open.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Final, Self

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.files import require_plain
from touchfield.filters.registry import Claims, FieldFilter
from touchfield.filters.separable import (
    SCIPY_MODES,
    AxisTaps,
    brick_field,
    checked_boundary,
    continued_index,
    cropped,
    factors,
    filter_field,
    spread,
    widened,
)
from touchfield.medium import ForceField
from touchfield.medium.field import brick_keys
from touchfield.parallel import for_chunks

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from touchfield.medium import Grid

    Float64s = NDArray[np.float64]

ANCHORS: Final = ("centred", "causal")
METHODS: Final = ("auto", "direct", "fft")
_DIRECT_S: Final = 0.55e-9  # a tap of a sample, `scipy.ndimage.correlate`
_ROW_S: Final = 0.4e-9  # the same along one axis, `correlate1d`
_FFT_S: Final = 2.1e-9  # a padded sample and each doubling of their count, padding and three transforms


def fir_filter(
    signal: ArrayLike, taps: ArrayLike, *, anchor: str = "centred", boundary: str = "zero", method: str = "auto"
) -> NDArray[Any]:
    """Equation 4 on a dense array.

    signal : float32 or float64, M-D; its leading axes are filtered, as many as `taps` has; the others are components,
        or times that are not filtered over. Whole numbers are taken as float64.
    taps : float, N-D, N <= M; h, the kernel.
    anchor : {"centred", "causal"}; which tap stands over the sample: the middle one, or the first, as equation 4 is
        printed.
    boundary : {"zero", "nearest", "reflect", "wrap"}; what lies beyond the border; "reflect" mirrors about the edge
        of the cell: c b a | a b c d | d c b.
    method : {"auto", "direct", "fft"}; "auto" takes the cheaper by `fir_costs_s`.
    Returns float32 or float64: Of the signal's shape and type.
    Raises `InvalidArgument` if the kernel is empty, not finite or larger than the signal; even and asked to be
    centred; if the signal is not finite; if a sum is beyond the signal's type; if a word is unknown.
    """
    x, h = np.asarray(signal), _checked_taps(taps, anchor)
    x = x if x.dtype in (np.float32, np.float64) else x.astype(np.float64)
    checked_boundary(boundary)
    if method not in METHODS:
        raise InvalidArgument("method", repr(method), f"one of {', '.join(METHODS)}")
    if h.ndim > x.ndim:
        raise InvalidArgument("taps", f"{h.ndim} axes for a signal {x.shape}", f"at most {x.ndim}")
    origins = [_origin(n, anchor) for n in h.shape]
    for axis, (n, count) in enumerate(zip(h.shape, x.shape, strict=False)):
        AxisTaps(np.ones(n), 0).check_fits(count, f"taps of axis {axis}")
    if not all_finite(x):
        raise InvalidArgument("signal", "a number that is not finite", "finite numbers")
    direct_s, fft_s = fir_costs_s(x.shape, h)
    summed = _direct if method == "direct" or (method == "auto" and direct_s <= fft_s) else _by_fft
    with np.errstate(over="ignore", invalid="ignore"):
        made = summed(x, h, origins, boundary)
    return without_overflow(made, "signal")


def all_finite(x: NDArray[Any]) -> bool:
    """Test that no number is infinite or NaN, at about the speed of memory."""
    flat = x.reshape(-1)

    def piece(begin: int, end: int) -> bool:
        with np.errstate(over="ignore", invalid="ignore"):
            return bool(np.isfinite(flat[begin:end].sum()))

    # what is not finite stays so in a sum; a sum that is not finite may be one of large numbers
    return all(for_chunks(piece, len(flat), chunk=1 << 16)) or bool(np.isfinite(x).all())


def without_overflow(made: NDArray[Any], where: str) -> NDArray[Any]:
    """Pass on the result of a filter of finite numbers, if it is finite.

    Raises `InvalidArgument` naming `where`, if a sum went beyond the type of `made`.
    """
    if not all_finite(made):
        raise InvalidArgument(
            where, f"numbers whose sums are beyond {made.dtype}", f"sums below {np.finfo(made.dtype).max:.3g}",
            "Scale the signal or the taps down.",
        )  # fmt: skip
    return made


def fir_costs_s(shape: tuple[int, ...], taps: ArrayLike) -> tuple[float, float]:
    """About how many seconds a direct sum and the FFT take, for `fir_filter`'s choice.

    A direct sum costs 0.55 ns for each sample and tap, or 0.4 ns for each sample and tap of an axis where the kernel
    is a product of rows; the FFT costs 2.1 ns times N log2 N of the padded array, for the padding, both transforms
    of the signal and the one of the kernel. Measured on one core of a 2023 server processor; only the ratio matters.

    shape : tuple of int; of the signal.
    """
    h = np.asarray(taps, np.float64)
    samples = float(math.prod(shape))
    rows = factors(h)
    direct = samples * (_ROW_S * float(sum(h.shape)) if rows else _DIRECT_S * float(np.count_nonzero(h)))
    padded = math.prod(shape[h.ndim :])
    for count, n in zip(shape, h.shape, strict=False):
        padded *= count + n - 1
    return direct, _FFT_S * padded * math.log2(max(2, padded))


def _checked_taps(taps: ArrayLike, anchor: str) -> Float64s:
    h = np.asarray(taps, np.float64)
    if not h.size or not h.ndim:
        raise InvalidArgument("taps", f"an array {h.shape}", "at least one tap along each of one or more axes")
    if not np.isfinite(h).all():
        raise InvalidArgument("taps", "a tap that is not finite", "finite numbers")
    if anchor not in ANCHORS:
        raise InvalidArgument("anchor", repr(anchor), f"one of {', '.join(ANCHORS)}")
    if anchor == "centred" and any(n % 2 == 0 for n in h.shape):
        raise InvalidArgument(
            "taps", f"{h.shape} taps to be centred", "an odd number along each axis",
            'An even kernel has no middle tap: add a zero, or take anchor="causal".',
        )  # fmt: skip
    return h


def _origin(count: int, anchor: str) -> int:
    return count // 2 if anchor == "centred" else 0


def _direct(x: NDArray[Any], h: Float64s, origins: list[int], boundary: str) -> NDArray[Any]:
    from scipy import ndimage

    mode = SCIPY_MODES[boundary]
    # scipy counts the origin from the middle of the mirrored kernel
    places = [n - 1 - o - n // 2 for n, o in zip(h.shape, origins, strict=True)]
    rows = factors(h)
    if rows:
        for axis, (row, place) in enumerate(zip(rows, places, strict=True)):
            x = ndimage.correlate1d(x, row[::-1], axis=axis, mode=mode, origin=place)
        return np.asarray(x)
    beside = x.ndim - h.ndim
    mirrored = h[(slice(None, None, -1),) * h.ndim].reshape(*h.shape, *[1] * beside)
    return np.asarray(ndimage.correlate(x, mirrored, mode=mode, origin=[*places, *[0] * beside]))


def _by_fft(x: NDArray[Any], h: Float64s, origins: list[int], boundary: str) -> NDArray[Any]:
    from scipy import signal

    # powers of two, which lose nothing, keep the transforms within float64 where the sums are
    x_order, h_order = (int(np.frexp(np.abs(a).max(initial=0.0))[1]) for a in (x, h))
    wide = np.ldexp(x.astype(np.float64), -x_order)
    for axis, (n, origin) in enumerate(zip(h.shape, origins, strict=True)):
        index = continued_index(x.shape[axis], n - 1 - origin, origin, boundary)
        wide = np.take(wide, np.maximum(index, 0), axis=axis)
        np.moveaxis(wide, axis, 0)[index < 0] = 0
    beside = x.ndim - h.ndim
    row = np.ldexp(h, -h_order).reshape(*h.shape, *[1] * beside)
    made = signal.fftconvolve(wide, row, mode="valid", axes=tuple(range(h.ndim)))
    return np.asarray(np.ldexp(made, x_order + h_order), x.dtype)


@dataclass(frozen=True)
class FirFilter(FieldFilter):
    """Equation 4 on the sparse bricks of a field; nothing is made dense.

    taps : str; the taps of one axis, ``1/2/1``, applied along all three but those of a single sample; a box of taps
        in raster order after its shape, ``3x1x3:0/1/0/1/-4/1/0/1/0``; or a file NAME.npy with an array of one or
        three axes. `of` makes the text of an array.
    anchor : {"centred", "causal"}
    boundary : {"zero", "nearest", "reflect", "wrap"}; what lies beyond the grid, see `touchfield.filters.separable`.
    normalise : bool; scale the taps to unit sum, so that a constant field stays itself.
    Raises `InvalidArgument` if the taps cannot be read, are not finite, even and to be centred, or of sum zero and to
    be normalised; on use, if the kernel is larger than the field, or a sum is beyond float32.
    """

    name: ClassVar[str] = "fir"
    summary: ClassVar[str] = "equation 4 with these taps: 1/2/1, or -1/2/-1,normalise=false, or taps=FILE.npy"
    example: ClassVar[str] = "1/2/1"

    taps: str
    anchor: str = "centred"
    boundary: str = "zero"
    normalise: bool = True

    def __post_init__(self) -> None:
        checked_boundary(self.boundary, "--fir boundary")
        total = float(self.kernel.sum())
        nothing = abs(total) <= 1e-12 * float(np.abs(self.kernel).sum())
        if (self.normalise and nothing) or not self.kernel.any():
            raise InvalidArgument(
                "--fir taps", f"{self.taps!r}, of sum {total:g}", "a sum that is not zero",
                "Take normalise=false for a high-pass.",
            )  # fmt: skip

    @classmethod
    def of(cls, taps: ArrayLike, **others: Any) -> Self:
        """The filter of an array of one or three axes; `others` are its other fields."""
        h = np.asarray(taps, np.float64)
        text = "/".join(repr(float(v)) for v in h.ravel())
        return cls(f"{'x'.join(str(n) for n in h.shape)}:{text}" if h.ndim != 1 else text, **others)

    @cached_property
    def kernel(self) -> Float64s:
        """The taps as they were given, float64 [n] or [nx, ny, nz]."""
        h = _checked_taps(_read_taps(self.taps), self.anchor)
        if h.ndim not in (1, 3):
            raise InvalidArgument("--fir taps", f"an array of {h.ndim} axes", "one axis or three")
        return h

    @cached_property
    def _rows(self) -> list[Float64s] | None:
        """One row of taps an axis, or None where the kernel is no product of rows; normalised where that is asked."""
        scale = 1 / self.kernel.sum() if self.normalise else 1.0
        if self.kernel.ndim == 1:
            return [self.kernel * scale] * 3
        return factors(self.kernel * scale)

    def _axes(self, grid: Grid) -> tuple[AxisTaps, AxisTaps, AxisTaps]:
        """The reach of each axis, with its taps if the kernel is a product of rows."""
        rows = self._rows or [np.ones(n) for n in self.kernel.shape]
        axes = []
        for axis, (row, count) in enumerate(zip(rows, grid.shape, strict=True)):
            if count == 1 and self.kernel.ndim == 1:
                row = np.ones(1)
            found = AxisTaps(row, _origin(len(row), self.anchor))
            found.check_fits(count, f"--fir taps along {'xyz'[axis]}")
            axes.append(found)
        return axes[0], axes[1], axes[2]

    def claims(self, grid: Grid) -> Claims:
        """Linear, with the sum of the taps as its gain; the literal form moves the field by (N - 1)/2."""
        axes = self._axes(grid)
        if self._rows:
            gain = math.prod(float(a.taps.sum()) for a in axes)
            most = math.prod(float(np.abs(a.taps).sum()) for a in axes)
        else:
            scale = 1 / self.kernel.sum() if self.normalise else 1.0
            gain, most = float(self.kernel.sum() * scale), float(np.abs(self.kernel * scale).sum())
        moved = [0.0 if self.anchor == "centred" else (len(a.taps) - 1) / 2 for a in axes]
        return Claims(
            reach=(axes[0].reach, axes[1].reach, axes[2].reach),
            linear=True,
            dc_gain=gain,
            keeps_mean=abs(gain - 1) < 1e-9,
            max_principle=most < 1 + 1e-9,
            shift=(moved[0], moved[1], moved[2]),
        )

    def __call__(self, field: ForceField) -> ForceField:
        """See `FieldFilter`."""
        with np.errstate(over="ignore", invalid="ignore"):  # of taps that float32 cannot hold
            made = self._filtered(field)
        without_overflow(made.forces_n, "--fir forces")
        return made

    def _filtered(self, field: ForceField) -> ForceField:
        axes = self._axes(field.grid)
        if self._rows:
            return filter_field(field, axes, self.boundary)[0]
        if not len(field.bricks):
            return field
        if self.boundary == "zero":
            return self._summed(field, axes)
        wide = widened(field, tuple(a.before for a in axes), tuple(a.after for a in axes), self.boundary)
        return cropped(self._summed(wide, axes), field.grid)

    def _summed(self, field: ForceField, axes: tuple[AxisTaps, AxisTaps, AxisTaps]) -> ForceField:
        """All taps of the kernel at once, for kernels that are no product of rows."""
        from touchfield.filters.kernels import resample as kernels

        own = keys = brick_keys(field.grid, field.bricks)
        lattice = field.grid.brick_shape
        for axis in range(3):
            keys = spread(keys, lattice, axis, axes[axis])
        bricks = np.stack(np.unravel_index(keys, lattice), axis=1).astype(np.int32)
        weights = self.kernel[::-1, ::-1, ::-1] / (self.kernel.sum() if self.normalise else 1.0)
        before = (axes[0].before, axes[1].before, axes[2].before)
        made = kernels.bricks_filtered(field.forces_n, own, bricks, lattice, before, np.ascontiguousarray(weights))
        return brick_field(field.grid, bricks, *made)


def _read_taps(text: str) -> Float64s:
    """The taps of a text or a file, see `FirFilter`."""
    if text.endswith(".npy"):
        require_plain(text, "a .npy file")
        try:
            read = np.load(Path(text), allow_pickle=False)
            return np.asarray(read, np.float64)
        except (OSError, ValueError, TypeError) as error:
            raise InvalidArgument("--fir taps", f"{text}, which cannot be read: {error}", "a .npy file") from None
    shape, colon, numbers = text.rpartition(":")
    try:
        row = np.array([float(part) for part in numbers.split("/")])
        return row.reshape([int(n) for n in shape.split("x")]) if colon else row
    except ValueError:
        expected = "numbers with / between, 1/2/1, perhaps after a shape, 3x3x3:"
        raise InvalidArgument("--fir taps", repr(text), expected) from None


FILTER = FirFilter
