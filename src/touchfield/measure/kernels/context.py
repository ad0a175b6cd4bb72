"""Compiled loops: a voxel with its causal neighbours as one packed row, and an exact count of equal rows.

A row holds ``columns`` symbols of ``bits`` bits in uint64 words, as many whole symbols to a word as fit, the first in
the lowest bits: the symbol itself, its seven neighbours in `CORNER`, and the voxel of the previous frame.

Imported only when first needed, because it imports numba.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from touchfield.arrays import Int32s, Int64s

HALO = 2
"""Samples around a brick; what lies beyond the grid is symbol 0."""

REACH = 1
"""Samples before an array along each axis: as far back as `CORNER` goes."""

CORNER = np.array(
    [[0, 0, -1], [0, -1, 0], [-1, 0, 0], [0, -1, -1], [-1, 0, -1], [-1, -1, 0], [-1, -1, -1]], np.int64
)  # the corner {-1, 0}^3 in the order in which neighbourhoods are nested: 1, 3, 7


@njit(cache=True, nogil=True)
def fill_halo(local, symbols, slots, limit):
    """A brick and two samples of its 26 neighbours, int32 [12, 12, 12].

    `slots` int [27] tells where each of them lies in `symbols`; those below 0 or from `limit` on are left empty.
    """
    for n in range(27):
        slot = slots[n]
        held = 0 <= slot < limit
        dx, dy, dz = n // 9 - 1, n // 3 % 3 - 1, n % 3 - 1
        for x in range(max(0, 8 * dx + 2), min(12, 8 * dx + 10)):
            for y in range(max(0, 8 * dy + 2), min(12, 8 * dy + 10)):
                for z in range(max(0, 8 * dz + 2), min(12, 8 * dz + 10)):
                    local[x, y, z] = symbols[slot, (x - 2) & 7, (y - 2) & 7, (z - 2) & 7] if held else 0


@njit(cache=True, nogil=True)
def _rows(now, before, halo, extent, columns, bits, out, count):
    """Append the rows that are not all 0 of a block with `halo` samples before it; the new count."""
    per_word = 64 // bits
    cells = np.zeros(9, np.uint64)
    for x in range(extent[0]):
        for y in range(extent[1]):
            for z in range(extent[2]):
                a, b, c = x + halo, y + halo, z + halo
                cells[0] = now[a, b, c]
                some = cells[0]
                for n in range(7):
                    cells[n + 1] = now[a + CORNER[n, 0], b + CORNER[n, 1], c + CORNER[n, 2]]
                    some |= cells[n + 1]
                if columns > 8:
                    cells[8] = before[a, b, c]
                    some |= cells[8]
                if some == 0:
                    continue
                for w in range(out.shape[1]):
                    out[count, w] = 0
                for n in range(columns):
                    out[count, n // per_word] |= cells[n] << np.uint64(n % per_word * bits)
                count += 1
    return count


@njit(cache=True, nogil=True)
def _all_rows(now, old, halo, slots, slots_before, symbols, before, extents, columns, bits, out):
    # one loop for bricks and for whole arrays: the one call of _rows is compiled once
    count = 0
    for n in range(extents.shape[0]):
        if slots.shape[0] > 0:
            fill_halo(now, symbols, slots[n], symbols.shape[0])
            # no neighbour of the previous frame is looked at, but it costs nothing to have them
            fill_halo(old, before, slots_before[n], before.shape[0])
        count = _rows(now, old, halo, extents[n], columns, bits, out, count)
    return count


def field_rows(
    slots: tuple[Int64s, Int64s],
    symbols: tuple[Int32s, Int32s],
    extents: Int64s,
    columns: int,
    bits: int,
) -> NDArray[np.uint64]:
    """The rows of some bricks that are not all 0, uint64 [m, words].

    `slots` int64 [n, 27] in the frame and in the previous one; `symbols` int32 [., 8, 8, 8] of both; `extents`
    int64 [n, 3] samples of each brick within the grid.
    """
    local = np.zeros((2, 12, 12, 12), np.int32)
    out = np.empty((512 * len(extents), -(-columns // (64 // bits))), np.uint64)
    count = _all_rows(local[0], local[1], HALO, *slots, *symbols, extents, columns, bits, out)
    return out[:count]


def block_rows(
    now: Int32s, before: Int32s, extent: tuple[int, int, int], columns: int, bits: int
) -> NDArray[np.uint64]:
    """The rows of an array with its halo, int32 [nx + 1, ny + 1, nz + 1], that are not all 0."""
    size = extent[0] * extent[1] * extent[2]
    out = np.empty((size, -(-columns // (64 // bits))), np.uint64)
    none, bricks = np.zeros((0, 27), np.int64), np.zeros((0, 8, 8, 8), np.int32)
    extents = np.array([extent], np.int64)
    count = _all_rows(now, before, REACH, none, none, bricks, bricks, extents, columns, bits, out)
    return out[:count]


@njit(cache=True, nogil=True)
def _insert(rows, weights, begin, slots, keys, counts, used):
    """Count rows from `begin` on until all are counted or `keys` is full; the next row and the keys in use."""
    mask = np.uint64(slots.shape[0] - 1)
    words = rows.shape[1]
    for n in range(begin, rows.shape[0]):
        h = np.uint64(0)
        for w in range(words):
            h = (h ^ rows[n, w]) * np.uint64(0x9E3779B97F4A7C15)
            h ^= h >> np.uint64(29)
        h = (h * np.uint64(0xBF58476D1CE4E5B9)) >> np.uint64(20)
        while True:
            key = slots[h & mask]
            if key < 0:
                if used == keys.shape[0]:
                    return n, used
                slots[h & mask] = used
                for w in range(words):
                    keys[used, w] = rows[n, w]
                counts[used] = weights[n] if weights.shape[0] else 1
                used += 1
                break
            same = True  # the whole key decides, never its hash alone
            for w in range(words):
                same &= keys[key, w] == rows[n, w]
            if same:
                counts[key] += weights[n] if weights.shape[0] else 1
                break
            h += np.uint64(1)
    return rows.shape[0], used


def insert(
    rows: NDArray[np.uint64],
    weights: Int64s,
    begin: int,
    table: tuple[Int32s, NDArray[np.uint64], Int64s],
    used: int,
) -> tuple[int, int]:
    """Count rows uint64 [n, words] in a table: slots int32 [2^b] (-1: free), keys [m, words], counts int64 [m].

    `weights` int64 [n] or [0] (each row once). Stops before the first row for which no key is free.
    """
    done, full = _insert(rows, weights, begin, *table, used)
    return int(done), int(full)
