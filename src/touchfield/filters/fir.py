"""Applies finite impulse response (FIR) filters to arrays (equation 4), and computes their frequency response
(equation 5).

y[n] = sum over k of h[k] x[n - k], componentwise, along any number of axes of space and time. As printed,
with k = 0 .. N - 1, it is causal and shifts the signal by (N - 1)/2 samples; that is ``anchor="causal"``. The
default, ``anchor="centred"``, which is the only one for a field, puts the middle tap over the sample and
needs an odd number of taps along each axis. The paper does not define the signal beyond the border; the
argument `boundary` does (`touchfield.filters.separable`).

H(w1, ..) = sum over n of h[n] exp(-i (w1 n1 + ..)), frequencies in radians per sample (paper section 3.2).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from touchfield.arrays import Float64s, Int64s
from touchfield.compute.threads import for_chunks, worker_count
from touchfield.errors import InvalidArgument, reason, require_one_of
from touchfield.files import require_plain
from touchfield.filters.registry import Claims, FieldFilter
from touchfield.filters.separable import (
    BOUNDARIES,
    NUMPY_MODES,
    SCIPY_MODES,
    AxisTaps,
    brick_field,
    factors,
    filter_field,
    keys_of_passes,
    reach_of,
)
from touchfield.medium import BRICK, ForceField
from touchfield.medium.budget import require_memory, zero_forces
from touchfield.medium.field import bricks_of, frozen, numbers_of, padded_blocks

if TYPE_CHECKING:
    from touchfield.filters.separable import Axes
    from touchfield.medium import Grid

ANCHORS: Final = ("centred", "causal")
_MIN_THREADED: Final = 1 << 20  # numbers: fewer are checked by numpy


def fir_filter(
    signal: ArrayLike, taps: ArrayLike, *, anchor: str = "centred", boundary: str = "zero"
) -> NDArray[Any]:
    """Apply equation 4 to a dense array.

    signal : float32, else converted to float64, M-D; its leading axes are filtered, as many as `taps` has.
    taps : float, N-D, N <= M; h, the kernel.
    anchor : {"centred", "causal"}; which tap stands over the sample: the middle one, or the first, as
        printed.
    boundary : {"zero", "nearest", "reflect", "wrap"}; see `touchfield.filters.separable`.
    Returns float32 or float64 of the signal's shape and type. Raises `InvalidArgument` if the kernel is
    empty, not finite, larger than the signal, or even and to be centred; if the signal or a sum is not
    finite; for other words.
    """
    x, h = checked_signal(signal, boundary), _checked_taps(taps, anchor)
    if h.ndim > x.ndim:
        raise InvalidArgument("taps", f"{h.ndim} axes for a signal {x.shape}", f"at most {x.ndim}")
    origins = [n // 2 if anchor == "centred" else 0 for n in h.shape]
    for axis, (n, count) in enumerate(zip(h.shape, x.shape, strict=False)):
        AxisTaps(np.ones(n)).check_fits(count, f"taps of axis {axis}")
    with np.errstate(over="ignore", invalid="ignore"):
        sums = direct_sums(x, factors(h) or h, origins, boundary)
    return without_overflow(sums, "signal")


def checked_signal(signal: ArrayLike, boundary: str) -> NDArray[Any]:
    """Return a dense array in float32 or float64.

    Raises `InvalidArgument` for an unknown boundary, or a number that is not finite.
    """
    require_one_of("boundary", boundary, BOUNDARIES)
    kind = np.float32 if getattr(signal, "dtype", None) == np.float32 else np.float64
    x = numbers_of("signal", signal, kind)
    if not _is_all_finite(x):
        raise InvalidArgument("signal", "a number that is not finite", "finite numbers")
    return x


def without_overflow(sums: NDArray[Any], where: str) -> NDArray[Any]:
    """Return the sums; raise `InvalidArgument` naming `where` if a sum overflowed its type."""
    if not _is_all_finite(sums):
        expected = f"sums below {np.finfo(sums.dtype).max:.3g}"
        mend = "Scale the signal or the taps down."
        raise InvalidArgument(where, f"numbers whose sums are beyond {sums.dtype}", expected, mend)
    return sums


def _is_all_finite(x: NDArray[Any]) -> bool:
    """True if all numbers are finite; large arrays are checked by all threads without a temporary array."""
    if x.size < _MIN_THREADED or not x.flags.c_contiguous:
        return bool(np.isfinite(x).all())
    from touchfield.filters.kernels.separable import COUNT_BLOCK, count_not_finite

    counts = np.zeros(-(-x.size // COUNT_BLOCK), np.int64)
    for_chunks(count_not_finite, len(counts), frozen(x).reshape(-1), np.finfo(x.dtype).max, counts)
    return not counts.any()


def _checked_taps(taps: ArrayLike, anchor: str) -> Float64s:
    h = numbers_of("taps", taps, is_finite=True)
    if not h.size or not h.ndim:
        raise InvalidArgument(
            "taps", f"an array {h.shape}", "at least one tap along each of one or more axes"
        )
    require_one_of("anchor", anchor, ANCHORS)
    if anchor == "centred" and any(n % 2 == 0 for n in h.shape):
        mend = "An even kernel has no middle tap: add a zero."
        raise InvalidArgument("taps", f"{h.shape} taps to be centred", "an odd number along each axis", mend)
    return h


def direct_sums(
    x: NDArray[Any], taps: Float64s | list[Float64s], origins: list[int], boundary: str
) -> NDArray[Any]:
    """Filter by a box of taps with `scipy.ndimage`, or by one row of taps after the other."""
    if isinstance(taps, list):
        return _separable_sums(x, taps, origins, boundary)
    from scipy import ndimage

    # scipy counts the origin from the middle of the mirrored kernel
    origin = [n - 1 - o - n // 2 for n, o in zip(taps.shape, origins, strict=True)]
    trailing = x.ndim - taps.ndim
    mirrored = np.flip(taps).reshape(*taps.shape, *[1] * trailing)
    return np.asarray(
        ndimage.correlate(x, mirrored, mode=SCIPY_MODES[boundary], origin=[*origin, *[0] * trailing])
    )


def filter_dense(
    field: ForceField, taps: Float64s | list[Float64s], origins: list[int], boundary: str
) -> ForceField:
    """Filter a field as a dense array that continues beyond its border as `boundary` says.

    `InvalidArgument` if the array exceeds `memory_budget_bytes`, or a sum is beyond float32.
    """
    require_memory("boundary", "a dense field", 24 * field.grid.voxel_count, "Take boundary=zero.")
    return ForceField.from_dense(
        field.grid, without_overflow(direct_sums(field.to_dense(), taps, origins, boundary), "forces")
    )


_Along = tuple[Int64s, Int64s, NDArray[Any], tuple[int, int, int]]
"""Runs, indices, weights and sizes of an axis: see `touchfield.filters.kernels.separable.sums_along`."""


def _separable_sums(x: NDArray[Any], taps: list[Float64s], origins: list[int], boundary: str) -> NDArray[Any]:
    """Filter along one axis after the other; the last two of three axes are done together, plane by plane."""
    from touchfield.filters.kernels.separable import sums_along, sums_along_float32, sums_of_planes

    is_float32, source, out = x.dtype == np.float32, np.ascontiguousarray(x), np.empty(x.shape, x.dtype)
    along = [
        _along(x, row[::-1], origin, axis, boundary)
        for axis, (row, origin) in enumerate(zip(taps, origins, strict=True))
    ]
    counts = [math.prod(x.shape[:axis]) for axis in range(len(taps))]  # of the rows that an axis has
    has_planes = is_float32 and len(taps) > 2 and counts[-2] >= 2 * worker_count()
    for (runs, indices, weights, sizes), count in list(zip(along, counts, strict=True))[
        : -2 if has_planes else None
    ]:
        blocks, arrays = (
            -(-sizes[1] // sizes[2]),
            (frozen(source).reshape(count, -1), runs, indices, weights, sizes),
        )
        for_chunks(
            sums_along_float32 if is_float32 else sums_along, count * blocks, *arrays, out.reshape(count, -1)
        )
        source = out
    if has_planes:
        rows, lines = (out.reshape(count, -1) for count in counts[-2:])
        for_chunks(sums_of_planes, counts[-2], rows, lines, *along[-2:])
    return out


def _along(x: NDArray[Any], weights: Float64s, origin: int, axis: int, boundary: str) -> _Along:
    """Return the arguments of `sums_along` for an axis; the last weight is of the sample `origin` ahead."""
    from touchfield.filters.kernels.separable import COLUMNS

    count, stride = x.shape[axis], math.prod(x.shape[axis + 1 :])
    # the samples that a line continues with, and which of them lie one behind the other; -1 for zero
    line = np.pad(np.arange(count) + 1, (len(weights) - 1 - origin, origin), mode=NUMPY_MODES[boundary]) - 1
    filled = np.flatnonzero(line >= 0)
    starts = filled if stride > COLUMNS else filled[np.diff(line[filled], prepend=-2) != 1]
    runs = np.stack([starts, line[starts], np.diff(starts, append=filled[-1:] + 1)], axis=1)
    indices = np.flatnonzero(weights)
    fill = (
        0,
        0 if x.dtype == np.float32 else -len(indices) % 4,
    )  # the kernel of float64 takes four weights at once
    taps, indices = np.pad(weights[indices].astype(x.dtype), fill), np.pad(indices, fill)
    return runs, indices, taps, (len(line), stride, max(1, min(stride, COLUMNS)))


@dataclass(frozen=True)
class FirFilter(FieldFilter):
    """Equation 4 on the sparse bricks of a field, without a dense copy.

    taps : str; the taps of one axis, ``1/2/1``, applied along all three but those of a single sample; or a
        box of taps in raster order after its shape, ``3x1x3:0/1/0/1/-4/1/0/1/0``.
    normalise : bool; scale the taps to unit sum, so that a constant field stays itself.
    boundary : str, optional; how the field continues beyond its border, "zero" (default), "nearest",
        "reflect" or "wrap" (`touchfield.filters.separable`); all but "zero" filter a dense copy.
    Raises `InvalidArgument` if the taps cannot be read, are not finite, even, or of sum zero and to be
    normalised; on use, if the kernel is larger than the field, or a sum is beyond float32.
    """

    name: ClassVar[str] = "fir"
    summary: ClassVar[str] = "equation 4 with these taps: 1/2/1, or -1/2/-1,normalise=false, or TAPS.npy"
    example: ClassVar[str] = "1/2/1"

    taps: str
    normalise: bool = True
    boundary: str | None = None

    @classmethod
    def expand(cls, text: str) -> str:
        """Replace NAME.npy, float [n] or [nx, ny, nz], by its taps as text.

        `InvalidArgument` if it cannot be read.
        """
        first, comma, more = text.partition(",")
        name = first.strip().removeprefix("taps=")
        if not name.lower().endswith(".npy"):
            return text
        require_plain(name, "a .npy file")
        try:
            taps = np.asarray(np.load(name, allow_pickle=False), np.float64)
        except (OSError, ValueError, TypeError) as error:
            found = f"{name}, which cannot be read ({reason(error)})"
            raise InvalidArgument("--fir taps", found, "a .npy file of numbers") from error
        shape = "x".join(map(str, taps.shape))
        return f"{shape}:{'/'.join(map(repr, taps.ravel().tolist()))}{comma}{more}"

    def __post_init__(self) -> None:
        require_one_of("--fir boundary", self.boundary or "zero", BOUNDARIES)
        total = float(self.kernel.sum())
        nothing = abs(total) <= 1e-12 * float(np.abs(self.kernel).sum())
        if (self.normalise and nothing) or not self.kernel.any():
            mend = "Take normalise=false for a high-pass."
            raise InvalidArgument(
                "--fir taps", f"{self.taps!r}, of sum {total:g}", "a sum that is not zero", mend
            )

    @cached_property
    def kernel(self) -> Float64s:
        """The taps before normalisation, float64 [n] or [nx, ny, nz]."""
        h = _checked_taps(_read_taps(self.taps), "centred")
        if h.ndim not in (1, 3):
            raise InvalidArgument("--fir taps", f"an array of {h.ndim} axes", "one axis or three")
        return h

    @cached_property
    def _weights(self) -> Float64s:
        """The taps, of unit sum if `normalise` is set."""
        return self.kernel / self.kernel.sum() if self.normalise else self.kernel

    @cached_property
    def _rows(self) -> list[Float64s] | None:
        """One row of taps an axis, or None where the kernel is no product of rows."""
        return [self._weights] * 3 if self.kernel.ndim == 1 else factors(self._weights)

    def _axes(self, grid: Grid) -> Axes:
        """The reach of each axis, with its taps if the kernel is a product of rows."""
        rows = self._rows or [np.ones(n) for n in self.kernel.shape]
        axes = []
        for axis, (row, count) in enumerate(zip(rows, grid.shape, strict=True)):
            if count == 1 and self.kernel.ndim == 1:
                row = np.ones(1)
            axes.append(AxisTaps(row))
            axes[-1].check_fits(count, f"--fir taps along {'xyz'[axis]}")
        return axes[0], axes[1], axes[2]

    def claims(self, grid: Grid) -> Claims:
        """Linear, with the sum of the taps as its gain."""
        axes = self._axes(grid)
        parts = [a.taps for a in axes] if self._rows else [self._weights]
        gain, magnitude_sum = (
            math.prod(float(part.sum()) for part in factors) for factors in (parts, map(np.abs, parts))
        )
        return Claims(
            reach_of(axes),
            linear=True,
            dc_gain=gain,
            keeps_mean=abs(gain - 1) < 1e-9,
            max_principle=magnitude_sum < 1 + 1e-9,
        )

    def __call__(self, field: ForceField) -> ForceField:
        """See `FieldFilter`."""
        axes = self._axes(field.grid)
        with np.errstate(over="ignore", invalid="ignore"):  # taps beyond float32
            if self.boundary not in (None, "zero"):
                taps = [a.taps for a in axes] if self._rows else self._weights
                result = filter_dense(field, taps, [a.reach for a in axes], self.boundary)
            elif self._rows or not len(field.bricks):
                result = filter_field(field, axes)[0]
            else:
                result = self._summed(field, axes)
        without_overflow(result.forces_n, "--fir forces")
        return result

    def _summed(self, field: ForceField, axes: Axes) -> ForceField:
        """Filter by all taps of the kernel at once, for kernels that are no product of rows."""
        from scipy import ndimage

        bricks = bricks_of(field.grid, keys_of_passes(field, axes)[3])
        weights, sums = np.flip(self._weights)[None, ..., None], zero_forces(len(bricks))
        middle = (slice(None), *(slice(n // 2, n // 2 + BRICK) for n in self.kernel.shape))
        reach = reach_of(axes)
        for span, blocks in padded_blocks(field, field.forces_n, bricks, reach, reach):
            sums[span] = ndimage.correlate(blocks, weights, mode="constant")[middle]
        return brick_field(field.grid, bricks, sums, np.asarray(sums.any(axis=(1, 2, 3, 4))))


def _read_taps(text: str) -> Float64s:
    """Parse the taps of a text, see `FirFilter`."""
    shape, colon, numbers = text.rpartition(":")
    try:
        row = np.array([float(part) for part in numbers.split("/")])
        return row.reshape([int(n) for n in shape.split("x")]) if colon else row
    except ValueError:
        expected = "numbers with / between, 1/2/1, perhaps after a shape, 3x3x3:"
        raise InvalidArgument("--fir taps", repr(text), expected) from None


def frequency_response(taps: ArrayLike, *omegas: ArrayLike) -> NDArray[np.complex128]:
    """Return equation 5, H(w1, ..) of a kernel [n1, ...], complex128 of the shape of the frequencies.

    omegas : frequencies in radians per sample, one array for each axis of the kernel; `InvalidArgument` for
        more or fewer. 20 log10 |H| is the gain in dB.
    """
    kernel = numbers_of("taps", taps)
    if kernel.ndim != len(omegas) or not omegas:
        raise InvalidArgument(
            "frequency_response", f"{len(omegas)} frequencies", f"{kernel.ndim}, one for each axis"
        )
    frequencies = np.broadcast_arrays(*(numbers_of("omegas", w) for w in omegas))
    response: Any = np.broadcast_to(kernel, (*frequencies[0].shape, *kernel.shape))
    for omega, count in zip(reversed(frequencies), reversed(kernel.shape), strict=True):
        wave = np.exp(-1j * omega[..., None] * np.arange(count))
        wave = wave.reshape(*omega.shape, *([1] * (response.ndim - omega.ndim - 1)), count)
        response = (response * wave).sum(axis=-1)
    return np.asarray(response, np.complex128)
