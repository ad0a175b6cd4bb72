"""Compiled: the composed field of bodies in motion, decoded beside source, at every voxel that a body reaches.

Both fields of a body are kept as cells in one order (`touchfield.medium.cells`). Each cell knows a bound of what its
error is of the mask, anywhere in it: a voxel that one body alone reaches is looked at only where that bound is above
the worst voxel found so far, and a voxel that several reach always.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numba import njit

from touchfield.codec.kernels.lean import LEAN
from touchfield.medium.kernels.cell import CELLS, between
from touchfield.medium.kernels.placed import SHIFT, START, C, H, R, T, find, in_scene, is_held, place, shortened

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Float64s = NDArray[np.float64]
    Float32s = NDArray[np.float32]

__all__ = ["Bodies", "Moves", "Rule", "Workspace", "bound_cells", "compare_frames"]

_1, _2 = np.uint64(1), np.uint64(2)
_COLUMNS = 33
_SLACK = 1 + 1e-6


class Bodies(NamedTuple):
    """Both fields of all bodies (`CellPool`), `bounds` float32 [n, 512] of their cells, and `tops` [n] of these."""

    lattices: Float64s
    boxes: NDArray[np.int64]
    starts: NDArray[np.int64]
    bricks: NDArray[np.int32]
    tables: NDArray[np.int64]
    held: NDArray[np.uint64]
    source: Float32s
    decoded: Float32s
    bounds: Float32s
    tops: Float32s


class Moves(NamedTuple):
    """Decoded poses [frames, bodies, 7], and b (v, omega) of source and decoded track, each [frames, bodies, 6]."""

    poses: Float64s
    source: Float64s
    decoded: Float64s


class Workspace(NamedTuple):
    """Origin and spacing of the lattice, float64 [6], and its shape, int64 [3]."""

    lattice: Float64s
    shape: NDArray[np.int64]


class Rule(NamedTuple):
    """|error| <= max(f0_n, k |F|); a body's own force up to `floor_n` is none, sums are cut to `limit_n`."""

    k: float
    f0_n: float
    floor_n: float
    limit_n: float


class _Found(NamedTuple):
    """The worst of each body so far; and room for what a voxel, a brick and a frame need."""

    worst: Float64s
    places: NDArray[np.int64]
    sums: Float64s
    near: NDArray[np.int64]
    here: NDArray[np.int64]
    voxel: NDArray[np.int64]
    low: NDArray[np.int64]
    high: NDArray[np.int64]
    first: Float64s
    size: Float64s
    spans: NDArray[np.int64]
    before: NDArray[np.int64]


@njit(cache=True, nogil=True)
def bound_cells(begin, end, source, decoded, rule, bounds):
    """Into `bounds` [n, 512], for bricks of cells: the most that |error| / mask can be within each cell.

    The error of a trilinear cell is at most that of its worst corner, and its force along the mean direction no less
    than that of the corner where this is least.
    """
    corners = np.empty((8, 3))
    for s in range(begin, end):
        for cell in range(512):
            error2, mean = 0.0, np.zeros(3)
            for e in range(8):
                o = s * CELLS + ((cell >> 6) + (e >> 2)) * 243
                o += (((cell >> 3) & 7) + ((e >> 1) & 1)) * 27 + ((cell & 7) + (e & 1)) * 3
                own2 = 0.0
                for a in range(3):
                    corners[e, a] = source[o + a]
                    mean[a] += corners[e, a]
                    own2 += (decoded[o + a] - corners[e, a]) ** 2
                error2 = max(error2, own2)
            if error2 == 0.0:
                continue
            length, least = np.sqrt(mean[0] ** 2 + mean[1] ** 2 + mean[2] ** 2), rule.limit_n
            for e in range(8):
                along = corners[e, 0] * mean[0] + corners[e, 1] * mean[1] + corners[e, 2] * mean[2]
                least = min(least, along / max(length, 1e-300))
            bounds[s, cell] = _SLACK * np.sqrt(error2) / max(rule.f0_n, rule.k * least)


@njit(nogil=True, forceinline=True)
def _own(row, px, py, pz):
    """A point of the scene in samples of a body, from the corner of its box."""
    dx, dy, dz = px - row[T], py - row[T + 1], pz - row[T + 2]
    x = row[0] * dx + row[1] * dy + row[2] * dz - row[C]
    y = row[3] * dx + row[4] * dy + row[5] * dz - row[C + 1]
    return x, y, row[6] * dx + row[7] * dy + row[8] * dz - row[C + 2]


@njit(nogil=True, forceinline=True)
def _slot(bodies, n, x, y, z):
    """The brick of cells of body n that holds a force about a point of its own, -1 for none."""
    boxes = bodies.boxes
    if not (0.0 <= x < 8.0 * boxes[n, 0] and 0.0 <= y < 8.0 * boxes[n, 1] and 0.0 <= z < 8.0 * boxes[n, 2]):
        return -1
    i, j, k = np.int64(x), np.int64(y), np.int64(z)
    key = ((i >> 3) * boxes[n, 1] + (j >> 3)) * boxes[n, 2] + (k >> 3)
    slot = find(bodies.tables, boxes[n, START], boxes[n, SHIFT], key)
    return slot if slot >= 0 and is_held(bodies.held, slot, i, j, k) else -1


@njit(**LEAN)
def _add(cells, slot, own, row, at, least, total):
    """Add to `total` the force of a body at a point, as it is in the scene."""
    x, y, z = own
    i, j, k = np.int64(x), np.int64(y), np.int64(z)
    o = np.uint64(slot * CELLS + (i & 7) * 243 + (j & 7) * 27 + (k & 7) * 3)
    gx, gy = between(cells, o, x - i, y - j, z - k), between(cells, o + _1, x - i, y - j, z - k)
    gz = between(cells, o + _2, x - i, y - j, z - k)
    if gx * gx + gy * gy + gz * gz > least:
        gx, gy, gz = in_scene(row, gx, gy, gz, at[0] - row[T], at[1] - row[T + 1], at[2] - row[T + 2])
        total[0] += gx
        total[1] += gy
        total[2] += gz


@njit(**LEAN)
def _ratio(sums, rule):
    """|error| / mask of the sums of the source and the decoded forces, each cut and rounded as a receiver does."""
    x, y, z = shortened(sums[0, 0], sums[0, 1], sums[0, 2], rule.limit_n)
    u, v, w = shortened(sums[1, 0], sums[1, 1], sums[1, 2], rule.limit_n)
    x, y, z = np.float64(np.float32(x)), np.float64(np.float32(y)), np.float64(np.float32(z))
    u, v, w = np.float64(np.float32(u)), np.float64(np.float32(v)), np.float64(np.float32(w))
    error = np.sqrt((u - x) ** 2 + (v - y) ** 2 + (w - z) ** 2)
    return error / max(rule.f0_n, rule.k * np.sqrt(x * x + y * y + z * z))


@njit(**LEAN)
def _span(row, first, size, workspace, low, high):
    """The box of the workspace's samples about a box of a body's own; whether there are any."""
    for a in range(3):
        centre, reach = row[T + a] - workspace.lattice[a], 0.0
        for b in range(3):
            centre += row[R + 3 * a + b] * row[H + b] * (first[b] + size[b] / 2 + row[C + b])
            reach += abs(row[R + 3 * a + b]) * row[H + b] * size[b] / 2
        spacing = workspace.lattice[3 + a]
        begin, end = (centre - reach) / spacing - 1e-6, (centre + reach) / spacing + 1e-6
        if not max(begin, 0.0) <= min(end, workspace.shape[a] - 1.0):
            return False
        low[a], high[a] = np.int64(np.ceil(max(begin, 0.0))), np.int64(min(end, workspace.shape[a] - 1.0))
        if low[a] > high[a]:
            return False
    return True


@njit(**LEAN)
def _row_within(row, brick, px, py, workspace, low, high):
    """The first and the last sample of a row along z within a brick of a body's own, to rounding."""
    h = workspace.lattice[5]
    dx, dy, dz = px - row[T], py - row[T + 1], workspace.lattice[2] - row[T + 2]
    first, last = float(low), float(high)
    for a in range(3):
        q = row[3 * a] * dx + row[3 * a + 1] * dy + row[3 * a + 2] * dz - row[C + a] - 8.0 * brick[a]
        step = row[3 * a + 2] * h
        if abs(step) < 1e-9:
            if not -1e-3 <= q <= 8.001:
                return 0, -1
            continue
        one, other = -q / step, (8.0 - q) / step
        first, last = max(first, min(one, other) - 1e-6), min(last, max(one, other) + 1e-6)
    return (np.int64(np.ceil(first)), np.int64(np.floor(last))) if first <= last else (0, -1)


@njit(**LEAN)
def _meets(bodies, rows, px, py, pz, found):
    """How many bodies that are near have a part in a voxel: their numbers and slots go to `found`."""
    count = 0
    for m in range(found.near[0]):
        body = found.near[1 + m]
        x, y, z = _own(rows[0, body], px, py, pz)
        slot = _slot(bodies, body, x, y, z)
        if slot >= 0:
            count += 1
            found.here[count, 0], found.here[count, 1] = body, slot
    return count


@njit(**LEAN)
def _compare_voxel(bodies, rows, rule, count, px, py, pz, found):
    """Compare at one voxel, of the bodies and slots `found.here[:count]`; whether it is beyond the rule."""
    sums, least = found.sums, rule.floor_n * rule.floor_n
    sums[:] = 0.0
    for m in range(count):
        body, slot = found.here[m]
        own = _own(rows[0, body], px, py, pz)
        _add(bodies.source, slot, own, rows[0, body], (px, py, pz), least, sums[0])
        _add(bodies.decoded, slot, own, rows[1, body], (px, py, pz), least, sums[1])
    ratio = _ratio(sums, rule)
    for m in range(count):
        body = found.here[m, 0]
        if ratio > found.worst[body]:
            found.worst[body] = ratio
            for a in range(4):
                found.places[body, a] = found.voxel[a]
    return ratio > 1.0


@njit(**LEAN)
def _compare_row(bodies, rows, rule, n, slot, workspace, span, px, py, found):
    """Compare at the voxels of a row that lie in one brick of body n; how many are beyond the rule."""
    beyond, brick = 0, bodies.bricks[slot]
    for k in range(span[0], span[1] + 1):
        pz = workspace.lattice[2] + k * workspace.lattice[5]
        x, y, z = _own(rows[0, n], px, py, pz)
        i, j, l = np.int64(np.floor(x)), np.int64(np.floor(y)), np.int64(np.floor(z))  # noqa: E741
        if i >> 3 != brick[0] or j >> 3 != brick[1] or l >> 3 != brick[2] or not is_held(bodies.held, slot, i, j, l):
            continue
        known = bodies.bounds[slot, (i & 7) * 64 + (j & 7) * 8 + (l & 7)] <= min(found.worst[n], 1.0)
        others = _meets(bodies, rows, px, py, pz, found) if found.near[0] else 0
        if (known and others == 0) or (others and found.here[1, 0] < n):  # compared where that body was walked
            continue
        found.here[0, 0], found.here[0, 1], found.voxel[3] = n, slot, k
        beyond += _compare_voxel(bodies, rows, rule, 1 + others, px, py, pz, found)
    return beyond


@njit(**LEAN)
def _compare_brick(bodies, rows, rule, n, slot, workspace, found):
    """Compare at the voxels within one brick of body n; how many are beyond the rule."""
    brick, low, high = bodies.bricks[slot], found.low, found.high
    for a in range(3):
        found.first[a], found.size[a] = 8.0 * brick[a], 8.0
    if not _span(rows[0, n], found.first, found.size, workspace, low, high):
        return 0
    found.near[0] = 0
    for m in range(bodies.boxes.shape[0]):
        if m != n:
            meets = True
            for a in range(3):
                meets = meets and found.spans[m, 0, a] <= high[a] and low[a] <= found.spans[m, 1, a]
            if meets:
                found.near[0] += 1
                found.near[found.near[0]] = m
    if found.near[0] == 0 and bodies.tops[slot] <= min(found.worst[n], 1.0):
        return 0
    beyond = 0
    for i in range(low[0], high[0] + 1):
        px = workspace.lattice[0] + i * workspace.lattice[3]
        for j in range(low[1], high[1] + 1):
            py = workspace.lattice[1] + j * workspace.lattice[4]
            found.voxel[1], found.voxel[2] = i, j
            span = _row_within(rows[0, n], brick, px, py, workspace, low[2], high[2])
            if span[0] <= span[1]:
                beyond += _compare_row(bodies, rows, rule, n, slot, workspace, span, px, py, found)
    return beyond


@njit(**LEAN)
def _stays(moves, f, n):
    """Whether a body is as it was in the frame before."""
    for a in range(7):
        if moves.poses[f, n, a] != moves.poses[f - 1, n, a]:
            return False
    for a in range(6):
        if moves.source[f, n, a] != moves.source[f - 1, n, a] or moves.decoded[f, n, a] != moves.decoded[f - 1, n, a]:
            return False
    return True


@njit(**LEAN)
def _alone(n, stays, found):
    """Whether no body that moves reaches where body n does, nor did so in the frame before."""
    for m in range(stays.shape[0]):
        for spans in (found.spans, found.before):
            meets = not stays[m]
            for a in range(3):
                meets = meets and spans[m, 0, a] <= found.spans[n, 1, a] and found.spans[n, 0, a] <= spans[m, 1, a]
            if meets:
                return False
    return True


@njit(cache=True, nogil=True)
def compare_frames(begin, end, bodies, moves, workspace, rule):
    """The largest |error| / mask of frames begin to end - 1 at the voxels that each body has a part in.

    Returns
    -------
    worst : float64 [bodies]
    places : int64 [bodies, 4]
        Frame and voxel of it, the first in the order of frames; -1 for none.
    beyond : int
        Voxels, of all frames, at which the error is beyond the mask.
    """
    count = bodies.boxes.shape[0]
    rows = np.empty((2, count, _COLUMNS))
    found = _Found(
        np.zeros(count), np.full((count, 4), -1), np.zeros((2, 3)), np.zeros(count + 1, np.int64),
        np.zeros((count, 2), np.int64), np.zeros(4, np.int64), np.zeros(3, np.int64), np.zeros(3, np.int64),
        np.zeros(3), np.zeros(3), np.zeros((count, 2, 3), np.int64), np.zeros((count, 2, 3), np.int64),
    )  # fmt: skip
    beyond, here, stays = 0, np.zeros(count, np.int64), np.zeros(count, np.bool_)
    for f in range(begin, end):
        found.voxel[0] = f
        place(moves.poses[f], bodies.lattices, moves.source[f], rows[0])
        place(moves.poses[f], bodies.lattices, moves.decoded[f], rows[1])
        found.before[:] = found.spans
        for n in range(count):
            for a in range(3):
                found.first[a], found.size[a] = 0.0, 8.0 * bodies.boxes[n, a]
            if not _span(rows[0, n], found.first, found.size, workspace, found.spans[n, 0], found.spans[n, 1]):
                found.spans[n, 0], found.spans[n, 1] = 1, 0
            stays[n] = f > begin and _stays(moves, f, n)
        for n in range(count):
            if not (stays[n] and _alone(n, stays, found)):  # else nothing has changed about it
                here[n] = 0
                for slot in range(bodies.starts[n], bodies.starts[n + 1]):
                    here[n] += _compare_brick(bodies, rows, rule, n, slot, workspace, found)
            beyond += here[n]
    return found.worst, found.places, beyond
