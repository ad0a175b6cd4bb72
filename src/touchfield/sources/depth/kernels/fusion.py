"""Compiled inner loops of `FusedScene`: update the samples of a volume with a depth image, and compute forces
from them.

`touchfield.sources.depth.fused_scene` describes the state of a sample.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Bools, Float32s, Int32s, Int64s
from touchfield.compute.jit import inner, kernel
from touchfield.compute.threads import for_chunks
from touchfield.medium.budget import zero_forces
from touchfield.sources.depth.kernels.field import B3, Query, first_sample, gather, pixels_of

_PASSED, CLEAR = 1, 2  # values of `Samples.free`: a ray passed; a ray passed with no surface near it
_CARVED = 128  # value of `Samples.strikes` of a carved surface
_0, _1 = np.float32(0), np.float32(1)
_TINY = np.float32(1e-30)
_NX, _NY, _NZ, _C = (B3 * q for q in range(4))


class View(NamedTuple):
    """A depth map and the lattice of the volume.

    For `integrate`, `marked` are the pixels whose surface lies in known free space, so that the samples
    behind it are new as well; for `mark`, they are the pixels whose samples are to be marked. `nearest_per_m`
    is the largest inverse depth in each tile of 8 x 8 pixels and its neighbours: samples clearly in front of
    it are free.
    """

    query: Query
    marked: NDArray[np.uint8]  # [height width + 1]
    nearest_per_m: Float32s  # [rows, columns]


class Rules(NamedTuple):
    """Distances that distinguish a surface, free space and a guess, float32.

    The noise at depth z is `noise_per_m` z^2, and the neighbourhood of a surface is at least `min_near_m`.
    Forces reach `wall_depth_m` behind the surface, and `ray_factor` times as far along the ray. `first` is
    the weight of the first observation.
    """

    noise_per_m: np.float32
    min_near_m: np.float32
    wall_depth_m: np.float32
    ray_factor: np.float32
    first: np.float32


class Samples(NamedTuple):
    """The state of the samples of the bricks of a volume, [bricks, 512] each."""

    distance_m: Float32s  # mean signed distance to the surface, negative behind it
    weight: Float32s  # 0 if only free space, or nothing, is known
    normal: Float32s  # [bricks, 3, 512], mean normal, scene axes
    has_surface: NDArray[np.uint8]  # 1 if a surface was seen near the sample
    free: NDArray[np.uint8]  # 0 if no ray passed, 1 after a ray, 2 after a ray with no surface near it
    strikes: NDArray[np.uint8]  # number of views in a row that contradict the state
    changes: NDArray[np.uint8]  # 1 if free space became a surface, a surface free space or another surface

    def first(self, count: int) -> Samples:
        """Return the samples of the first bricks, as views."""
        return Samples(*(array[:count] for array in self))  # type: ignore[arg-type]

    def rows(self, rows: Int64s) -> Samples:
        """Return copies of the samples of some bricks, `rows` int64 [n]."""
        return Samples(*(array[rows] for array in self))  # type: ignore[arg-type]

    def copy_from(self, other: Samples) -> None:
        """Copy the state of `other`, which has the same number of bricks."""
        for array, source in zip(self, other, strict=True):
            array[...] = source  # type: ignore[index]


def empty_samples(count: int) -> Samples:
    """Return samples without observations."""
    floats = (np.zeros((count, *shape), np.float32) for shape in ((512,), (512,), (3, 512)))
    return Samples(*floats, *(np.zeros((count, 512), np.uint8) for _ in range(4)))


@inner
def _reset_sample(samples, n, s):
    samples.weight[n, s] = _0
    samples.has_surface[n, s] = samples.free[n, s] = samples.strikes[n, s] = 0


@inner
def _carve(samples, n, s, is_clear):
    """Update a sample that a ray passed through: the second ray in a row removes a guess or a surface."""
    if samples.weight[n, s] > _0:
        samples.strikes[n, s] += 1
        if samples.strikes[n, s] < 2:
            return
        was_surface = samples.has_surface[n, s] > 0
        _reset_sample(samples, n, s)
        samples.strikes[n, s] = _CARVED if was_surface else 0
    samples.free[n, s] = max(samples.free[n, s], _PASSED)
    if is_clear:  # only here is a carved surface certainly gone: pose errors also carve next to a surface
        samples.free[n, s] = CLEAR
        if samples.strikes[n, s] == _CARVED:
            samples.changes[n, s] = 1
            samples.strikes[n, s] = 0


@inner(fastmath={"contract"})
def _update_mean(samples, n, s, phi, weight, normal):
    """Update the mean of a sample with one view."""
    total = samples.weight[n, s] + weight
    fraction = weight / total
    samples.weight[n, s] = total
    samples.distance_m[n, s] += (phi - samples.distance_m[n, s]) * fraction
    samples.normal[n, 0, s] += (normal[0] - samples.normal[n, 0, s]) * fraction
    samples.normal[n, 1, s] += (normal[1] - samples.normal[n, 1, s]) * fraction
    samples.normal[n, 2, s] += (normal[2] - samples.normal[n, 2, s]) * fraction


@inner(fastmath={"contract"}, error_model="numpy")
def _add_look(samples, n, s, look, first, normal):
    """Update a sample with a view whose surface lies at the distance phi, near the sample or in front of it.

    `look` holds phi, tolerance, weight and `is_marked`, which is True if the surface is new.
    """
    phi, tolerance, weight, is_marked = look
    if phi < -tolerance:  # behind a surface: a guess, whose weight decreases with the distance
        if samples.free[n, s] > 0 and samples.has_surface[n, s] == 0:
            if not is_marked:
                return
            _reset_sample(samples, n, s)
        decay = tolerance / phi
        decay *= decay
        if samples.weight[n, s] == _0:
            weight *= first
        _update_mean(samples, n, s, phi, weight * decay * decay, normal)
        return
    if samples.has_surface[n, s] == 0:  # a surface replaces a guess, or is new
        if samples.free[n, s] == CLEAR:
            samples.changes[n, s] = 1
        _reset_sample(samples, n, s)
        weight *= first
    elif abs(phi - samples.distance_m[n, s]) > tolerance:  # the surface has shifted within the neighbourhood
        samples.strikes[n, s] += 1
        if samples.strikes[n, s] < 2:
            return
        samples.changes[n, s] = 1
        _reset_sample(samples, n, s)
    samples.strikes[n, s] = samples.free[n, s] = 0
    samples.has_surface[n, s] = 1
    _update_mean(samples, n, s, phi, weight, normal)


@inner(fastmath={"contract"}, error_model="numpy", forceinline=True)
def _measure(x, y, z, plane, rules):
    """Return phi of a sample, its tolerance (-1: no observation) and the weight of the view.

    Branch-free. z phi / facing is the distance in z from the point where the sample's own ray meets the
    plane.
    """
    c = plane[3]
    facing = plane[0] * x + plane[1] * y + plane[2] * z
    phi = facing - c
    is_out_of_reach = (phi < -rules.wall_depth_m) | (z * phi < facing * rules.ray_factor * rules.wall_depth_m)
    depth = z * c / facing  # the depth at which the sample's ray meets the plane
    noise = rules.noise_per_m * depth * depth
    sigma = (noise + np.float32(1e-3)) * np.float32(1e3)
    tolerance = -_1 if (c >= _0) | (facing >= _0) | is_out_of_reach else max(rules.min_near_m, noise + noise)
    return phi, tolerance, facing * facing / ((x * x + y * y + z * z) * sigma * sigma)


@inner(fastmath={"contract"}, error_model="numpy")
def _measure_brick(brick, query, rules, index, r, measured):
    """Write pixels, planes and results of `_measure` of a brick.

    Returns the depth of its first sample.
    """
    surface, offsets = query.surface, query.offsets_m
    x0, y0, z0 = first_sample(brick, query.lattice_m)
    pixels_of(x0, y0, z0, offsets, B3, surface.camera_px, surface.size_px[0], surface.size_px[1], index)
    gather(surface.planes, index, B3, r)
    for s in range(B3):  # vectorised: eight samples at once
        x, y, z = x0 + offsets[s], y0 + offsets[s + B3], z0 + offsets[s + 2 * B3]
        plane = r[s + _NX], r[s + _NY], r[s + _NZ], r[s + _C]
        measured[s], measured[s + B3], measured[s + 2 * B3] = _measure(x, y, z, plane, rules)
    return z0


@inner(fastmath={"contract"}, error_model="numpy", forceinline=True)
def _update_sample(samples, n, s, look, pixel, plane, z, view, rules):
    """Update sample s of brick n, at the depth z, with a view."""
    phi, tolerance, weight = look
    if tolerance < _0:
        return
    if phi > tolerance:
        width = view.query.surface.size_px[1]
        v = pixel // width
        u = pixel - v * width
        _carve(samples, n, s, (z + tolerance) * view.nearest_per_m[v >> 3, u >> 3] < _1)
        return
    rotation, nx, ny, nz = view.query.rotation, plane[0], plane[1], plane[2]
    normal = (
        rotation[0, 0] * nx + rotation[0, 1] * ny + rotation[0, 2] * nz,
        rotation[1, 0] * nx + rotation[1, 1] * ny + rotation[1, 2] * nz,
        rotation[2, 0] * nx + rotation[2, 1] * ny + rotation[2, 2] * nz,
    )
    _add_look(samples, n, s, (phi, tolerance, weight, view.marked[pixel] > 0), rules.first, normal)


@kernel(fastmath={"contract"}, error_model="numpy")
def _integrate(start, stop, rows, bricks, view, rules, samples):
    index, r, measured = np.empty(B3, np.int32), np.empty(4 * B3, np.float32), np.empty(3 * B3, np.float32)
    for n in rows[start:stop]:
        z0 = _measure_brick(bricks[n], view.query, rules, index, r, measured)
        for s in range(B3):
            plane = r[s + _NX], r[s + _NY], r[s + _NZ], r[s + _C]
            look = measured[s], measured[s + B3], measured[s + 2 * B3]
            _update_sample(
                samples, n, s, look, index[s], plane, z0 + view.query.offsets_m[s + 2 * B3], view, rules
            )


@kernel(fastmath={"contract"}, error_model="numpy")
def _mark(start, stop, rows, bricks, view, rules, out):
    index, r, measured = np.empty(B3, np.int32), np.empty(4 * B3, np.float32), np.empty(3 * B3, np.float32)
    for n in rows[start:stop]:
        _measure_brick(bricks[n], view.query, rules, index, r, measured)
        for s in range(B3):
            if view.marked[index[s]] and measured[s + B3] >= _0 and measured[s] <= rules.min_near_m:
                out[n, s] = True


@kernel(error_model="numpy")
def _mark_surfaces(start, stop, query, slots, inverse, samples, is_selected, out):
    """Mark pixels of rows start..stop whose surface lies at a selected sample.

    Returns sum and number of the residuals against the known surfaces, metres.
    """
    camera, planes, (_, width) = query.surface.camera_px, query.surface.planes, query.surface.size_px
    lattice, shape = query.lattice_m, query.shape
    total, count = 0.0, 0
    for v in range(start, stop):
        for u in range(width):
            p = v * width + u
            out[p] = 0
            nx, ny, nz, c = planes[4 * p], planes[4 * p + 1], planes[4 * p + 2], planes[4 * p + 3]
            x, y = (u - camera[2]) / camera[0], (v - camera[3]) / camera[1]
            facing = nx * x + ny * y + nz
            if c >= _0 or facing >= _0:
                continue
            z = c / facing
            x, y, z = x * z - lattice[0, 0], y * z - lattice[0, 1], z - lattice[0, 2]
            i = int(np.floor(inverse[0, 0] * x + inverse[0, 1] * y + inverse[0, 2] * z + 0.5))
            j = int(np.floor(inverse[1, 0] * x + inverse[1, 1] * y + inverse[1, 2] * z + 0.5))
            k = int(np.floor(inverse[2, 0] * x + inverse[2, 1] * y + inverse[2, 2] * z + 0.5))
            if not (0 <= i < shape[0] and 0 <= j < shape[1] and 0 <= k < shape[2]):
                continue
            n, s = slots[i >> 3, j >> 3, k >> 3], (i & 7) << 6 | (j & 7) << 3 | (k & 7)
            if n < 0:
                continue
            out[p] = is_selected[n, s]
            if samples.has_surface[n, s] > 0:
                x -= i * lattice[1, 0] + j * lattice[2, 0] + k * lattice[3, 0]
                y -= i * lattice[1, 1] + j * lattice[2, 1] + k * lattice[3, 1]
                z -= i * lattice[1, 2] + j * lattice[2, 2] + k * lattice[3, 2]
                total += abs(nx * x + ny * y + nz * z + samples.distance_m[n, s])
                count += 1
    return total, count


@kernel(fastmath={"contract"}, error_model="numpy")
def _forces(start, stop, samples, pieces, shape, bricks, out):
    for q in range(start, stop):
        n, s = q >> 9, q & 511
        phi, f = samples.distance_m[n, s], _0
        is_outside = (
            8 * bricks[n, 0] + (s >> 6) >= shape[0]
            or 8 * bricks[n, 1] + (s >> 3 & 7) >= shape[1]
            or 8 * bricks[n, 2] + (s & 7) >= shape[2]
        )
        if samples.weight[n, s] > _0 and not is_outside:
            for p in range(pieces.shape[0]):
                if pieces[p, 0] < phi <= pieces[p, 1]:
                    f = pieces[p, 2] + pieces[p, 3] * phi
        x, y, z = samples.normal[n, 0, s], samples.normal[n, 1, s], samples.normal[n, 2, s]
        f /= math.sqrt(x * x + y * y + z * z + _TINY)
        out[n, s, 0], out[n, s, 1], out[n, s, 2] = f * x, f * y, f * z


def integrate(rows: Int64s, bricks: Int32s, view: View, rules: Rules, samples: Samples) -> None:
    """Update the samples of the bricks `rows` with one view.

    `rows` int64 [m] are indices in `bricks`, and in `samples`: those that the view may see.
    """
    for_chunks(_integrate, len(rows), rows, bricks, view, rules, samples, chunk=16)


def mark(rows: Int64s, bricks: Int32s, view: View, rules: Rules, out: Bools) -> None:
    """Set in `out`, bool [bricks, 512], the samples at and behind the surfaces of the marked pixels.

    `rows` are as in `integrate`.
    """
    for_chunks(_mark, len(rows), rows, bricks, view, rules, out, chunk=16)


def mark_surfaces(view: View, slots: Int32s, samples: Samples, is_selected: Bools) -> float | None:
    """Mark the pixels of the view whose surface lies at a sample of `is_selected`, bool [bricks, 512].

    `slots`, int32 [bricks along each axis of the grid], is the index of a brick in `samples` and
    `is_selected`, -1 if it has none. Returns the mean distance between the surfaces of the view and the known
    ones, metres; None if none is known.
    """
    query = view.query
    inverse = np.linalg.inv(query.lattice_m[1:].T)
    arguments = query, slots, inverse, samples, is_selected, view.marked
    sums = for_chunks(_mark_surfaces, query.surface.size_px[0], *arguments, chunk=32)
    view.marked[-1] = 0
    count = sum(count for _, count in sums)
    return sum(total for total, _ in sums) / count if count else None


def brick_forces(samples: Samples, pieces: Float32s, shape: tuple[int, int, int], bricks: Int32s) -> Float32s:
    """Return the forces of all bricks, newtons, float32 [n, 8, 8, 8, 3]."""
    out = zero_forces(len(bricks))
    for_chunks(
        _forces, B3 * len(bricks), samples, pieces, shape, bricks, out.reshape(-1, B3, 3), chunk=16 * B3
    )
    return out
