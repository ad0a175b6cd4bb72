"""Compiled inner loops of moving bodies: the force at a point from the fields of all bodies, each rotated and
shifted to its pose, as ``c/touch_placed.h`` has it. The encoder's check of objects and the GPU use them.

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
