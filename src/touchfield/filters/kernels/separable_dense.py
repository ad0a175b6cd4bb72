"""A dense array through three passes of taps, fused so that what lies between them stays in the cache.

All sums of a sample are made in one fixed order that depends on where the sample lies and on the numbers around it,
never on the threads. Long inner loops over contiguous floats are what makes it fast: every pass adds whole rows
along z, four mirrored pairs of rows at a time. Imported only when first needed, because it imports numba.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from touchfield.parallel import for_chunks

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Taps = tuple[NDArray[np.int64], NDArray[np.float32]]
    Int64s = NDArray[np.int64]
    Float32s = NDArray[np.float32]

# Rows are named by where they begin in a flat array: a slice of an array costs numba a count of references, which
# is an atomic instruction, and offsets without a sign cost it no test for being counted from the end.


@njit(cache=True, nogil=True)
def copied(out, o, flat, p, n):
    o, p = np.uint64(o), np.uint64(p)
    for r in range(np.uint64(n)):
        out[o + r] = flat[p + r]


@njit(cache=True, nogil=True)
def cleared(out, o, n):
    o = np.uint64(o)
    for r in range(np.uint64(n)):
        out[o + r] = 0


@njit(cache=True, nogil=True)
def _scaled(out, o, flat, p, w, n):
    o, p = np.uint64(o), np.uint64(p)
    for r in range(np.uint64(n)):
        out[o + r] = w * flat[p + r]


@njit(cache=True, nogil=True)
def _added(out, o, flat, p, w, n):
    o, p = np.uint64(o), np.uint64(p)
    for r in range(np.uint64(n)):
        out[o + r] += w * flat[p + r]


@njit(cache=True, nogil=True)
def _four_pairs_and_one(out, o, flat, c, v, p, q, w, n):
    """The row at `c` and four pairs, in place of what was there; `p`, `q` and `w` are tuples of four."""
    o, c = np.uint64(o), np.uint64(c)
    a0, a1, a2, a3 = np.uint64(p[0]), np.uint64(p[1]), np.uint64(p[2]), np.uint64(p[3])
    b0, b1, b2, b3 = np.uint64(q[0]), np.uint64(q[1]), np.uint64(q[2]), np.uint64(q[3])
    w0, w1, w2, w3 = w
    for r in range(np.uint64(n)):
        first = w0 * (flat[a0 + r] + flat[b0 + r]) + w1 * (flat[a1 + r] + flat[b1 + r])
        second = w2 * (flat[a2 + r] + flat[b2 + r]) + w3 * (flat[a3 + r] + flat[b3 + r])
        out[o + r] = v * flat[c + r] + (first + second)


@njit(cache=True, nogil=True)
def _four_pairs_added(out, o, flat, p, q, w, n):
    """`p`, `q` and `w` are tuples of four."""
    o = np.uint64(o)
    a0, a1, a2, a3 = np.uint64(p[0]), np.uint64(p[1]), np.uint64(p[2]), np.uint64(p[3])
    b0, b1, b2, b3 = np.uint64(q[0]), np.uint64(q[1]), np.uint64(q[2]), np.uint64(q[3])
    w0, w1, w2, w3 = w
    for r in range(np.uint64(n)):
        first = w0 * (flat[a0 + r] + flat[b0 + r]) + w1 * (flat[a1 + r] + flat[b1 + r])
        out[o + r] += first + (w2 * (flat[a2 + r] + flat[b2 + r]) + w3 * (flat[a3 + r] + flat[b3 + r]))


@njit(cache=True, nogil=True)
def sums(out, flat, table, jobs, count, places, weights, nothing):
    """Rows of sums, as `jobs` [count, 4] says: where in `out`, how many numbers, the first row, where in the rows.

    Row m of the input begins at ``flat[table[m]]``. `places` and `weights` are `Taps`; places count from the first
    row of the job. `nothing` is the `table` of a row of zeros, which must be there to be read, as the last.
    """
    alone, pairs = places[0], places[1]
    for job in range(count):
        o, n, i, at = jobs[job, 0], jobs[job, 1], jobs[job, 2], jobs[job, 3]
        k = 2 + alone
        together = alone > 0 and pairs >= 4
        if not together and alone > 0:
            _scaled(out, o, flat, table[i + places[2]] + at, weights[2], n)
        elif not together:
            cleared(out, o, n)
        while k + 4 <= 2 + alone + pairs:
            p0, q0 = table[i + places[k]], table[i + places[k + pairs]]
            p1, q1 = table[i + places[k + 1]], table[i + places[k + 1 + pairs]]
            p2, q2 = table[i + places[k + 2]], table[i + places[k + 2 + pairs]]
            p3, q3 = table[i + places[k + 3]], table[i + places[k + 3 + pairs]]
            some = min(min(min(p0, q0), min(p1, q1)), min(min(p2, q2), min(p3, q3))) < nothing
            if some or together:
                p, q = (p0 + at, p1 + at, p2 + at, p3 + at), (q0 + at, q1 + at, q2 + at, q3 + at)
                w = (weights[k], weights[k + 1], weights[k + 2], weights[k + 3])
                if together:
                    _four_pairs_and_one(out, o, flat, table[i + places[2]] + at, weights[2], p, q, w, n)
                    together = False
                else:
                    _four_pairs_added(out, o, flat, p, q, w, n)
            k += 4
        for m in range(k, 2 + alone + pairs):
            _added(out, o, flat, table[i + places[m]] + at, weights[m], n)
            _added(out, o, flat, table[i + places[m + pairs]] + at, weights[m], n)
        for m in range(3, 2 + alone):
            _added(out, o, flat, table[i + places[m]] + at, weights[m], n)


_RING_FLOATS = 1 << 18  # a thread's ring of rows should stay in its second-level cache


@njit(cache=True, nogil=True)
def _job(jobs, count, o, n, i, at):
    jobs[count, 0], jobs[count, 1], jobs[count, 2], jobs[count, 3] = o, n, i, at
    return count + 1


@njit(cache=True, nogil=True)
def _gathered(signal, place, x_map, source, table):
    """Copy one row of each plane that a block needs to `source`, and say in `table` where each begins.

    `place` is where the row begins in a plane, how long a row and a plane are, the first plane and how many.
    """
    y_at, run, plane, x0, count = place
    for p in range(count):
        x = x_map[x0 + p]
        table[p] = p * run if x >= 0 else source.shape[0] - run  # the row that stays zero
        if x >= 0:
            copied(source, p * run, signal, x * plane + y_at, run)


@njit(cache=True, nogil=True)
def _with_ends(line, lines, count, z_map, before, parts):
    """Fill what lies beyond the ends of `lines` lines of `count` samples that begin at `before`."""
    for i in range(lines):
        start = i * z_map.shape[0]
        for p in range(z_map.shape[0]):
            if p < before or p >= before + count:
                for c in range(parts):
                    z = z_map[p]
                    here = (start + p) * parts + c
                    line[here] = line[(start + before + z) * parts + c] if z >= 0 else np.float32(0)


@njit(cache=True, nogil=True)
def _dense(begin, end, signal, shape, block, maps, before, places, weights, out):
    """Planes `begin` to `end`, in blocks: sums along x, then along z, into a ring of rows that are summed along y."""
    count_x, count_y, count_z, parts = shape
    x_map, y_map, z_map = maps
    run, long_run = count_z * parts, z_map.shape[0] * parts
    deep, wide = x_map.shape[0] - count_x, y_map.shape[0] - count_y
    source, x_table = np.zeros((block + deep + 1) * run, np.float32), np.empty(block + deep, np.int64)
    ring, y_table = np.zeros((wide + 2) * block * run, np.float32), np.empty(wide + 1, np.int64)
    line = np.zeros((block + 1) * long_run, np.float32)
    z_table = np.arange(z_map.shape[0] - count_z + 1) * parts
    x_zero, y_zero, z_zero = (block + deep) * run, (wide + 1) * block * run, block * long_run
    jobs = np.empty((block, 4), np.int64)
    for x0 in range(begin, end, block):
        planes = min(block, end - x0)
        for q in range(count_y + wide):
            if y_map[q] >= 0:
                place = (y_map[q] * run, run, count_y * run, x0, planes + deep)
                _gathered(signal, place, x_map, source, x_table)
                for i in range(planes):
                    _job(jobs, i, i * long_run + before * parts, run, i, 0)
                sums(line, source, x_table, jobs, planes, places[0], weights[0], x_zero)
                _with_ends(line, planes, count_z, z_map, before, parts)
                for i in range(planes):
                    _job(jobs, i, ((q % (wide + 1)) * block + i) * run, run, 0, i * long_run)
                sums(ring, line, z_table, jobs, planes, places[2], weights[2], z_zero)
            if q >= wide:
                for p in range(q - wide, q + 1):
                    y_table[p - q + wide] = (p % (wide + 1)) * block * run if y_map[p] >= 0 else y_zero
                for i in range(planes):
                    _job(jobs, i, ((x0 + i) * count_y + q - wide) * run, run, 0, i * run)
                sums(out, ring, y_table, jobs, planes, places[1], weights[1], y_zero)


def dense_filtered(signal: Float32s, maps: tuple[Int64s, Int64s, Int64s], before: int, taps: Taps) -> Float32s:
    """An array filtered along its first three axes, float32 [nx, ny, nz, parts].

    signal : float32 [nx, ny, nz, parts]
    maps : int64 [nx + reach], [ny + reach], [nz + reach]; for each axis, which sample stands at each place of the
        axis continued beyond its ends; -1 for none.
    before : int; how many places the z axis was continued at its beginning.
    taps; what `touchfield.filters.separable.packed` gives.
    """
    nx, ny, nz, parts = signal.shape
    out = np.empty(signal.shape, np.float32)
    ring_rows = len(maps[1]) - ny + 2
    block = min(nx, max(8, min(64, _RING_FLOATS // (ring_rows * nz * parts))))
    flat = np.ascontiguousarray(signal).reshape(-1)
    for_chunks(_dense, nx, flat, signal.shape, block, maps, before, *taps, out.reshape(-1), chunk=block)
    return out
