"""Compiled loops of the fused world: what one depth map tells each sample of a volume, and the forces of the
mean.

What a sample remembers and why is told in `touchfield.sources.depth.fused_scene`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Bools, Float32s, Int32s
from touchfield.compute.jit import inner, kernel
from touchfield.compute.threads import for_chunks
from touchfield.medium.budget import zero_forces
from touchfield.sources.depth.kernels.field import B3, Query, first_sample, gather, pixels_of

_PASSED, CLEAR = 1, 2  # free: a ray passed; one did with nothing near it
_CARVED = 128  # strikes of a surface that was carved
_0, _1 = np.float32(0), np.float32(1)
_TINY = np.float32(1e-30)
_NX, _NY, _NZ, _C = (B3 * q for q in range(4))


class View(NamedTuple):
    """A depth map before the lattice of the volume.

    `marked` are, of `integrate`, pixels whose surface stands where free space was known, so that what lies
    behind is new, too; of `mark`, those whose samples are asked for. `nearest_per_m` is the largest inverse
    depth in each tile of 8 x 8 pixels and those around it: what lies clearly before it is free.
    """

    query: Query
    marked: NDArray[np.uint8]  # [height width + 1]
    nearest_per_m: Float32s  # [rows, columns]


class Rules(NamedTuple):
    """Distances that tell a surface from free space and from a guess, float32.

    Of depth z the noise is `noise_per_m` z^2, and a surface is never taken to be thinner than `least_m`;
    there may be a force `behind_m` behind it, and `along` times as far along the ray; the first look counts
    `first` times.
    """

    noise_per_m: np.float32
    least_m: np.float32
    behind_m: np.float32
    along: np.float32
    first: np.float32


class Samples(NamedTuple):
    """The memory of the samples of the bricks of a volume, [bricks, 512] each."""

    distance_m: Float32s  # mean signed distance to the surface, negative behind it
    weight: Float32s  # 0 where nothing is known but free space
    normal: Float32s  # [bricks, 3, 512], mean normal, scene axes
    near: NDArray[np.uint8]  # 1 where a surface was seen close by
    free: NDArray[np.uint8]  # 0 until a ray passed, since; then 1, and 2 once one did with nothing near it
    strikes: NDArray[np.uint8]  # how often in a row the view spoke against it
    changes: NDArray[
        np.uint8
    ]  # 1 where free space became a surface, a surface free space, or a surface another

    def first(self, count: int) -> Samples:
        """Those of the first bricks, as views."""
        return Samples(*(array[:count] for array in self))  # type: ignore[arg-type]

    def take(self, other: Samples) -> None:
        """Remember what `other`, of as many bricks, does."""
        for array, its in zip(self, other, strict=True):
            array[...] = its  # type: ignore[index]


def no_samples(count: int) -> Samples:
    """Samples of bricks of which nothing is known."""
    floats = (np.zeros((count, *shape), np.float32) for shape in ((512,), (512,), (3, 512)))
    return Samples(*floats, *(np.zeros((count, 512), np.uint8) for _ in range(4)))


@inner
def _forget(of, n, s):
    of.weight[n, s] = _0
    of.near[n, s] = of.free[n, s] = of.strikes[n, s] = 0


@inner
def _passed(of, n, s, is_clear):
    """A ray passed through the sample: what was only guessed there goes at the second one, so does a surface."""
    if of.weight[n, s] > _0:
        of.strikes[n, s] += 1
        if of.strikes[n, s] < 2:
            return
        was_surface = of.near[n, s] > 0
        _forget(of, n, s)
        of.strikes[n, s] = _CARVED if was_surface else 0
    of.free[n, s] = max(of.free[n, s], _PASSED)
    if (
        is_clear
    ):  # only now is a carved surface surely gone: close beside a thing a pose that is off carves, too
        of.free[n, s] = CLEAR
        if of.strikes[n, s] == _CARVED:
            of.changes[n, s] = 1
            of.strikes[n, s] = 0


@inner(fastmath={"contract"})
def _met(of, n, s, phi, weight, normal):
    """The mean of the sample moves towards what one view says."""
    total = of.weight[n, s] + weight
    share = weight / total
    of.weight[n, s] = total
    of.distance_m[n, s] += (phi - of.distance_m[n, s]) * share
    of.normal[n, 0, s] += (normal[0] - of.normal[n, 0, s]) * share
    of.normal[n, 1, s] += (normal[1] - of.normal[n, 1, s]) * share
    of.normal[n, 2, s] += (normal[2] - of.normal[n, 2, s]) * share


@inner(fastmath={"contract"}, error_model="numpy")
def _tell(of, n, s, look, first, normal):
    """Tell a sample what a view says that sees a surface at the distance phi, at it or before it.

    Marked is a look at a surface that is new.
    """
    phi, least, weight, is_marked = look
    if phi < -least:  # behind a surface: a guess, the less worth the farther behind
        if of.free[n, s] > 0 and of.near[n, s] == 0:
            if not is_marked:
                return
            _forget(of, n, s)
        share = least / phi
        share *= share
        if of.weight[n, s] == _0:
            weight *= first
        _met(of, n, s, phi, weight * share * share, normal)
        return
    if of.near[n, s] == 0:  # a surface in front of a guess, or where nothing was
        if of.free[n, s] == CLEAR:
            of.changes[n, s] = 1
        _forget(of, n, s)
        weight *= first
    elif (
        abs(phi - of.distance_m[n, s]) > least
    ):  # it has come nearer, or gone, within what counts as close by
        of.strikes[n, s] += 1
        if of.strikes[n, s] < 2:
            return
        of.changes[n, s] = 1
        _forget(of, n, s)
    of.strikes[n, s] = of.free[n, s] = 0
    of.near[n, s] = 1
    _met(of, n, s, phi, weight, normal)


@inner(fastmath={"contract"}, error_model="numpy", forceinline=True)
def _measured(x, y, z, plane, rules):
    """Of a sample phi, how near counts as near (-1: nothing is known) and the weight of the look.

    Without a branch; z phi / facing is the distance in z from where the sample's own ray meets the plane.
    """
    c = plane[3]
    facing = plane[0] * x + plane[1] * y + plane[2] * z
    phi = facing - c
    is_far = (phi < -rules.behind_m) | (z * phi < facing * rules.along * rules.behind_m)
    deep = z * c / facing  # the depth at which the sample's ray meets the plane
    noise = rules.noise_per_m * deep * deep
    sigma = (noise + np.float32(1e-3)) * np.float32(1e3)
    near = -_1 if (c >= _0) | (facing >= _0) | is_far else max(rules.least_m, noise + noise)
    return phi, near, facing * facing / ((x * x + y * y + z * z) * sigma * sigma)


@inner(fastmath={"contract"}, error_model="numpy")
def _look(brick, query, rules, index, r, seen):
    """Pixels, planes and what is `_measured` of all samples of a brick; the depth of the first."""
    surface, offsets = query.surface, query.offsets_m
    x0, y0, z0 = first_sample(brick, query.lattice_m)
    pixels_of(x0, y0, z0, offsets, B3, surface.camera_px, surface.size_px[0], surface.size_px[1], index)
    gather(surface.planes, index, B3, r)
    for s in range(B3):  # eight at once
        x, y, z = x0 + offsets[s], y0 + offsets[s + B3], z0 + offsets[s + 2 * B3]
        plane = r[s + _NX], r[s + _NY], r[s + _NZ], r[s + _C]
        seen[s], seen[s + B3], seen[s + 2 * B3] = _measured(x, y, z, plane, rules)
    return z0


@inner(fastmath={"contract"}, error_model="numpy", forceinline=True)
def _learn(of, n, s, seen, pixel, plane, z, view, rules):
    """Tell sample s of brick n, at the depth z, what the view sees there."""
    phi, least, weight = seen
    if least < _0:
        return
    if phi > least:
        width = view.query.surface.size_px[1]
        v = pixel // width
        u = pixel - v * width
        _passed(of, n, s, (z + least) * view.nearest_per_m[v >> 3, u >> 3] < _1)
        return
    turn, nx, ny, nz = view.query.turn, plane[0], plane[1], plane[2]
    normal = (
        turn[0, 0] * nx + turn[0, 1] * ny + turn[0, 2] * nz,
        turn[1, 0] * nx + turn[1, 1] * ny + turn[1, 2] * nz,
        turn[2, 0] * nx + turn[2, 1] * ny + turn[2, 2] * nz,
    )
    _tell(of, n, s, (phi, least, weight, view.marked[pixel] > 0), rules.first, normal)


@kernel(fastmath={"contract"}, error_model="numpy")
def _integrate(begin, end, bricks, view, rules, of):
    index, r, seen = np.empty(B3, np.int32), np.empty(4 * B3, np.float32), np.empty(3 * B3, np.float32)
    for n in range(begin, end):
        z0 = _look(bricks[n], view.query, rules, index, r, seen)
        for s in range(B3):
            plane = r[s + _NX], r[s + _NY], r[s + _NZ], r[s + _C]
            of_sample = seen[s], seen[s + B3], seen[s + 2 * B3]
            _learn(of, n, s, of_sample, index[s], plane, z0 + view.query.offsets_m[s + 2 * B3], view, rules)


@kernel(fastmath={"contract"}, error_model="numpy")
def _mark(begin, end, bricks, view, rules, out):
    index, r, seen = np.empty(B3, np.int32), np.empty(4 * B3, np.float32), np.empty(3 * B3, np.float32)
    for n in range(begin, end):
        _look(bricks[n], view.query, rules, index, r, seen)
        for s in range(B3):
            if view.marked[index[s]] and seen[s + B3] >= _0 and seen[s] <= rules.least_m:
                out[n, s] = True


@kernel(error_model="numpy")
def _surfaces_in(begin, end, query, slots, inverse, of, wanted, out):
    """Pixels of rows begin..end whose surface lies at a sample that is wanted.

    Sum and number of the residuals against the surfaces that are known, metres.
    """
    camera, planes, (_, width) = query.surface.camera_px, query.surface.planes, query.surface.size_px
    lattice, shape = query.lattice_m, query.shape
    total, count = 0.0, 0
    for v in range(begin, end):
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
            out[p] = wanted[n, s]
            if of.near[n, s] > 0:
                x -= i * lattice[1, 0] + j * lattice[2, 0] + k * lattice[3, 0]
                y -= i * lattice[1, 1] + j * lattice[2, 1] + k * lattice[3, 1]
                z -= i * lattice[1, 2] + j * lattice[2, 2] + k * lattice[3, 2]
                total += abs(nx * x + ny * y + nz * z + of.distance_m[n, s])
                count += 1
    return total, count


@kernel(fastmath={"contract"}, error_model="numpy")
def _forces(begin, end, of, pieces, shape, bricks, out):
    for q in range(begin, end):
        n, s = q >> 9, q & 511
        phi, f = of.distance_m[n, s], _0
        outside = (
            8 * bricks[n, 0] + (s >> 6) >= shape[0]
            or 8 * bricks[n, 1] + (s >> 3 & 7) >= shape[1]
            or 8 * bricks[n, 2] + (s & 7) >= shape[2]
        )
        if of.weight[n, s] > _0 and not outside:
            for p in range(pieces.shape[0]):
                if pieces[p, 0] < phi <= pieces[p, 1]:
                    f = pieces[p, 2] + pieces[p, 3] * phi
        x, y, z = of.normal[n, 0, s], of.normal[n, 1, s], of.normal[n, 2, s]
        f /= math.sqrt(x * x + y * y + z * z + _TINY)
        out[n, s, 0], out[n, s, 1], out[n, s, 2] = f * x, f * y, f * z


def integrate(bricks: Int32s, view: View, rules: Rules, of: Samples) -> None:
    """Tell every sample of `bricks` what one view says."""
    for_chunks(_integrate, len(bricks), bricks, view, rules, of, chunk=16)


def mark(bricks: Int32s, view: View, rules: Rules, out: Bools) -> None:
    """Set in `out`, bool [bricks, 512], the samples at and behind the surfaces of the marked pixels."""
    for_chunks(_mark, len(bricks), bricks, view, rules, out, chunk=16)


def surfaces_in(view: View, slots: Int32s, of: Samples, wanted: Bools) -> float | None:
    """Mark the pixels of the view whose surface lies at a sample of `wanted`, bool [bricks, 512].

    `slots`, int32 [bricks along each axis of the grid], is where a brick lies in `of` and `wanted`, -1 where
    it does not. The result is the mean distance between the surfaces of the view and those known, metres;
    None if none is.
    """
    query = view.query
    inverse = np.linalg.inv(query.lattice_m[1:].T)
    work = query, slots, inverse, of, wanted, view.marked
    sums = for_chunks(_surfaces_in, query.surface.size_px[0], *work, chunk=32)
    view.marked[-1] = 0
    count = sum(count for _, count in sums)
    return sum(total for total, _ in sums) / count if count else None


def brick_forces(of: Samples, pieces: Float32s, shape: tuple[int, int, int], bricks: Int32s) -> Float32s:
    """The forces of all bricks, newtons, float32 [n, 8, 8, 8, 3]."""
    out = zero_forces(len(bricks))
    for_chunks(_forces, B3 * len(bricks), of, pieces, shape, bricks, out.reshape(-1, B3, 3), chunk=16 * B3)
    return out
