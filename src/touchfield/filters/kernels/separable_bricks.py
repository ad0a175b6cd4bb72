"""Sparse bricks through three passes of taps, of which each adds only the bricks it reaches.

Imported only when first needed, because it imports numba.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from touchfield.filters.kernels.row_sums import cleared, sums
from touchfield.medium.budget import BYTES_PER_BRICK, memory_budget_bytes, zero_forces
from touchfield.medium.kernels import first_at_least
from touchfield.parallel import for_chunks

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.filters.kernels.row_sums import Taps

    Int64s = NDArray[np.int64]
    Float32s = NDArray[np.float32]

__all__ = ["bricks_filtered"]

_NO_SIGNS = np.uint64(0x7FFFFFFF7FFFFFFF)  # all bits of two numbers but their signs
_TILE = 32  # bricks along z that are filtered at once


# The 24 numbers of a brick's row are looked at and copied as 12 words.


@njit(cache=True, nogil=True)
def _row_masks(begin, end, words, masks):
    """Which of the 64 rows of each brick hold a force, one bit a row; minus zero is none."""
    for n in range(begin, end):
        mask = np.uint64(0)
        for row in range(np.uint64(64)):
            p, merged = np.uint64(n) * np.uint64(768) + row * np.uint64(12), np.uint64(0)
            for r in range(np.uint64(12)):
                merged |= words[p + r]
            if merged & _NO_SIGNS:
                mask |= np.uint64(1) << row
        masks[n] = mask


@njit(cache=True, nogil=True)
def _source_rows(words, masks, keys, x0, bricks_x, column, source, rows):
    """Copy the rows of planes `x0` and on of a column of bricks to `source`.

    `rows` [8, 3, planes] says, for each place along y, where each begins there, and where in it forces lie, from and
    to; the end is 0 for none. `column` is the key of the column's brick at x = 0 and place 0 of a row, the step of
    keys along x, and the range of places along z, in bricks.
    """
    base, step, first, last = column
    planes = rows.shape[2]
    width = source.shape[0] * 2 // (8 * planes + 1)
    for j in range(8):
        for p in range(planes):
            rows[j, 0, p], rows[j, 1, p], rows[j, 2, p] = 8 * planes * width, width, 0  # the row that stays zero
    for xb in range(max(0, x0 >> 3), min(bricks_x, (x0 + planes + 7) >> 3)):
        key = base + xb * step
        slot = first_at_least(keys, key + first)
        while slot < keys.shape[0] and keys[slot] < key + last:
            at = (keys[slot] - key) * 24
            for p in range(max(0, xb * 8 - x0), min(planes, xb * 8 - x0 + 8)):
                for j in range(8):
                    row = (x0 + p - xb * 8) * 8 + j
                    if (masks[slot] >> np.uint64(row)) & np.uint64(1):
                        start = (j * planes + p) * width
                        o, q = np.uint64((start + at) >> 1), np.uint64((slot * 64 + row) * 12)
                        for r in range(np.uint64(12)):
                            source[o + r] = words[q + r]
                        rows[j, 0, p], rows[j, 1, p], rows[j, 2, p] = start, min(rows[j, 1, p], at), at + 24
            slot += 1


@njit(cache=True, nogil=True)
def _extents(rows, extents):
    """From where to where something lies in each of 8 sums of rows, int64 [8, 2]; the end is 0 for none."""
    for i in range(8):
        low, high = rows[1, i], rows[2, i]
        for k in range(i + 1, i + rows.shape[1] - 7):
            low, high = min(low, rows[1, k]), max(high, rows[2, k])
        extents[i, 0], extents[i, 1] = min(low, high), high


@njit(cache=True, nogil=True)
def _jobs(keys, slots, base, extents, spread, start, width, jobs):
    """The jobs of 8 rows, as far as something is spread from their extents and there are bricks for it.

    `start` is where the first row begins, `width` how far the next; see `sums`.
    """
    count = 0
    for i in range(8):
        low, high = (extents[i, 0] - spread) // 24, (extents[i, 1] + spread) // 24
        slot = slots[0]
        while extents[i, 1] > 0 and slot < slots[1] and keys[slot] - base < high:
            after = slot + 1
            while after < slots[1] and keys[after] == keys[after - 1] + 1:
                after += 1
            first, last = max(low, keys[slot] - base), min(high, keys[after - 1] + 1 - base)
            if first < last:
                jobs[count, 0], jobs[count, 1] = start + i * width + first * 24, (last - first) * 24
                jobs[count, 2], jobs[count, 3] = i, first * 24
                count += 1
            slot = after
    return count


@njit(cache=True, nogil=True)
def _column_x(words, masks, keys, keys_x, x0, lattice, place, source, rows, places, weights, ring, made, jobs):
    """One column of the ring: the sums along x of all its rows.

    `place` is the column's x and y, in bricks, the first place along z, how many places, and which column of the ring
    it is. `made` [8, 8, 2] is the extents of its rows: of what was there before, which is cleared, and of the new.
    """
    x, y, first, count, slot = place
    base = (x * lattice[1] + y) * lattice[2] + first
    low, high = max(0, -first), min(count, lattice[2] - first)
    slots = first_at_least(keys_x, base + low), first_at_least(keys_x, base + high)
    column = (y * lattice[2] + first, lattice[1] * lattice[2], low, high)
    width, planes = count * 24, rows.shape[2]
    _source_rows(words, masks, keys, x0, lattice[0], column, source.view(np.uint64), rows)
    for j in range(8):
        start = (slot * 8 + j) * 8 * width
        for i in range(8):
            cleared(ring, start + i * width + made[j, i, 0], made[j, i, 1] - made[j, i, 0])
        _extents(rows[j], made[j])
        found = _jobs(keys_x, slots, base, made[j], 0, start, width, jobs)
        sums(ring, source, rows[j, 0], jobs, found, places, weights, 8 * planes * width)
        for p in range(planes):
            if rows[j, 2, p] > 0:
                cleared(source, rows[j, 0, p] + rows[j, 1, p], rows[j, 2, p] - rows[j, 1, p])


@njit(cache=True, nogil=True)
def _ring_rows(made, owner, y0, i, width, rows):
    """Where the rows along y that the sums of a brick need lie in the ring, as `rows` in `_source_rows`."""
    for k in range(rows.shape[1]):
        s, j = ((y0 + k) >> 3) % owner.shape[0], (y0 + k) & 7
        rows[0, k], rows[1, k], rows[2, k] = owner.shape[0] * 64 * width, width, 0
        if owner[s] == (y0 + k) >> 3 and made[s, j, i, 1] > 0:
            rows[0, k], rows[1, k], rows[2, k] = ((s * 8 + j) * 8 + i) * width, made[s, j, i, 0], made[s, j, i, 1]


@njit(cache=True, nogil=True)
def _to_bricks(keys, slots, base, extents, spread, line, i, out, held):
    """Write all rows of one i of a column's bricks: what is finished in `line`, and zero elsewhere."""
    width = line.shape[0] // 4  # of a row, in numbers: two to a word
    for j in range(8):
        low, high = extents[j, 0] - spread, extents[j, 1] + spread
        for s in range(slots[0], slots[1]):
            at = (keys[s] - base) * 24
            o, p, merged = np.uint64(((s * 8 + i) * 8 + j) * 12), np.uint64((j * width + at) >> 1), np.uint64(0)
            if extents[j, 1] > 0 and low <= at < high:
                for r in range(np.uint64(12)):
                    out[o + r] = line[p + r]
                    merged |= line[p + r]
            else:
                for r in range(np.uint64(12)):
                    out[o + r] = 0
            if merged & _NO_SIGNS:
                held[s] = True


@njit(cache=True, nogil=True)
def _bricks(
    begin, end, items, source_bricks, keys_of_passes, lattice, before, deep, sizes, places, weights, out, held
):
    """Slabs of output bricks of one x and a range of z: a ring of columns filtered along x, then row by row.

    `sizes` is how many bricks along z make an item, and how many beyond them its sums reach.
    """
    keys, keys_x, keys_y, keys_z = keys_of_passes
    words, masks = source_bricks
    tile, margin = sizes
    count = tile + 2 * margin
    width = count * 24
    back = -((-before[1]) >> 3)
    columns = back + ((7 + deep[1] - before[1]) >> 3) + 1
    planes = 8 + deep[0]
    source, x_rows = np.zeros((8 * planes + 1) * width, np.float32), np.zeros((8, 3, planes), np.int64)
    ring, y_rows = np.zeros((columns * 64 + 1) * width, np.float32), np.zeros((3, 8 + deep[1]), np.int64)
    made, owner = np.zeros((columns, 8, 8, 2), np.int64), np.empty(columns, np.int64)
    rows, extents = np.zeros(9 * width, np.float32), np.zeros((8, 2), np.int64)  # the ninth row stays zero
    line, z_table = np.empty(8 * width, np.float32), np.arange(deep[2] + 1) * 3 - before[2] * 3
    line_words, jobs = line.view(np.uint64), np.empty((8 * count, 4), np.int64)
    for n in range(begin, end):
        x, first = items[n, 0], items[n, 1] * tile - margin
        owner[:] = -(1 << 40)  # of no column, not even of one before the first
        slot = first_at_least(keys_z, x * lattice[1] * lattice[2])
        last = first_at_least(keys_z, (x + 1) * lattice[1] * lattice[2])
        while slot < last:
            y = keys_z[slot] // lattice[2] - x * lattice[1]
            base = (x * lattice[1] + y) * lattice[2] + first
            low, high = base + max(0, -first), base + min(count, lattice[2] - first)
            y_slots = first_at_least(keys_y, low), first_at_least(keys_y, high)
            ends = base + margin, min(high, base + margin + tile)
            z_slots = first_at_least(keys_z, ends[0]), first_at_least(keys_z, ends[1])
            slot = first_at_least(keys_z, (x * lattice[1] + y + 1) * lattice[2])
            if y_slots[0] == y_slots[1] or z_slots[0] == z_slots[1]:
                continue
            for c in range(max(0, y - back), min(lattice[1], y - back + columns)):
                s = c % columns
                if owner[s] != c:
                    owner[s] = c
                    _column_x(
                        words, masks, keys, keys_x, x * 8 - before[0], lattice, (x, c, first, count, s), source,
                        x_rows, places[0], weights[0], ring, made[s], jobs,
                    )  # fmt: skip
            for i in range(8):
                _ring_rows(made, owner, y * 8 - before[1], i, width, y_rows)
                for j in range(8):
                    cleared(rows, j * width + extents[j, 0], extents[j, 1] - extents[j, 0])
                _extents(y_rows, extents)
                found = _jobs(keys_y, y_slots, base, extents, 0, 0, width, jobs)
                sums(rows, ring, y_rows[0], jobs, found, places[1], weights[1], columns * 64 * width)
                found = _jobs(keys_z, z_slots, base, extents, margin * 24, 0, width, jobs)
                for job in range(found):
                    jobs[job, 2], jobs[job, 3] = 0, jobs[job, 0]
                sums(line, rows, z_table, jobs, found, places[2], weights[2], 8 * width)
                _to_bricks(keys_z, z_slots, base, extents, margin * 24, line_words, i, out, held)


def bricks_filtered(
    forces_n: Float32s,
    keys: tuple[Int64s, Int64s, Int64s, Int64s],
    lattice: tuple[int, int, int],
    before: tuple[int, int, int],
    deep: tuple[int, int, int],
    taps: Taps,
) -> tuple[Float32s, NDArray[np.bool_]]:
    """The forces of output bricks, float32 [n, 8, 8, 8, 3], and which of them hold one, bool [n].

    Forces of a brick that holds none are not set.

    Parameters
    ----------
    forces_n : float32 [m, 8, 8, 8, 3]
    keys : int64
        Ascending keys of the input's bricks, and of those that hold something after x, after y and after z.
    lattice : (int, int, int)
        Bricks of the grid along each axis.
    before, deep : (int, int, int)
        For each axis, how far back the first sample of a sum lies, and how many samples after it the last one.
    taps
        As for `dense_filtered`.
    """
    count = len(keys[3])
    if count * BYTES_PER_BRICK > memory_budget_bytes():
        zero_forces(count)  # says that it is too much
    out = np.empty(
        (count, 8, 8, 8, 3), np.float32
    )  # the kernel sets every row: clearing it first is a fifth of the time
    held = np.zeros(count, np.bool_)
    words, masks = forces_n.reshape(-1).view(np.uint64), np.empty(len(forces_n), np.uint64)
    for_chunks(_row_masks, len(masks), words, masks, chunk=64)
    tile = min(lattice[2], _TILE)
    sizes = (tile, -(-max(before[2], deep[2] - before[2]) // 8))
    z, x = keys[3] % lattice[2] // tile, keys[3] // (lattice[1] * lattice[2])
    tiles = -(-lattice[2] // tile)
    items = np.stack(np.divmod(np.unique(x * tiles + z), tiles), axis=1)
    target = out.reshape(-1).view(np.uint64)
    for_chunks(_bricks, len(items), items, (words, masks), keys, lattice, before, deep, sizes, *taps, target, held)
    return out, held
