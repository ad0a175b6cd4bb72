"""Compiled search of block motion: which displacement of the frame before predicts a block best.

Only the encoder runs it, so floating point is welcome. Blocks take over the displacements of their neighbours, as
motion does not change much from one to the next, and refine them by descent; few are searched in full.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from touchfield.codec.kernels.touch_motion import LIMIT, QUARTERS, REACH, fetch, slots_around

__all__ = ["BITS_AGAIN", "BITS_NEW", "field_cost", "search"]

BITS_NEW = 14.0
"""What a displacement of its own costs, about, bits."""
BITS_AGAIN = 4.0
"""And that of a neighbour."""

_STILL_ENOUGH = 0.25  # bits a sample with a force: below, a block that stands still is well predicted
_FULL_ABOVE = 0.7
_FULL_STEP = 2  # voxels
_FULL_POINTS = 64
_AROUND = REACH + 1  # voxels on each side of a block that a displacement may ask for
_HUGE = np.float32(1e30)


@njit(cache=True, nogil=True)
def _bits(squared):
    """What it costs to mend an error of sqrt(squared) steps, about: 1.5 log2(1 + squared), capped, but quick."""
    if squared < 1:
        return np.float32(1.5) * squared
    return min(np.float32(3) * np.float32(np.sqrt(squared)) - np.float32(1.5), np.float32(10))


@njit(cache=True, nogil=True)
def _step(f0, f1, f2, floor, rate):
    return max(floor, np.float32(np.sqrt(f0 * f0 + f1 * f1 + f2 * f2)) * rate)


@njit(cache=True, nogil=True)
def field_cost(keys, forces, units, floor, rate, guess_keys, guess):
    """Bits that a guess leaves to be coded, about.

    `keys`, ``forces[n, 8, 8, 8, 3]`` and the factor `units` that makes units of them are the frame, `guess_keys`
    and ``guess[m, 8, 8, 8, 3]`` what predicts it.
    """
    total = 0.0
    a = b = 0
    while a < keys.shape[0] or b < guess_keys.shape[0]:
        in_frame = b == guess_keys.shape[0] or (a < keys.shape[0] and keys[a] <= guess_keys[b])
        in_guess = a == keys.shape[0] or (b < guess_keys.shape[0] and guess_keys[b] <= keys[a])
        for x in range(8):
            for y in range(8):
                for z in range(8):
                    f0 = f1 = f2 = g0 = g1 = g2 = np.float32(0)
                    if in_frame:
                        f0, f1, f2 = forces[a, x, y, z, 0], forces[a, x, y, z, 1], forces[a, x, y, z, 2]
                        f0, f1, f2 = f0 * units, f1 * units, f2 * units
                    if in_guess:
                        g0 = np.float32(guess[b, x, y, z, 0])
                        g1 = np.float32(guess[b, x, y, z, 1])
                        g2 = np.float32(guess[b, x, y, z, 2])
                    e0, e1, e2 = f0 - g0, f1 - g1, f2 - g2
                    squared = e0 * e0 + e1 * e1 + e2 * e2
                    if squared > 0:
                        step = _step(f0, f1, f2, floor, rate)
                        total += _bits(squared / (step * step))
        a += in_frame
        b += in_guess
    return total


@njit(cache=True, nogil=True)
def _points(size, origin, table, forces, units, floor, rate, most, where, what, share, weight):
    """Samples of a block to compare at: of those with a force, and of those without, `most` at most each.

    Fills in position, force in units, 1 / step^2 and how many samples each one stands for. Returns how many there
    are, and how many samples have a force.
    """
    full = 0
    held = np.zeros((size, size, size), np.bool_)
    for x in range(size):
        for y in range(size):
            for z in range(size):
                u, v, w = origin[0] + x, origin[1] + y, origin[2] + z
                slot = table[u >> 3, v >> 3, w >> 3]
                if slot >= 0:
                    f = forces[slot, u & 7, v & 7, w & 7]
                    if f[0] != 0 or f[1] != 0 or f[2] != 0:
                        held[x, y, z] = True
                        full += 1
    every = max(1, (full + most - 1) // most)
    every_empty = ((size**3 - full + most - 1) // most) | 1  # odd: not always the same plane
    n = seen = seen_empty = 0
    for x in range(size):
        for y in range(size):
            for z in range(size):
                if held[x, y, z]:
                    seen += 1
                    if (seen - 1) % every:
                        continue
                    u, v, w = origin[0] + x, origin[1] + y, origin[2] + z
                    f = forces[table[u >> 3, v >> 3, w >> 3], u & 7, v & 7, w & 7]
                    f0, f1, f2 = f[0] * units, f[1] * units, f[2] * units
                    step = _step(f0, f1, f2, floor, rate)
                    weight[n] = every
                else:
                    seen_empty += 1
                    if (seen_empty - 1) % every_empty:
                        continue
                    f0 = f1 = f2 = np.float32(0)
                    step = floor
                    weight[n] = every_empty
                where[n, 0], where[n, 1], where[n, 2] = x, y, z
                what[n, 0], what[n, 1], what[n, 2] = f0, f1, f2
                share[n] = np.float32(1) / (step * step)
                n += 1
    return n, full


@njit(cache=True, nogil=True)
def _cost(d, n, every, where, what, share, weight, origin, table, vectors, least, limit, out):
    """Bits at the displacement `d`, from one in `every` points; more than `limit` means only that."""
    total = np.float32(0)
    o0, o1, o2 = origin[0] * QUARTERS + d[0], origin[1] * QUARTERS + d[1], origin[2] * QUARTERS + d[2]
    for p in range(0, n, every):
        x, y, z = where[p, 0] * QUARTERS + o0, where[p, 1] * QUARTERS + o1, where[p, 2] * QUARTERS + o2
        e0, e1, e2 = what[p, 0], what[p, 1], what[p, 2]
        if fetch(x, y, z, table, vectors, least, out):
            e0, e1, e2 = e0 - np.float32(out[0]), e1 - np.float32(out[1]), e2 - np.float32(out[2])
        squared = (e0 * e0 + e1 * e1 + e2 * e2) * share[p]
        if squared > 0:
            total += weight[p] * _bits(squared)
            if total > limit:
                return total
    return total


@njit(cache=True, nogil=True)
def _descend(d, best, step, n, points, origin, table, vectors, least, out):
    """Steps of `step` quarters to a neighbour as long as that is better, then of half as many, down to one."""
    where, what, share, weight = points
    trial = np.empty(3, np.int64)
    centre = np.empty(3, np.int64)
    new = np.float32(BITS_NEW)
    while step >= 1:
        for _ in range(4):
            centre[:] = d
            better = False
            for side in range(6):
                trial[:] = centre
                trial[side >> 1] += step if side & 1 else -step
                if abs(trial[side >> 1]) > LIMIT:
                    continue
                t = new + _cost(
                    trial, n, 1, where, what, share, weight, origin, table, vectors, least, best - new, out
                )
                if t < best:
                    best = t
                    d[:] = trial
                    better = True
            if not better:
                break
        step >>= 1
    return best


@njit(cache=True, nogil=True)
def _everywhere(d, n, points, origin, table, vectors, least, out):
    """Put into `d` the best of all displacements of even voxels, by a few points; returns the bits of all points."""
    where, what, share, weight = points
    every = (n + _FULL_POINTS - 1) // _FULL_POINTS
    per_axis = 2 * REACH // _FULL_STEP + 1
    best = _HUGE
    trial = np.empty(3, np.int64)
    for at in range(per_axis**3 + 1):
        if at < per_axis**3:
            trial[0] = at // (per_axis * per_axis)
            trial[1] = at // per_axis % per_axis
            trial[2] = at % per_axis
            trial[:] = (trial * _FULL_STEP - REACH) * QUARTERS
        else:
            trial[:] = d
            best = _HUGE
            every = 1
        t = _cost(trial, n, every, where, what, share, weight, origin, table, vectors, least, best, out)
        if t < best:
            best = t
            d[:] = trial
    return best


@njit(cache=True, nogil=True)
def search(
    blocks, neighbours, shift, now, before, counts, steps, least, most, full, passes, first_step, moves, settled
):
    """Find displacements, int64 ``moves[n, 3]``, quarters; what is in there already is tried as well.

    Parameters
    ----------
    blocks : int64 [n, 3]
    neighbours : int64 [n, 6]
        Blocks beside each one; -1 for none.
    shift : int
        Blocks have 2^shift samples along each axis.
    now : (int64 [f], float32 [f, 8, 8, 8, 3])
        Keys and forces of the frame; times `units` they are in units.
    before : (int64 [p], int32 [p, 8, 8, 8, 3])
        Keys and vectors of the frame before.
    counts : int64 [3]
        Bricks of the grid.
    steps : (float32, float32, float32)
        Units of a newton; and `floor` and `rate` of the step max(floor, rate |F|), units.
    least : int
        As for `fetch`.
    most : int
        Points to compare at, in a block.
    full : int
        Blocks that may be searched in full.
    passes : int
        Forwards, backwards, forwards...
    first_step : int
        Quarters, of the descent of the first pass; a quarter of it in the next.
    settled : bool [n]
        Blocks that stand still without a search; those found to be predicted well as they stand are added.
    """
    keys, forces = now
    units, floor, rate = steps
    old_keys, vectors = before[0], before[1].reshape(-1)
    size = 1 << shift
    room = 2 * most + 2
    where, what = np.empty((room, 3), np.int64), np.empty((room, 3), np.float32)
    share, weight = np.empty(room, np.float32), np.empty(room, np.float32)
    points = (where, what, share, weight)
    own = np.empty((1, 1, 1), np.int32)
    span = (7 + size + 2 * _AROUND) // 8 + 1
    table = np.empty((span, span, span), np.int32)
    first, origin, local = np.empty(3, np.int64), np.empty(3, np.int64), np.empty(3, np.int64)
    d, trial, out = np.zeros(3, np.int64), np.zeros(3, np.int64), np.zeros(3, np.int64)
    new, again = np.float32(BITS_NEW), np.float32(BITS_AGAIN)
    for turn in range(passes):
        for q in range(blocks.shape[0]):
            i = blocks.shape[0] - 1 - q if turn & 1 else q
            if settled[i]:
                continue
            for c in range(3):
                begin = blocks[i, c] << shift
                first[c] = begin >> 3
                local[c] = begin & 7
            slots_around(keys, counts, first, own)
            n, held = _points(size, local, own, forces, units, floor, rate, most, where, what, share, weight)
            for c in range(3):
                begin = blocks[i, c] << shift
                first[c] = (begin - _AROUND) >> 3
                origin[c] = begin - (first[c] << 3)
            slots_around(old_keys, counts, first, table)
            d[:] = 0
            still = best = kept = _HUGE
            for h in range(-2, 6):  # stand still, go on as before, follow a neighbour
                j = i if h < 0 else neighbours[i, h]
                trial[:] = 0
                price = np.float32(0)
                if h > -2:
                    if j < 0 or (moves[j, 0] == 0 and moves[j, 1] == 0 and moves[j, 2] == 0):
                        continue
                    trial[:] = moves[j]
                    price = new if h < 0 else again
                t = price + _cost(
                    trial, n, 1, where, what, share, weight, origin, table, vectors, least, best - price, out
                )
                if t < best:
                    best = t
                    d[:] = trial
                if h == -2:
                    still = t
                    if still <= max(new, np.float32(_STILL_ENOUGH) * held):
                        settled[i] = True
                        break
                if h < 0:
                    kept = best
            if not settled[i]:
                if turn == 0 and full > 0 and best > np.float32(_FULL_ABOVE) * held:
                    full -= 1
                    trial[:] = d
                    t = new + _everywhere(trial, n, points, origin, table, vectors, least, out)
                    if t < best:
                        best = t
                        d[:] = trial
                if turn == 0 or best < kept:  # what was there already has been refined
                    step = first_step >> (2 * turn)
                    best = _descend(d, best, step, n, points, origin, table, vectors, least, out)
            if best >= still:
                d[:] = 0
            moves[i] = d
