"""Computes the field of a picture of planes by a rule in integers: the decoder's side of the base layer that
``source_layer.md`` defines.

It repeats in integers what the package does in floating point: planes of a depth map
(`touchfield.sources.depth`), a force law, a lattice of twice the samples and a low-pass to that of the device
(`touchfield.filters`). Every receiver makes the same numbers of the same bytes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from source_layer_tree import UNIT, Planes, Surface, compiled
from touchfield.filters.device_spec import DeviceFilter
from touchfield.medium import BRICK
from touchfield.sources.camera import Intrinsics
from touchfield.sources.depth.depth_scene import RAY_LIMIT
from touchfield.sources.depth.kernels.planes import SurfacePlanes

LENGTH: Final = 1 << 22
"""Units of length in 1/m of the scene, and of pixels times metres."""
TAPS: Final = (300, 1748, 1748, 300)
"""Weights of the low-pass, in 1/4096: the cubic B-spline of `touchfield.filters.resample` at two samples for
one. The other two weights are below 1/100000."""
MAX_GRADIENT: Final = 1 << 30
"""Inverse depth per pixel, times the focal length, above which a plane has no force, in 1/2^28 per metre."""
FINE: Final = 2 * BRICK + 2
"""Samples of the finer lattice along a brick that its low-pass needs."""
TILE: Final = 16
"""Pixels along a side of the tiles whose nearest and farthest planes exclude bricks."""
BATCH: Final = 256
"""Bricks that are computed at once."""

Integers = NDArray[np.int64]


class Rule(NamedTuple):
    """The numbers of the head.

    lattice : int64 [4, 3]; u z, v z and z of sample (0, 0, 0) of the finer lattice, and their steps along its
        axes, in 1/2^22 m.
    camera : int64 [4]; fx, fy, cx, cy in 1/16 pixel.
    pieces : int64 [n, 4]; of the force law: above and up to which distance, 1/2^22 m, force in units there,
        and its slope in units per metre.
    reach : int64 [2]; distance along the ray in front of and behind a plane, 1/2^22 m.
    limits : int64 [2]; the longest force, and the length below which a force is dropped, units.
    """

    lattice: Integers
    camera: Integers
    pieces: Integers
    reach: Integers
    limits: Integers


@dataclass(frozen=True)
class Lattice:
    """What the receiver knows of a picture besides its planes."""

    shape: tuple[int, int, int]
    size_px: tuple[int, int]
    """Height and width."""
    rule: Rule

    def head(self) -> bytes:
        """Return the bytes of the head: whole numbers as varints, signed ones in turns."""
        rule, out = self.rule, bytearray([2])
        unsigned = [self.size_px[1], self.size_px[0], *rule.camera.tolist(), *rule.limits.tolist()]
        signed = [*rule.lattice.reshape(-1).tolist(), *rule.pieces.reshape(-1).tolist(), *rule.reach.tolist()]
        numbers = [*unsigned, len(rule.pieces), *(2 * n if n >= 0 else -2 * n - 1 for n in signed)]
        for number in numbers:
            while number > 127:
                out.append(number & 127 | 128)
                number >>= 7
            out.append(number)
        return bytes(out)

    @classmethod
    def read(cls, head: bytes, shape: tuple[int, int, int]) -> Lattice:
        """Return the content of `head`."""
        numbers, number, shift = list[int](), 0, 0
        for byte in head[1:]:
            number, shift = number | (byte & 127) << shift, shift + 7
            if byte < 128:
                numbers.append(number)
                number, shift = 0, 0
        width, height, *rest = numbers
        camera, limits, count = rest[:4], rest[4:6], rest[6]
        signed = np.array([n // 2 if n % 2 == 0 else -(n // 2) - 1 for n in rest[7:]])
        lattice, pieces = signed[:12].reshape(4, 3), signed[12 : 12 + 4 * count].reshape(-1, 4)
        rule = Rule(lattice, np.array(camera), pieces, signed[12 + 4 * count :], np.array(limits))
        return cls(shape, (height, width), rule)


def lattice_of(
    mapping: DeviceFilter,
    pose: NDArray[np.float64],
    camera: Intrinsics,
    size_px: tuple[int, int],
    unit_n: float,
) -> Lattice:
    """Return the lattice and law of a frame in integers.

    `pose` float64 [4, 4] is scene from camera. Raises ValueError for another device filter than the default.
    """
    spec, placement = mapping.spec, mapping.placement
    if (spec.oversample, spec.low_pass) != (2, "spline"):
        raise ValueError(
            f"the rule is that of two samples and a spline, not {spec.oversample}, {spec.low_pass}"
        )
    fine = placement.to_scene(mapping.grid.refined(2))
    rotation = pose[:3, :3]
    rays = np.empty((4, 3))
    rays[0] = (np.asarray(fine.origin_m) - pose[:3, 3]) @ rotation
    rays[1:] = np.asarray(fine.spacing_m)[:, None] * rotation
    projected = rays @ np.array([[camera.fx, 0, 0], [0, camera.fy, 0], [camera.cx, camera.cy, 1]])
    law = mapping.profile.rescaled(placement.scale)
    pieces = [
        (low * LENGTH, high * LENGTH, force / unit_n, slope / unit_n)
        for low, high, force, slope in law.pieces
    ]
    reach = RAY_LIMIT * LENGTH * np.array([max(law.high_m, 0.0), max(-law.low_m, 0.0)])
    force_max_n = mapping.device.force_max_n
    limits = np.array([force_max_n, force_max_n * spec.force_floor_share]) / unit_n
    numbers = (
        projected * LENGTH,
        16 * np.array([camera.fx, camera.fy, camera.cx, camera.cy]),
        np.array(pieces),
        reach,
        limits,
    )
    return Lattice(mapping.grid.shape, size_px, Rule(*(np.rint(n).astype(np.int64) for n in numbers)))


def surface_of(planes: SurfacePlanes, weight: NDArray[np.float64]) -> Surface:
    """Return tangent planes as a surface in inverse depth; see `Surface`."""
    (height, width), (fx, fy, cx, cy) = planes.size_px, planes.camera_px.astype(np.float64)
    normal = planes.planes[:-4].reshape(height, width, 4).astype(np.float64)
    offset = np.where(normal[..., 3] < 0, normal[..., 3], np.inf)
    slope_u, slope_v = normal[..., 0] / offset / fx, normal[..., 1] / offset / fy
    u, v = np.arange(width) - cx, np.arange(height)[:, None] - cy
    inverse_m = normal[..., 2] / offset + slope_u * u + slope_v * v
    is_known = (normal[..., 3] < 0) & (inverse_m > 0)
    parts = inverse_m, slope_u, slope_v, -normal[..., 3]
    inverse_m, slope_u, slope_v, distance_m = (np.where(is_known, part, 0.0) for part in parts)
    return Surface(inverse_m, slope_u, slope_v, distance_m, weight)


# -- the rule ----------------------------------------------------------------------------------------------


@compiled
def integer_root(n):  # type: ignore[no-untyped-def]
    """Return the whole square root of a number below 2^62."""
    root = np.int64(math.sqrt(n))
    while root * root > n:
        root -= 1
    while (root + 1) * (root + 1) <= n:
        root += 1
    return root


@compiled
def axes_of(rule):  # type: ignore[no-untyped-def]
    """Return unit vectors along the axes of the lattice, camera axes, in 1/16384: int64 [3, 3]."""
    axes = np.zeros((3, 3), np.int64)
    fx, fy, cx, cy = rule.camera
    for n in range(3):
        u, v, z = rule.lattice[1 + n]
        axes[n, 0], axes[n, 1], axes[n, 2] = (16 * u - cx * z) // fx, (16 * v - cy * z) // fy, z
        length = integer_root(axes[n, 0] ** 2 + axes[n, 1] ** 2 + axes[n, 2] ** 2)
        for m in range(3):
            axes[n, m] = (axes[n, m] << 14) // max(length, 1)
    return axes


@compiled
def amplitude_at(rule, planes, u_z, v_z, z):  # type: ignore[no-untyped-def]
    """Return the amplitude of the force at a sample, units, and its pixel; 0, 0, 0 if there is none."""
    height, width = planes.is_hole.shape
    if z <= 0:
        return 0, 0, 0
    u, v = (2 * u_z + z) // (2 * z), (2 * v_z + z) // (2 * z)
    if u < 0 or v < 0 or u >= width or v >= height or planes.is_hole[v, u]:
        return 0, 0, 0
    own = planes.coefficients
    facing = (own[v, u, 0] * u_z + own[v, u, 1] * v_z + own[v, u, 2] * z) >> 22  # UNIT on the plane
    ahead = UNIT - facing
    if facing <= 0 or abs(ahead) > 4 * UNIT:
        return 0, 0, 0
    if z * abs(ahead) > facing * (rule.reach[0] if ahead > 0 else rule.reach[1]):
        return 0, 0, 0
    g_x, g_y, g_z = gradient_of(rule, planes, u, v)
    if max(abs(g_x), abs(g_y), abs(g_z)) >= MAX_GRADIENT:
        return 0, 0, 0
    length = max(integer_root(g_x * g_x + g_y * g_y + g_z * g_z), 1)
    distance = (ahead * ((16 * UNIT * LENGTH) // length)) >> 24
    for n in range(rule.pieces.shape[0]):
        if rule.pieces[n, 0] < distance <= rule.pieces[n, 1]:
            return rule.pieces[n, 2] + ((rule.pieces[n, 3] * distance) >> 22), u, v
    return 0, 0, 0


@compiled
def gradient_of(rule, planes, u, v):  # type: ignore[no-untyped-def]
    """Return the gradient of inverse depth at a pixel, 1/2^28 per metre, camera axes."""
    a, b, c = planes.coefficients[v, u, 0], planes.coefficients[v, u, 1], planes.coefficients[v, u, 2]
    return rule.camera[0] * a, rule.camera[1] * b, 16 * c + rule.camera[2] * a + rule.camera[3] * b


@compiled
def force_at(rule, axes, planes, sample, force):  # type: ignore[no-untyped-def]
    """Write the force of a sample [3], units in 1/256, to `force` [3]; returns whether there is one."""
    amplitude, u, v = amplitude_at(rule, planes, sample[0], sample[1], sample[2])
    if amplitude == 0:
        return False
    g_x, g_y, g_z = gradient_of(rule, planes, u, v)
    length = max(integer_root(g_x * g_x + g_y * g_y + g_z * g_z), 1)
    n_x, n_y, n_z = -(g_x << 14) // length, -(g_y << 14) // length, -(g_z << 14) // length
    for n in range(3):
        normal = (axes[n, 0] * n_x + axes[n, 1] * n_y + axes[n, 2] * n_z + 8192) >> 14
        force[n] = (amplitude * normal + 32) >> 6
    return True


@compiled
def tiles_of(planes):  # type: ignore[no-untyped-def]
    """Return the largest and smallest inverse depth of the planes in tiles, int64 [rows, columns, 2].

    A tile without planes has -1 and 2^62.
    """
    height, width = planes.is_hole.shape
    tiles = np.empty(((height + TILE - 1) // TILE, (width + TILE - 1) // TILE, 2), np.int64)
    tiles[..., 0], tiles[..., 1] = -1, 1 << 62
    for v in range(height):
        for u in range(width):
            if planes.is_hole[v, u]:
                continue
            a, b, c = planes.coefficients[v, u]
            w, half = a * u + b * v + c, (abs(a) + abs(b)) // 2 + 1
            tile = tiles[v // TILE, u // TILE]
            tile[0], tile[1] = max(tile[0], w + half), min(tile[1], w - half)
    return tiles


@compiled
def may_hold_force(rule, tiles, size_px, first):  # type: ignore[no-untyped-def]
    """Return False if no sample of a brick can have a force; `first` is its first fine sample [3].

    It only saves time: the bricks of the base layer are those with a force.
    """
    height, width = size_px
    far: Any = np.int64(1) << 62
    u0 = v0 = z0 = far
    u1 = v1 = z1 = -far
    for corner in range(8):
        u_z, v_z, z = rule.lattice[0]
        for n in range(3):
            at = first[n] + (FINE - 1 if corner >> n & 1 else 0)
            u_z, v_z, z = (
                u_z + at * rule.lattice[1 + n, 0],
                v_z + at * rule.lattice[1 + n, 1],
                z + at * rule.lattice[1 + n, 2],
            )
        if z <= LENGTH // 64:
            return True
        u0, u1 = min(u0, u_z // z), max(u1, u_z // z + 1)
        v0, v1 = min(v0, v_z // z), max(v1, v_z // z + 1)
        z0, z1 = min(z0, z), max(z1, z)
    if u1 < 0 or v1 < 0 or u0 >= width or v0 >= height:
        return False
    largest, smallest = np.int64(-1), np.int64(1) << 62
    left, right, top, bottom = max(u0, 0), min(u1, width - 1), max(v0, 0), min(v1, height - 1)
    for row in range(top // TILE, bottom // TILE + 1):
        for column in range(left // TILE, right // TILE + 1):
            largest, smallest = max(largest, tiles[row, column, 0]), min(smallest, tiles[row, column, 1])
    if largest <= 0:
        return False
    nearest = UNIT * LENGTH // largest - rule.reach[0] - 64
    return z1 >= nearest and (smallest <= 0 or z0 <= UNIT * LENGTH // smallest + rule.reach[1] + 64)


@compiled
def fill_brick(rule, axes, planes, first, shape, fine, force):  # type: ignore[no-untyped-def]
    """Write the forces of a brick, units, int64 [8, 8, 8, 3]; returns whether there is one.

    `fine` is scratch, int64 [FINE, FINE, FINE, 3].
    """
    fine[:] = 0
    has_force = False
    step, sample = rule.lattice[1:], np.zeros(3, np.int64)
    for i in range(FINE):
        for j in range(FINE):
            for n in range(3):
                sample[n] = rule.lattice[0, n] + first[2] * step[2, n]
                sample[n] += (first[0] + i) * step[0, n] + (first[1] + j) * step[1, n]
            for k in range(FINE):
                if amplitude_at(rule, planes, sample[0], sample[1], sample[2])[0]:
                    has_force |= force_at(rule, axes, planes, sample, fine[i, j, k])
                for n in range(3):
                    sample[n] += step[2, n]
    if not has_force:
        return False
    smooth(fine, shape, first, rule.limits, force)
    return bool(force.any())


@compiled
def smooth(fine, shape, first, limits, force):  # type: ignore[no-untyped-def]
    """Write the low-pass of the finer samples of a brick, limited, to `force` [8, 8, 8, 3]."""
    along_z = np.empty((FINE, FINE, BRICK, 3), np.int64)
    along_y = np.empty((FINE, BRICK, BRICK, 3), np.int64)
    for k in range(BRICK):
        total = np.zeros((FINE, FINE, 3), np.int64)
        for n in range(4):
            total += TAPS[n] * fine[:, :, 2 * k + n]
        along_z[:, :, k] = (total + 2048) >> 12
    for j in range(BRICK):
        middle = np.zeros((FINE, BRICK, 3), np.int64)
        for n in range(4):
            middle += TAPS[n] * along_z[:, 2 * j + n]
        along_y[:, j] = (middle + 2048) >> 12
    for i in range(BRICK):
        last = np.zeros((BRICK, BRICK, 3), np.int64)
        for n in range(4):
            last += TAPS[n] * along_y[2 * i + n]
        force[i] = (((last + 2048) >> 12) + 128) >> 8
    for i in range(BRICK):
        for j in range(BRICK):
            for k in range(BRICK):
                limit(force[i, j, k], limits)
                at = (first[0] + 1) // 2 + i, (first[1] + 1) // 2 + j, (first[2] + 1) // 2 + k
                if at[0] >= shape[0] or at[1] >= shape[1] or at[2] >= shape[2]:
                    force[i, j, k] = 0


@compiled
def limit(force, limits):  # type: ignore[no-untyped-def]
    """Clip a force [3] to the longest, and drop one that is too short."""
    length = integer_root(force[0] * force[0] + force[1] * force[1] + force[2] * force[2])
    for n in range(3):
        if length < limits[1]:
            force[n] = 0
        elif length > limits[0]:
            force[n] = force[n] * limits[0] // length


def field_of(
    lattice: Lattice, planes: Planes, candidates: NDArray[np.int32] | None = None
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return the base layer: bricks int32 [n, 3], ascending, and vectors int32 [n, 512, 3], units.

    The receiver finds the bricks among all of the grid; `candidates` int32 [m, 3] are the only ones that an
    encoder wants to see.
    """
    if candidates is None:
        counts = [-(-n // BRICK) for n in lattice.shape]
        candidates = np.indices(counts, np.int32).reshape(3, -1).T
    tiles, marks, parts = tiles_of(planes), list[NDArray[np.bool_]](), list[NDArray[np.int32]]()
    for start in range(0, len(candidates), BATCH):
        batch = np.ascontiguousarray(candidates[start : start + BATCH])
        vectors = np.zeros((len(batch), BRICK**3, 3), np.int32)
        marks.append(_fill(lattice.rule, planes, tiles, lattice.shape, batch, vectors))
        parts.append(vectors[marks[-1]])
    return candidates[np.concatenate(marks)], np.concatenate(parts)


@compiled
def _fill(rule, planes, tiles, shape, candidates, out):  # type: ignore[no-untyped-def]
    axes, size_px = axes_of(rule), planes.is_hole.shape
    fine, force = np.zeros((FINE, FINE, FINE, 3), np.int64), np.zeros((BRICK, BRICK, BRICK, 3), np.int64)
    has_force = np.zeros(len(candidates), np.bool_)
    for n in range(len(candidates)):
        first = 2 * BRICK * candidates[n].astype(np.int64) - 1
        if may_hold_force(rule, tiles, size_px, first):
            has_force[n] = fill_brick(rule, axes, planes, first, shape, fine, force)
            out[n] = force.reshape(-1, 3)
    return has_force
