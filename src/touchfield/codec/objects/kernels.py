"""Compiled: the composed field of bodies in motion, decoded beside source, at every voxel that a body
reaches.

Both fields of a body are kept as cells in one order (`touchfield.medium.cells`). Each cell knows a bound of
what its error is of the mask, anywhere in it: a voxel that one body alone reaches is looked at only where
that bound is above the worst voxel found so far, and a voxel that several reach always. All is compiled into
one function: to hand on tuples of arrays took a quarter of the time.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Float32s, Float64s, Int32s, Int64s
from touchfield.compute.jit import kernel, lean
from touchfield.medium.kernels.placed import (
    CELLS,
    C,
    H,
    R,
    T,
    force_of,
    in_scene,
    is_held,
    own,
    place,
    shortened,
    slot_at,
)

_COLUMNS = 33
_SLACK = 1 + 1e-6
_ROUNDING = 2.0**-22  # of a force: two roundings to float32, and those of the sums
_NOWHERE = 1 << 40


class Bodies(NamedTuple):
    """Both fields of all bodies (`CellPool`), `bounds` float32 [n, 512] of their cells, and `tops` [n] of
    these.

    `marks` uint8 [n, 512] takes 1 for each cell that has a part in a voxel beyond the rule; [0, 512] takes
    none.
    """

    lattices: Float64s
    boxes: Int64s
    starts: Int64s
    bricks: Int32s
    tables: Int64s
    held: NDArray[np.uint64]
    source: Float32s
    decoded: Float32s
    bounds: Float32s
    tops: Float32s
    marks: NDArray[np.uint8]


class Rule(NamedTuple):
    """|error| <= max(f0_n, k |F|), of which f0_n may be 0.

    A body's own force up to `floor_n` is none; sums are cut to `limit_n`.
    """

    k: float
    f0_n: float
    floor_n: float
    limit_n: float


class _Found(NamedTuple):
    """The worst of each body so far; and room: `near` and `here` begin with a count or a body, boxes are [2,
    3].
    """

    worst: Float64s
    places: Int64s
    sums: Float64s
    near: Int64s
    here: Int64s
    voxel: Int64s
    box: Int64s
    spans: Int64s
    before: Int64s


@kernel
def bound_cells(begin, end, source, decoded, rule, bounds):
    """Into `bounds` [n, 512], for bricks of cells: the most that |error| / mask can be within each cell.

    The error of a trilinear cell is at most that of its worst corner, and its force along the mean direction
    no less than that of the corner where this is least. Where the force may vanish within a cell that is not
    exact, and f0_n is 0, there is no bound. A force may be cut off by `floor_n` in one field only, and is
    rounded to float32 in both.
    """
    corners, mean = np.empty((8, 3)), np.empty(3)
    for s in range(begin, end):
        for cell in range(512):
            error2 = 0.0
            mean[:] = 0.0
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
            length, least, most = np.sqrt(mean[0] ** 2 + mean[1] ** 2 + mean[2] ** 2), rule.limit_n, 0.0
            for e in range(8):
                along = corners[e, 0] * mean[0] + corners[e, 1] * mean[1] + corners[e, 2] * mean[2]
                least = min(least, along / max(length, 1e-300))
                most = max(most, corners[e, 0] ** 2 + corners[e, 1] ** 2 + corners[e, 2] ** 2)
            error, allowed = np.sqrt(error2), max(rule.f0_n, rule.k * least)
            if least - error <= 2.0 * rule.floor_n:
                error += 2.0 * rule.floor_n
            error += _ROUNDING * min(np.sqrt(most), rule.limit_n)
            bounds[s, cell] = _SLACK * error / allowed if allowed > 0.0 else np.inf


@lean(forceinline=True)
def _add(cells, slot, row, at, least, total):
    """Add to `total` the force of a body at a point x - t, as it is in the scene."""
    x, y, z = own(row, at[0], at[1], at[2])
    x, y, z = force_of(cells, slot, x, y, z)
    if x * x + y * y + z * z > least:
        x, y, z = in_scene(row, x, y, z, at[0], at[1], at[2])
        total[0] += x
        total[1] += y
        total[2] += z


@lean(forceinline=True)
def _span(row, first, size, world, box):
    """Into `box` the workspace's samples about a box of a body's own, first and last; whether there are any."""
    for a in range(3):
        centre, reach = row[T + a] - world[0, a], 0.0
        for b in range(3):
            centre += row[R + 3 * a + b] * row[H + b] * (first[b] + size[b] / 2 + row[C + b])
            reach += abs(row[R + 3 * a + b]) * row[H + b] * size[b] / 2
        spacing = world[1, a]
        begin = np.ceil(max((centre - reach) / spacing - 1e-6, 0.0))
        end = min((centre + reach) / spacing + 1e-6, world[2, a] - 1.0)
        if not begin <= end:
            box[0, a] = _NOWHERE
            return False
        box[0, a], box[1, a] = np.int64(begin), np.int64(end)
    return True


@lean(forceinline=True)
def _overlap(one, other):
    """True where two boxes of samples have one in common."""
    meets = True
    for a in range(3):
        meets = meets and one[0, a] <= other[1, a] and other[0, a] <= one[1, a]
    return meets


@lean(forceinline=True)
def _row_within(row, brick, px, py, world, low, high):
    """The first and the last sample of a row along z within a brick of a body's own, to rounding."""
    h = world[1, 2]
    dx, dy, dz = px - row[T], py - row[T + 1], world[0, 2] - row[T + 2]
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


@lean(forceinline=True)
def _meets(bodies, row_of, px, py, pz, found):
    """How many bodies that are near have a part in a voxel: their numbers and slots go to `found`."""
    count = 0
    for m in range(found.near[0]):
        body = found.near[1 + m]
        row = row_of[body]
        x, y, z = own(row, px - row[T], py - row[T + 1], pz - row[T + 2])
        slot = slot_at(bodies.boxes, body, bodies.tables, bodies.held, x, y, z)
        if slot >= 0:
            count += 1
            found.here[count, 0], found.here[count, 1] = body, slot
    return count


@lean(forceinline=True)
def _mark(bodies, row_of, count, px, py, pz, found):
    """Mark the cells of the bodies `found.here[:count]` that a voxel lies in."""
    for m in range(count):
        body, slot = found.here[m]
        row = row_of[body]
        x, y, z = own(row, px - row[T], py - row[T + 1], pz - row[T + 2])
        i, j, l = np.int64(np.floor(x)), np.int64(np.floor(y)), np.int64(np.floor(z))  # noqa: E741
        bodies.marks[slot, (i & 7) * 64 + (j & 7) * 8 + (l & 7)] = 1


@lean(forceinline=True)
def _compare_voxel(bodies, rows, rule, count, px, py, pz, found):
    """Compare at one voxel, of the bodies and slots `found.here[:count]`; whether it is beyond the rule."""
    sums, least = found.sums, rule.floor_n * rule.floor_n
    sums[:] = 0.0
    for m in range(count):
        body, slot = found.here[m]
        row = rows[0, body]
        at = px - row[T], py - row[T + 1], pz - row[T + 2]
        _add(bodies.source, slot, row, at, least, sums[0])
        _add(bodies.decoded, slot, rows[1, body], at, least, sums[1])
    # the forces of the source and the decoded ones, each cut and rounded as a receiver does
    x, y, z = shortened(sums[0, 0], sums[0, 1], sums[0, 2], rule.limit_n)
    u, v, w = shortened(sums[1, 0], sums[1, 1], sums[1, 2], rule.limit_n)
    x, y, z = np.float64(np.float32(x)), np.float64(np.float32(y)), np.float64(np.float32(z))
    u, v, w = np.float64(np.float32(u)), np.float64(np.float32(v)), np.float64(np.float32(w))
    error = np.sqrt((u - x) ** 2 + (v - y) ** 2 + (w - z) ** 2)
    allowed = max(rule.f0_n, rule.k * np.sqrt(x * x + y * y + z * z))
    ratio = error / allowed if allowed > 0.0 else (np.inf if error > 0.0 else 0.0)
    if ratio > 1.0 and bodies.marks.shape[0]:
        _mark(bodies, rows[0], count, px, py, pz, found)
    for m in range(count):
        body = found.here[m, 0]
        if ratio > found.worst[body]:
            found.worst[body] = ratio
            for a in range(4):
                found.places[body, a] = found.voxel[a]
    return ratio > 1.0


@lean(forceinline=True)
def _compare_row(bodies, rows, rule, n, slot, world, span, px, py, found):
    """Compare at the voxels of a row that lie in one brick of body n; how many are beyond the rule."""
    beyond, brick, row = 0, bodies.bricks[slot], rows[0, n]
    for k in range(span[0], span[1] + 1):
        pz = world[0, 2] + k * world[1, 2]
        x, y, z = own(row, px - row[T], py - row[T + 1], pz - row[T + 2])
        i, j, l = np.int64(np.floor(x)), np.int64(np.floor(y)), np.int64(np.floor(z))  # noqa: E741
        if (
            i >> 3 != brick[0]
            or j >> 3 != brick[1]
            or l >> 3 != brick[2]
            or not is_held(bodies.held, slot, i, j, l)
        ):
            continue
        known = bodies.bounds[slot, (i & 7) * 64 + (j & 7) * 8 + (l & 7)] <= min(found.worst[n], 1.0)
        others = _meets(bodies, rows[0], px, py, pz, found) if found.near[0] else 0
        if (known and others == 0) or (
            others and found.here[1, 0] < n
        ):  # compared where that body was walked
            continue
        found.here[0, 0], found.here[0, 1], found.voxel[3] = n, slot, k
        beyond += _compare_voxel(bodies, rows, rule, 1 + others, px, py, pz, found)
    return beyond


@lean(forceinline=True)
def _compare_brick(bodies, rows, rule, n, slot, world, found):
    """Compare at the voxels within one brick of body n; how many are beyond the rule."""
    brick, box = bodies.bricks[slot], found.box
    first = 8.0 * brick[0], 8.0 * brick[1], 8.0 * brick[2]
    if not _span(rows[0, n], first, (8.0, 8.0, 8.0), world, box):
        return 0
    found.near[0] = 0
    for m in range(bodies.boxes.shape[0]):
        if m != n and _overlap(found.spans[m], box):
            found.near[0] += 1
            found.near[found.near[0]] = m
    if found.near[0] == 0 and bodies.tops[slot] <= min(found.worst[n], 1.0):
        return 0
    beyond = 0
    for i in range(box[0, 0], box[1, 0] + 1):
        px = world[0, 0] + i * world[1, 0]
        for j in range(box[0, 1], box[1, 1] + 1):
            py = world[0, 1] + j * world[1, 1]
            found.voxel[1], found.voxel[2] = i, j
            span = _row_within(rows[0, n], brick, px, py, world, box[0, 2], box[1, 2])
            if span[0] <= span[1]:
                beyond += _compare_row(bodies, rows, rule, n, slot, world, span, px, py, found)
    return beyond


@lean(forceinline=True)
def _alone(n, stays, found):
    """True where no body that moves reaches where body n does, nor did so in the frame before."""
    here = found.spans[n]
    for m in range(stays.shape[0]):
        if not stays[m] and (_overlap(found.spans[m], here) or _overlap(found.before[m], here)):
            return False
    return True


@kernel
def compare_frames(begin, end, bodies, moves, stays, world, rule):
    """The largest |error| / mask of frames begin to end - 1 at the voxels that each body has a part in.

    `moves` are poses and motions (`promise.Moves`), `stays` bool [frames, bodies] where a body is as it was
    in the frame before, and `world` float64 [3, 3] origin, spacing and shape of the lattice. Returns that
    ratio, float64 [bodies]; frame and voxel of it, int64 [bodies, 4], the first in the order of frames, -1
    for none; and at how many voxels, of all frames, the error is beyond the mask.
    """
    count = bodies.boxes.shape[0]
    rows = np.empty((2, count, _COLUMNS))
    found = _Found(
        np.zeros(count), np.full((count, 4), -1), np.zeros((2, 3)), np.zeros(count + 1, np.int64),
        np.zeros((count, 2), np.int64), np.zeros(4, np.int64), np.zeros((2, 3), np.int64),
        np.zeros((count, 2, 3), np.int64), np.zeros((count, 2, 3), np.int64),
    )  # fmt: skip
    beyond, here = 0, np.zeros(count, np.int64)
    for f in range(begin, end):
        found.voxel[0] = f
        place(moves.poses[f], bodies.lattices, moves.source[f], rows[0])
        place(moves.poses[f], bodies.lattices, moves.decoded[f], rows[1])
        for n in range(count):
            for end in range(
                2
            ):  # by numbers: a copy of arrays compiles an error message, a second of a first run
                for axis in range(3):
                    found.before[n, end, axis] = found.spans[n, end, axis]
            size = 8.0 * bodies.boxes[n, 0], 8.0 * bodies.boxes[n, 1], 8.0 * bodies.boxes[n, 2]
            _span(rows[0, n], (0.0, 0.0, 0.0), size, world, found.spans[n])
        for n in range(count):
            if f == begin or not (
                stays[f, n] and _alone(n, stays[f], found)
            ):  # else nothing has changed about it
                here[n] = 0
                for slot in range(bodies.starts[n], bodies.starts[n + 1]):
                    here[n] += _compare_brick(bodies, rows, rule, n, slot, world, found)
            beyond += here[n]
    return found.worst, found.places, beyond
