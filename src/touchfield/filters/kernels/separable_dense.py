"""A dense array through three passes of taps, fused so that what lies between them stays in the cache.

Imported only when first needed, because it imports numba.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from touchfield.filters.kernels.row_sums import copied, sums
from touchfield.parallel import for_chunks

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.filters.kernels.row_sums import Taps

    Int64s = NDArray[np.int64]
    Float32s = NDArray[np.float32]

__all__ = ["dense_filtered"]

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
