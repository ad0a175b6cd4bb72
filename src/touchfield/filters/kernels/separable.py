"""Sparse bricks through three passes of taps, of which each adds only the bricks it reaches.

The inner loop makes weighted sums of four short rows at once, their sums held in registers (`four_rows`). A
loop of 24 numbers is too short for the compiler: the tests that two rows do not overlap cost as much as the
sums. There the vectors are written as such, with eight lanes: those of 24 it would take to pieces after the
loop. Imported only when first needed.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from touchfield.compute.jit import inner, kernel
from touchfield.medium.kernels import first_at_least

ROW = 24  # numbers of a brick's row: eight samples of three components
_LANES = 8  # twelve sums of them leave registers for a weight
_FLOATS = ir.VectorType(ir.FloatType(), _LANES)
_SAME_PLACE = ir.Constant(ir.VectorType(ir.IntType(32), _LANES), [0] * _LANES)


def _four_rows(typing, out, o, out_step, flat, at, step, offsets, weights, count):
    """``out[o + r out_step + n] = sum over k of weights[k] flat[at + r step + offsets[k] + n]``, r < 4, n
    < 24.

    The sum runs over the first `count` of `offsets` int64 and `weights` float32; of none it is zero. `out`
    and `flat` are float32 [n]. Product and addition may be rounded once. No place is tested.
    """
    i64 = types.int64

    def generated(context, builder, signature, arguments):
        def data(n):
            return context.make_array(signature.args[n])(context, builder, arguments[n]).data

        def part(numbers, first, stride, n):
            row, lane = divmod(n * _LANES, ROW)
            place = builder.add(first, builder.mul(stride, ir.Constant(ir.IntType(64), row)))
            place = builder.add(place, ir.Constant(ir.IntType(64), lane))
            return builder.bitcast(builder.gep(numbers, [place]), _FLOATS.as_pointer())

        o, out_step, at, step = (arguments[n] for n in (1, 2, 4, 5))
        target, source, offsets, weights = data(0), data(3), data(6), data(7)
        nothing = ir.Constant(_FLOATS, [0.0] * _LANES)
        sums = [cgutils.alloca_once_value(builder, nothing) for _ in range(4 * ROW // _LANES)]
        for kept in sums:
            builder.store(nothing, kept)
        with cgutils.for_range(builder, arguments[8]) as loop:
            weight = builder.load(builder.gep(weights, [loop.index]))
            empty = ir.Constant(_FLOATS, ir.Undefined)
            spread = builder.insert_element(empty, weight, ir.Constant(ir.IntType(32), 0))
            spread = builder.shuffle_vector(spread, empty, _SAME_PLACE)
            first = builder.add(at, builder.load(builder.gep(offsets, [loop.index])))
            for n, kept in enumerate(sums):
                numbers = builder.load(part(source, first, step, n), align=4)
                product = builder.fmul(spread, numbers, flags=("contract",))
                builder.store(builder.fadd(builder.load(kept), product, flags=("contract",)), kept)
        for n, kept in enumerate(sums):
            builder.store(builder.load(kept), part(target, o, out_step, n), align=4)
        return context.get_dummy_value()

    return types.void(out, i64, i64, flat, i64, i64, offsets, weights, i64), generated


four_rows: Any = intrinsic(_four_rows)


_NO_SIGNS = np.uint64(0x7FFFFFFF7FFFFFFF)  # all bits of two numbers but their signs
_NO_SIGN = np.uint32(0x7FFFFFFF)
TILE = 32  # bricks along z that are filtered at once
_PLANE, _BRICK = 8 * ROW, 64 * ROW  # numbers
_FOUR = np.uint64(0xF)  # the bits of four rows of one i
_HALF = np.uint64(0xFFFFFFFF)  # those of four i
_COLUMN = np.uint64(0x0101010101010101)  # the bits of a mask whose rows have j = 0


@kernel
def row_masks(begin, end, words, masks):
    """The rows, of the 64 of each brick, that hold a force, one bit a row; minus zero is none."""
    for n in range(begin, end):
        mask = np.uint64(0)
        for row in range(np.uint64(64)):
            p, merged = np.uint64(n) * np.uint64(768) + row * np.uint64(12), np.uint64(0)
            for r in range(np.uint64(12)):
                merged |= words[p + r]
            if merged & _NO_SIGNS:
                mask |= np.uint64(1) << row
        masks[n] = mask


# Arrays are handed on one by one: to put them into a tuple counts references, which is an atomic instruction.


@inner
def _reached(i, places, every, count, begins, bits, offsets, weights):
    """The taps of row or plane i that meet something, into `offsets` and `weights`; how many, and the bits
    they meet.

    `begins` says where each row or plane begins, and `bits` what lies there, 0 for nothing.
    """
    found, met = 0, np.uint64(0)
    for k in range(count):
        p = i + places[k]
        offsets[found], weights[found] = begins[p], every[k]
        met |= bits[p]
        found += bits[p] != 0
    return found, met


@inner
def _planes(keys, masks, cursors, key, step, start, before, bricks_x, begins, bits):
    """Where the planes along x that a brick's sums need begin, and which of their rows hold something.

    `start` is the brick's x, in bricks; `cursors`, one for each brick along x, only ever go ahead in `keys`.
    """
    low = (start * 8 - before) >> 3
    for d in range(len(cursors)):
        wanted, n = key + (low + d - start) * step, cursors[d]
        while n < len(keys) and keys[n] < wanted:
            n += 1
        cursors[d] = n
        there = n < len(keys) and keys[n] == wanted and 0 <= low + d < bricks_x
        mask, p = masks[n] if there else np.uint64(0), (low + d - start) * 8 + before
        for i in range(max(0, -p), min(8, len(begins) - p)):
            begins[p + i], bits[p + i] = n * _BRICK + i * _PLANE, (mask >> np.uint64(8 * i)) & np.uint64(0xFF)


@inner
def _column_x(
    flat, masks, keys, keys_x, place, lattice, before, places, every, taps, begins, bits, offsets, weights, cursors,
    ring, made,
):  # fmt: skip
    """One column of the ring: the sums along x of its bricks, and in `made` which of their rows hold
    something.

    `place` is the column's x and y, in bricks, the first place along z, how many places, and where in the
    ring it begins.
    """
    x, y, first, count, ring_at = place
    made[:] = 0
    base, step = (x * lattice[1] + y) * lattice[2] + first, lattice[1] * lattice[2]
    low, high = max(0, -first), min(count, lattice[2] - first)
    for d in range(len(cursors)):
        cursors[d] = first_at_least(keys, base + low + (((x * 8 - before) >> 3) + d - x) * step)
    for slot in range(first_at_least(keys_x, base + low), first_at_least(keys_x, base + high)):
        _planes(keys, masks, cursors, keys_x[slot], step, x, before, lattice[0], begins, bits)
        o, mask = ring_at + (keys_x[slot] - base) * _BRICK, np.uint64(0)
        for i in range(8):
            found, met = _reached(i, places, every, taps, begins, bits, offsets, weights)
            mask |= met << np.uint64(8 * i)
            for j in range(0, 8, 4):
                some = found if (met >> np.uint64(j)) & _FOUR else 0
                four_rows(ring, o + i * _PLANE + j * ROW, ROW, flat, j * ROW, ROW, offsets, weights, some)
        made[keys_x[slot] - base] = mask


@inner
def _brick_y(
    at, y, owner, made, before, places, every, taps, begins, bits, offsets, weights, ring, line, count
):  # fmt: skip
    """The sums along y of one brick, into `line`, which is zero there; which of its rows hold something."""
    slot, held = -1, False
    for p in range(len(begins)):
        c, j = (y * 8 - before + p) >> 3, (y * 8 - before + p) & 7
        if p == 0 or j == 0:
            slot = c % len(owner)
            held = owner[slot] == c
        begins[p] = (slot * count + at) * _BRICK + j * ROW
        bits[p] = (made[slot, at] >> np.uint64(j)) & _COLUMN if held else np.uint64(0)
    mask, width = np.uint64(0), count * ROW
    for j in range(8):
        found, met = _reached(j, places, every, taps, begins, bits, offsets, weights)
        mask |= met << np.uint64(j)
        for i in range(0, 8, 4):
            if (met >> np.uint64(8 * i)) & _HALF:
                o = (i * 8 + j) * width + at * ROW
                four_rows(line, o, 8 * width, ring, i * _PLANE, _PLANE, offsets, weights, found)
    return mask


@inner
def _brick_z(at, mask, slot, offsets, weights, taps, line, width, out):
    """The sums along z of one brick, `mask` saying which of its rows hold something."""
    for row in range(0, 64, 4):
        some = taps if (mask >> np.uint64(row)) & _FOUR else 0
        four_rows(
            out, slot * _BRICK + row * ROW, ROW, line, row * width + at * ROW, width, offsets, weights, some
        )


@inner
def _top(bits, slot):
    """The greatest size of a number of a brick, as its bits without the sign."""
    top, p = np.uint32(0), np.uint64(slot * _BRICK)
    for r in range(np.uint64(_BRICK)):
        here = np.uint32(bits[p + r] & _NO_SIGN)
        top = here if here > top else top
    return top


@inner
def _line_cleared(line, width, at):
    for row in range(64):
        p = np.uint64(row * width + at * ROW)
        for r in range(np.uint64(ROW)):
            line[p + r] = 0


@kernel
def filtered_bricks(
    begin, end, items, source, keys_of_passes, lattice, before, deep, sizes, taps, out, bits, tops
):
    """Slabs of output bricks of one x and a range of z: a ring of columns filtered along x, then column by
    column.

    `before` and `deep` are for each axis how far back the first sample of a sum lies, and how many samples
    after it the last one; `sizes` is how many bricks along z make an item, and how many beyond them its sums
    reach.
    """
    keys, keys_x, keys_y, keys_z = keys_of_passes
    flat, masks = source
    places, weights, counts = taps
    tile, margin = sizes
    count = tile + 2 * margin
    width = count * ROW
    back = -((-before[1]) >> 3)
    columns = back + ((7 + deep[1] - before[1]) >> 3) + 1
    slots = min(columns, lattice[1])
    cursors = np.empty(((7 + deep[0] - before[0]) >> 3) - ((-before[0]) >> 3) + 1, np.int64)
    x_begins, x_bits = np.zeros(8 + deep[0], np.int64), np.zeros(8 + deep[0], np.uint64)
    y_begins, y_bits = np.zeros(8 + deep[1], np.int64), np.zeros(8 + deep[1], np.uint64)
    offsets, some = np.empty(places.shape[1] + 1, np.int64), np.empty(places.shape[1] + 1, np.float32)
    x_places, x_weights, y_places, y_weights = places[0], weights[0], places[1], weights[1]
    z_offsets, z_weights = (places[2] - before[2]) * 3, weights[2]
    ring, line = np.empty(slots * count * _BRICK, np.float32), np.zeros(64 * width, np.float32)
    made, made_y = np.zeros((slots, count), np.uint64), np.zeros(count, np.uint64)
    owner = np.empty(slots, np.int64)
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
            if z_slots[0] == z_slots[1]:
                continue
            for c in range(max(0, y - back), min(lattice[1], y - back + columns)):
                s = c % slots
                if owner[s] != c:
                    owner[s] = c
                    _column_x(
                        flat, masks, keys, keys_x, (x, c, first, count, s * count * _BRICK), lattice, before[0],
                        x_places, x_weights, counts[0], x_begins, x_bits, offsets, some, cursors, ring, made[s],
                    )  # fmt: skip
            for s in range(y_slots[0], y_slots[1]):
                at = keys_y[s] - base
                made_y[at] = _brick_y(
                    at, y, owner, made, before[1], y_places, y_weights, counts[1], y_begins, y_bits, offsets, some,
                    ring, line, count,
                )  # fmt: skip
            for s in range(z_slots[0], z_slots[1]):
                at, mask = keys_z[s] - base, np.uint64(0)
                for k in range(at - margin, at + margin + 1):
                    mask |= made_y[k]
                _brick_z(at, mask, s, z_offsets, z_weights, counts[2], line, width, out)
                tops[s] = _top(bits, s)
            for s in range(y_slots[0], y_slots[1]):
                if made_y[keys_y[s] - base]:
                    _line_cleared(line, width, keys_y[s] - base)
                    made_y[keys_y[s] - base] = 0


_AT_ONCE = 4 * ROW
"""Numbers that `four_rows` sums at once."""
COLUMNS = 2 * _AT_ONCE
"""Of a dense array, filtered at once: their samples along an axis stay in the cache."""
_NARROW = 10 * _AT_ONCE  # sums at once, of columns narrower than that


@inner
def _line_filled(line, source, runs, beside, first, columns, width):
    """The samples of `columns` columns from `first` on, as `runs` says, into `line`, `width` numbers a
    sample.
    """
    for n in range(len(runs)):
        p, q = np.uint64(runs[n, 0] * width), np.uint64(runs[n, 1] * beside + first)
        for i in range(np.uint64(columns * runs[n, 2])):
            line[p + i] = source[q + i]


@inner
def _sums_of_items(begin, end, source, along, out):
    """As `sums_along`, of float32: the sums are held in registers (`four_rows`), and each is rounded in one
    order.

    The last numbers are summed together with some before them, once more; fewer than `_AT_ONCE` with zeros.
    """
    runs, places, weights, (samples, beside, width) = along
    blocks, count = -(-beside // width), out.shape[1] // max(1, beside)
    many = max(1, _NARROW // width) if blocks == 1 else 1
    line, few = np.zeros(samples * width + _AT_ONCE, np.float32), np.empty(_AT_ONCE, np.float32)
    offsets, taps = places * width, len(places)
    for item in range(begin, end):
        first = item % blocks * width
        columns, target = min(width, beside - first), out[item // blocks]
        _line_filled(line, source[item // blocks], runs, beside, first, columns, width)
        for row in range(0, count, many):
            o, at, size = row * beside + first, row * width, columns * min(many, count - row)
            if size < _AT_ONCE:
                four_rows(few, 0, ROW, line, at, ROW, offsets, weights, taps)
                for i in range(size):
                    target[o + i] = few[i]
                continue
            for n in range(0, size, _AT_ONCE):
                n = min(n, size - _AT_ONCE)
                four_rows(target, o + n, ROW, line, at + n, ROW, offsets, weights, taps)


@kernel
def sums_along_float32(begin, end, source, runs, places, weights, sizes, out):
    """See `sums_along`; of float32."""
    _sums_of_items(begin, end, source, (runs, places, weights, sizes), out)


@kernel
def sums_of_planes(begin, end, rows, lines, along_rows, along_lines):
    """Sums along the last two axes of float32, in place: a plane stays in the cache between them.

    `rows` [a, n m] and `lines` [a n, m] are the same numbers; the others are what `sums_along` takes, of each
    axis.
    """
    blocks, count = -(-along_rows[3][1] // along_rows[3][2]), len(lines) // len(rows)
    for a in range(begin, end):
        _sums_of_items(a * blocks, (a + 1) * blocks, rows, along_rows, rows)
        _sums_of_items(a * count, (a + 1) * count, lines, along_lines, lines)


COUNTED = 1 << 14
"""Numbers that `count_not_finite` counts at once."""


@kernel
def count_not_finite(begin, end, numbers, limit, counts):
    """Of each `COUNTED` numbers, how many are not finite: larger than `limit`, or none."""
    for block in range(begin, end):
        count = 0
        for i in range(np.uint64(block * COUNTED), np.uint64(min(len(numbers), (block + 1) * COUNTED))):
            count += not abs(numbers[i]) <= limit
        counts[block] = count


@kernel(fastmath={"contract"})
def sums_along(begin, end, source, runs, places, weights, sizes, out):
    """Weighted sums along an axis of a dense array, whose samples are numbers `beside` each other: [a, n x
    beside].

    `sizes` are the samples of a line that is continued beyond its ends, `beside`, and how many of these are
    filtered at once. `runs` [n, 3] say what a line is made of: where in it, from which sample, and how many;
    else it is zero. `places` and `weights` are of a sum from its first sample on, four and four.
    """
    samples, beside, width = sizes
    blocks, count = -(-beside // width), out.shape[1] // max(1, beside)
    line, many = np.zeros(samples * width, out.dtype), max(1, _NARROW // width) if blocks == 1 else 1
    for item in range(begin, end):
        a, first = item // blocks, item % blocks * width
        columns = min(width, beside - first)
        _line_filled(line, source[a], runs, beside, first, columns, width)
        for row in range(0, count, many):
            o, size = np.uint64(row * beside + first), np.uint64(columns * min(many, count - row))
            for i in range(size):
                out[a, o + i] = 0
            for k in range(0, len(places), 4):
                p, q = np.uint64((row + places[k]) * width), np.uint64((row + places[k + 1]) * width)
                r, s = np.uint64((row + places[k + 2]) * width), np.uint64((row + places[k + 3]) * width)
                t, u, v, w = weights[k], weights[k + 1], weights[k + 2], weights[k + 3]
                for i in range(size):
                    out[a, o + i] += t * line[p + i] + u * line[q + i] + v * line[r + i] + w * line[s + i]
