"""Compiled loops over forces: clip and floor, pooling along the depth for arrays, and friction.

Of a stored field a column of the image asks at points that differ along z only: its forces are made between
the four columns of samples around it once for each stored depth, and the points in between are linear along
z. `friction` takes and gives plain numbers, so that the loop of a renderer can call it a thousand times a
second. All sums are in float64. Imported only when first needed.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from touchfield.arrays import Bools, Float32s, Float64s, Int32s, Int64s
from touchfield.compute.jit import entry, inlined, kernel, lean
from touchfield.compute.threads import for_chunks
from touchfield.medium.budget import zero_forces
from touchfield.medium.kernels import first_at_least

if TYPE_CHECKING:
    from collections.abc import Sequence

    from touchfield.medium import ForceField, Grid

_INSIDE = 1 - 2.0**-22  # so that rounding to float32 never lifts a clipped force above the limit


@entry
def limited(begin, end, forces, force_max, floor, out, held):
    """Forces [n, 512, 3] clipped to a length and dropped below another, and which bricks hold any."""
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


_COLUMNS_AT_ONCE = 256


@kernel(error_model="numpy")
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
                out[n, 2], out[n, 3] = out[n, 2] if count > 1 else m + 1, m + 1
        out[n, 0] = np.sqrt(greatest)
        out[n, 1] = total / max(count, 1)


def pooled(stored: ForceField, asked: Grid) -> Float64s:
    """Of the columns of a grid the greatest |F|, the mean of those that are there, and where these begin and
    end.

    float64 [4, x, y]; the numbers of the lowest sample with a force and of the highest, from 1, or 0 without
    any.
    """
    grid = stored.grid
    x, y, z = ((asked.axis_m(axis) - grid.origin_m[axis]) / grid.spacing_m[axis] for axis in range(3))
    slots = np.full(grid.brick_shape, -1, np.int64)
    slots[tuple(stored.bricks.T)] = np.arange(len(stored.bricks))
    out = np.zeros((len(x) * len(y), 4))
    given = ((x, y, z), np.array(grid.shape, np.int64), slots, stored.forces_n, out)
    for_chunks(_pool, len(out), *given, chunk=_COLUMNS_AT_ONCE)
    return np.moveaxis(out.reshape(len(x), len(y), 4), 2, 0)


# -- to another lattice: three passes over each output brick, which is made alone, in a fixed order of
# additions ---


@inlined
def _pass_x(forces, slot, span, low, first, weights, n0, n1, tmp):
    """Add what one input brick gives to the first pass; `span` holds its sample ranges x0, x1, y0, y1, z0,
    z1.
    """
    run = (span[5] - span[4]) * 3
    at = (span[4] - low[2]) * 3
    start = (span[4] & 7) * 3
    for i in range(n0, n1):
        for t in range(max(0, span[0] - first[i]), min(weights.shape[1], span[1] - first[i])):
            w = weights[i, t]
            if w != 0:
                x = (first[i] + t) & 7
                for y in range(span[2], span[3]):
                    source = forces[slot, x, y & 7, start : start + run]
                    target = tmp[i - n0, y - low[1], at : at + run]
                    for r in range(run):
                        target[r] += w * source[r]


@inlined
def _pass_y(tmp, low, high, first, weights, n0, n1, run, out):
    for i in range(8):
        for j in range(n0, n1):
            target = out[i, j - n0]
            target[:run] = 0
            for t in range(max(0, low - first[j]), min(weights.shape[1], high - first[j])):
                w = weights[j, t]
                if w != 0:
                    source = tmp[i, first[j] + t - low]
                    for r in range(run):
                        target[r] += w * source[r]


@inlined
def _pass_z(tmp, rows, columns, low, high, first, weights, n0, n1, n, out):
    held = False
    for i in range(rows):
        for j in range(columns):
            line = tmp[i, j]
            for k in range(n0, n1):
                a = np.float32(0)
                b = np.float32(0)
                c = np.float32(0)
                for t in range(max(0, low - first[k]), min(weights.shape[1], high - first[k])):
                    w = weights[k, t]
                    force = line[first[k] + t - low]
                    a += w * force[0]
                    b += w * force[1]
                    c += w * force[2]
                target = out[n, i, j, k - n0]
                target[0], target[1], target[2] = a, b, c
                held |= a != 0 or b != 0 or c != 0
    return held


@lean
def _footprint(first, taps, brick, source_count):
    """Target samples of one output brick along one axis, and the source samples that they need."""
    n0 = brick * 8
    n1 = min(n0 + 8, first.shape[0])
    return n0, n1, max(0, first[n0]), min(source_count, first[n1 - 1] + taps)


@entry
def _resampled(begin, end, source, x, y, z, scratch, out, held):
    """Make output bricks; `scratch` holds two passes, the second flat and as vectors, and ranges of samples."""
    bricks, keys, forces, shape = source
    x_first, x_w = x
    y_first, y_w = y
    z_first, z_w = z
    tmp, tmp2, tmp2_vectors, low, span = scratch
    bricks_y, bricks_z = (shape[1] + 7) >> 3, (shape[2] + 7) >> 3
    for n in range(begin, end):
        i0, i1, low[0], high_x = _footprint(x_first, x_w.shape[1], bricks[n, 0], shape[0])
        j0, j1, low[1], high_y = _footprint(y_first, y_w.shape[1], bricks[n, 1], shape[1])
        k0, k1, low[2], high_z = _footprint(z_first, z_w.shape[1], bricks[n, 2], shape[2])
        tmp[:] = 0
        any_source = False
        for a in range(low[0] >> 3, (high_x + 7) >> 3):
            span[0], span[1] = max(low[0], a * 8), min(high_x, a * 8 + 8)
            for b in range(low[1] >> 3, (high_y + 7) >> 3):
                span[2], span[3] = max(low[1], b * 8), min(high_y, b * 8 + 8)
                row = (a * bricks_y + b) * bricks_z
                slot = first_at_least(keys, row + (low[2] >> 3))
                last = row + ((high_z - 1) >> 3)
                while slot < keys.shape[0] and keys[slot] <= last:
                    c = keys[slot] - row
                    span[4], span[5] = max(low[2], c * 8), min(high_z, c * 8 + 8)
                    _pass_x(forces, slot, span, low, x_first, x_w, i0, i1, tmp)
                    any_source = True
                    slot += 1
        if any_source:
            _pass_y(tmp, low[1], high_y, y_first, y_w, j0, j1, (high_z - low[2]) * 3, tmp2)
            held[n] = _pass_z(tmp2_vectors, i1 - i0, j1 - j0, low[2], high_z, z_first, z_w, k0, k1, n, out)


def resampled(
    bricks: Int32s,
    source_shape: tuple[int, int, int],
    keys: Int64s,
    forces_n: Float32s,
    weights: Sequence[tuple[Int64s, Float32s]],
) -> tuple[Float32s, Bools]:
    """The forces of output bricks int32 [n, 3], float32 [n, 8, 8, 8, 3], and which of them hold one, bool
    [n].

    source_shape : (int, int, int); samples of the input grid.
    keys, forces_n : int64 [m], float32 [m, 8, 8, 8, 3]; the input bricks, ascending.
    weights : `AxisWeights` of each axis.
    """
    across, deep = (_widest(*weights[axis], source_shape[axis]) for axis in (1, 2))
    x, y, z = (tuple(axis) for axis in weights)
    out = zero_forces(len(bricks))
    held = np.zeros(len(bricks), np.bool_)
    source = bricks, keys, forces_n.reshape(len(forces_n), 8, 8, 24), np.array(source_shape)

    def piece(begin: int, end: int) -> None:
        vectors = np.zeros((8, 8, deep, 3), np.float32)
        passes = np.zeros((8, across, 3 * deep), np.float32), vectors.reshape(8, 8, -1), vectors
        _resampled(
            begin, end, source, x, y, z, (*passes, np.zeros(3, np.int64), np.zeros(6, np.int64)), out, held
        )

    for_chunks(piece, len(bricks), chunk=16)
    return out, held


def _widest(first: Int64s, weights: Float32s, source_count: int) -> int:
    """The most source samples that an output brick needs along one axis."""
    last = first[np.minimum(np.arange(7, len(first) + 7, 8), len(first) - 1)]
    return min(source_count, int((last + weights.shape[1] - first[::8]).max()))


_IN_CONE = 1 - 2.0**-49  # so that rounding never lifts the friction out of its cone
_LEAST_N = 1e-290
"""Friction below this is none: near the least number of float64 its direction would be lost to rounding."""

_LEAST_SLIP = 2.0**-47  # of the greatest component of v: 32 units of rounding


@kernel
def friction(fx, fy, fz, vx, vy, vz, mu, slip_speed):
    """F_t = -mu |F| v_t / max(|v_t|, v_s), three numbers, newtons.

    Force and velocity are first scaled by powers of two, which is exact, so that no square is lost at either
    end of float64. A slip so small beside v that its direction is rounding alone could drive the hand, and is
    taken as none. So F_t . v <= 0 holds of the numbers themselves, summed without rounding.
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
