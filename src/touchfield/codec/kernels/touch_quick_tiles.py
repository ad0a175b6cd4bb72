"""Tiles of 8x8 samples in the quick model of coder `touch`: empty, coded, or as something known already."""

from __future__ import annotations

import numpy as np

from touchfield.codec.kernels.touch_light_choice import F0, FREE, MOVABLE, kept, tolerance, units
from touchfield.codec.kernels.touch_light_coder import lean
from touchfield.codec.kernels.touch_light_tiles import CODED, DEEPER, EMPTY, OLD
from touchfield.codec.kernels.touch_quick_cells import HELD, RAW, ready, scaled
from touchfield.codec.kernels.touch_quick_coder import plain, quick

__all__ = [
    "CODED",
    "EMPTY",
    "TILES",
    "choose_state",
    "code_state",
    "code_way",
    "copy_tile",
    "mark",
    "turned",
    "turned_back",
]

_WAY = 3 * 192
TILES = _WAY + 128
"""Contexts of `code_state` and `code_way`, from 0 on."""


@lean
def turned(to, n, slot, stride, values):
    """The samples of a brick from `slot` on in the order of the scan, or zeros, as brick `n` of a layer."""
    at = np.uint64(n * 512)
    for i in range(8):
        for j in range(8):
            for k in range(8):
                if values is None:
                    to[at, 0] = to[at, 1] = to[at, 2] = 0
                else:
                    s = np.uint64(slot + i * stride[0] + j * stride[1] + k * stride[2])
                    to[at, 0], to[at, 1], to[at, 2] = values[s, 0], values[s, 1], values[s, 2]
                at += np.uint64(1)


@lean
def turned_back(values, n, slot, stride, to):
    """The inverse of `turned`."""
    at = np.uint64(n * 512)
    for i in range(8):
        for j in range(8):
            for k in range(8):
                s = np.uint64(slot + i * stride[0] + j * stride[1] + k * stride[2])
                to[s, 0], to[s, 1], to[s, 2] = values[at, 0], values[at, 1], values[at, 2]
                at += np.uint64(1)


@lean
def mark(was, row, pitch, old, begin):
    """Tell in `was` where a tile of the reference has forces; whether it has any."""
    any_set = np.int64(0)
    for j in range(8):
        for k in range(8):
            s = np.uint64(begin + j * 8 + k)
            if (old[s, 0] | old[s, 1] | old[s, 2]) != 0:
                was[np.uint64(row + j * pitch + k)] = 1
                any_set = np.int64(1)
    return any_set


@lean
def _fits(state, forces, scale, there, cells, was, old, row, back, pitch, begin, low, high, rule, f, law):
    """Whether a tile may be coded as empty, as the plane before, or as the reference."""
    for j in range(low[1], high[1]):
        for k in range(low[2], high[2]):
            s = np.uint64(begin + j * 8 + k)
            size = units(forces, s, scale, f)
            d0 = d1 = d2 = np.int64(0)
            if state == DEEPER:
                at = back + j * pitch + k
                if there[np.uint64(at)] != 0:
                    ready(at, there, cells, law)
                    c = np.uint64(at * 8)
                    a = np.int64(cells[c + np.uint64(3)])
                    d0, d1 = scaled(np.int64(cells[c]), a), scaled(np.int64(cells[c + np.uint64(1)]), a)
                    d2 = scaled(np.int64(cells[c + np.uint64(2)]), a)
            elif state == OLD and was[np.uint64(row + j * pitch + k)]:
                d0, d1, d2 = np.int64(old[s, 0]), np.int64(old[s, 1]), np.int64(old[s, 2])
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
def choose_state(
    is_deep, is_old, asked, scale, there, cells, was, old, row, back, pitch, begin, low, high, rule, f, law
):
    """The encoder's choice of a tile's state."""
    for state in (EMPTY, DEEPER, OLD):
        if (state == DEEPER and not is_deep) or (state == OLD and not is_old):
            continue
        if _fits(state, asked, scale, there, cells, was, old, row, back, pitch, begin, low, high, rule, f, law):
            return np.int64(state)
    return np.int64(CODED)


@quick
def code_state(mode, context, is_deep, is_old, source, span, x, place, data, chances):
    """Code a tile's state; "as the plane before" and "as the reference" are there where these hold anything."""
    bit, span, x, place = plain(context, np.int64(mode == CODED), source, span, x, place, data, chances)
    out = np.int64(CODED)
    if bit == 0:
        if is_deep + is_old > 0:
            bit, span, x, place = plain(context + 192, np.int64(mode != EMPTY), source, span, x, place, data, chances)
        out = np.int64(EMPTY)
        if bit:
            bit = is_old
            if is_deep + is_old == 2:
                bit, span, x, place = plain(
                    context + 384, np.int64(mode == OLD), source, span, x, place, data, chances
                )
            out = np.int64(OLD) if bit else np.int64(DEEPER)
    return out, span, x, place


@quick
def code_way(way, about, source, span, x, place, data, chances):
    """Code how a brick is predicted, 0 to 3; `about` (0 to 24) is how those before it are."""
    high, span, x, place = plain(_WAY + about, way >> 1, source, span, x, place, data, chances)
    about += 25 + 25 * high
    bit, span, x, place = plain(_WAY + about, way & 1, source, span, x, place, data, chances)
    return high << 1 | bit, span, x, place


@lean
def copy_tile(mode, there, cells, was, old, made, row, back, pitch, begin, low, high, law):
    """Take a tile from the plane before or from the reference."""
    for j in range(low[1], high[1]):
        for k in range(low[2], high[2]):
            to = np.uint64(row + j * pitch + k)
            c = to * np.uint64(8)
            s = np.uint64(begin + j * 8 + k)
            if mode == OLD:
                if was[to] == 0:
                    continue
                v0, v1, v2 = old[s, 0], old[s, 1], old[s, 2]
                there[to] = RAW
                cells[c], cells[c + np.uint64(1)], cells[c + np.uint64(2)] = v0, v1, v2
                made[s, 0], made[s, 1], made[s, 2] = v0, v1, v2
                continue
            at = back + j * pitch + k
            if there[np.uint64(at)] == 0:
                continue
            ready(at, there, cells, law)
            there[to] = HELD
            b = np.uint64(at * 8)
            for q in range(8):
                cells[c + np.uint64(q)] = cells[b + np.uint64(q)]
            cells[c + np.uint64(4)] = 0
            a = np.int64(cells[b + np.uint64(3)])
            for q in range(3):
                made[s, q] = scaled(np.int64(cells[b + np.uint64(q)]), a)
