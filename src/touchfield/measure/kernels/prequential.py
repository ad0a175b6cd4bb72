"""Compiled loop of the prequential code: each voxel as binary decisions, each with a chance learnt from the past.

One decision (`_decide`): `CONTEXTS` hashed contexts each hold an adaptive chance; these and the order-0 estimate of
Krichevsky and Trofimov (1981) are mixed in the logistic domain (Mattern 2013, as in PAQ) by weights that learn on
line. Beside the mixture stands the order-0 estimate alone, and the chance that is charged is the Bayesian mixture of
the two: the whole code is never more than one bit longer than the shorter of both. All sums are in float64.

A chance in a context lives in one uint64: 32 bits chance, 22 bits that tell its context from others at the same
place, 10 bits count. Contexts that meet at one place replace each other, which costs bits and never validity.

Imported only when first needed, because it imports numba.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from touchfield.arrays import Float64s, Int32s, Int64s
from touchfield.measure.kernels.context import fill_halo

LOW, HIGH = 2, 1
"""How far the contexts of a voxel reach before it and after it along each axis."""

CONTEXTS = 7
TABLE_BITS = 22
FULL_COUNT = 1023
"""From so many decisions on a context forgets the oldest, for chances drift with the field; 10 bits hold it."""

FIRST_WEIGHT = 0.25
LEARNING = 0.01
SETS = 16 + 2 * 64

_ONE = 4294967296.0
_LEAST = 2.0**-30
_SUPPORT, _SYMBOL, _LEAD = 0, 1, 2  # places in totals: bits so far, and the mixture's lag behind order 0
_M1 = np.uint64(0x9E3779B97F4A7C15)
_M2 = np.uint64(0xBF58476D1CE4E5B9)
_S = np.uint64(29)
_TAG = np.uint64((1 << 22) - 1)
_COUNT = np.uint64(1023)
_TEN = np.uint64(10)
_HIGH = np.uint64(32)
_PLACE = np.uint64(64 - TABLE_BITS)
_EPSILON = 2.0**-20  # a mixture is never surer than this: at most 20 bits for one decision


class Model:
    """State of the code: its tables, and the bits so far.

    Parameters
    ----------
    radices : (int, int)
        How many values the two digits of a symbol have; the first may be 1.
    """

    def __init__(self, radices: tuple[int, int]) -> None:
        self.radices = np.array(radices, np.int64)
        self.depths = np.array([(r - 1).bit_length() for r in radices], np.int64)
        nodes = 1 + sum(1 << int(d) for d in self.depths)
        self.order0 = np.full((1 << min(TABLE_BITS, (nodes - 1).bit_length()), 2), 0.5)
        self.shares_order0 = nodes > len(self.order0)
        self.table = np.zeros(1 << TABLE_BITS, np.uint64)
        self.weights = np.full((SETS, CONTEXTS + 1), FIRST_WEIGHT)
        self.totals = np.zeros(3)

    @property
    def arrays(self) -> tuple[Int64s, Int64s, Float64s, NDArray[np.uint64],
                              Float64s, Float64s]:  # fmt: skip
        """Arrays of the kernel."""
        return self.radices, self.depths, self.order0, self.table, self.weights, self.totals


@njit(cache=True, nogil=True)
def _mix(h, value):
    h = (h ^ np.uint64(value)) * _M1
    return h ^ (h >> _S)


@njit(cache=True, nogil=True)
def _seed(n):
    """Where the hash of context n begins; far from all others, for digits are small numbers, too."""
    return _mix(np.uint64(0), n)


@njit(cache=True, nogil=True)
def _decide(bit, node, chosen, keys, hashes, inputs, order0, table, weights, totals):
    """The bits of one decision; all that is learnt from it."""
    zero = node & (order0.shape[0] - 1)
    plain = order0[zero, 1] / (order0[zero, 0] + order0[zero, 1])
    inputs[CONTEXTS] = np.log(plain / (1.0 - plain))
    dot = weights[chosen, CONTEXTS] * inputs[CONTEXTS]
    for i in range(CONTEXTS):
        h = _mix(keys[i], node + 1) * _M2
        hashes[i] = h
        entry = table[h >> _PLACE]
        inputs[i] = 0.0
        if (entry & _COUNT) > 0 and ((entry >> _TEN) & _TAG) == (h & _TAG):
            chance = np.float64(entry >> _HIGH) / _ONE
            inputs[i] = np.log(chance / (1.0 - chance))
            dot += weights[chosen, i] * inputs[i]
    mixed = min(max(1.0 / (1.0 + np.exp(-dot)), _EPSILON), 1.0 - _EPSILON)
    error = bit - mixed
    for i in range(CONTEXTS + 1):
        weights[chosen, i] += LEARNING * error * inputs[i]
    # only now: were a context that shares its place to learn the bit before it is charged, it would be no code
    for i in range(CONTEXTS):
        place, tag = hashes[i] >> _PLACE, hashes[i] & _TAG
        entry = table[place]
        count, chance = np.int64(0), np.float64(0.5)
        if (entry & _COUNT) > 0 and ((entry >> _TEN) & _TAG) == tag:
            count, chance = np.int64(entry & _COUNT), np.float64(entry >> _HIGH) / _ONE
        chance += (bit - chance) / (count + 1.5)
        stored = np.uint64(np.float64(min(max(chance, _LEAST), 1.0 - _LEAST)) * _ONE)
        table[place] = (stored << _HIGH) | (tag << _TEN) | np.uint64(count + np.int64(count < FULL_COUNT))
    order0[zero, bit] += 1.0
    if bit == 0:
        plain, mixed = 1.0 - plain, 1.0 - mixed
    # exp2 of a lag beyond +-1000 is 0 or infinite, and both say the right thing
    share = 1.0 / (1.0 + 2.0 ** totals[_LEAD])
    totals[_LEAD] += np.log2(plain / mixed)
    return -np.log2(share * mixed + (1.0 - share) * plain)


@njit(cache=True, nogil=True)
def _digit(symbol, lower, first):
    """A digit of a symbol, from 1 on; 0 for no force."""
    if symbol == 0:
        return np.int64(0)
    return np.int64(symbol - 1) // lower + 1 if first else np.int64(symbol - 1) % lower + 1


@njit(cache=True, nogil=True)
def _support_keys(now, old, x, y, z, lower, keys):
    """The contexts of "is there a force?"; the set of weights."""
    near = np.int64(0)
    for dx in range(-1, 1):
        for dy in range(-1, 2 if dx < 0 else 1):
            for dz in range(-1, 2 if dx < 0 or dy < 0 else 0):
                near = near << 1 | np.int64(now[x + dx, y + dy, z + dz] > 0)
    far = np.int64(now[x - 2, y, z] > 0) | np.int64(now[x, y - 2, z] > 0) << 1 | np.int64(now[x, y, z - 2] > 0) << 2
    a, b, c = now[x, y, z - 1], now[x, y - 1, z], now[x - 1, y, z]
    three = np.int64(a > 0) | np.int64(b > 0) << 1 | np.int64(c > 0) << 2
    p = old[x, y, z]
    then = np.int64(p > 0) | np.int64(old[x, y, z + 1] > 0) << 1 | np.int64(old[x, y, z - 1] > 0) << 2
    then |= np.int64(old[x, y + 1, z] > 0) << 3 | np.int64(old[x, y - 1, z] > 0) << 4
    then |= np.int64(old[x + 1, y, z] > 0) << 5 | np.int64(old[x - 1, y, z] > 0) << 6
    da, db, dc, dp = _digit(a, lower, True), _digit(b, lower, True), _digit(c, lower, True), _digit(p, lower, True)
    keys[0] = _mix(_seed(1), near << 3 | far)
    keys[1] = _mix(_seed(2), then << 3 | three)
    keys[2] = _mix(_mix(_mix(_seed(3), da), db), dc)
    keys[3] = _mix(_mix(_mix(_seed(4), da), dp), dc)
    keys[4] = _mix(_mix(_seed(5), db), _digit(now[x, y - 2, z], lower, True))
    keys[5] = _mix(_mix(_seed(6), da), _digit(now[x, y, z - 2], lower, True))
    keys[6] = _mix(_seed(7), near >> 4 << 7 | then)
    return three | np.int64(p > 0) << 3


@njit(cache=True, nogil=True)
def _digit_keys(now, old, x, y, z, lower, first, own, keys):
    """The contexts of a digit of a symbol, `own` being the digit before it (0 before the first)."""
    a, b, c = now[x, y, z - 1], now[x, y - 1, z], now[x - 1, y, z]
    da, db, dc = _digit(a, lower, first), _digit(b, lower, first), _digit(c, lower, first)
    dp = _digit(old[x, y, z], lower, first)
    seed = 8 if first else 16
    if first:  # the mean of three planes through the neighbours: levels have an order
        ab, ac = _digit(now[x, y - 1, z - 1], lower, True), _digit(now[x - 1, y, z - 1], lower, True)
        bc = _digit(now[x - 1, y - 1, z], lower, True)
        guess = np.int64(2 * (da + db + dc) - ab - ac - bc) << 3
        guess |= np.int64(a > 0) | np.int64(b > 0) << 1 | np.int64(c > 0) << 2
    else:  # the neighbour whose first digit is nearest
        guess, best = np.int64(0), np.int64(1 << 40)
        for n in range(4):
            s = b if n == 0 else c if n == 1 else a if n == 2 else old[x, y, z]
            away = abs(_digit(s, lower, True) - own)
            if s > 0 and away < best:
                best, guess = away, _digit(s, lower, False) << 2 | min(away, 3)
    keys[0] = _mix(_seed(seed), da)
    keys[1] = _mix(_seed(seed + 1), db)
    keys[2] = _mix(_seed(seed + 2), dc)
    keys[3] = _mix(_mix(_mix(_seed(seed + 3), da), db), dc)
    keys[4] = _mix(_mix(_seed(seed + 4), dp), own)
    keys[5] = _mix(_seed(seed + 5), guess)
    keys[6] = _mix(_mix(_mix(_seed(seed + 6), own), db), dc)


@njit(cache=True, nogil=True)
def _code(now, old, truth, extent, radices, depths, order0, table, weights, totals):
    """Code a block whose halo is in `now` (known) and `old` (the previous frame); `now` is filled in."""
    keys = np.zeros(CONTEXTS, np.uint64)
    hashes = np.zeros(CONTEXTS, np.uint64)
    inputs = np.zeros(CONTEXTS + 1)
    lower = radices[1]
    for x in range(extent[0]):
        for y in range(extent[1]):
            for z in range(extent[2]):
                symbol = np.int64(truth[x, y, z])
                chosen = _support_keys(now, old, x + 2, y + 2, z + 2, lower, keys)
                bit = np.int64(symbol > 0)
                totals[_SUPPORT] += _decide(bit, 0, chosen, keys, hashes, inputs, order0, table, weights, totals)
                if bit == 0:
                    continue
                own = np.int64(0)
                base = np.int64(1)
                for d in range(2):
                    if depths[d] == 0:
                        continue
                    digit = _digit(symbol, lower, d == 0) - 1
                    _digit_keys(now, old, x + 2, y + 2, z + 2, lower, d == 0, own, keys)
                    node = np.int64(1)
                    for level in range(depths[d]):
                        shift = depths[d] - 1 - level
                        node <<= 1
                        # where the tree holds no value to the right, nothing is left to decide
                        if (node | 1) << shift >= (1 << depths[d]) + radices[d]:
                            continue
                        bit = (digit >> shift) & 1
                        chosen = 16 + 64 * d + 2 * level + np.int64(now[x + 1, y + 2, z + 2] > 0)
                        totals[_SYMBOL] += _decide(
                            bit, base + (node >> 1), chosen, keys, hashes, inputs, order0, table, weights, totals
                        )
                        node |= bit
                    own = digit + 1
                    base += 1 << depths[0]
                now[x + 2, y + 2, z + 2] = symbol


@njit(cache=True, nogil=True)
def _code_blocks(now, old, block, slots, slots_before, symbols, before, extents, radices, depths, order0, table,
                 weights, totals):  # fmt: skip
    # one loop for bricks and for whole arrays: the one call of _code is compiled once
    for n in range(extents.shape[0]):
        if slots.shape[0] > 0:
            fill_halo(now, symbols, slots[n], n)
            fill_halo(old, before, slots_before[n], before.shape[0])
            block = symbols[n]
        _code(now, old, block, extents[n], radices, depths, order0, table, weights, totals)


def code_bricks(
    model: Model,
    slots: tuple[Int64s, Int64s],
    symbols: tuple[Int32s, Int32s],
    extents: Int64s,
) -> None:
    """Code bricks in order, symbols int32 [n, 8, 8, 8], beside those of the previous frame, and add up the bits.

    `slots` int64 [n, 27]: where the bricks around each lie in the frame and in the previous one.
    """
    local = np.zeros((2, 12, 12, 12), np.int32)
    _code_blocks(local[0], local[1], local[0], *slots, *symbols, extents, *model.arrays)


def code_block(model: Model, truth: Int32s, now: Int32s, before: Int32s) -> None:
    """Code a box int32 [nx, ny, nz] in raster order, and add up the bits.

    `now` and `before`, the frame and the previous one, reach `LOW` samples further before the box and `HIGH` after
    it. Of `now` only what comes before the box is known; the rest is 0, and the box is filled in.
    """
    none = np.zeros((0, 27), np.int64)
    bricks = np.zeros((0, 8, 8, 8), np.int32)
    extents = np.array([truth.shape], np.int64)
    _code_blocks(now, before, truth, none, none, bricks, bricks, extents, *model.arrays)
