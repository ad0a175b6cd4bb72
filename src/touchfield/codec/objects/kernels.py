"""Compiled inner loops of `error_bound`: they compare the decoded forces of moving bodies with the source,
voxel by voxel, and return the largest error.

All voxels that the bodies reach are compared. Both fields of a body are stored as cells in the same order
(`touchfield.medium.cells`), and each cell has an upper bound of its error ratio. A voxel that only one body
reaches is evaluated only if that bound exceeds the largest ratio found so far; a voxel that several bodies
reach is always evaluated. Everything is inlined into one function, because passing tuples of arrays took a
quarter of the time.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Float32s, Float64s, Int32s, Int64s
from touchfield.compute.jit import inner, kernel
from touchfield.medium.kernels.placed import (
    CELLS,
    C,
    H,
    R,
    T,
    body_coordinates,
    clipped,
    fill_placements,
    force_of,
    in_scene,
    is_supported,
    slot_at,
)

_COLUMNS = 33
_SLACK = 1 + 1e-6
_ROUNDING = 2.0**-22  # relative error of a force: two roundings to float32, and those of the sums
_NOWHERE = 1 << 40


class Bodies(NamedTuple):
    """Both fields of all bodies (`CellPool`), error bounds of their cells, and marks.

    `bounds`: float32 [n, 512], and `tops` [n] their maximum in each brick. `marks`: uint8 [n, 512], set to 1
    for each cell that contributes to a voxel outside the bound; [0, 512] to mark nothing.
    """

    lattices: Float64s
    boxes: Int64s
    starts: Int64s
    bricks: Int32s
    tables: Int64s
    supported: NDArray[np.uint64]
    source: Float32s
    decoded: Float32s
    bounds: Float32s
    tops: Float32s
    marks: NDArray[np.uint8]


class Rule(NamedTuple):
    """The bound |error| <= max(f0_n, k |F|); f0_n may be 0.

    Body forces of at most `floor_n` are treated as zero; a sum of forces is clipped to the length `limit_n`.
    """

    k: float
    f0_n: float
    floor_n: float
    limit_n: float


class _Search(NamedTuple):
    """Largest ratio of each body so far, and workspace.

    `candidates` holds a count followed by that many bodies. Each row of `parts` is a body and a slot. Boxes
    of samples are [2, 3]: first and last sample along each axis.
    """

    ratios: Float64s
    voxels: Int64s
    sums: Float64s
    candidates: Int64s
    parts: Int64s
    voxel: Int64s
    box: Int64s
    spans: Int64s
    previous_spans: Int64s


@kernel
def bound_cells(start, stop, source, decoded, rule, bounds):
    """Fill `bounds` [n, 512] with upper bounds of |error| / mask within each cell.

    The error within a trilinear cell is at most the largest at its corners; the force along the mean
    direction of the corners is at least the smallest of theirs. The bound is infinite if f0_n is 0, the cell
    is not exact and the force may vanish within it. The bound allows for `floor_n`, which may remove a force
    from one of the two fields only, and for the rounding of both to float32.
    """
    corners, mean = np.empty((8, 3)), np.empty(3)
    for s in range(start, stop):
        for cell in range(512):
            error2 = 0.0
            mean[:] = 0.0
            for e in range(8):
                o = s * CELLS + ((cell >> 6) + (e >> 2)) * 243
                o += (((cell >> 3) & 7) + ((e >> 1) & 1)) * 27 + ((cell & 7) + (e & 1)) * 3
                corner2 = 0.0
                for a in range(3):
                    corners[e, a] = source[o + a]
                    mean[a] += corners[e, a]
                    corner2 += (decoded[o + a] - corners[e, a]) ** 2
                error2 = max(error2, corner2)
            if error2 == 0.0:
                continue
            length, min_along, max_length2 = (
                np.sqrt(mean[0] ** 2 + mean[1] ** 2 + mean[2] ** 2),
                rule.limit_n,
                0.0,
            )
            for e in range(8):
                along = corners[e, 0] * mean[0] + corners[e, 1] * mean[1] + corners[e, 2] * mean[2]
                min_along = min(min_along, along / max(length, 1e-300))
                max_length2 = max(max_length2, corners[e, 0] ** 2 + corners[e, 1] ** 2 + corners[e, 2] ** 2)
            error, allowed = np.sqrt(error2), max(rule.f0_n, rule.k * min_along)
            if min_along - error <= 2.0 * rule.floor_n:
                error += 2.0 * rule.floor_n
            error += _ROUNDING * min(np.sqrt(max_length2), rule.limit_n)
            bounds[s, cell] = _SLACK * error / allowed if allowed > 0.0 else np.inf


@inner(error_model="numpy", forceinline=True)
def _add(cells, slot, row, offset, floor2, total):
    """Add to `total` the force of a body at a point x - t, in scene coordinates."""
    x, y, z = body_coordinates(row, offset[0], offset[1], offset[2])
    x, y, z = force_of(cells, slot, x, y, z)
    if x * x + y * y + z * z > floor2:
        x, y, z = in_scene(row, x, y, z, offset[0], offset[1], offset[2])
        total[0] += x
        total[1] += y
        total[2] += z


@inner(error_model="numpy", forceinline=True)
def _span(row, first, size, world, box):
    """Set `box` to the first and last workspace sample around a box of a body.

    Returns False if there is none.
    """
    for a in range(3):
        centre, reach = row[T + a] - world[0, a], 0.0
        for b in range(3):
            centre += row[R + 3 * a + b] * row[H + b] * (first[b] + size[b] / 2 + row[C + b])
            reach += abs(row[R + 3 * a + b]) * row[H + b] * size[b] / 2
        spacing = world[1, a]
        low = np.ceil(max((centre - reach) / spacing - 1e-6, 0.0))
        high = min((centre + reach) / spacing + 1e-6, world[2, a] - 1.0)
        if not low <= high:
            box[0, a] = _NOWHERE
            return False
        box[0, a], box[1, a] = np.int64(low), np.int64(high)
    return True


@inner(error_model="numpy", forceinline=True)
def _overlap(box, other):
    """True if two boxes of samples overlap."""
    overlaps = True
    for a in range(3):
        overlaps = overlaps and box[0, a] <= other[1, a] and other[0, a] <= box[1, a]
    return overlaps


@inner(error_model="numpy", forceinline=True)
def _row_within(row, brick, px, py, world, low, high):
    """First and last sample of a row along z within a brick of a body, up to rounding."""
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
        entry, leave = -q / step, (8.0 - q) / step
        first, last = max(first, min(entry, leave) - 1e-6), min(last, max(entry, leave) + 1e-6)
    return (np.int64(np.ceil(first)), np.int64(np.floor(last))) if first <= last else (0, -1)


@inner(error_model="numpy", forceinline=True)
def _find_parts(bodies, row_of, px, py, pz, search):
    """Number of candidates that contribute to a voxel.

    Their bodies and slots are written to ``search.parts[1:]``.
    """
    count = 0
    for m in range(search.candidates[0]):
        body = search.candidates[1 + m]
        row = row_of[body]
        x, y, z = body_coordinates(row, px - row[T], py - row[T + 1], pz - row[T + 2])
        slot = slot_at(bodies.boxes, body, bodies.tables, bodies.supported, x, y, z)
        if slot >= 0:
            count += 1
            search.parts[count, 0], search.parts[count, 1] = body, slot
    return count


@inner(error_model="numpy", forceinline=True)
def _mark(bodies, row_of, count, px, py, pz, search):
    """Mark the cells of the bodies ``search.parts[:count]`` that contain a voxel."""
    for m in range(count):
        body, slot = search.parts[m]
        row = row_of[body]
        x, y, z = body_coordinates(row, px - row[T], py - row[T + 1], pz - row[T + 2])
        i, j, l = np.int64(np.floor(x)), np.int64(np.floor(y)), np.int64(np.floor(z))  # noqa: E741
        bodies.marks[slot, (i & 7) * 64 + (j & 7) * 8 + (l & 7)] = 1


@inner(error_model="numpy", forceinline=True)
def _compare_voxel(bodies, rows, rule, count, px, py, pz, search):
    """Compare source and decoded force at one voxel; True if it is outside the bound.

    The voxel is reached by the bodies and slots ``search.parts[:count]``.
    """
    sums, floor2 = search.sums, rule.floor_n * rule.floor_n
    sums[:] = 0.0
    for m in range(count):
        body, slot = search.parts[m]
        row = rows[0, body]
        offset = px - row[T], py - row[T + 1], pz - row[T + 2]
        _add(bodies.source, slot, row, offset, floor2, sums[0])
        _add(bodies.decoded, slot, rows[1, body], offset, floor2, sums[1])
    # the forces of the source and the decoded ones, each limited and rounded as in a receiver
    x, y, z = clipped(sums[0, 0], sums[0, 1], sums[0, 2], rule.limit_n)
    u, v, w = clipped(sums[1, 0], sums[1, 1], sums[1, 2], rule.limit_n)
    x, y, z = np.float64(np.float32(x)), np.float64(np.float32(y)), np.float64(np.float32(z))
    u, v, w = np.float64(np.float32(u)), np.float64(np.float32(v)), np.float64(np.float32(w))
    error = np.sqrt((u - x) ** 2 + (v - y) ** 2 + (w - z) ** 2)
    allowed = max(rule.f0_n, rule.k * np.sqrt(x * x + y * y + z * z))
    ratio = error / allowed if allowed > 0.0 else (np.inf if error > 0.0 else 0.0)
    if ratio > 1.0 and bodies.marks.shape[0]:
        _mark(bodies, rows[0], count, px, py, pz, search)
    for m in range(count):
        body = search.parts[m, 0]
        if ratio > search.ratios[body]:
            search.ratios[body] = ratio
            for a in range(4):
                search.voxels[body, a] = search.voxel[a]
    return ratio > 1.0


@inner(error_model="numpy", forceinline=True)
def _compare_row(bodies, rows, rule, n, slot, world, span, px, py, search):
    """Compare the voxels of a row within one brick of body n.

    Returns the number of voxels outside the bound.
    """
    violations, brick, row = 0, bodies.bricks[slot], rows[0, n]
    for k in range(span[0], span[1] + 1):
        pz = world[0, 2] + k * world[1, 2]
        x, y, z = body_coordinates(row, px - row[T], py - row[T + 1], pz - row[T + 2])
        i, j, l = np.int64(np.floor(x)), np.int64(np.floor(y)), np.int64(np.floor(z))  # noqa: E741
        if (
            i >> 3 != brick[0]
            or j >> 3 != brick[1]
            or l >> 3 != brick[2]
            or not is_supported(bodies.supported, slot, i, j, l)
        ):
            continue
        is_bounded = bodies.bounds[slot, (i & 7) * 64 + (j & 7) * 8 + (l & 7)] <= min(search.ratios[n], 1.0)
        others = _find_parts(bodies, rows[0], px, py, pz, search) if search.candidates[0] else 0
        # in the second case the voxel was compared together with the bricks of the first of these bodies
        if (is_bounded and others == 0) or (others and search.parts[1, 0] < n):
            continue
        search.parts[0, 0], search.parts[0, 1], search.voxel[3] = n, slot, k
        violations += _compare_voxel(bodies, rows, rule, 1 + others, px, py, pz, search)
    return violations


@inner(error_model="numpy", forceinline=True)
def _compare_brick(bodies, rows, rule, n, slot, world, search):
    """Compare the voxels of one brick of body n; return how many violate the bound."""
    brick, box = bodies.bricks[slot], search.box
    first = 8.0 * brick[0], 8.0 * brick[1], 8.0 * brick[2]
    if not _span(rows[0, n], first, (8.0, 8.0, 8.0), world, box):
        return 0
    search.candidates[0] = 0
    for m in range(bodies.boxes.shape[0]):
        if m != n and _overlap(search.spans[m], box):
            search.candidates[0] += 1
            search.candidates[search.candidates[0]] = m
    if search.candidates[0] == 0 and bodies.tops[slot] <= min(search.ratios[n], 1.0):
        return 0
    violations = 0
    for i in range(box[0, 0], box[1, 0] + 1):
        px = world[0, 0] + i * world[1, 0]
        for j in range(box[0, 1], box[1, 1] + 1):
            py = world[0, 1] + j * world[1, 1]
            search.voxel[1], search.voxel[2] = i, j
            span = _row_within(rows[0, n], brick, px, py, world, box[0, 2], box[1, 2])
            if span[0] <= span[1]:
                violations += _compare_row(bodies, rows, rule, n, slot, world, span, px, py, search)
    return violations


@inner(error_model="numpy", forceinline=True)
def _alone(n, stays, search):
    """True if no moving body overlaps body n, in this frame or the one before."""
    span = search.spans[n]
    for m in range(stays.shape[0]):
        if not stays[m] and (_overlap(search.spans[m], span) or _overlap(search.previous_spans[m], span)):
            return False
    return True


@kernel
def compare_frames(start, stop, bodies, moves, stays, world, rule):
    """Largest |error| / mask in frames start to stop - 1 over the voxels of each body.

    `moves` are poses and motions (`error_bound.Moves`). `stays`, bool [frames, bodies], is True where a body
    has not moved since the frame before. `world`, float64 [3, 3], holds origin, spacing and shape of the
    lattice.

    Returns the largest ratio of each body, float64 [bodies]; the frame and voxel where it occurs first in the
    order of frames, int64 [bodies, 4], or -1 if there is none; and the number of voxels in all frames whose
    error exceeds the mask.
    """
    count = bodies.boxes.shape[0]
    rows = np.empty((2, count, _COLUMNS))
    search = _Search(
        np.zeros(count), np.full((count, 4), -1), np.zeros((2, 3)), np.zeros(count + 1, np.int64),
        np.zeros((count, 2), np.int64), np.zeros(4, np.int64), np.zeros((2, 3), np.int64),
        np.zeros((count, 2, 3), np.int64), np.zeros((count, 2, 3), np.int64),
    )  # fmt: skip
    violations, per_body = 0, np.zeros(count, np.int64)
    for f in range(start, stop):
        search.voxel[0] = f
        fill_placements(moves.poses[f], bodies.lattices, moves.source[f], rows[0])
        fill_placements(moves.poses[f], bodies.lattices, moves.decoded[f], rows[1])
        for n in range(count):
            # element by element: an array copy compiles an error message, which takes a second of a first run
            for side in range(2):
                for axis in range(3):
                    search.previous_spans[n, side, axis] = search.spans[n, side, axis]
            size = 8.0 * bodies.boxes[n, 0], 8.0 * bodies.boxes[n, 1], 8.0 * bodies.boxes[n, 2]
            _span(rows[0, n], (0.0, 0.0, 0.0), size, world, search.spans[n])
        for n in range(count):
            # otherwise nothing around the body has changed, and the last count still holds
            if f == start or not (stays[f, n] and _alone(n, stays[f], search)):
                per_body[n] = 0
                for slot in range(bodies.starts[n], bodies.starts[n + 1]):
                    per_body[n] += _compare_brick(bodies, rows, rule, n, slot, world, search)
            violations += per_body[n]
    return search.ratios, search.voxels, violations
