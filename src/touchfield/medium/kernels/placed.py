"""Compiled inner loops of moving bodies: interpolate the force at a point from the fields of all bodies, each
rotated and shifted to its pose.

The fields are stored as *cells*: each brick of 8^3 samples is stored with the first samples of the next
bricks, 9^3 samples in all, so that the eight samples around any point are in one brick of cells. Bricks of
cells are found through a hash table.
"""

from __future__ import annotations

import math

import numpy as np

from touchfield.compute.jit import inner, kernel

_1, _2 = np.uint64(1), np.uint64(2)
INSIDE = 1 - 2.0**-22  # rounding to float32 then never raises a clipped force above the limit

CELLS = 9 * 9 * 9 * 3  # numbers of a brick of cells
GOLDEN = np.uint64(0x9E3779B97F4A7C15)  # Fibonacci hashing (Knuth, volume 3, section 6.4)

Z, Y, X = np.uint64(3), np.uint64(27), np.uint64(243)
YZ, XZ, XY, XYZ = Y + Z, X + Z, X + Y, X + Y + Z  # unsigned, so that indices are not tested for their sign

# columns of `placed`: a point x of the scene has the coordinates A (x - t) - c in the object, in samples (h
# metres apart) from the corner of its box of bricks; R rotates its force into the scene; v + w x (x - t) is b
# times the velocity of its surface, which is added
A, C, T, R, V, W, H = 0, 9, 12, 15, 24, 27, 30

# columns of `boxes`: number of bricks along each axis, start of the object's hash table, and 64 minus the
# number of bits of its index
START, SHIFT = 3, 4


@inner(forceinline=True)
def between(cells, o, fx, fy, fz):
    """Interpolate one component trilinearly in float64; its first corner is at index `o`."""
    a, b = np.float64(cells[o]), np.float64(cells[o + Y])
    c, d = np.float64(cells[o + X]), np.float64(cells[o + XY])
    a += fz * (np.float64(cells[o + Z]) - a)
    b += fz * (np.float64(cells[o + YZ]) - b)
    c += fz * (np.float64(cells[o + XZ]) - c)
    d += fz * (np.float64(cells[o + XYZ]) - d)
    a += fy * (b - a)
    c += fy * (d - c)
    return a + fx * (c - a)


@inner(forceinline=True)
def find(tables, start, shift, key):
    """Return the slot of a brick of cells, or -1 if there is none."""
    mask = (1 << (64 - shift)) - 1
    h = np.int64((np.uint64(key) * GOLDEN) >> np.uint64(shift))
    while tables[start + h, 0] != key:
        if tables[start + h, 0] < 0:
            return -1
        h = (h + 1) & mask
    return tables[start + h, 1]


@inner(forceinline=True)
def is_supported(supported, slot, i, j, k):
    return (supported[slot, i & 7] >> np.uint64(8 * (j & 7) + (k & 7))) & _1


@kernel
def hash_table(keys, shift, table):
    """Write each key and its index in `keys` to a hash table with open addressing.

    `table` is int64 [2^(64 - shift), 2], filled with -1.
    """
    mask = table.shape[0] - 1
    for s in range(keys.shape[0]):
        h = np.int64((np.uint64(keys[s]) * GOLDEN) >> np.uint64(shift))
        while table[h, 0] >= 0:
            h = (h + 1) & mask
        table[h, 0], table[h, 1] = keys[s], s


@kernel
def cells_of(start, stop, sources, forces, cells, supported):
    """Fill `cells` [n, 9, 9, 9, 3] from the bricks of a field.

    `sources` [n, 8] are the indices of the eight source bricks of each brick of cells, -1 for a missing one.
    `supported` is uint64 [n, 8] and initially zero: bit 8 j + k of word i is set if a corner of cell (i, j,
    k) is not zero.
    """
    bit = np.uint64(1)
    for s in range(start, stop):
        for e in range(8):
            brick = sources[s, e]
            if brick < 0:
                continue
            ei, ej, ek = e >> 2, (e >> 1) & 1, e & 1
            for i in range(1 if ei else 8):
                for j in range(1 if ej else 8):
                    for k in range(1 if ek else 8):
                        force = forces[brick, i, j, k]
                        if force[0] == 0 and force[1] == 0 and force[2] == 0:
                            continue
                        x, y, z = 8 * ei + i, 8 * ej + j, 8 * ek + k
                        cells[s, x, y, z, 0], cells[s, x, y, z, 1], cells[s, x, y, z, 2] = (
                            force[0],
                            force[1],
                            force[2],
                        )
                        for a in range(max(x - 1, 0), min(x, 7) + 1):
                            for b in range(max(y - 1, 0), min(y, 7) + 1):
                                for c in range(max(z - 1, 0), min(z, 7) + 1):
                                    supported[s, a] |= bit << np.uint64(8 * b + c)


@kernel
def fill_placements(poses, lattices, motions, placed):
    """Compute the table `placed` of one frame.

    `poses` [n, 7] are quaternion (w, x, y, z) and t, `lattices` [n, 6] spacing and corner, `motions` [n, 6]
    linear and angular velocity times b.
    """
    for n in range(poses.shape[0]):
        w, x, y, z = poses[n, 0], poses[n, 1], poses[n, 2], poses[n, 3]
        row = placed[n]
        row[R + 0], row[R + 1], row[R + 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
        row[R + 3], row[R + 4], row[R + 5] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
        row[R + 6], row[R + 7], row[R + 8] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
        for i in range(3):
            for j in range(3):
                row[A + 3 * i + j] = row[R + 3 * j + i] / lattices[n, i]
            row[C + i] = lattices[n, 3 + i] / lattices[n, i]
            row[T + i], row[H + i] = poses[n, 4 + i], lattices[n, i]
            row[V + i], row[W + i] = motions[n, i], motions[n, 3 + i]


# -- the force at a point ----------------------------------------------------------------------------------


@inner(forceinline=True)
def body_coordinates(row, dx, dy, dz):
    """Return the coordinates of a point in an object, in samples from the corner of its box.

    (dx, dy, dz) is x - t in the scene.
    """
    x = row[0] * dx + row[1] * dy + row[2] * dz - row[C]
    y = row[3] * dx + row[4] * dy + row[5] * dz - row[C + 1]
    return x, y, row[6] * dx + row[7] * dy + row[8] * dz - row[C + 2]


@inner(forceinline=True)
def slot_at(boxes, n, tables, supported, x, y, z):
    """Return the brick of cells of object n with a force around a point; -1 if there is none.

    (x, y, z) are the coordinates of the point in the object.
    """
    if not (0.0 <= x < 8.0 * boxes[n, 0] and 0.0 <= y < 8.0 * boxes[n, 1] and 0.0 <= z < 8.0 * boxes[n, 2]):
        return -1
    i, j, k = np.int64(x), np.int64(y), np.int64(z)
    key = ((i >> 3) * boxes[n, 1] + (j >> 3)) * boxes[n, 2] + (k >> 3)
    slot = find(tables, boxes[n, START], boxes[n, SHIFT], key)
    return slot if slot >= 0 and is_supported(supported, slot, i, j, k) else -1


@inner(forceinline=True)
def force_of(cells, slot, x, y, z):
    """Return the force of an object, in its body frame, at a point in a brick of cells."""
    i, j, k = np.int64(x), np.int64(y), np.int64(z)
    o = np.uint64(slot * CELLS + (i & 7) * 243 + (j & 7) * 27 + (k & 7) * 3)
    gx, gy = between(cells, o, x - i, y - j, z - k), between(cells, o + _1, x - i, y - j, z - k)
    return gx, gy, between(cells, o + _2, x - i, y - j, z - k)


@inner(forceinline=True)
def in_scene(row, gx, gy, gz, dx, dy, dz):
    """Rotate the force (gx, gy, gz) of a body into the scene, and add the damping of its motion.

    (dx, dy, dz) is x - t.
    """
    x = row[R] * gx + row[R + 1] * gy + row[R + 2] * gz + row[V] + row[W + 1] * dz - row[W + 2] * dy
    y = row[R + 3] * gx + row[R + 4] * gy + row[R + 5] * gz + row[V + 1] + row[W + 2] * dx - row[W] * dz
    z = row[R + 6] * gx + row[R + 7] * gy + row[R + 8] * gz + row[V + 2] + row[W] * dy - row[W + 1] * dx
    return x, y, z


@inner(forceinline=True)
def clipped(x, y, z, limit):
    """Clip a sum of forces to the magnitude `limit`; its direction is unchanged."""
    square = x * x + y * y + z * z
    if not square < np.inf:  # a force that overflowed has no direction
        return 0.0, 0.0, 0.0
    if square > limit * limit:
        factor = limit * INSIDE / math.sqrt(square)
        return x * factor, y * factor, z * factor
    return x, y, z


@kernel(_nrt=False)
def at_points(start, stop, points, boxes, placed, tables, cells, supported, floor, limit, out):
    """Write the forces at points [m, 3], metres, to `out`.

    Forces of an object with a magnitude of at most `floor` are ignored, and the sum is clipped to `limit`.
    """
    min_square = floor * floor
    for p in range(start, stop):
        px, py, pz = points[p, 0], points[p, 1], points[p, 2]
        sx, sy, sz = 0.0, 0.0, 0.0
        for n in range(boxes.shape[0]):
            row = placed[n]
            dx, dy, dz = px - row[T], py - row[T + 1], pz - row[T + 2]
            x, y, z = body_coordinates(row, dx, dy, dz)
            slot = slot_at(boxes, n, tables, supported, x, y, z)
            if slot < 0:
                continue
            gx, gy, gz = force_of(cells, slot, x, y, z)
            if gx * gx + gy * gy + gz * gz > min_square:
                gx, gy, gz = in_scene(row, gx, gy, gz, dx, dy, dz)
                sx, sy, sz = sx + gx, sy + gy, sz + gz
        out[p, 0], out[p, 1], out[p, 2] = clipped(sx, sy, sz, limit)


# -- on a lattice ------------------------------------------------------------------------------------------


@kernel
def meetings(lattice, shape, boxes, placed, starts, bricks, stamps, max_pairs):
    """Find the bricks of a lattice that each object may reach.

    Returns the number of pairs (brick, object), and the pairs, int64 [m, 2], objects ascending. The number is
    -1 if there are more than `max_pairs`, or if more than sixteen times as many would have to be tested. A
    brick of cells and a brick of the lattice are tested for overlap along the axes of both. `bricks` [n, 3]
    are the bricks of cells; those of object n start at `starts[n]`. `stamps` holds a zero for each brick of
    the lattice and receives the number of the last object there, plus one.
    """
    by, bz = (shape[1] + 7) // 8, (shape[2] + 7) // 8
    pairs = np.empty((1024, 2), np.int64)
    count, tested = 0, 0
    low, high = np.empty(3, np.int64), np.empty(3, np.int64)
    centre, reach, body_reach = np.empty(3), np.empty(3), np.empty(3)
    for n in range(boxes.shape[0]):
        row = placed[n]
        for a in range(3):
            reach[a], body_reach[a] = 1e-6, 4.0 + 1e-6
            for b in range(3):
                reach[a] += 4.0 * abs(row[R + 3 * a + b]) * row[H + b] / lattice[3 + a]
                body_reach[a] += 3.5 * abs(row[3 * a + b]) * lattice[3 + b]
        for s in range(starts[n], starts[n + 1]):
            is_inside = True
            for a in range(3):
                centre[a] = row[T + a] - lattice[a]
                for b in range(3):
                    centre[a] += row[R + 3 * a + b] * row[H + b] * (8.0 * bricks[s, b] + 4.0 + row[C + b])
                centre[a] /= lattice[3 + a]
                first, last = max(centre[a] - reach[a], 0.0), min(centre[a] + reach[a], shape[a] - 1.0)
                if not first <= last:
                    is_inside = False
                    break
                low[a], high[a] = np.int64(np.ceil(first)) >> 3, np.int64(last) >> 3
            if not is_inside:
                continue
            tested += (high[0] - low[0] + 1) * (high[1] - low[1] + 1) * (high[2] - low[2] + 1)
            if tested > 16 * max_pairs or count > max_pairs:
                return -1, pairs
            for i in range(low[0], high[0] + 1):
                for j in range(low[1], high[1] + 1):
                    for k in range(low[2], high[2] + 1):
                        key = (i * by + j) * bz + k
                        if stamps[key] == n + 1:
                            continue
                        dx = lattice[0] + (8 * i + 3.5) * lattice[3] - row[T]
                        dy = lattice[1] + (8 * j + 3.5) * lattice[4] - row[T + 1]
                        dz = lattice[2] + (8 * k + 3.5) * lattice[5] - row[T + 2]
                        meets = True
                        for a in range(3):
                            q = row[3 * a] * dx + row[3 * a + 1] * dy + row[3 * a + 2] * dz - row[C + a]
                            meets = meets and abs(q - 8.0 * bricks[s, a] - 4.0) <= body_reach[a]
                        if not meets:
                            continue
                        stamps[key] = n + 1
                        if count == pairs.shape[0]:
                            grown = np.empty((2 * count, 2), np.int64)
                            grown[:count] = pairs
                            pairs = grown
                        pairs[count, 0], pairs[count, 1] = key, n
                        count += 1
    return (count if count <= max_pairs else -1), pairs


@inner
def _add_brick(total, first, lattice, shape, row, box, tables, cells, supported, min_square):
    """Add one object's forces at the samples of a brick; return True if there is a force.

    `first` [3] is the index of the first sample of the brick.
    """
    lx, ly, lz = 8.0 * box[0], 8.0 * box[1], 8.0 * box[2]
    ax, ay, az = row[2] * lattice[5], row[5] * lattice[5], row[8] * lattice[5]
    depth = min(8, shape[2] - first[2])
    last, slot = np.int64(-1), np.int64(-1)
    added = False
    dz = lattice[2] + first[2] * lattice[5] - row[T + 2]
    for i in range(min(8, shape[0] - first[0])):
        dx = lattice[0] + (first[0] + i) * lattice[3] - row[T]
        for j in range(min(8, shape[1] - first[1])):
            dy = lattice[1] + (first[1] + j) * lattice[4] - row[T + 1]
            x0, y0, z0 = body_coordinates(row, dx, dy, dz)
            for k in range(depth):
                x, y, z = x0 + k * ax, y0 + k * ay, z0 + k * az
                if not (0.0 <= x < lx and 0.0 <= y < ly and 0.0 <= z < lz):
                    continue
                p, q, r = np.int64(x), np.int64(y), np.int64(z)
                key = ((p >> 3) * box[1] + (q >> 3)) * box[2] + (r >> 3)
                if key != last:
                    last, slot = key, find(tables, box[START], box[SHIFT], key)
                if slot < 0 or not is_supported(supported, slot, p, q, r):
                    continue
                gx, gy, gz = force_of(cells, slot, x, y, z)
                if gx * gx + gy * gy + gz * gz > min_square:
                    gx, gy, gz = in_scene(row, gx, gy, gz, dx, dy, dz + k * lattice[5])
                    total[i, j, k, 0] += gx
                    total[i, j, k, 1] += gy
                    total[i, j, k, 2] += gz
                    added = True
    return added


@kernel
def fill(
    start,
    stop,
    bricks,
    starts,
    object_indices,
    lattice,
    shape,
    boxes,
    placed,
    tables,
    cells,
    supported,
    limits,
    forces,
    full,
):
    """Write the sum of the forces of objects to each brick, and whether it is not zero.

    Brick s, initially zero, receives the forces of the objects ``object_indices[starts[s]:starts[s + 1]]``;
    `full[s]` is set to True if one of its forces is not zero.
    """
    total = np.zeros((8, 8, 8, 3))
    first = np.empty(3, np.int64)
    floor, limit = limits
    for s in range(start, stop):
        for a in range(3):
            first[a] = 8 * bricks[s, a]
        added = False
        for m in range(starts[s], starts[s + 1]):
            n = object_indices[m]
            if _add_brick(
                total, first, lattice, shape, placed[n], boxes[n], tables, cells, supported, floor * floor
            ):
                added = True
        if not added:
            continue
        any_force = False
        for i in range(8):
            for j in range(8):
                for k in range(8):
                    x, y, z = total[i, j, k, 0], total[i, j, k, 1], total[i, j, k, 2]
                    if x != 0.0 or y != 0.0 or z != 0.0:
                        force = forces[s, i, j, k]
                        force[0], force[1], force[2] = clipped(x, y, z, limit)
                        any_force = any_force or force[0] != 0 or force[1] != 0 or force[2] != 0
        full[s] = any_force
        total[:] = 0.0
