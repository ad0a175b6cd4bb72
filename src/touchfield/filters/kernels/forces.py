"""Compiled inner loops of the device filter and of friction: clip forces and drop small ones, and reduce the
forces along the depth to one value for each actuator of an array.

The points of an image column differ along z only. The pooling therefore interpolates a stored field between
the four surrounding columns once per stored depth, and linearly along z between those depths. `friction`
takes and returns plain numbers, so that a renderer's loop can call it a thousand times a second. All sums are
in float64. Imported only when first needed.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from touchfield.arrays import Bools, Float32s, Float64s, Int32s, Int64s
from touchfield.compute.coder_jit import entry, inlined, lean
from touchfield.compute.jit import kernel
from touchfield.compute.threads import for_chunks
from touchfield.medium.budget import zero_forces
from touchfield.medium.kernels import lower_bound

if TYPE_CHECKING:
    from collections.abc import Sequence

    from touchfield.medium import ForceField, Grid

_INSIDE = 1 - 2.0**-22  # so that rounding to float32 never lifts a clipped force above the limit


@entry
def limit_bricks(start, stop, forces, force_max, floor, out, has_force):
    """Clip forces [n, 512, 3] to a length, drop those below `floor`, and flag the bricks with a force."""
    ceiling, bottom = force_max * force_max, floor * floor
    for n in range(start, stop):
        is_any = False
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
                is_any = True
        has_force[n] = is_any


_COLUMNS_AT_ONCE = 256


@kernel(error_model="numpy")
def _pool(start, stop, indices, counts, slots, forces, out):
    nx, ny, nz = counts[0], counts[1], counts[2]
    x_at, y_at, z_at = indices
    rows = len(y_at)
    column = np.zeros((nz + 2, 3), np.float64)  # with a depth of nothing at both ends
    has_force = np.zeros(nz + 2, np.bool_)
    low, fraction = np.empty(len(z_at), np.int64), np.empty(len(z_at), np.float64)
    for m in range(len(z_at)):
        low[m] = min(max(int(np.floor(z_at[m])), -2), nz)
        fraction[m] = z_at[m] - low[m]
    for n in range(start, stop):
        x, y = x_at[n // rows], y_at[n % rows]
        i0, j0 = int(np.floor(x)), int(np.floor(y))
        column[:] = 0.0
        has_force[:] = False
        is_any = False
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
                            has_force[at] = is_any = True
                            column[at, 0] += w * fx
                            column[at, 1] += w * fy
                            column[at, 2] += w * fz
        if not is_any:
            continue
        greatest, total, count = 0.0, 0.0, 0
        for m in range(len(z_at)):
            at, after = low[m] + 1, fraction[m]
            if at < 0 or at > nz or not (has_force[at] or has_force[at + 1]):
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


def pool_depth(stored: ForceField, target: Grid) -> Float64s:
    """Pool |F| along each column of a grid: maximum, mean over supported samples, first and last of them.

    Returns float64 [4, x, y]; samples are numbered from 1, and 0 stands for a column without a force.
    """
    grid = stored.grid
    x, y, z = ((target.axis_m(axis) - grid.origin_m[axis]) / grid.spacing_m[axis] for axis in range(3))
    slots = np.full(grid.brick_shape, -1, np.int64)
    slots[tuple(stored.bricks.T)] = np.arange(len(stored.bricks))
    out = np.zeros((len(x) * len(y), 4))
    arguments = ((x, y, z), np.array(grid.shape, np.int64), slots, stored.forces_n, out)
    for_chunks(_pool, len(out), *arguments, chunk=_COLUMNS_AT_ONCE)
    return np.moveaxis(out.reshape(len(x), len(y), 4), 2, 0)


# -- resampling: three passes over each output brick, independent of the others, additions in a fixed order


@inlined
def _pass_x(forces, slot, span, low, first, weights, n0, n1, tmp):
    """Add the contribution of one input brick to the first pass; `span` is x0, x1, y0, y1, z0, z1."""
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
    has_force = False
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
                has_force |= a != 0 or b != 0 or c != 0
    return has_force


@lean
def _footprint(first, taps, brick, source_count):
    """Target samples of one output brick along one axis, and the source samples that they need."""
    n0 = brick * 8
    n1 = min(n0 + 8, first.shape[0])
    return n0, n1, max(0, first[n0]), min(source_count, first[n1 - 1] + taps)


@entry
def _resampled(start, stop, source, x, y, z, scratch, out, has_force):
    """Compute output bricks; `scratch` is two passes, the second flat and as vectors, and sample ranges."""
    bricks, keys, forces, shape = source
    x_first, x_w = x
    y_first, y_w = y
    z_first, z_w = z
    tmp, tmp2, tmp2_vectors, low, span = scratch
    bricks_y, bricks_z = (shape[1] + 7) >> 3, (shape[2] + 7) >> 3
    for n in range(start, stop):
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
                slot = lower_bound(keys, row + (low[2] >> 3))
                last = row + ((high_z - 1) >> 3)
                while slot < keys.shape[0] and keys[slot] <= last:
                    c = keys[slot] - row
                    span[4], span[5] = max(low[2], c * 8), min(high_z, c * 8 + 8)
                    _pass_x(forces, slot, span, low, x_first, x_w, i0, i1, tmp)
                    any_source = True
                    slot += 1
        if any_source:
            _pass_y(tmp, low[1], high_y, y_first, y_w, j0, j1, (high_z - low[2]) * 3, tmp2)
            has_force[n] = _pass_z(
                tmp2_vectors, i1 - i0, j1 - j0, low[2], high_z, z_first, z_w, k0, k1, n, out
            )


def resample_bricks(
    bricks: Int32s,
    source_shape: tuple[int, int, int],
    keys: Int64s,
    forces_n: Float32s,
    weights: Sequence[tuple[Int64s, Float32s]],
) -> tuple[Float32s, Bools]:
    """Resample to output bricks int32 [n, 3]: float32 [n, 8, 8, 8, 3], and which have a force, bool [n].

    source_shape : (int, int, int); samples of the input grid.
    keys, forces_n : int64 [m], float32 [m, 8, 8, 8, 3]; the input bricks, ascending.
    weights : `AxisWeights` of each axis.
    """
    across, deep = (_widest(*weights[axis], source_shape[axis]) for axis in (1, 2))
    x, y, z = (tuple(axis) for axis in weights)
    out = zero_forces(len(bricks))
    has_force = np.zeros(len(bricks), np.bool_)
    source = bricks, keys, forces_n.reshape(len(forces_n), 8, 8, 24), np.array(source_shape)

    def piece(start: int, stop: int) -> None:
        vectors = np.zeros((8, 8, deep, 3), np.float32)
        passes = np.zeros((8, across, 3 * deep), np.float32), vectors.reshape(8, 8, -1), vectors
        _resampled(
            start,
            stop,
            source,
            x,
            y,
            z,
            (*passes, np.zeros(3, np.int64), np.zeros(6, np.int64)),
            out,
            has_force,
        )

    for_chunks(piece, len(bricks), chunk=16)
    return out, has_force


def _widest(first: Int64s, weights: Float32s, source_count: int) -> int:
    """Return the largest number of source samples that an output brick needs along one axis."""
    last = first[np.minimum(np.arange(7, len(first) + 7, 8), len(first) - 1)]
    return min(source_count, int((last + weights.shape[1] - first[::8]).max()))


_IN_CONE = 1 - 2.0**-49  # so that rounding never lifts the friction out of its cone
_MIN_FRICTION_N = 1e-290
"""Friction below this is zero: near the smallest float64 its direction would be lost to rounding."""

_MIN_SLIP = 2.0**-47  # of the greatest component of v: 32 units of rounding


@kernel
def friction(fx, fy, fz, vx, vy, vz, mu, slip_speed):
    """Return F_t = -mu |F| v_t / max(|v_t|, v_s), three numbers, newtons.

    Force and velocity are first scaled by powers of two, which is exact, so that no square over- or
    underflows. A slip so small relative to v that its direction is rounding alone could drive the hand, and
    counts as zero. So F_t . v <= 0 holds for the returned numbers themselves, summed without rounding.
    """
    f_max, v_max = max(abs(fx), abs(fy), abs(fz)), max(abs(vx), abs(vy), abs(vz))
    if f_max == 0 or v_max == 0 or mu == 0:
        return 0.0, 0.0, 0.0
    f_exponent, v_exponent = math.frexp(f_max)[1], math.frexp(v_max)[1]
    nx, ny, nz = math.ldexp(fx, -f_exponent), math.ldexp(fy, -f_exponent), math.ldexp(fz, -f_exponent)
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    nx, ny, nz = nx / length, ny / length, nz / length
    ux, uy, uz = math.ldexp(vx, -v_exponent), math.ldexp(vy, -v_exponent), math.ldexp(vz, -v_exponent)
    tx, ty, tz = ux, uy, uz
    for _ in range(2):  # the second time takes off what rounding left along n
        along = tx * nx + ty * ny + tz * nz
        tx, ty, tz = tx - along * nx, ty - along * ny, tz - along * nz
    slip = math.sqrt(tx * tx + ty * ty + tz * tz)
    if slip <= _MIN_SLIP:
        return 0.0, 0.0, 0.0
    mantissa, mu_exponent = math.frexp(mu)
    size = math.ldexp(mantissa * length * _IN_CONE, f_exponent + mu_exponent)
    scaled_slip_speed = math.ldexp(slip_speed, -v_exponent)  # infinite where v is all but nothing
    if scaled_slip_speed > slip:
        size *= (
            slip / scaled_slip_speed
        )  # one number, so that what it loses near the least of float64 turns no direction
    if size < _MIN_FRICTION_N:
        return 0.0, 0.0, 0.0
    return -tx / slip * size, -ty / slip * size, -tz / slip * size
