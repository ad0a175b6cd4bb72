"""Compiled inner loops of separable filters: one pass along each axis of a sparse field, which adds only the
bricks (blocks of 8x8x8 samples) that the filter reaches.

The inner loop computes weighted sums of four short rows at once and keeps them in registers (`four_rows`). A
loop over 24 numbers is too short for the compiler: the checks that two rows do not overlap cost as much as
the sums. The vectors are therefore written explicitly, with eight lanes; vectors of 24 would be split after
the loop. Imported only when first needed.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from touchfield.compute.jit import inner, kernel
from touchfield.medium.kernels import lower_bound

ROW = 24  # numbers of a brick's row: eight samples of three components
_LANES = 8  # twelve sums of them leave registers for a weight
_FLOATS = ir.VectorType(ir.FloatType(), _LANES)
_FIRST_LANE = ir.Constant(ir.VectorType(ir.IntType(32), _LANES), [0] * _LANES)


def _four_rows(typing, out, o, out_step, flat, at, step, offsets, weights, count):
    """``out[o + r out_step + n] = sum over k of weights[k] flat[at + r step + offsets[k] + n]``, r < 4, n
    < 24.

    The sum runs over the first `count` of `offsets` int64 and `weights` float32; with none it is zero. `out`
    and `flat` are float32 [n]. Product and addition may be rounded once. No index is checked.
    """
    i64 = types.int64

    def generated(context, builder, signature, arguments):
        def data(n):
            return context.make_array(signature.args[n])(context, builder, arguments[n]).data

        def part(numbers, first, stride, n):
            row, lane = divmod(n * _LANES, ROW)
            index = builder.add(first, builder.mul(stride, ir.Constant(ir.IntType(64), row)))
            index = builder.add(index, ir.Constant(ir.IntType(64), lane))
            return builder.bitcast(builder.gep(numbers, [index]), _FLOATS.as_pointer())

        o, out_step, at, step = (arguments[n] for n in (1, 2, 4, 5))
        target, source, offsets, weights = data(0), data(3), data(6), data(7)
        nothing = ir.Constant(_FLOATS, [0.0] * _LANES)
        sums = [cgutils.alloca_once_value(builder, nothing) for _ in range(4 * ROW // _LANES)]
        for total in sums:
            builder.store(nothing, total)
        with cgutils.for_range(builder, arguments[8]) as loop:
            weight = builder.load(builder.gep(weights, [loop.index]))
            empty = ir.Constant(_FLOATS, ir.Undefined)
            spread = builder.insert_element(empty, weight, ir.Constant(ir.IntType(32), 0))
            spread = builder.shuffle_vector(spread, empty, _FIRST_LANE)
            first = builder.add(at, builder.load(builder.gep(offsets, [loop.index])))
            for n, total in enumerate(sums):
                numbers = builder.load(part(source, first, step, n), align=4)
                product = builder.fmul(spread, numbers, flags=("contract",))
                builder.store(builder.fadd(builder.load(total), product, flags=("contract",)), total)
        for n, total in enumerate(sums):
            builder.store(builder.load(total), part(target, o, out_step, n), align=4)
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
def row_masks(start, stop, numbers, masks):
    """Set one bit for each of the 64 rows of a brick that has a force; minus zero counts as none."""
    for n in range(start, stop):
        mask = np.uint64(0)
        for row in range(np.uint64(64)):
            p, merged = np.uint64(n) * np.uint64(768) + row * np.uint64(12), np.uint64(0)
            for r in range(np.uint64(12)):
                merged |= numbers[p + r]
            if merged & _NO_SIGNS:
                mask |= np.uint64(1) << row
        masks[n] = mask


# Arrays are passed one by one: putting them into a tuple counts references, an atomic instruction.


@inner
def _reached_taps(i, indices, all_weights, count, starts, bits, offsets, weights):
    """Write the taps of row or plane i that meet a force to `offsets` and `weights`; return count and bits.

    `starts` is where each row or plane starts in memory, and `bits` which of its rows have a force.
    """
    found, met = 0, np.uint64(0)
    for k in range(count):
        p = i + indices[k]
        offsets[found], weights[found] = starts[p], all_weights[k]
        met |= bits[p]
        found += bits[p] != 0
    return found, met


@inner
def _planes(keys, masks, cursors, key, step, brick_x, before, bricks_x, starts, bits):
    """Locate the planes along x that a brick's sums need, and which of their rows have a force.

    `brick_x` is the brick's x, in bricks; `cursors`, one for each brick along x, only ever advance in `keys`.
    """
    low = (brick_x * 8 - before) >> 3
    for d in range(len(cursors)):
        target, n = key + (low + d - brick_x) * step, cursors[d]
        while n < len(keys) and keys[n] < target:
            n += 1
        cursors[d] = n
        is_stored = n < len(keys) and keys[n] == target and 0 <= low + d < bricks_x
        mask, p = masks[n] if is_stored else np.uint64(0), (low + d - brick_x) * 8 + before
        for i in range(max(0, -p), min(8, len(starts) - p)):
            starts[p + i], bits[p + i] = n * _BRICK + i * _PLANE, (mask >> np.uint64(8 * i)) & np.uint64(0xFF)


@inner
def _column_x(
    flat, masks, keys, keys_x, column, lattice, before, indices, all_weights, taps, starts, bits, offsets,
    weights, cursors, ring, ring_masks,
):  # fmt: skip
    """Sum one column of the ring along x, and set in `ring_masks` which rows of its bricks have a force.

    `column` is the column's x and y, in bricks, its first index along z, its length, and its start in the
    ring.
    """
    x, y, first, count, ring_at = column
    ring_masks[:] = 0
    base, step = (x * lattice[1] + y) * lattice[2] + first, lattice[1] * lattice[2]
    low, high = max(0, -first), min(count, lattice[2] - first)
    for d in range(len(cursors)):
        cursors[d] = lower_bound(keys, base + low + (((x * 8 - before) >> 3) + d - x) * step)
    for slot in range(lower_bound(keys_x, base + low), lower_bound(keys_x, base + high)):
        _planes(keys, masks, cursors, keys_x[slot], step, x, before, lattice[0], starts, bits)
        o, mask = ring_at + (keys_x[slot] - base) * _BRICK, np.uint64(0)
        for i in range(8):
            found, met = _reached_taps(i, indices, all_weights, taps, starts, bits, offsets, weights)
            mask |= met << np.uint64(8 * i)
            for j in range(0, 8, 4):
                tap_count = found if (met >> np.uint64(j)) & _FOUR else 0
                four_rows(
                    ring, o + i * _PLANE + j * ROW, ROW, flat, j * ROW, ROW, offsets, weights, tap_count
                )
        ring_masks[keys_x[slot] - base] = mask


@inner
def _brick_y(
    at, y, owner, ring_masks, before, indices, all_weights, taps, starts, bits, offsets, weights, ring, line,
    count
):  # fmt: skip
    """Sum one brick along y into `line`, which is zero there; return the mask of its rows with a force."""
    slot, is_filled = -1, False
    for p in range(len(starts)):
        c, j = (y * 8 - before + p) >> 3, (y * 8 - before + p) & 7
        if p == 0 or j == 0:
            slot = c % len(owner)
            is_filled = owner[slot] == c
        starts[p] = (slot * count + at) * _BRICK + j * ROW
        bits[p] = (ring_masks[slot, at] >> np.uint64(j)) & _COLUMN if is_filled else np.uint64(0)
    mask, width = np.uint64(0), count * ROW
    for j in range(8):
        found, met = _reached_taps(j, indices, all_weights, taps, starts, bits, offsets, weights)
        mask |= met << np.uint64(j)
        for i in range(0, 8, 4):
            if (met >> np.uint64(8 * i)) & _HALF:
                o = (i * 8 + j) * width + at * ROW
                four_rows(line, o, 8 * width, ring, i * _PLANE, _PLANE, offsets, weights, found)
    return mask


@inner
def _brick_z(at, mask, slot, offsets, weights, taps, line, width, out):
    """Sum one brick along z; `mask` has the rows with a force."""
    for row in range(0, 64, 4):
        tap_count = taps if (mask >> np.uint64(row)) & _FOUR else 0
        four_rows(
            out,
            slot * _BRICK + row * ROW,
            ROW,
            line,
            row * width + at * ROW,
            width,
            offsets,
            weights,
            tap_count,
        )


@inner
def _top(bits, slot):
    """Return the largest absolute value in a brick, as its bits without the sign."""
    top, p = np.uint32(0), np.uint64(slot * _BRICK)
    for r in range(np.uint64(_BRICK)):
        size = np.uint32(bits[p + r] & _NO_SIGN)
        top = size if size > top else top
    return top


@inner
def _clear_line(line, width, at):
    for row in range(64):
        p = np.uint64(row * width + at * ROW)
        for r in range(np.uint64(ROW)):
            line[p + r] = 0


@kernel
def filter_bricks(
    start, stop, items, source, keys_of_passes, lattice, before, span, sizes, taps, out, bits, tops
):
    """Filter slabs of output bricks, of one x and a range of z: a ring of columns along x, then y and z.

    For each axis `before` is how many samples back a sum starts, and `span` how many samples later it ends;
    `sizes` is how many bricks along z an item has, and how many bricks beyond them its sums reach.
    """
    keys, keys_x, keys_y, keys_z = keys_of_passes
    flat, masks = source
    indices, weights, counts = taps
    tile, margin = sizes
    count = tile + 2 * margin
    width = count * ROW
    bricks_before = -((-before[1]) >> 3)
    columns = bricks_before + ((7 + span[1] - before[1]) >> 3) + 1
    slots = min(columns, lattice[1])
    cursors = np.empty(((7 + span[0] - before[0]) >> 3) - ((-before[0]) >> 3) + 1, np.int64)
    x_starts, x_bits = np.zeros(8 + span[0], np.int64), np.zeros(8 + span[0], np.uint64)
    y_starts, y_bits = np.zeros(8 + span[1], np.int64), np.zeros(8 + span[1], np.uint64)
    offsets, tap_weights = (
        np.empty(indices.shape[1] + 1, np.int64),
        np.empty(indices.shape[1] + 1, np.float32),
    )
    x_indices, x_weights, y_indices, y_weights = indices[0], weights[0], indices[1], weights[1]
    z_offsets, z_weights = (indices[2] - before[2]) * 3, weights[2]
    ring, line = np.empty(slots * count * _BRICK, np.float32), np.zeros(64 * width, np.float32)
    x_masks, y_masks = np.zeros((slots, count), np.uint64), np.zeros(count, np.uint64)
    owner = np.empty(slots, np.int64)
    for n in range(start, stop):
        x, first = items[n, 0], items[n, 1] * tile - margin
        owner[:] = -(1 << 40)  # of no column, not even of one before the first
        slot = lower_bound(keys_z, x * lattice[1] * lattice[2])
        last = lower_bound(keys_z, (x + 1) * lattice[1] * lattice[2])
        while slot < last:
            y = keys_z[slot] // lattice[2] - x * lattice[1]
            base = (x * lattice[1] + y) * lattice[2] + first
            low, high = base + max(0, -first), base + min(count, lattice[2] - first)
            y_slots = lower_bound(keys_y, low), lower_bound(keys_y, high)
            bounds = base + margin, min(high, base + margin + tile)
            z_slots = lower_bound(keys_z, bounds[0]), lower_bound(keys_z, bounds[1])
            slot = lower_bound(keys_z, (x * lattice[1] + y + 1) * lattice[2])
            if z_slots[0] == z_slots[1]:
                continue
            for c in range(max(0, y - bricks_before), min(lattice[1], y - bricks_before + columns)):
                s = c % slots
                if owner[s] != c:
                    owner[s] = c
                    _column_x(
                        flat, masks, keys, keys_x, (x, c, first, count, s * count * _BRICK), lattice,
                        before[0], x_indices, x_weights, counts[0], x_starts, x_bits, offsets, tap_weights,
                        cursors, ring, x_masks[s],
                    )  # fmt: skip
            for s in range(y_slots[0], y_slots[1]):
                at = keys_y[s] - base
                y_masks[at] = _brick_y(
                    at, y, owner, x_masks, before[1], y_indices, y_weights, counts[1], y_starts, y_bits,
                    offsets, tap_weights, ring, line, count,
                )  # fmt: skip
            for s in range(z_slots[0], z_slots[1]):
                at, mask = keys_z[s] - base, np.uint64(0)
                for k in range(at - margin, at + margin + 1):
                    mask |= y_masks[k]
                _brick_z(at, mask, s, z_offsets, z_weights, counts[2], line, width, out)
                tops[s] = _top(bits, s)
            for s in range(y_slots[0], y_slots[1]):
                if y_masks[keys_y[s] - base]:
                    _clear_line(line, width, keys_y[s] - base)
                    y_masks[keys_y[s] - base] = 0


_SUMS_AT_ONCE = 4 * ROW
"""Numbers that `four_rows` sums at once."""
COLUMNS = 2 * _SUMS_AT_ONCE
"""Of a dense array, filtered at once: their samples along an axis stay in the cache."""
_NARROW_SUMS = 10 * _SUMS_AT_ONCE  # sums at once, of columns narrower than that


@inner
def _fill_line(line, source, runs, stride, first, columns, width):
    """Copy `columns` columns from `first` on to `line` as `runs` describes, `width` numbers a sample."""
    for n in range(len(runs)):
        p, q = np.uint64(runs[n, 0] * width), np.uint64(runs[n, 1] * stride + first)
        for i in range(np.uint64(columns * runs[n, 2])):
            line[p + i] = source[q + i]


@inner
def _sums_of_items(start, stop, source, along, out):
    """Like `sums_along` for float32: sums stay in registers (`four_rows`), each rounded in a fixed order.

    The last block overlaps the one before it and repeats some sums; fewer than `_SUMS_AT_ONCE` numbers are
    padded with zeros.
    """
    runs, indices, weights, (samples, stride, width) = along
    blocks, count = -(-stride // width), out.shape[1] // max(1, stride)
    many = max(1, _NARROW_SUMS // width) if blocks == 1 else 1
    line, few = np.zeros(samples * width + _SUMS_AT_ONCE, np.float32), np.empty(_SUMS_AT_ONCE, np.float32)
    offsets, taps = indices * width, len(indices)
    for item in range(start, stop):
        first = item % blocks * width
        columns, target = min(width, stride - first), out[item // blocks]
        _fill_line(line, source[item // blocks], runs, stride, first, columns, width)
        for row in range(0, count, many):
            o, at, size = row * stride + first, row * width, columns * min(many, count - row)
            if size < _SUMS_AT_ONCE:
                four_rows(few, 0, ROW, line, at, ROW, offsets, weights, taps)
                for i in range(size):
                    target[o + i] = few[i]
                continue
            for n in range(0, size, _SUMS_AT_ONCE):
                n = min(n, size - _SUMS_AT_ONCE)
                four_rows(target, o + n, ROW, line, at + n, ROW, offsets, weights, taps)


@kernel
def sums_along_float32(start, stop, source, runs, indices, weights, sizes, out):
    """See `sums_along`; of float32."""
    _sums_of_items(start, stop, source, (runs, indices, weights, sizes), out)


@kernel
def sums_of_planes(start, stop, rows, lines, along_rows, along_lines):
    """Sum float32 along the last two axes in place: a plane stays in the cache between the two passes.

    `rows` [a, n m] and `lines` [a n, m] are views of the same numbers; the others are the arguments of
    `sums_along` for each axis.
    """
    blocks, count = -(-along_rows[3][1] // along_rows[3][2]), len(lines) // len(rows)
    for a in range(start, stop):
        _sums_of_items(a * blocks, (a + 1) * blocks, rows, along_rows, rows)
        _sums_of_items(a * count, (a + 1) * count, lines, along_lines, lines)


COUNT_BLOCK = 1 << 14
"""Numbers that `count_not_finite` counts at once."""


@kernel
def count_not_finite(start, stop, numbers, limit, counts):
    """Count in each block of `COUNT_BLOCK` numbers those that are not finite: above `limit`, or NaN."""
    for block in range(start, stop):
        count = 0
        for i in range(
            np.uint64(block * COUNT_BLOCK), np.uint64(min(len(numbers), (block + 1) * COUNT_BLOCK))
        ):
            count += not abs(numbers[i]) <= limit
        counts[block] = count


@kernel(fastmath={"contract"})
def sums_along(start, stop, source, runs, indices, weights, sizes, out):
    """Weighted sums along an axis of a dense array [a, n x stride]; a sample has `stride` numbers.

    `sizes` are the samples of a line with its continuation beyond the border, `stride`, and how many of these
    numbers are filtered at once. `runs` [n, 3] describe a line: index in it, first sample, and count;
    elsewhere it is zero. `indices` (from the first sample of a sum) and `weights` are padded to a multiple of
    four.
    """
    samples, stride, width = sizes
    blocks, count = -(-stride // width), out.shape[1] // max(1, stride)
    line, many = np.zeros(samples * width, out.dtype), max(1, _NARROW_SUMS // width) if blocks == 1 else 1
    for item in range(start, stop):
        a, first = item // blocks, item % blocks * width
        columns = min(width, stride - first)
        _fill_line(line, source[a], runs, stride, first, columns, width)
        for row in range(0, count, many):
            o, size = np.uint64(row * stride + first), np.uint64(columns * min(many, count - row))
            for i in range(size):
                out[a, o + i] = 0
            for k in range(0, len(indices), 4):
                p, q = np.uint64((row + indices[k]) * width), np.uint64((row + indices[k + 1]) * width)
                r, s = np.uint64((row + indices[k + 2]) * width), np.uint64((row + indices[k + 3]) * width)
                t, u, v, w = weights[k], weights[k + 1], weights[k + 2], weights[k + 3]
                for i in range(size):
                    out[a, o + i] += t * line[p + i] + u * line[q + i] + v * line[r + i] + w * line[s + i]
