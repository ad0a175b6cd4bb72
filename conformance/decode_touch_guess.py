"""Decodes base layers of coder `touch`, smooth approximations that the encoder sends before the differences,
step by step as docs/format/touch-base-layer.md says. `decode_touch.py` calls it.
"""

from itertools import combinations, product
from math import isqrt
from typing import NamedTuple

import numpy as np
from reading import Array, Cursor, Place, TruncatedFile, brick_of, inside, need, samples_of
from touch_bits import Bits, bricks
from touch_frame import Units

LIMIT = (1 << 17) - 1
STEPS = ((1, 0, 0), (0, 1, 0), (0, 0, 1))


def bounded(value: int, most: int, least: int | None = None) -> int:
    return max(-most if least is None else least, min(value, most))


# -- kind 0: a spline --------------------------------------------------------------------------------------


def spline(data: bytes, shape: Place) -> Units:
    """The guess of a spline over a grid of `shape` samples."""
    c = Cursor(data)
    shifts, (step, *scales) = [c.varint(6, 2) for _ in range(3)], [c.varint(1 << 20, 1) for _ in range(4)]
    bits = Bits(c.rest())
    told = bricks(bits, shape)
    need(told, "a guess without bricks")
    around = [
        [range((8 * b >> s) - 1, (8 * b + 7 >> s) + 3) for b, s in zip(brick, shifts)] for brick in told
    ]
    nodes, sizes = dict[Place, int](), dict[Place, int]()
    for node in sorted({node for ranges in around for node in product(*ranges)}):
        r = residual(bits, 24 * min(sum(sizes.get(beside(node, d), 0) for d in STEPS).bit_length(), 9))
        sizes[node] = abs(r)
        nodes[node] = bounded(expected(nodes, node) + r * step, 1 << 23)
    bits.end(len(told))
    vectors: dict[Place, Array] = {}
    for brick, ranges in zip(told, around):
        own = np.array([nodes[node] for node in product(*ranges)]).reshape([len(r) for r in ranges])
        made = forces(corners(own, brick, shifts), scales).astype(object)
        vectors |= {at: made[inside(at)] for at in samples_of(brick, shape) if made[inside(at)].any()}
    return Units(told, vectors)


def beside(node: Place, *steps: Place) -> Place:
    return tuple(n - sum(s) for n, s in zip(node, zip(*steps)))


def expected(nodes: dict[Place, int], node: Place) -> int:
    faces = [(beside(node, a), beside(node, b), beside(node, a, b)) for a, b in combinations(STEPS, 2)]
    said = [
        nodes[one] + nodes[two] - nodes[both] for one, two, both in faces if {one, two, both} <= nodes.keys()
    ]
    said = said or [nodes[beside(node, a)] for a in STEPS if beside(node, a) in nodes] or [0]
    return (2 * sum(said) + len(said)) // (2 * len(said))


def residual(bits: Bits, row: int) -> int:
    length = 0
    while length < 24 and bits.code(row + length):
        length += 1
    if not length:
        return 0
    sign = -1 if bits.even(1) else 1
    return sign * (1 << (length - 1) | bits.even(length - 1))


def corners(f: Array, brick: Place, shifts: list[int]) -> Array:
    """The potential at the corners around the samples of a brick, [9, 9, 9], by the nodes that it needs."""
    for place, shift in zip(brick, shifts):
        h, out = 1 << shift, []
        for corner in range(9):
            cell = min(corner, 7) >> shift
            p = (8 * place & (h - 1)) + corner - cell * h
            q = h - p
            w = [q**3, 4 * h**3 - 6 * h * p * p + 3 * p**3, 4 * h**3 - 6 * h * q * q + 3 * q**3, p**3]
            out.append((sum(w[n] * f[cell + n] for n in range(4)) + (h**3 >> 1)) >> (3 * shift))
        f = np.stack(out, axis=-1)
    return f


def forces(f: Array, scales: list[int]) -> Array:
    maps = []
    for along in (None, 0, 1, 2):
        m = f
        for axis in range(3):
            m = np.diff(m, axis=axis) if axis == along else m.take(range(1, 9), axis) + m.take(range(8), axis)
        maps.append(m)
    size = np.clip((maps[0] + 864) // 1728, 0, 65536)
    slopes = [np.clip(m * scale >> 20, -(1 << 20), 1 << 20) for m, scale in zip(maps[1:], scales)]
    steep = np.array([max(isqrt(int(n)), 1 << 14) for n in sum(s * s for s in slopes).flat]).reshape(8, 8, 8)
    return np.stack([(steep - 2 * size * s) // (2 * steep) for s in slopes], axis=-1)


# -- kind 1: columns ---------------------------------------------------------------------------------------

Z, A = 2, 3


class Surface(NamedTuple):
    """X, Y, Z, A within their limits, the direction of X, Y, and the residuals."""

    told: list[int]
    u: Place
    residuals: list[int]


def direction(x: int, y: int) -> Place:
    """The direction that X and Y stand for, 1/16384: along a, along b, outward."""
    double = (1 << 43) // ((1 << 28) + x * x + y * y)
    return x * double >> 14, y * double >> 14, max(820, double - 16384)


class Told(NamedTuple):
    """The head of columns, and the bits of what is told."""

    top: int
    ramp: int
    ratio_a: int
    ratio_b: int
    xy_step: int
    z_step: int
    a_step: int
    bits: Bits

    def rise(self, u: Place, axis: int) -> int:
        """How much farther inside a surface is one column on."""
        return bounded(u[axis] * (self.ratio_a, self.ratio_b)[axis] // u[2], 4096)

    def bit(self, node: int, first: int, second: int) -> int:
        return self.bits.mix(((node, 1, first), (node, 2, second)), node)

    def number(self, node: int, first: int, second: int) -> int:
        if not self.bit(node, first, second):
            return 0
        sign, v = -1 if self.bit(node + 1, first, second) else 1, 1
        while v <= 20 and self.bit(node + 1 + v, first, second):
            v += 1
        return sign * (v if v <= 20 else 20 + self.bits.gamma(24))


def column(head: Told, near: list[list[Surface]]) -> list[Surface]:
    """The surfaces of a column, behind those of W, N, C, E."""
    here, twos = (sum(8 >> n for n in range(4) if len(near[n]) > m) for m in (0, 1))
    if not head.bit(0, here, twos):
        return []
    apart = near[0] and near[1] and abs(near[0][0].told[Z] - near[1][0].told[Z]) > 768
    torn, mode = int(twos >> 2 > 0 or bool(apart)), 0
    count = 1 + head.bit(1, 2 * twos + torn, here)
    if torn:
        mode = head.bit(22, twos >> 2, count)
        mode = 2 * mode + head.bit(23 + mode, twos >> 2, count)
    few, own = min(3, sum(len(k) > 0 for k in near)), list[Surface]()
    for slot in range(count):
        (likely, sides), r = surface_expected(head, near, own, mode, count), list[int]()
        for c in range(4):
            w, n = (min(4, abs(k[slot].residuals[c])) if len(k) > slot else 5 for k in near[:2])
            last = min(3, max(map(abs, r[:2] if c == Z else r[-1:]), default=0))
            r.append(head.number(22 * (2 + 4 * (count - 1 + slot) + c), 6 * w + n, 4 * last + few))
        x, y = (bounded(e + n * head.xy_step, 16384) for e, n in zip(likely[:2], r))
        u = direction(x, y)
        if sides:
            starts = [side.told[Z] + (head.rise(side.u, c) + head.rise(u, c) >> 1) for side, c in sides]
            likely[Z] = sum(starts) // len(starts)
        a = likely[A] + r[A] * max(1, max(likely[A], head.top >> 4) * head.a_step >> 16)
        told = [x, y, bounded(likely[Z] + r[Z] * head.z_step, 1 << 24), bounded(a, LIMIT, 1)]
        own.append(Surface(told, u, r))
    return own


def surface_expected(
    head: Told, near: list[list[Surface]], own: list[Surface], mode: int, count: int
) -> tuple[list[int], list[tuple[Surface, int]]]:
    """X, Y, Z, A that the sides of a surface make likely, and the sides; `own` are those of its column before
    it.
    """
    k = 1 if own or mode == 3 else 0
    west, north, corner = (n[k] if len(n) > k else None for n in near[:3])
    if not own and mode:
        west, north = (west, None) if mode == 1 or (mode == 3 and west) else (None, north)
    sides = [(side, c) for side, c in ((west, 1), (north, 0)) if side]
    if sides:
        out = [sum(n) // len(sides) for n in zip(*(side.told for side, _ in sides))]
        if west and north and corner:
            beside = zip(out[:2], west.told, north.told, corner.told)
            out[:2] = [o + sorted((w, n, w + n - c))[1] >> 1 for o, w, n, c in beside]
    elif own:
        out = [*own[0].told[:2], own[0].told[Z] + 1536, 0]
    else:
        out = list(near[3][0].told) if near[3] else [0, 0, 0, head.top]
    if own:
        out[A] = max(head.top >> 4, head.top - own[0].told[A])
    elif count == 2:
        out[A] = head.top >> 1
    return out, sides


def columns(data: bytes, shape: Place) -> Units:
    """The guess of columns over a grid of `shape` samples."""
    c = Cursor(data)
    axis, inverted = divmod(c.varint(6), 2)
    across, depth = [n for n in range(3) if n != axis], shape[axis]
    tiles = [-(-shape[n] // 8) for n in across]
    first = [c.varint(n) for n in tiles]
    box = [range(a, a + c.varint(n) + 1) for a, n in zip(first, tiles)]
    limits = 17, 20, 20, 20, 14, 12, 16
    top, ramp, ratio_a, ratio_b, xy_step, z_step, a_step = (c.varint(1 << n) for n in limits)
    need(all(b[-1] < n for b, n in zip(box, tiles)) and depth <= 1 << 14, "a box beyond the grid")
    bits = Bits(c.rest())
    need(len(box[0]) * len(box[1]) - 64 <= len(bits.data), "a box of many tiles", TruncatedFile)
    head, surfaces = (
        Told(top, ramp, ratio_a, ratio_b, xy_step, z_step, a_step, bits),
        dict[Place, list[Surface]](),
    )
    for a, b in product(*(range(8 * n[0], min(8 * n[-1] + 8, shape[m])) for n, m in zip(box, across))):
        near = [surfaces.get(p, []) for p in ((a, b - 1), (a - 1, b), (a - 1, b - 1), (a - 1, b + 1))]
        if own := column(head, near):
            surfaces[a, b] = own
    bits.check()
    starts: dict[Place, int] = {}
    for (a, b), own in surfaces.items():
        starts[a // 8, b // 8] = min(
            starts.get((a // 8, b // 8), depth), *((s.told[Z] >> 8) + 1 for s in own)
        )
    told = set[Place]()
    for tile, start in starts.items():
        for n in range(-(-depth // 8)) if start < depth else ():
            if 8 * n < depth - start if inverted else 8 * n + 8 > start:
                told.add((*tile[:axis], n, *tile[axis:]))
    need(-(-(len(told) - 64) // 16) <= len(bits.data), f"{len(told)} bricks", TruncatedFile)
    bits.end(len(told), len(box[0]) * len(box[1]))
    out, t = Units(sorted(told), {}), np.arange(depth)
    for (a, b), own in surfaces.items():
        total = np.zeros((depth, 3), np.int64)
        for s in own:
            share = np.clip((256 * t - s.told[Z]) * max(16, ramp * s.u[2] >> 14) >> 8, 0, 65536)
            total += share[:, None] * [(s.told[A] * u + 8192) >> 14 for u in s.u]
        force = np.clip((total + 32768) >> 16, -LIMIT, LIMIT)
        force = force[::-1] if inverted else force * [1, 1, -1]
        for n in np.flatnonzero(force.any(axis=1)).tolist():
            at = (*(a, b)[:axis], n, *(a, b)[axis:])
            if brick_of(at) in told:
                out.vectors[at] = force[n, np.argsort([*across, axis])].astype(object)
    return out
