"""The states of 8x8 tiles in the light models of coder `touch`: empty, coded, or as something known already."""

from __future__ import annotations

import numpy as np

from touchfield.codec.kernels import touch_light_coder as coder
from touchfield.codec.kernels.touch_light_cells import length_of, store
from touchfield.codec.kernels.touch_light_choice import F0, FREE, MOVABLE, kept, tolerance, units
from touchfield.codec.kernels.touch_light_coder import lean

__all__ = ["CODED", "DEEPER", "EMPTY", "OLD", "STATES", "choose_state", "code_state", "code_way", "copy_tile"]

EMPTY, CODED, DEEPER, OLD = 0, 1, 2, 3
"""Nothing; sample by sample; the plane before; the reference."""

_WAY = 3 * 192
STATES = _WAY + 75
"""Contexts of `code_state` and `code_way`, from 0 on."""

_TRIALS = np.array([EMPTY, DEEPER, OLD], np.int64)


@lean
def _fits(state, cells, old, forces, scale, row, back, pitch, begin, stride, low, high, rule, f):
    """Whether a tile may be coded as empty, as the plane before, or as the reference."""
    for j in range(low[1], high[1]):
        for k in range(low[2], high[2]):
            size = units(forces, begin + j * stride[1] + k * stride[2], scale, f)
            d0 = d1 = d2 = np.int64(0)
            if state == DEEPER:
                c = (back + j * pitch + k) * 8
                if cells[c + 3] > 0:
                    d0, d1, d2 = np.int64(cells[c]), np.int64(cells[c + 1]), np.int64(cells[c + 2])
            elif state == OLD:
                c = (row + j * pitch + k) * 4
                if old[c + 3] > 0:
                    d0, d1, d2 = np.int64(old[c]), np.int64(old[c + 1]), np.int64(old[c + 2])
            held = d0 != 0 or d1 != 0 or d2 != 0
            if not held and size == 0:
                continue
            if held != (size > 0) and rule[MOVABLE] == 0:
                return False
            tol = tolerance(size, rule)
            if rule[FREE] > 0:
                tol = 0.6 * rule[F0]
                if (d0 - f[0]) ** 2 + (d1 - f[1]) ** 2 + (d2 - f[2]) ** 2 > tol * tol:
                    return False
            elif not kept(np.float64(d0), np.float64(d1), np.float64(d2), f[0], f[1], f[2], size, tol, rule):
                return False
    return True


@lean
def choose_state(is_deep, is_old, cells, old, forces, scale, row, back, pitch, begin, stride, low, high, rule, f):
    """The encoder's choice of a tile's state."""
    for trial in _TRIALS:
        if (trial == DEEPER and not is_deep) or (trial == OLD and not is_old):
            continue
        if _fits(trial, cells, old, forces, scale, row, back, pitch, begin, stride, low, high, rule, f):
            return np.int64(trial)
    return np.int64(CODED)


@lean
def code_state(mode, context, is_deep, is_old, decoding, state, buffer, chances):
    """Code a tile's state; "as the plane before" and "as the reference" are there where these hold anything."""
    if coder.plain(context, np.int64(mode == CODED), decoding, state, buffer, chances):
        return np.int64(CODED)
    if is_deep + is_old == 0:
        return np.int64(EMPTY)
    if coder.plain(context + 192, np.int64(mode != EMPTY), decoding, state, buffer, chances) == 0:
        return np.int64(EMPTY)
    bit = np.int64(is_old)
    if is_deep + is_old == 2:
        bit = coder.plain(context + 384, np.int64(mode == OLD), decoding, state, buffer, chances)
    return np.int64(OLD) if bit else np.int64(DEEPER)


@lean
def code_way(way, about, decoding, state, buffer, chances):
    """Code how a brick is predicted, 0 to 3; `about` (0 to 24) is how those before it are."""
    high = coder.plain(_WAY + about, way >> 1, decoding, state, buffer, chances)
    return high << 1 | coder.plain(_WAY + 25 + about + 25 * high, way & 1, decoding, state, buffer, chances)


@lean
def copy_tile(mode, cells, old, row, back, pitch, begin, stride, low, high, slope, out):
    """Take a tile from the plane before or from the reference."""
    for j in range(low[1], high[1]):
        for k in range(low[2], high[2]):
            to = row + j * pitch + k
            if mode == DEEPER:
                c = np.uint64((back + j * pitch + k) * 8)
                if cells[c + np.uint64(3)] == 0:
                    continue
                v0, v1, v2 = cells[c], cells[c + np.uint64(1)], cells[c + np.uint64(2)]
                for q in range(8):
                    if q != 4:
                        cells[np.uint64(to * 8 + q)] = cells[c + np.uint64(q)]
            else:
                c = np.uint64(to * 4)
                if old[c + np.uint64(3)] == 0:
                    continue
                v0, v1, v2 = old[c], old[c + np.uint64(1)], old[c + np.uint64(2)]
                a = max(np.int64(1), length_of(np.int64(v0), np.int64(v1), np.int64(v2)))
                store(cells, to, np.int64(v0), np.int64(v1), np.int64(v2), a, 0, slope)
            s = np.uint64(begin + j * stride[1] + k * stride[2])
            out[s, 0], out[s, 1], out[s, 2] = v0, v1, v2
