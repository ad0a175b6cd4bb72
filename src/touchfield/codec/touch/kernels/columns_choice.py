"""Compiled choice of the column guess's encoder: the residuals that save most of the voxels' bits for their own."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from touchfield.codec.kernels.lean import entry, inlined, lean
from touchfield.codec.touch.kernels.columns import (
    A,
    CUT,
    MODES,
    TOP,
    U,
    X,
    XY_STEP,
    Y,
    Z,
    Z_STEP,
    amplitude_step,
    code_column,
    expect,
    is_torn,
    set_surface,
    slope_of,
)  # fmt: skip

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["Fits", "write_row"]

# bits, about: of a voxel that the guess misses, of all of a column's constant ones, and above which to try two
_MISS, _PLATEAU_MISS, _WORTH_TWO = 5.0, 20.0, 20.0


class Fits(NamedTuple):
    """What the columns of a row speak for; those that can be told, ascending.

    Attributes
    ----------
    places : int64 [n]
        In the row.
    forces : float32 [n, depth, 4]
        Across, across, outward, and the length, units, from outside to inside.
    spans : int64 [n, 2]
        The first sample with a force, and that from which on it is constant.
    surfaces : float64 [n, 3, 4]
        Z, X, Y, A of the one surface, and of two; A is 0 where it cannot be told.
    mask : float64 [2]
        k, and F_0 in units.
    """

    places: NDArray[np.int64]
    forces: NDArray[np.float32]
    spans: NDArray[np.int64]
    surfaces: NDArray[np.float64]
    mask: NDArray[np.float64]


@lean
def _bits(r):
    """Bits of a residual, about."""
    r = abs(r)
    if r > 20:
        return 13.0 + 2 * np.log2(r - 19)
    return 2.6 + min(r, 4) + 0.35 * max(r - 4, 0) if r else 0.1


@lean
def _cost(columns, at, fits, n, count, enough):
    """Bits that the voxels of a column would still take, about; whatever is above `enough` counts as that."""
    heads, d, stop = columns.heads, fits.forces[n], fits.forces.shape[1]
    first, second = columns.surfaces[at], columns.surfaces[at + 1]
    slopes = slope_of(first, heads), slope_of(second, heads)
    limit = heads[CUT] << 16
    cost = 0.0
    start = min(first[Z], second[Z]) if count == 2 else first[Z]
    more = np.int64(0)
    for t in range(max(np.int64(0), min(fits.spans[n, 0], start >> 8)), stop):
        share = min(max(((t << 8) - first[Z]) * slopes[0] >> 8, np.int64(0)), np.int64(65536))
        if count == 2:
            more = min(max(((t << 8) - second[Z]) * slopes[1] >> 8, np.int64(0)), np.int64(65536))
        whole = share == 65536 and (more == 65536 or count < 2) and t >= fits.spans[n, 1]
        a, b = np.float64(share * first[A]), np.float64(more * second[A])
        if a + b <= limit:
            a = b = 0.0
        square = 0.0
        for c in range(3):
            x = (a * first[U + c] + b * second[U + c]) / 1073741824.0 - d[t, c]
            square += x * x
        tol = max(fits.mask[1], fits.mask[0] * d[t, 3])
        if square > tol * tol:
            cost += min(_MISS * (stop - t), _PLATEAU_MISS) if whole else _MISS
            if cost > enough:
                return cost
        if whole:
            return cost
    return cost


@lean
def _nearest(value, step):
    return np.int64(np.rint(min(max(value / step, -1e6), 1e6)))


@lean
def _copy(source, out):
    for slot in range(2):
        for c in range(4):
            out[slot, c] = source[slot, c]


@lean
def _try(columns, at, fits, n, count, mode, own, best, kept):
    """Residuals of a column of `count` surfaces: `own` or as expected; kept if they take fewer bits than `best`."""
    heads, r, expected = columns.heads, columns.residuals, columns.expected
    bits = 2.0 * (mode > 0) + 3.0 * (count > 1) + 0.2
    for slot in range(count):
        fit = fits.surfaces[n, slot + count - 1]
        if not expect(columns, at, np.int64(slot), mode if slot == 0 else np.int64(0)):
            return best
        if slot:
            expected[A] = max(heads[TOP] >> 4, heads[TOP] - columns.surfaces[at, A])
        elif count == 2:
            expected[A] = heads[TOP] >> 1
        for c in range(4):
            r[slot, c] = 0
        if own & 1 or (count == 2 and slot == 0):
            r[slot, 0] = _nearest(fit[X] - expected[X], heads[XY_STEP])
            r[slot, 1] = _nearest(fit[Y] - expected[Y], heads[XY_STEP])
        if own & 1 or count == 2:
            if fit[A] > 0.0:
                r[slot, 3] = _nearest(fit[A] - expected[A], amplitude_step(expected[A], heads))
        if own & 2 or count == 2:
            r[slot, 2] = _nearest(fit[Z] - expected[Z], heads[Z_STEP])
        set_surface(columns, at, np.int64(slot))
        for c in range(4):
            bits += _bits(r[slot, c])
    if bits < best:
        bits += _cost(columns, at, fits, n, count, best - bits)
    if bits < best:
        _copy(r, kept)
        columns.told[0] = count
        columns.told[1] = mode
        return bits
    return best


@inlined
def _choose(columns, at, fits, n, kept):
    """The residuals of one column."""
    best = 1e18
    modes = MODES if is_torn(columns.surfaces, at, columns.row) else 1
    for count in range(1, 3):
        if count == 2 and (best < _WORTH_TWO or fits.surfaces[n, 2, A] <= 0.0):
            break
        for mode in range(modes):
            for own in range(4 // count):
                best = _try(columns, at, fits, n, np.int64(count), np.int64(mode), np.int64(own), best, kept)
    _copy(kept, columns.residuals)


@entry
def write_row(bits, at, columns, row, count, fits, kept):
    """Choose and write the columns of a row, of what was fitted."""
    n = 0
    for j in range(count):
        place = (row + 1) * columns.row + 2 * j + 2
        columns.told[0] = 0
        if n < fits.places.shape[0] and fits.places[n] == j:
            _choose(columns, place, fits, n, kept)
            n += 1
        code_column(bits, at, columns, place)
