"""Compiled choice of the column guess's encoder: the residuals that save most of the voxels' bits for their own."""

from __future__ import annotations

import numpy as np

from touchfield.codec.touch.kernels import columns as layout
from touchfield.codec.touch.kernels.columns_fit import fit_one, fit_two
from touchfield.lean import entry, inlined, lean

__all__ = ["choose_row"]

# bits, about: of a voxel that the guess misses, of all of a column's constant ones, and above which to try two
_MISS, _PLATEAU_MISS, _WORTH_TWO = 6.5, 20.0, 16.0
_A, _X, _Y, _Z = layout.A, layout.X, layout.Y, layout.Z


@lean
def _bits(r):
    """Bits of a residual, about."""
    r = abs(r)
    if r > 20:
        return 13.0 + 2 * np.log2(r - 19)
    return 2.6 + min(r, 4) + 0.35 * max(r - 4, 0) if r else 0.1


@lean
def _cost(columns, at, fits, n, enough):
    """Bits that the voxels of a column would still take, about; whatever is above `enough` counts as that."""
    heads, d, stop = columns.heads, fits.forces[n], fits.forces.shape[1]
    one, two = columns.surfaces[at], columns.surfaces[at + 1]
    cost = 0.0
    for t in range(max(np.int64(0), min(fits.spans[n, 0], one[_Z] >> 8)), stop):
        share, more = layout.share_at(one, t, heads), layout.share_at(two, t, heads)
        whole = share == 65536 and (more == 65536 or two[_A] == 0) and t >= fits.spans[n, 1]
        a, b = np.float64(share * one[_A]), np.float64(more * two[_A])
        square = 0.0
        for c in range(3):
            x = (a * one[layout.U + c] + b * two[layout.U + c]) / 1073741824.0 - d[t, c]
            square += x * x
        tol = max(fits.mask[1], fits.mask[0] * d[t, 3])
        if square > tol * tol:
            cost += min(_MISS * (stop - t), _PLATEAU_MISS) if whole else _MISS
        if whole or cost > enough:
            return cost
    return cost


@lean
def _try(columns, at, fits, n, own, best):
    """Set the column's surfaces as ``columns.told`` says, and return the bits that this takes, about.

    Bits 0, 1, 2 of `own` tell whether the direction, the start and the amplitude of the last surface are as fitted,
    else as expected; those of the first one of two are as fitted.
    """
    r, expected, count, mode = columns.residuals, columns.expected, columns.told[0], columns.told[1]
    columns.surfaces[at + 1, _A] = 0
    bits = 0.2 + 2.0 * (mode > 0) + 3.0 * (count > 1)
    for slot in range(count):
        fit = fits.surfaces[n, slot + count - 1]
        layout.expect(columns, at, np.int64(slot))
        for c in range(4):
            told = slot + 1 < count or (own >> max(0, c - 1)) & 1
            r[slot, c] = 0
            if told and fit[_A] + (c != _A) > 0.0:
                steps = (fit[c] - expected[c]) / layout.step_of(columns, np.int64(c))
                r[slot, c] = np.int64(np.rint(min(max(steps, -1e6), 1e6)))
            bits += _bits(r[slot, c])
            if c == layout.Y:
                layout.turn(columns, at, np.int64(slot))
        layout.set_surface(columns, at, np.int64(slot))
    return bits + _cost(columns, at, fits, n, best - bits) if bits < best else best


@inlined
def _choose(columns, at, fits, n):
    """Set the residuals of one column, and ``columns.told``."""
    told, best = columns.told, 1e18
    fit_one(fits, n)
    chosen = np.int64(1), np.int64(0), np.int64(0)
    modes = layout.MODES if layout.is_torn(columns.surfaces, at, columns.row) else 1
    for count in range(1, 3):
        if count == 2 and (best < _WORTH_TWO or not fit_two(fits, n)):
            break
        for mode in range(modes):
            for own in range(8):
                told[0], told[1] = count, mode
                bits = _try(columns, at, fits, n, np.int64(own), best)
                if bits < best:
                    best, chosen = bits, (np.int64(count), np.int64(mode), np.int64(own))
    told[0], told[1] = chosen[0], chosen[1]
    _try(columns, at, fits, n, chosen[2], 1e18)


@entry
def choose_row(columns, row, fits, wishes):
    """Choose what `code_row` is to write of a row, of what was fitted: `wishes`, zeros before."""
    for n in range(fits.places.shape[0]):
        j = fits.places[n]
        _choose(columns, (row + 1) * columns.row + 2 * j + 2, fits, n)
        wishes[j, 0], wishes[j, 1] = columns.told[0], columns.told[1]
        for c in range(8):
            wishes[j, 2 + c] = columns.residuals[c >> 2, c & 3]
