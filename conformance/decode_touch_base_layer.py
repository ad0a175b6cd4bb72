"""Decodes base layers of coder `touch`, parametric predictions that the encoder sends before the residuals,
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
    """The base layer of a spline over a grid of `shape` samples."""
    c = Cursor(data)
    shifts, (step, *scales) = [c.varint(6, 2) for _ in range(3)], [c.varint(1 << 20, 1) for _ in range(4)]
    bits = Bits(c.rest())
    listed = bricks(bits, shape)
    need(listed, "a base layer without bricks")
    around = [
        [range((8 * b >> s) - 1, (8 * b + 7 >> s) + 3) for b, s in zip(brick, shifts)] for brick in listed
    ]
    nodes, sizes = dict[Place, int](), dict[Place, int]()
    for node in sorted({node for ranges in around for node in product(*ranges)}):
        r = residual(bits, 24 * min(sum(sizes.get(before(node, d), 0) for d in STEPS).bit_length(), 9))
        sizes[node] = abs(r)
        nodes[node] = bounded(expected(nodes, node) + r * step, 1 << 23)
    bits.end(len(listed))
    vectors: dict[Place, Array] = {}
    for brick, ranges in zip(listed, around):
        own = np.array([nodes[node] for node in product(*ranges)]).reshape([len(r) for r in ranges])
        vectors_of_brick = forces(corners(own, brick, shifts), scales).astype(object)
        vectors |= {
            at: vectors_of_brick[inside(at)]
            for at in samples_of(brick, shape)
            if vectors_of_brick[inside(at)].any()
        }
    return Units(listed, vectors)


def before(node: Place, *steps: Place) -> Place:
    return tuple(n - sum(s) for n, s in zip(node, zip(*steps)))


def expected(nodes: dict[Place, int], node: Place) -> int:
    faces = [(before(node, a), before(node, b), before(node, a, b)) for a, b in combinations(STEPS, 2)]
    means = [nodes[p] + nodes[q] - nodes[pq] for p, q, pq in faces if {p, q, pq} <= nodes.keys()]
    means = means or [nodes[before(node, a)] for a in STEPS if before(node, a) in nodes] or [0]
    return (2 * sum(means) + len(means)) // (2 * len(means))


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
        spacing, out = 1 << shift, []
        for corner in range(9):
            span = min(corner, 7) >> shift
            p = (8 * place & (spacing - 1)) + corner - span * spacing
            q = spacing - p
            second, third = (4 * spacing**3 - 6 * spacing * n * n + 3 * n**3 for n in (p, q))
            weights = [q**3, second, third, p**3]
            out.append((sum(weights[n] * f[span + n] for n in range(4)) + (spacing**3 >> 1)) >> (3 * shift))
        f = np.stack(out, axis=-1)
    return f


def forces(f: Array, scales: list[int]) -> Array:
    sums = []
    for difference_axis in (None, 0, 1, 2):
        m = f
        for axis in range(3):
            m = (
                np.diff(m, axis=axis)
                if axis == difference_axis
                else m.take(range(1, 9), axis) + m.take(range(8), axis)
            )
        sums.append(m)
    depth = np.clip((sums[0] + 864) // 1728, 0, 65536)
    gradients = [np.clip(m * scale >> 20, -(1 << 20), 1 << 20) for m, scale in zip(sums[1:], scales)]
    steepness = np.array([max(isqrt(int(n)), 1 << 14) for n in sum(s * s for s in gradients).flat]).reshape(
        8, 8, 8
    )
    return np.stack([(steepness - 2 * depth * s) // (2 * steepness) for s in gradients], axis=-1)


# -- kind 1: columns ---------------------------------------------------------------------------------------

START, AMPLITUDE = 2, 3


class Surface(NamedTuple):
    """Direction (two numbers), start and amplitude; the normal; the residuals of these four numbers."""

    numbers: list[int]
    normal: Place
    residuals: list[int]


def normal_of(x: int, y: int) -> Place:
    """The normal of the direction numbers x and y, 1/16384: along a, along b, outward."""
    inverse = (1 << 43) // ((1 << 28) + x * x + y * y)
    return x * inverse >> 14, y * inverse >> 14, max(820, inverse - 16384)


class Head(NamedTuple):
    """The head of columns, and the bits of their code."""

    top: int
    ramp: int
    ratio_a: int
    ratio_b: int
    direction_step: int
    start_step: int
    amplitude_step: int
    bits: Bits

    def rise(self, normal: Place, axis: int) -> int:
        """How much farther inside a surface starts one column on."""
        return bounded(normal[axis] * (self.ratio_a, self.ratio_b)[axis] // normal[2], 4096)

    def bit(self, node: int, first: int, second: int) -> int:
        return self.bits.mix(((node, 1, first), (node, 2, second)), node)

    def number(self, node: int, first: int, second: int) -> int:
        if not self.bit(node, first, second):
            return 0
        sign, v = -1 if self.bit(node + 1, first, second) else 1, 1
        while v <= 20 and self.bit(node + 1 + v, first, second):
            v += 1
        return sign * (v if v <= 20 else 20 + self.bits.gamma(24))


def column(head: Head, near: list[list[Surface]]) -> list[Surface]:
    """The surfaces of a column, given those of west, north, corner and east."""
    here, twos = (sum(8 >> n for n in range(4) if len(near[n]) > m) for m in (0, 1))
    if not head.bit(0, here, twos):
        return []
    is_step = near[0] and near[1] and abs(near[0][0].numbers[START] - near[1][0].numbers[START]) > 768
    torn, mode = int(twos >> 2 > 0 or bool(is_step)), 0
    count = 1 + head.bit(1, 2 * twos + torn, here)
    if torn:
        mode = head.bit(22, twos >> 2, count)
        mode = 2 * mode + head.bit(23 + mode, twos >> 2, count)
    with_surface, own = min(3, sum(len(k) > 0 for k in near)), list[Surface]()
    for slot in range(count):
        (expected, continued), r = surface_expected(head, near, own, mode, count), list[int]()
        for c in range(4):
            w, n = (min(4, abs(k[slot].residuals[c])) if len(k) > slot else 5 for k in near[:2])
            last = min(3, max(map(abs, r[:2] if c == START else r[-1:]), default=0))
            r.append(head.number(22 * (2 + 4 * (count - 1 + slot) + c), 6 * w + n, 4 * last + with_surface))
        x, y = (bounded(e + n * head.direction_step, 16384) for e, n in zip(expected[:2], r))
        normal = normal_of(x, y)
        if continued:
            starts = [
                surface.numbers[START] + (head.rise(surface.normal, c) + head.rise(normal, c) >> 1)
                for surface, c in continued
            ]
            expected[START] = sum(starts) // len(starts)
        start = expected[START] + r[START] * head.start_step
        amplitude_step = max(1, max(expected[AMPLITUDE], head.top >> 4) * head.amplitude_step >> 16)
        amplitude = expected[AMPLITUDE] + r[AMPLITUDE] * amplitude_step
        numbers = [x, y, bounded(start, 1 << 24), bounded(amplitude, LIMIT, 1)]
        own.append(Surface(numbers, normal, r))
    return own


def surface_expected(
    head: Head, near: list[list[Surface]], own: list[Surface], mode: int, count: int
) -> tuple[list[int], list[tuple[Surface, int]]]:
    """The four numbers that are expected of a surface, and the surfaces that it continues with the axes along
    which they lie; `own` are the surfaces of its column that are decoded.
    """
    k = 1 if own or mode == 3 else 0
    west, north, corner = (n[k] if len(n) > k else None for n in near[:3])
    if not own and mode:
        west, north = (west, None) if mode == 1 or (mode == 3 and west) else (None, north)
    continued = [(surface, c) for surface, c in ((west, 1), (north, 0)) if surface]
    if continued:
        out = [sum(n) // len(continued) for n in zip(*(surface.numbers for surface, _ in continued))]
        if west and north and corner:
            planes = zip(out[:2], west.numbers, north.numbers, corner.numbers)
            out[:2] = [o + sorted((w, n, w + n - c))[1] >> 1 for o, w, n, c in planes]
    elif own:
        out = [*own[0].numbers[:2], own[0].numbers[START] + 1536, 0]
    else:
        out = list(near[3][0].numbers) if near[3] else [0, 0, 0, head.top]
    if own:
        out[AMPLITUDE] = max(head.top >> 4, head.top - own[0].numbers[AMPLITUDE])
    elif count == 2:
        out[AMPLITUDE] = head.top >> 1
    return out, continued


def columns(data: bytes, shape: Place) -> Units:
    """The base layer of columns over a grid of `shape` samples."""
    c = Cursor(data)
    axis, inverted = divmod(c.varint(6), 2)
    across, depth = [n for n in range(3) if n != axis], shape[axis]
    tiles = [-(-shape[n] // 8) for n in across]
    first = [c.varint(n) for n in tiles]
    box = [range(a, a + c.varint(n) + 1) for a, n in zip(first, tiles)]
    limits = 17, 20, 20, 20, 14, 12, 16
    top, ramp, ratio_a, ratio_b, direction_step, start_step, amplitude_step = (
        c.varint(1 << n) for n in limits
    )
    need(all(b[-1] < n for b, n in zip(box, tiles)) and depth <= 1 << 14, "a box beyond the grid")
    bits = Bits(c.rest())
    need(len(box[0]) * len(box[1]) - 64 <= len(bits.data), "a box of many tiles", TruncatedFile)
    head, surfaces = (
        Head(top, ramp, ratio_a, ratio_b, direction_step, start_step, amplitude_step, bits),
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
            starts.get((a // 8, b // 8), depth), *((s.numbers[START] >> 8) + 1 for s in own)
        )
    listed = set[Place]()
    for tile, start in starts.items():
        for n in range(-(-depth // 8)) if start < depth else ():
            if 8 * n < depth - start if inverted else 8 * n + 8 > start:
                listed.add((*tile[:axis], n, *tile[axis:]))
    need(-(-(len(listed) - 64) // 16) <= len(bits.data), f"{len(listed)} bricks", TruncatedFile)
    bits.end(len(listed), len(box[0]) * len(box[1]))
    out, t = Units(sorted(listed), {}), np.arange(depth)
    for (a, b), own in surfaces.items():
        total = np.zeros((depth, 3), np.int64)
        for s in own:
            fraction = np.clip(
                (256 * t - s.numbers[START]) * max(16, ramp * s.normal[2] >> 14) >> 8, 0, 65536
            )
            total += fraction[:, None] * [(s.numbers[AMPLITUDE] * n + 8192) >> 14 for n in s.normal]
        force = np.clip((total + 32768) >> 16, -LIMIT, LIMIT)
        force = force[::-1] if inverted else force * [1, 1, -1]
        for n in np.flatnonzero(force.any(axis=1)).tolist():
            at = (*(a, b)[:axis], n, *(a, b)[axis:])
            if brick_of(at) in listed:
                out.vectors[at] = force[n, np.argsort([*across, axis])].astype(object)
    return out
