"""Compiled loops over forces: clip and floor, pooling along the depth for arrays, friction, and texture.

Of a stored field a column of the image asks at points that differ along z only: its forces are made between the four
columns of samples around it once for each stored depth, and the points in between are linear along z. `friction`
takes and gives plain numbers, so that the loop of a renderer can call it a thousand times a second. All sums are in
float64. Of a texture each impulse is a hash of where it lies, and each brick is made alone, so that the result
depends neither on the number of threads nor on which bricks there are. Imported only when first needed.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from touchfield.lean import entry
from touchfield.medium.budget import zero_forces
from touchfield.parallel import for_chunks

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.medium import ForceField, Grid

    Float64s = NDArray[np.float64]
    Float32s = NDArray[np.float32]
    Triple = tuple[int, int, int]

_INSIDE = 1 - 2.0**-22  # so that rounding to float32 never lifts a clipped force above the limit


@entry
def _limited(begin, end, forces, force_max, floor, out, held):
    ceiling, bottom = force_max * force_max, floor * floor
    for n in range(begin, end):
        some = False
        for s in range(512):
            x, y, z = np.float64(forces[n, s, 0]), np.float64(forces[n, s, 1]), np.float64(forces[n, s, 2])
            square = x * x + y * y + z * z
            if square > ceiling:
                factor = force_max * _INSIDE / np.sqrt(square)
                x, y, z = x * factor, y * factor, z * factor
            elif square < bottom:
                x, y, z = np.float64(0), np.float64(0), np.float64(0)
            out[n, s, 0], out[n, s, 1], out[n, s, 2] = x, y, z
            if x != 0 or y != 0 or z != 0:
                some = True
        held[n] = some


def limited(
    forces_n: NDArray[np.float32], force_max_n: float, floor_n: float
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Forces [n, 8, 8, 8, 3] clipped to a length and dropped below another, and which bricks hold any."""
    out = np.empty_like(forces_n)
    held = np.zeros(len(forces_n), np.bool_)
    flat = (len(forces_n), 512, 3)
    for_chunks(
        _limited, len(forces_n), forces_n.reshape(flat), force_max_n, floor_n, out.reshape(flat), held, chunk=64
    )
    return out, held


@entry
def add_depths(bricks, forces, greatest, total, count):
    """Take bricks into three images [x, y]: the greatest |F| of each column, the sum, and how many forces."""
    for n in range(bricks.shape[0]):
        for i in range(8):
            for j in range(8):
                for k in range(8):
                    x, y, z = forces[n, i, j, k, 0], forces[n, i, j, k, 1], forces[n, i, j, k, 2]
                    if x != 0 or y != 0 or z != 0:
                        length = np.sqrt(np.float64(x) * x + np.float64(y) * y + np.float64(z) * z)
                        a, b = bricks[n, 0] * 8 + i, bricks[n, 1] * 8 + j
                        greatest[a, b] = max(greatest[a, b], length)
                        total[a, b] += length
                        count[a, b] += 1


_COLUMNS_AT_ONCE = 256


@njit(cache=True, nogil=True, error_model="numpy")
def _pool(begin, end, places, counts, slots, forces, out):
    nx, ny, nz = counts[0], counts[1], counts[2]
    x_at, y_at, z_at = places
    rows = len(y_at)
    column = np.zeros((nz + 2, 3), np.float64)  # with a depth of nothing at both ends
    some = np.zeros(nz + 2, np.bool_)
    low, share = np.empty(len(z_at), np.int64), np.empty(len(z_at), np.float64)
    for m in range(len(z_at)):
        low[m] = min(max(int(np.floor(z_at[m])), -2), nz)
        share[m] = z_at[m] - low[m]
    for n in range(begin, end):
        x, y = x_at[n // rows], y_at[n % rows]
        i0, j0 = int(np.floor(x)), int(np.floor(y))
        column[:] = 0.0
        some[:] = False
        any_held = False
        for a in range(2):
            i, wx = i0 + a, (x - i0 if a else 1.0 - (x - i0))
            if i < 0 or i >= nx or wx == 0.0:
                continue
            for b in range(2):
                j, wy = j0 + b, (y - j0 if b else 1.0 - (y - j0))
                if j < 0 or j >= ny or wy == 0.0:
                    continue
                w = wx * wy
                for c in range(slots.shape[2]):
                    slot = slots[i >> 3, j >> 3, c]
                    if slot < 0:
                        continue
                    for k in range(min(8, nz - 8 * c)):
                        fx = forces[slot, i & 7, j & 7, k, 0]
                        fy = forces[slot, i & 7, j & 7, k, 1]
                        fz = forces[slot, i & 7, j & 7, k, 2]
                        if fx != 0 or fy != 0 or fz != 0:
                            at = 8 * c + k + 1
                            some[at] = any_held = True
                            column[at, 0] += w * fx
                            column[at, 1] += w * fy
                            column[at, 2] += w * fz
        if not any_held:
            continue
        greatest, total, count = 0.0, 0.0, 0
        for m in range(len(z_at)):
            at, after = low[m] + 1, share[m]
            if at < 0 or at > nz or not (some[at] or some[at + 1]):
                continue
            before = 1.0 - after
            px = np.float32(before * column[at, 0] + after * column[at + 1, 0])
            py = np.float32(before * column[at, 1] + after * column[at + 1, 1])
            pz = np.float32(before * column[at, 2] + after * column[at + 1, 2])
            square = np.float64(px) * px + np.float64(py) * py + np.float64(pz) * pz
            if square > 0.0:
                greatest = max(greatest, square)
                total += np.sqrt(square)
                count += 1
        out[n, 0] = np.sqrt(greatest)
        out[n, 1] = total / max(count, 1)


def pooled(stored: ForceField, asked: Grid) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The greatest |F| along z of the points of a grid, and the mean of those that are there, newtons, float64 [x, y]."""
    grid = stored.grid
    x, y, z = ((asked.axis_m(axis) - grid.origin_m[axis]) / grid.spacing_m[axis] for axis in range(3))
    slots = np.full(grid.brick_shape, -1, np.int64)
    slots[tuple(stored.bricks.T)] = np.arange(len(stored.bricks))
    out = np.zeros((len(x) * len(y), 2))
    given = ((x, y, z), np.array(grid.shape, np.int64), slots, stored.forces_n, out)
    for_chunks(_pool, len(out), *given, chunk=_COLUMNS_AT_ONCE)
    greatest, mean = out.reshape(len(x), len(y), 2).transpose(2, 0, 1)
    return greatest, mean


_IN_CONE = 1 - 2.0**-49  # so that rounding never lifts the friction out of its cone
_LEAST_N = 1e-290
"""Friction below this is none: near the least number of float64 its direction would be lost to rounding."""

_LEAST_SLIP = 2.0**-47
"""Of the greatest component of v: 32 units of rounding."""


@njit(cache=True, nogil=True)
def friction(fx, fy, fz, vx, vy, vz, mu, slip_speed):
    """F_t = -mu |F| v_t / max(|v_t|, v_s), three numbers, newtons.

    Force and velocity are first scaled by powers of two, which is exact, so that no square is lost at either end of
    float64. A slip so small beside v that its direction is rounding alone could drive the hand, and is taken as none.
    So F_t . v <= 0 holds of the numbers themselves, summed without rounding.
    """
    top, fast = max(abs(fx), abs(fy), abs(fz)), max(abs(vx), abs(vy), abs(vz))
    if top == 0 or fast == 0 or mu == 0:
        return 0.0, 0.0, 0.0
    lift, haste = math.frexp(top)[1], math.frexp(fast)[1]
    nx, ny, nz = math.ldexp(fx, -lift), math.ldexp(fy, -lift), math.ldexp(fz, -lift)
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    nx, ny, nz = nx / length, ny / length, nz / length
    ux, uy, uz = math.ldexp(vx, -haste), math.ldexp(vy, -haste), math.ldexp(vz, -haste)
    tx, ty, tz = ux, uy, uz
    for _ in range(2):  # the second time takes off what rounding left along n
        along = tx * nx + ty * ny + tz * nz
        tx, ty, tz = tx - along * nx, ty - along * ny, tz - along * nz
    slip = math.sqrt(tx * tx + ty * ty + tz * tz)
    if slip <= _LEAST_SLIP:
        return 0.0, 0.0, 0.0
    share, order = math.frexp(mu)
    size = math.ldexp(share * length * _IN_CONE, lift + order)
    whole = math.ldexp(slip_speed, -haste)  # infinite where v is all but nothing
    if whole > slip:
        size *= slip / whole  # one number, so that what it loses near the least of float64 turns no direction
    if size < _LEAST_N:
        return 0.0, 0.0, 0.0
    return -tx / slip * size, -ty / slip * size, -tz / slip * size


@njit(cache=True, nogil=True)
def frictions(forces, velocities, mu, slip_speed, out):
    """`friction` of many contacts, float64 [m, 3] of float64 [m, 3] twice."""
    for i in range(forces.shape[0]):
        out[i, 0], out[i, 1], out[i, 2] = friction(
            forces[i, 0], forces[i, 1], forces[i, 2],
            velocities[i, 0], velocities[i, 1], velocities[i, 2], mu, slip_speed,
        )  # fmt: skip


_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_FIRST, _SECOND = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)


@njit(cache=True, nogil=True)
def mixed(z):
    """The output function of splitmix64 (Steele, Lea and Flood 2014), uint64 to uint64, one to one."""
    z = (z ^ (z >> np.uint64(30))) * _FIRST
    z = (z ^ (z >> np.uint64(27))) * _SECOND
    return z ^ (z >> np.uint64(31))


@njit(cache=True, nogil=True)
def _impulse(x, y, z, key, density):
    """-1, 0 or 1 at a grain, whose coordinates are -1 to 2^20: the splitmix64 stream of `key`, jumped into."""
    place = np.uint64(x + 1) | (np.uint64(y + 1) << np.uint64(21)) | (np.uint64(z + 1) << np.uint64(42))
    bits = mixed(key + (place + np.uint64(1)) * _GOLDEN)
    if np.float64(bits >> np.uint64(11)) * 2.0**-53 >= density:
        return 0
    return 1 if bits & np.uint64(1) else -1


@njit(cache=True, nogil=True)
def _drawn(first, grains, half, key, density, impulses):
    """The impulses of the grains of a brick and of `half` grains around them."""
    for p in range(grains[0, 7] + 2 * half[0] + 1):
        for q in range(grains[1, 7] + 2 * half[1] + 1):
            for r in range(grains[2, 7] + 2 * half[2] + 1):
                x, y, z = first[0] + p - half[0], first[1] + q - half[1], first[2] + r - half[2]
                impulses[p, q, r] = _impulse(x, y, z, key, density)


@njit(cache=True, nogil=True)
def _shortened(x, y, z, ceiling, target):
    square = x * x + y * y + z * z
    if square > ceiling * ceiling:
        factor = ceiling * _INSIDE / np.sqrt(square)
        x, y, z = x * factor, y * factor, z * factor
    target[0], target[1], target[2] = x, y, z
    return target[0] != 0 or target[1] != 0 or target[2] != 0


@njit(cache=True, nogil=True)
def _textured(begin, end, bricks, forces, grain, half, key, density, gain, limit, ceiling, out, held):
    impulses = np.zeros((10, 10, 10), np.int64)
    first, grains = np.zeros(3, np.int64), np.zeros((3, 8), np.int64)  # the grain of each sample, from `first`
    taps = (2 * half[0] + 1) * (2 * half[1] + 1) * (2 * half[2] + 1)
    for n in range(begin, end):
        for a in range(3):
            first[a] = bricks[n, a] * 8 // grain[a]
            for i in range(8):
                grains[a, i] = (bricks[n, a] * 8 + i) // grain[a] - first[a]
        _drawn(first, grains, half, key, density, impulses)
        some = False
        for i in range(8):
            p = grains[0, i]
            for j in range(8):
                q = grains[1, j]
                for k in range(8):
                    x = np.float64(forces[n, i, j, k, 0])
                    y = np.float64(forces[n, i, j, k, 1])
                    z = np.float64(forces[n, i, j, k, 2])
                    if x == 0 and y == 0 and z == 0:
                        continue
                    r = grains[2, k]
                    total = 0
                    for a in range(p, p + 2 * half[0] + 1):
                        for b in range(q, q + 2 * half[1] + 1):
                            for c in range(r, r + 2 * half[2] + 1):
                                total += impulses[a, b, c]
                    share = gain * (impulses[p + half[0], q + half[1], r + half[2]] * taps - total)
                    factor = 1 + min(max(share, -limit), limit)
                    some |= _shortened(x * factor, y * factor, z * factor, ceiling, out[n, i, j, k])
        held[n] = some


def textured(
    bricks: NDArray[np.int32],
    forces_n: Float32s,
    grain: Triple,
    half: Triple,
    law: tuple[int, float, float, float, float],
) -> tuple[Float32s, NDArray[np.bool_]]:
    """Forces [n, 8, 8, 8, 3] times 1 + share, and which bricks hold any.

    `grain` is samples to a grain and `half` grains on each side of the high-pass (0 or 1), for each axis; `law` is
    the seed, the density, the gain of one impulse, the limit of the share, and the greatest |F|.
    """
    out = zero_forces(len(bricks))
    held = np.zeros(len(bricks), np.bool_)
    seed, density, gain, limit, ceiling = law
    with np.errstate(over="ignore"):  # the sum is meant to wrap round
        key = np.uint64(mixed(np.uint64(seed) + _GOLDEN))
    for_chunks(
        _textured, len(bricks), bricks, forces_n, grain, half, key, density, gain, limit, ceiling, out, held, chunk=16
    )
    return out, held


@njit(cache=True, nogil=True)
def _gathered(slots, forces, half, halo):
    """A brick with `half` samples around it, zero where `slots` has no brick."""
    for i in range(8 + 2 * half[0]):
        x = i - half[0] + 8
        for j in range(8 + 2 * half[1]):
            y = j - half[1] + 8
            for k in range(8 + 2 * half[2]):
                z = k - half[2] + 8
                slot = slots[(x >> 3) * 9 + (y >> 3) * 3 + (z >> 3)]
                for c in range(3):
                    halo[i, j, k * 3 + c] = forces[slot, x & 7, y & 7, z & 7, c] if slot >= 0 else 0.0


@njit(cache=True, nogil=True)
def _high_passed(begin, end, slots, forces, half, ceiling, out):
    rx, ry, rz = half
    taps = (2 * rx + 1) * (2 * ry + 1) * (2 * rz + 1)
    run = (8 + 2 * rz) * 3
    halo, along_x = np.zeros((8 + 2 * rx, 8 + 2 * ry, run)), np.zeros((8 + 2 * ry, run))
    along_xy, high = np.zeros(run), np.zeros(3)
    for n in range(begin, end):
        _gathered(slots[n], forces, half, halo)
        for i in range(8):
            for j in range(8 + 2 * ry):
                for r in range(run):
                    along_x[j, r] = halo[i, j, r]
                    for t in range(i + 1, i + 2 * rx + 1):
                        along_x[j, r] += halo[t, j, r]
            for j in range(8):
                for r in range(run):
                    along_xy[r] = along_x[j, r]
                    for t in range(j + 1, j + 2 * ry + 1):
                        along_xy[r] += along_x[t, r]
                for k in range(8):
                    for c in range(3):
                        total = 0.0
                        for t in range(k, k + 2 * rz + 1):
                            total += along_xy[t * 3 + c]
                        # a constant is exact here: whole multiples of float32 below 2^13 in float64
                        high[c] = (taps * halo[i + rx, j + ry, (k + rz) * 3 + c] - total) / taps
                    _shortened(high[0], high[1], high[2], ceiling, out[n, i, j, k])


def high_passed(slots: NDArray[np.int32], forces_n: Float32s, half: Triple, ceiling_n: float) -> Float32s:
    """The impulse minus the box of 2 half + 1 samples, over each component, float32 [n, 8, 8, 8, 3].

    `slots` int32 [n, 27] says where in `forces_n` the bricks around each output brick are, -1 for none, in the
    order of `touchfield.medium.field.neighbour_slots`; `half` is 0 to 8 for each axis.
    """
    out = zero_forces(len(slots))
    for_chunks(_high_passed, len(slots), slots, forces_n, half, ceiling_n, out, chunk=16)
    return out
