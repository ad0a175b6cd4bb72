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
COLUMNS = (6, 1 << 17, 1 << 20, 1 << 20, 1 << 20, 1 << 12, 1 << 14, 1 << 16, 1 << 17)


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

PRESENT, MODE, TWO, XY, START, AMPLITUDE, HALF, START_2, XY_2, AMPLITUDE_2 = range(10)
FAR = 1 << 24
Column = tuple[int, int]


class Surface:
    """A start, a point of the disc, an amplitude, and the direction that the point stands for."""

    def __init__(self, z: int, x: int, y: int, amplitude: int) -> None:
        self.z, self.amplitude = bounded(z, -FAR, FAR), bounded(amplitude, 1, LIMIT)
        self.xy = x, y = bounded(x, -32767, 32767), bounded(y, -32767, 32767)
        square = x * x + y * y
        if square > 1 << 29:
            scale = (23170 << 14) // isqrt(square)
            x, y = x * scale >> 14, y * scale >> 14
            square = x * x + y * y
        m = isqrt((1 << 28) - (square >> 2))
        self.u = x * m >> 14, y * m >> 14, max(820, 16384 - (square >> 15))


def rise(s: Surface, c: int, ratio: int) -> int:
    return bounded(s.u[c] * ratio // s.u[2], -4096, 4096)


def median(a: int, b: int, c: int) -> int:
    return sorted((a, b, c))[1]


class Columns:
    """The columns of a frame, as they are read."""

    def __init__(self, data: bytes, shape: Place) -> None:
        (told, *self.heads), code = head(data, COLUMNS)
        self.axis, self.inverted, self.shape = told >> 1, told & 1, shape
        self.across = [c for c in range(3) if c != self.axis]
        self.bits = Bits(code)
        size = [shape[c] for c in self.across]
        self.tiles = bricks(self.bits, (-(-size[0] // 8), -(-size[1] // 8), 1))
        need(self.tiles, "a guess without tiles")
        need(len(self.tiles) - 64 <= len(code), f"{len(self.tiles)} tiles", TruncatedFile)
        self.surfaces: dict[Column, list[Surface]] = {}
        self.sizes: dict[Column, tuple[int, int, int]] = {}
        self.last: Surface | None = None
        for tile in self.tiles:
            for i, j in product(range(8), repeat=2):
                column = 8 * tile[0] + i, 8 * tile[1] + j
                if column[0] < size[0] and column[1] < size[1]:
                    self.read(column, i, j)
        check_end(self.bits)

    def bit(self, kind: int, node: int, first: int, second: int) -> int:
        at = 96 * (22 * kind + node)
        return self.bits.mix((at + first, at + 64 + second), 22 * kind + node)

    def number(self, kind: int, first: int, second: int) -> int:
        if not self.bit(kind, 0, first, second):
            return 0
        sign = -1 if self.bit(kind, 1, first, second) else 1
        v = 1
        while v <= 20 and self.bit(kind, 1 + v, first, second):
            v += 1
        if v > 20:
            d = 0
            while d < 24 and self.bits.even(1):
                d += 1
            v = 20 + (1 << d | self.bits.even(d))
        return sign * v

    def read(self, column: Column, i: int, j: int) -> None:
        a, b = column
        places = [(a, b - 1), (a - 1, b), (a - 1, b - 1), (a - 1, b + 1)]
        near = [p if p in self.surfaces else None for p in places]
        mask = sum(8 >> n for n in range(4) if near[n])
        if not self.bit(PRESENT, 0, mask, 8 * (i == 0) + 4 * (j == 0) + (mask >> 2)):
            return
        known = [self.surfaces[p] if p else None for p in near]
        twos = sum(8 >> n for n in range(4) if known[n] and len(known[n]) == 2)
        few = min(3, sum(p is not None for p in near))
        torn = twos >> 2 > 0 or (known[0] and known[1] and abs(known[0][0].z - known[1][0].z) > 768)
        two = self.bit(TWO, 0, twos, 4 * bool(torn) + few)
        mode = 0
        if torn:
            mode = self.bit(MODE, 0, twos >> 2, two)
            mode = 2 * mode + self.bit(MODE, 1 + mode, twos >> 2, two)
        sides = self.sides(mode, known)
        xy, z, am = ([min(self.sizes[p][n], m) if p else m for p in near[:2]] for n, m in enumerate((4, 6, 4)))
        f = 5 * xy[0] + xy[1]
        r = [self.number(XY, f, few)]
        r.append(self.number(XY, 25 + f, 4 + 4 * min(abs(r[0]), 3) + few))
        turned = max(min(abs(n), 3) for n in r)
        z_step, xy_step, a_step = self.heads[4:7]
        at = self.point(sides)
        own = Surface(0, at[0] + r[0] * xy_step, at[1] + r[1] * xy_step, 1)
        start, amplitude = self.start(sides, own), self.amplitude(sides, two)
        r.append(self.number(START, 7 * z[0] + z[1], 4 * turned + few))
        deep = min(abs(r[2]), 3)
        r.append(self.number(HALF if two else AMPLITUDE, 5 * am[0] + am[1], 4 * deep + turned))
        top = self.heads[0]
        amplitude += r[3] * max(1, (top if two else amplitude) * a_step >> 16)
        own = Surface(start + r[2] * z_step, *own.xy, amplitude)
        self.surfaces[column], self.sizes[column] = [own], (abs(r[0]) + abs(r[1]), abs(r[2]), abs(r[3]))
        if two:
            expected = self.second(known, own)
            f = 4 * (twos > 0) + deep
            r = [self.number(START_2, f, 0), self.number(XY_2, f, 0)]
            r += [self.number(XY_2, 8 + f, 1 + min(abs(r[1]), 3)), self.number(AMPLITUDE_2, f, 0)]
            steps = z_step, xy_step, xy_step, max(1, top * a_step >> 16)
            self.surfaces[column].append(Surface(*(e + n * s for e, n, s in zip(expected, r, steps))))
        self.last = own

    def sides(self, mode: int, known: list[Any]) -> list[Any]:
        """What is predicted from, to the west, north, north-west and north-east: a surface, and a whole amplitude."""
        sides = [(k[0], sum(s.amplitude for s in k)) if k else None for k in known]
        if mode == 3:
            place = next((n for n in range(2) if known[n] and len(known[n]) == 2), -1)
            need(place >= 0, "a column predicted from none")
            sides[place] = (known[place][1], known[place][1].amplitude)
            mode = place + 1
        need(not mode or sides[mode - 1], "a column predicted from none")
        return [side if mode in (0, n + 1) else None for n, side in enumerate(sides)]

    def point(self, sides: list[Any]) -> tuple[int, ...]:
        west, north, corner, _ = sides
        if west and north:
            pairs = list(zip(west[0].xy, north[0].xy))
            if not corner:
                return tuple((a + b) >> 1 for a, b in pairs)
            return tuple(((a + b >> 1) + median(a, b, a + b - c)) >> 1 for (a, b), c in zip(pairs, corner[0].xy))
        return self.other(sides).xy

    def other(self, sides: list[Any]) -> Surface:
        """The one side there is, else the column read last."""
        west, north, corner, east = sides
        side = west or north or east or corner
        return side[0] if side else self.last or Surface(0, 0, 0, 1)

    def start(self, sides: list[Any], own: Surface) -> int:
        west, north, corner, _ = sides
        said = []
        for side, c in ((west, 1), (north, 0)):
            ratio = self.heads[2 + c]
            if side:
                said.append(side[0].z + ((rise(own, c, ratio) + rise(side[0], c, ratio)) >> 1))
        if len(said) < 2:
            return said[0] if said else self.other(sides).z
        if not corner:
            return sum(said) >> 1
        return ((sum(said) >> 1) + median(*said, west[0].z + north[0].z - corner[0].z)) >> 1

    def amplitude(self, sides: list[Any], two: int) -> int:
        top, (west, north, corner, _) = self.heads[0], sides
        if two:
            return top >> 1
        if not (west and north):
            return min(top, (west or north)[1]) if west or north else top
        return min(top, median(west[1], north[1], west[1] + north[1] - (corner or west)[1]))

    def second(self, known: list[Any], own: Surface) -> list[int]:
        top = self.heads[0]
        seconds = [k[1] for k in known if k and len(k) == 2]
        if seconds:
            out = [sum(n) // len(seconds) for n in zip(*((s.z, *s.xy) for s in seconds))]
        else:
            behind = [k[0] for k in known if k and k[0].z > own.z + 768]
            deepest = max(behind, key=lambda s: s.z) if behind else None
            out = [deepest.z, *deepest.xy] if deepest else [own.z + 1536, *own.xy]
        return [*out, max(top >> 4, top - own.amplitude)]

    def field(self) -> Field:
        """The forces: bricks from the first sample with any, of a tile, to the end of the grid inside."""
        depth, out = self.shape[self.axis], {}
        ramp, cut = self.heads[1], self.heads[7]
        first = dict.fromkeys(((a, b) for a, b, _ in self.tiles), depth)
        for (a, b), surfaces in self.surfaces.items():
            t = max(0, (min(s.z for s in surfaces) >> 8) + 1)
            first[a // 8, b // 8] = min(first[a // 8, b // 8], t)
        for tile, begin in first.items():
            if begin < depth:
                inner = range(-(-(depth - begin) // 8)) if self.inverted else range(begin // 8, -(-depth // 8))
                for n in inner:
                    out[self.place(tile, n)] = np.zeros((8, 8, 8, 3), np.int64)
        need(-(-(len(out) - 64) // 16) <= len(self.bits.data), f"{len(out)} bricks", TruncatedFile)
        t = np.arange(depth)
        for (a, b), surfaces in self.surfaces.items():
            total, length = np.zeros((depth, 3), np.int64), np.zeros(depth, np.int64)
            for s in surfaces:
                share = np.clip((256 * t - s.z) * max(16, ramp * s.u[2] >> 14) >> 8, 0, 65536)
                length += share * s.amplitude
                total += share[:, None] * [(s.amplitude * u + 8192) >> 14 for u in s.u]
            force = np.clip((total + 32768) >> 16, -LIMIT, LIMIT)
            force[(length <= cut << 16) | (256 * t <= min(s.z for s in surfaces))] = 0
            if self.inverted:
                force = force[::-1]
            else:
                force[:, 2] *= -1
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
