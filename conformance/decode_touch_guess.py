"""The part of the second decoder for coder `touch` that makes guesses: docs/format/touch-guess.md, step by step."""

from __future__ import annotations

from itertools import combinations, product
from math import isqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray
from reading import Cursor, TruncatedFile, need
from touch_bits import Bits, Place, bricks

__all__ = ["columns", "spline"]

Array = NDArray[Any]
Field = dict[Place, Array]
"""Bricks and their forces, units, int64 [8, 8, 8, 3]."""

LIMIT = (1 << 17) - 1
SPLINE = (6, 6, 6, 1 << 20, 1 << 20, 1 << 20, 1 << 20)
COLUMNS = (1 << 17, 1 << 20, 1 << 20, 1 << 20, 1 << 14, 1 << 12, 1 << 16)


def head(data: bytes, limits: tuple[int, ...]) -> tuple[list[int], bytes]:
    """Varints below some limits, and the bytes behind them."""
    c, out = Cursor(data), []
    for limit in limits:
        out.append(c.varint())
        need(out[-1] < limit, f"{out[-1]} in the head of a guess")
    return out, data[c.at :]


def check_end(bits: Bits) -> None:
    """Refuse a code that ends too early."""
    need(bits.place <= len(bits.data) + 6, "the end of the code of a guess", TruncatedFile)


def bounded(value: int, low: int, high: int) -> int:
    return max(low, min(value, high))


# -- kind 0: a spline -------------------------------------------------------------------------------------


def spline(data: bytes, shape: Place) -> Field:
    """The guess of a spline over a grid of `shape` samples."""
    (*shifts, step, a, b, c), code = head(data, SPLINE)
    need(min(shifts) > 1 and min(step, a, b, c) > 0, "too small a number in the head of a guess")
    bits = Bits(code)
    told = bricks(bits, tuple(-(-n // 8) for n in shape))
    need(told, "a guess without bricks")
    around = [[range((8 * b >> s) - 1, (8 * b + 7 >> s) + 3) for b, s in zip(brick, shifts)] for brick in told]
    nodes: dict[Place, int] = {}
    sizes: dict[Place, int] = {}
    for node in sorted({node for ranges in around for node in product(*ranges)}):
        r = residual(bits, 24 * min(sum(sizes.get(beside(node, d), 0) for d in STEPS).bit_length(), 9))
        sizes[node] = abs(r)
        nodes[node] = bounded(expected(nodes, node) + r * step, -(1 << 23), 1 << 23)
    check_end(bits)
    out = {}
    for brick, ranges in zip(told, around):
        own = np.array([nodes[node] for node in product(*ranges)]).reshape([len(r) for r in ranges])
        out[brick] = forces(corners(own, brick, shifts), (a, b, c))
        for axis in range(3):
            np.moveaxis(out[brick], axis, 0)[max(0, shape[axis] - 8 * brick[axis]) :] = 0
    return out


STEPS = ((1, 0, 0), (0, 1, 0), (0, 0, 1))


def beside(node: Place, *steps: Place) -> Place:
    return tuple(n - sum(s) for n, s in zip(node, zip(*steps)))


def expected(nodes: dict[Place, int], node: Place) -> int:
    faces = [(beside(node, a), beside(node, b), beside(node, a, b)) for a, b in combinations(STEPS, 2)]
    said = [
        nodes[one] + nodes[other] - nodes[both] for one, other, both in faces if {one, other, both} <= nodes.keys()
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


def forces(f: Array, scales: Place) -> Array:
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


# -- kind 1: columns --------------------------------------------------------------------------------------

X, Y, Z, A = range(4)
Column = tuple[int, int]


class Surface:
    """X, Y, Z, A within their limits, the direction of X, Y, and how large the residuals were."""

    def __init__(self, told: list[int], sizes: list[int]) -> None:
        x, y = (bounded(n, -16384, 16384) for n in told[:2])
        self.told = x, y, bounded(told[Z], -(1 << 24), 1 << 24), bounded(told[A], 1, LIMIT)
        self.sizes = sizes
        double = (1 << 43) // ((1 << 28) + x * x + y * y)
        self.u = x * double >> 14, y * double >> 14, max(820, double - 16384)


class Columns:
    """The columns of a frame, as they are read."""

    def __init__(self, data: bytes, shape: Place) -> None:
        self.axis, self.shape = data[0] >> 1 if data else 0, shape
        need(self.axis < 3, "the axis of a guess")
        self.across = [c for c in range(3) if c != self.axis]
        tiles = [-(-shape[c] // 8) for c in self.across]
        (told, a, b, *self.size), code = head(data, (6, *tiles, *tiles, *COLUMNS))
        self.inverted, self.heads = told & 1, self.size[2:]
        self.box = [range(a, a + self.size[0] + 1), range(b, b + self.size[1] + 1)]
        within = all(box[-1] < n for box, n in zip(self.box, tiles))
        need(within and shape[self.axis] <= 1 << 14, "a box beyond the grid")
        need(len(self.box[0]) * len(self.box[1]) - 64 <= len(code), "a box of many tiles", TruncatedFile)
        self.bits, self.surfaces = Bits(code), dict[Column, list[Surface]]()
        rows, row = (range(8 * box[0], min(8 * box[-1] + 8, shape[c])) for box, c in zip(self.box, self.across))
        for column in product(rows, row):
            self.read(column)
        check_end(self.bits)

    def bit(self, node: int, first: int, second: int) -> int:
        return self.bits.mix((52 * node + first, 52 * node + 36 + second), node)

    def number(self, node: int, first: int, second: int) -> int:
        if not self.bit(node, first, second):
            return 0
        sign = -1 if self.bit(node + 1, first, second) else 1
        v = 1
        while v <= 20 and self.bit(node + 1 + v, first, second):
            v += 1
        return sign * (v if v <= 20 else 20 + self.bits.gamma(24))

    def read(self, column: Column) -> None:
        a, b = column
        near = [self.surfaces.get(p, []) for p in ((a, b - 1), (a - 1, b), (a - 1, b - 1), (a - 1, b + 1))]
        here, twos = (sum(8 >> n for n in range(4) if len(near[n]) > m) for m in (0, 1))
        count = self.bit(0, here, twos)
        if not count:
            return
        apart = near[0] and near[1] and abs(near[0][0].told[Z] - near[1][0].told[Z]) > 768
        torn = int(twos >> 2 > 0 or bool(apart))
        count += self.bit(1, 2 * twos + torn, here)
        mode = 0
        if torn:
            mode = self.bit(22, twos >> 2, count)
            mode = 2 * mode + self.bit(23 + mode, twos >> 2, count)
        few, own = min(3, sum(len(k) > 0 for k in near)), list[Surface]()
        for slot in range(count):
            expected = self.expected(near, own, mode, count)
            west, north = (k[slot] if len(k) > slot else None for k in near[:2])
            r: list[int] = []
            for c in range(4):
                sizes = [min(4, abs(s.sizes[c])) if s else 5 for s in (west, north)]
                last = min(3, max(map(abs, r[:2] if c == Z else r[-1:]), default=0))
                node = 22 * (2 + 4 * (count - 1 + slot) + c)
                r.append(self.number(node, 6 * sizes[0] + sizes[1], 4 * last + few))
            top, xy, z, share = self.heads[0], *self.heads[4:]
            steps = xy, xy, z, max(1, max(expected[A], top >> 4) * share >> 16)
            own.append(Surface([e + n * s for e, n, s in zip(expected, r, steps)], r))
        self.surfaces[column] = own

    def expected(self, near: list[list[Surface]], own: list[Surface], mode: int, count: int) -> list[int]:
        slot, top = len(own), self.heads[0]
        k = slot if slot else int(mode == 3)
        west, north = (n[k] if len(n) > k else None for n in near[:2])
        mode = 0 if slot else mode
        if mode == 2:
            west = None
        elif mode == 1 or (mode == 3 and west):
            north = None
        sides = []
        for side, c in ((west, 1), (north, 0)):
            if side:
                rise = bounded(side.u[c] * self.heads[2 + c] // side.u[2], -4096, 4096)
                sides.append([n + rise * (q == Z) for q, n in enumerate(side.told)])
        if sides:
            out = [sum(n) // len(sides) for n in zip(*sides)]
        elif slot:
            out = [n + 1536 * (q == Z) for q, n in enumerate(own[0].told)]
        else:
            out = list(near[3][0].told) if near[3] else [0, 0, 0, top]
        if slot:
            out[A] = max(top >> 4, top - own[0].told[A])
        elif count == 2:
            out[A] = top >> 1
        return out

    def field(self) -> Field:
        """The forces: bricks from where the first surface of a tile starts to the end of the grid inside."""
        depth, starts = self.shape[self.axis], dict[Column, int]()
        for (a, b), surfaces in self.surfaces.items():
            tile = a // 8, b // 8
            starts[tile] = min(starts.get(tile, depth), *((s.told[Z] >> 8) + 1 for s in surfaces), depth)
        out = {}
        for tile, start in starts.items():
            for n in range(-(-depth // 8)) if start < depth else ():
                if 8 * n < depth - start if self.inverted else 8 * n + 8 > start:
                    out[self.place(tile, n)] = np.zeros((8, 8, 8, 3), np.int64)
        need(-(-(len(out) - 64) // 16) <= len(self.bits.data), f"{len(out)} bricks", TruncatedFile)
        t = np.arange(depth)
        for (a, b), surfaces in self.surfaces.items():
            total = np.zeros((depth, 3), np.int64)
            for s in surfaces:
                share = np.clip((256 * t - s.told[Z]) * max(16, self.heads[1] * s.u[2] >> 14) >> 8, 0, 65536)
                total += share[:, None] * [(s.told[A] * u + 8192) >> 14 for u in s.u]
            force = np.clip((total + 32768) >> 16, -LIMIT, LIMIT)
            force = force[::-1] if self.inverted else force * [1, 1, -1]
            for n in range(0, depth, 8):
                brick = self.place((a // 8, b // 8), n // 8)
                if brick in out:
                    cells = np.moveaxis(out[brick], self.axis, 2)[a % 8, b % 8]
                    cells[: depth - n, [*self.across, self.axis]] = force[n : n + 8]
        return dict(sorted(out.items()))

    def place(self, tile: Column, n: int) -> Place:
        brick = list(tile)
        brick.insert(self.axis, n)
        return tuple(brick)


def columns(data: bytes, shape: Place) -> Field:
    """The guess of columns over a grid of `shape` samples."""
    return Columns(data, shape).field()
