"""Compiled inner loops of the measures: counting of symbols, alone or with their neighbours, the curl of a
field, and sums of forces by direction.

Imported only when first needed, because it imports numba.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Int64s
from touchfield.compute.jit import inner, kernel
from touchfield.compute.threads import for_chunks

# -- symbols in tables. One addition to a table costs one or two cycles and waits for a preceding addition to
# the same entry. Therefore four tables are used in turn, and eight bytes of symbols are loaded at once.
# Stretches of one symbol, which make up most of a field, take a single addition.

_SPAN = 1 << 16
_PAD = 16  # entries between tables, so that they do not share the sets of the cache
_SMALL = 1 << 15  # fewer samples are counted without these tables
_STRETCH = 1 << 7  # words of eight bytes in a stretch
_PIECE = 1 << 11  # smallest number of stretches worth a thread
_ROUND = 1 << 22  # number of stretches after which the 32-bit tables are summed

_FFFF = np.uint64(0xFFFF)
_0, _1, _S, _16, _32, _48 = (np.uint64(i) for i in (0, 1, _STRETCH, 16, 32, 48))  # no sign to check
_SAME, _SPARE, _TURNS = np.uint64(0x0001000100010001), np.uint64(_SPAN), np.uint64(8)
_NONE, _UNIT, _ALL = np.uint32(0), np.uint32(1), np.uint32(4 * _STRETCH)


@kernel
def _count_packed(packed, tables):
    """Count 16-bit symbols, packed four to a word, in four tables in turn.

    `packed` has whole stretches; `tables` are uint32 [4, 65552].
    """
    t0, t1, t2, t3 = tables[0], tables[1], tables[2], tables[3]
    for start in range(_0, np.uint64(len(packed)), _S):
        usual = packed[start] & _FFFF
        if (
            packed[start] == usual * _SAME
        ):  # in a stretch of mostly one symbol, its additions take turns over spare entries
            differ = _0
            for i in range(start, start + _S):
                differ |= packed[i] ^ packed[start]
            if differ == _0:
                t0[usual] += _ALL
                continue
            for i in range(start, start + _S):
                v, turn = packed[i], _SPARE + i % _TURNS
                a, b, c, d = v & _FFFF, (v >> _16) & _FFFF, (v >> _32) & _FFFF, v >> _48
                t0[turn if a == usual else a] += _UNIT
                t1[turn if b == usual else b] += _UNIT
                t2[turn if c == usual else c] += _UNIT
                t3[turn if d == usual else d] += _UNIT
            for n in range(_SPARE, _SPARE + _TURNS):
                t0[usual] += t0[n] + t1[n] + t2[n] + t3[n]
                t0[n], t1[n], t2[n], t3[n] = _NONE, _NONE, _NONE, _NONE
            continue
        for i in range(start, start + _S):
            v = packed[i]
            t0[v & _FFFF] += _UNIT
            t1[(v >> _16) & _FFFF] += _UNIT
            t2[(v >> _32) & _FFFF] += _UNIT
            t3[v >> _48] += _UNIT


def counts_of_16_bits(x: NDArray[np.uint16]) -> Int64s:
    """Count each 16-bit word of contiguous, aligned uint16 [n], int64 [65536]."""
    if len(x) < _SMALL:
        return np.bincount(x, minlength=_SPAN)
    head = min(len(x), (-x.ctypes.data % 8) // 2)
    tail = head + (len(x) - head) // (4 * _STRETCH) * (4 * _STRETCH)
    packed = x[head:tail].view(np.uint64)
    total = np.bincount(x[:head], minlength=_SPAN) + np.bincount(x[tail:], minlength=_SPAN)
    stretches = len(packed) // _STRETCH
    for start in range(0, stretches, _ROUND):
        chunk = packed[start * _STRETCH :]
        for part in for_chunks(_count_stretches, min(_ROUND, stretches - start), chunk, chunk=_PIECE):
            total += part
    return total


def _count_stretches(start: int, stop: int, packed: Any) -> Int64s:
    tables = np.zeros((4, _SPAN + _PAD), np.uint32)
    _count_packed(packed[start * _STRETCH : stop * _STRETCH], tables)
    return tables.sum(axis=0, dtype=np.int64)[:_SPAN]


def counts_of_8_bits(x: NDArray[np.uint8]) -> Int64s:
    """Count each byte of contiguous uint8 [n], int64 [256].

    The counts are the margins of a table of 16-bit words.
    """
    head = x.ctypes.data % 2
    tail = head + (len(x) - head) // 2 * 2
    counts = np.bincount(x[:head], minlength=256) + np.bincount(x[tail:], minlength=256)
    table = counts_of_16_bits(x[head:tail].view(np.uint16)).reshape(256, 256)
    total: Int64s = counts + table.sum(axis=0) + table.sum(axis=1)
    return total


@kernel
def add_counts(keys, table):
    """Count `keys`, int64 [n] of 0 .. K - 1, into `table`, int64 [K].

    The range of the keys is not checked.
    """
    for i in range(len(keys)):
        table[keys[i]] += 1


# -- a voxel with its causal neighbours as one packed row, and an exact count of equal rows

CORNER = np.array(
    [[0, 0, -1], [0, -1, 0], [-1, 0, 0], [0, -1, -1], [-1, 0, -1], [-1, -1, 0], [-1, -1, -1]], np.int64
)  # the corner {-1, 0}^3 in the order in which neighbourhoods are nested: 1, 3, 7


@inner
def _fill_corner(local, symbols, slots):
    """Copy a brick and one sample before it along each axis to `local`.

    `local`: int32 [9, 9, 9]. `slots` int [27]: slots of the surrounding bricks, -1 for none.
    """
    for x in range(9):
        for y in range(9):
            for z in range(9):
                slot = slots[((x + 7) >> 3) * 9 + ((y + 7) >> 3) * 3 + ((z + 7) >> 3)]
                local[x, y, z] = symbols[slot, (x + 7) & 7, (y + 7) & 7, (z + 7) & 7] if slot >= 0 else 0


@kernel
def field_rows(slots, symbols, slots_before, before, extents, columns, bits, out):
    """Write the rows of voxels of some bricks to `out`; return their number.

    `out`: uint64 [512 n, words]; rows of zeros only are omitted. A row holds `columns` symbols of `bits` bits
    each: the symbol itself, its seven neighbours in `CORNER`, and the voxel of the previous frame. As many
    whole symbols as fit are in a word, the first in the lowest bits.

    `slots` and `slots_before` int64 [n, 27]: slots of the surrounding bricks in this frame and in the one
    before, -1 for none. `symbols` and `before`, int32 [., 8, 8, 8]: symbols of both frames. `extents` int64
    [n, 3]: number of samples of each brick within the grid.
    """
    per_word = 64 // bits
    cells, local = np.zeros(9, np.uint64), np.zeros((9, 9, 9), np.int32)
    count = 0
    for brick in range(extents.shape[0]):
        _fill_corner(local, symbols, slots[brick])
        slot_before = slots_before[brick, 13]
        for a in range(1, extents[brick, 0] + 1):
            for b in range(1, extents[brick, 1] + 1):
                for c in range(1, extents[brick, 2] + 1):
                    cells[0] = local[a, b, c]
                    bits_set = cells[0]
                    for n in range(7):
                        cells[n + 1] = local[a + CORNER[n, 0], b + CORNER[n, 1], c + CORNER[n, 2]]
                        bits_set |= cells[n + 1]
                    if columns > 8:
                        cells[8] = before[slot_before, a - 1, b - 1, c - 1] if slot_before >= 0 else 0
                        bits_set |= cells[8]
                    if bits_set == 0:
                        continue
                    for w in range(out.shape[1]):
                        out[count, w] = 0
                    for n in range(columns):
                        out[count, n // per_word] |= cells[n] << np.uint64(n % per_word * bits)
                    count += 1
    return count


@kernel
def insert(rows, weights, start, slots, keys, counts, used):
    """Count rows, uint64 [n, words], in a hash table, from row `start` on.

    Stops when all rows are counted or `keys` is full; returns the next row and the number of keys in use.
    `weights` int64 [n]; or [0] to count each row once. The table consists of `slots` int32 [2^b] (-1: free),
    `keys` uint64 [m, words] and `counts` int64 [m].
    """
    mask = np.uint64(slots.shape[0] - 1)
    word_count = rows.shape[1]
    for n in range(start, rows.shape[0]):
        h = np.uint64(0)
        for w in range(word_count):
            h = (h ^ rows[n, w]) * np.uint64(0x9E3779B97F4A7C15)
            h ^= h >> np.uint64(29)
        h = (h * np.uint64(0xBF58476D1CE4E5B9)) >> np.uint64(20)
        while True:
            key = slots[h & mask]
            if key < 0:
                if used == keys.shape[0]:
                    return n, used
                slots[h & mask] = used
                for w in range(word_count):
                    keys[used, w] = rows[n, w]
                counts[used] = weights[n] if weights.shape[0] else 1
                used += 1
                break
            same = True  # compare the whole key, never the hash alone
            for w in range(word_count):
                same &= keys[key, w] == rows[n, w]
            if same:
                counts[key] += weights[n] if weights.shape[0] else 1
                break
            h += np.uint64(1)
    return rows.shape[0], used


# -- curl at the lattice points, and work around the squares of the lattice


@inner
def _fill_halo(slots, forces, halo, has_force):
    """Copy the forces of a brick and one sample around it to `halo`, [10^3, 3].

    `has_force` is set to whether each of them is not zero.
    """
    for a in range(10):
        da, la = (a + 7) >> 3, (a + 7) & 7
        for b in range(10):
            db, lb = (b + 7) >> 3, (b + 7) & 7
            for c in range(10):
                p = a * 100 + b * 10 + c
                slot = slots[da * 9 + db * 3 + ((c + 7) >> 3)]
                has_force[p] = False
                for d in range(3):
                    f = np.float64(0.0)
                    if slot >= 0:
                        f = np.float64(forces[slot, la, lb, (c + 7) & 7, d])
                    halo[p, d] = f
                    if f != 0.0:
                        has_force[p] = True


@kernel
def curl_and_squares(start, stop, slots, spacing, forces, sums):
    """Sum |curl|^2, |gradient|^2 and squared loop work of each brick, SI units.

    `sums`: float64 [n, 7]. Columns: number of samples with a curl, sum of |curl|^2, sum of |gradient|^2,
    number of squares, sum of W^2 around them, largest |curl|^2, largest |W|.

    `slots` int32 [n, 27]: index in `forces` of each neighbour of a brick, -1 for none.
    """
    halo, has_force = np.empty((1000, 3)), np.empty(1000, np.bool_)
    jacobian = np.empty((3, 3))
    step = (100, 10, 1)
    half = (0.5 / spacing[0], 0.5 / spacing[1], 0.5 / spacing[2])
    for n in range(start, stop):
        _fill_halo(slots[n], forces, halo, has_force)
        for s in range(512):
            p = (s // 64 + 1) * 100 + (s // 8 % 8 + 1) * 10 + s % 8 + 1
            has_neighbours = has_force[p]
            for d in range(3):
                has_neighbours = has_neighbours and has_force[p + step[d]] and has_force[p - step[d]]
            if has_neighbours:
                square = 0.0
                for d in range(3):
                    for e in range(3):
                        jacobian[e, d] = (halo[p + step[d], e] - halo[p - step[d], e]) * half[d]
                        square += jacobian[e, d] ** 2
                curl2 = 0.0
                for d in range(3):
                    e, f = (d + 1) % 3, (d + 2) % 3
                    curl2 += (jacobian[f, e] - jacobian[e, f]) ** 2
                sums[n, 0] += 1
                sums[n, 1] += curl2
                sums[n, 2] += square
                sums[n, 5] = max(sums[n, 5], curl2)
            for d in range(3):  # the square from p along axes d and e
                e = (d + 1) % 3
                u, v, w = p + step[d], p + step[d] + step[e], p + step[e]
                if has_force[p] and has_force[u] and has_force[v] and has_force[w]:
                    work = 0.5 * spacing[d] * (halo[p, d] + halo[u, d] - halo[w, d] - halo[v, d])
                    work += 0.5 * spacing[e] * (halo[u, e] + halo[v, e] - halo[p, e] - halo[w, e])
                    sums[n, 3] += 1
                    sums[n, 4] += work * work
                    sums[n, 6] = max(sums[n, 6], abs(work))


# -- spherical harmonics: what a descriptor sums up of each force


@inner
def _recurrence(degrees):
    """Factors of the recurrence of Legendre derivatives by m and l, two tables [degrees, degrees]."""
    factors, factors_before = np.zeros((degrees, degrees)), np.zeros((degrees, degrees))
    for m in range(degrees):
        for order in range(m, degrees):
            factors[m, order] = (2 * order + 1) / (order + 1 - m)
            factors_before[m, order] = (order + m) / (order + 1 - m)
    return factors, factors_before


@inner
def _fill_harmonics(x, y, z, norms, factors, factors_before, values):
    """Write the real harmonics of a unit vector to `values`, at index l (l + 1) + m.

    A harmonic is (sin(theta) exp(i phi))^m times the m-th derivative of the Legendre polynomial of degree l,
    computed upwards in l by the three-term recurrence (`_recurrence`).
    """
    real, imaginary, of_m = 1.0, 0.0, 1.0  # of_m: (-1)^m 1 3 .. (2 m - 1)
    for m in range(len(norms)):
        before, legendre = 0.0, of_m
        for order in range(m, len(norms)):
            middle, term = order * (order + 1), norms[order, m] * legendre
            values[middle + m] = term * real
            if m > 0:
                values[middle - m] = term * imaginary
            above = factors[m, order] * z * legendre - factors_before[m, order] * before
            before, legendre = legendre, above
        real, imaginary = real * x - imaginary * y, real * y + imaginary * x
        of_m *= -(2 * m + 1)


@kernel
def sums_by_direction(forces, directions, sharpness, norms):
    """Sum the lengths of forces [n, 3] by direction and by spherical harmonic.

    Returns the sums around `directions` [k, 3], float64 [k], and the coefficients of the harmonics. A force
    is shared between the directions in proportion to exp(`sharpness` cos(angle)).
    """
    by_direction, coefficients = np.zeros(len(directions)), np.zeros(len(norms) ** 2)
    weights, values = np.empty(len(directions)), np.empty(len(norms) ** 2)
    factors, factors_before = _recurrence(len(norms))
    for n in range(len(forces)):
        length = math.sqrt(forces[n, 0] ** 2 + forces[n, 1] ** 2 + forces[n, 2] ** 2)
        if length == 0:
            continue
        x, y, z = forces[n, 0] / length, forces[n, 1] / length, forces[n, 2] / length
        total = 0.0
        for k in range(len(directions)):
            cosine = x * directions[k, 0] + y * directions[k, 1] + z * directions[k, 2]
            weights[k] = math.exp((cosine - 1) * sharpness)
            total += weights[k]
        for k in range(len(directions)):
            by_direction[k] += weights[k] * (length / total)
        _fill_harmonics(x, y, z, norms, factors, factors_before, values)
        for k in range(len(values)):
            coefficients[k] += length * values[k]
    return by_direction, coefficients


@kernel
def sums_by_shell(points, weights, shells_per_m, shells, norms):
    """Sum the weights of points [n, 3] by shell around the origin and by spherical harmonic.

    Returns the coefficients, float64 [shells, len(norms)^2]. A weight is shared between the two shells whose
    middles are nearest. A point at the origin has no direction, and counts for degree 0 only.
    """
    coefficients, values = np.zeros((shells, len(norms) ** 2)), np.empty(len(norms) ** 2)
    factors, factors_before = _recurrence(len(norms))
    for n in range(len(points)):
        radius = math.sqrt(points[n, 0] ** 2 + points[n, 1] ** 2 + points[n, 2] ** 2)
        depth = min(max(radius * shells_per_m - 0.5, 0.0), shells - 1.0)
        lower = min(int(depth), shells - 2)
        upper_weight = (depth - lower) * weights[n]
        lower_weight = weights[n] - upper_weight
        if radius == 0:
            coefficients[0, 0] += weights[n] * norms[0, 0]
            continue
        x, y, z = points[n, 0] / radius, points[n, 1] / radius, points[n, 2] / radius
        _fill_harmonics(x, y, z, norms, factors, factors_before, values)
        for k in range(len(values)):
            coefficients[lower, k] += lower_weight * values[k]
            coefficients[lower + 1, k] += upper_weight * values[k]
    return coefficients
