"""The part of the second decoder for the light frame models of coder `touch`, numbers 0 and 1.

Everything is told in the coordinates of the scan: (p, q, r), the slowest axis first, each ascending.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import product

from reference_decoder import (
    CERTAIN,
    RATES,
    SQUASH,
    STRETCH,
    Cursor,
    Position,
    brick_counts,
    decode_support,
    inside,
    need,
)
from reference_touch import LIMIT, Field, Lattice, Vector, along_axes, rebuilt, root

__all__ = ["decode_light"]

Key = tuple[object, ...]

EMPTY, CODED, DEEPER, OLD = range(4)

SATURATED = 64512

RATIO_CLASS = [*[0] * 17, 1, 2, 2, 3, 3, 3, *[4] * 4, *[5] * 5, *[6] * 13, *[7] * 19]

ENERGY_CLASS = [0, 1, 2, 2, 3, 3, 3, 4, 4, 4, 4, *[5] * 5, *[6] * 8, *[7] * 8]


class RangeCoder:
    """The arithmetic decoder of these models, and their chances."""

    def __init__(self, data: bytes) -> None:
        self.data, self.place = data, 6
        self.x = int.from_bytes(data[:6].ljust(6, b"\0"), "big")
        self.range = 1 << 48
        self.chances: dict[Key, list[int]] = {}
        self.weights: dict[Key, list[int]] = {}

    def bit(self, p: int) -> int:
        """A bit whose chance to be 1 is p / 65536."""
        bound = (self.range >> 16) * p
        bit = int(self.x < bound)
        if bit:
            self.range = bound
        else:
            self.x -= bound
            self.range -= bound
        if self.range < 1 << 32:
            need(self.place <= len(self.data) + 14, "the end of the code of a frame")
            word = self.data[self.place : self.place + 2].ljust(2, b"\0")
            self.x = self.x << 16 | int.from_bytes(word, "big")
            self.range <<= 16
            self.place += 2
        return bit

    def chance(self, context: Key) -> list[int]:
        """Chance (of 2^22) and visits of a context."""
        return self.chances.setdefault(context, [1 << 21, 0])

    def learn(self, context: Key, bit: int) -> None:
        """Teach a context a bit."""
        one = self.chance(context)
        one[0] += (CERTAIN * bit - one[0]) * RATES[one[1]] >> 19
        one[1] = min(one[1] + 1, 126)

    def plain(self, *context: object) -> int:
        """A bit by one context."""
        bit = self.bit(max(8, min(self.chance(context)[0] >> 6, 65528)))
        self.learn(context, bit)
        return bit

    def mixed(self, contexts: list[Key], chosen: Key) -> int:
        """A bit by three contexts."""
        weights = self.weights.setdefault(chosen, [26214] * 3)
        told = [STRETCH[self.chance(c)[0] >> 10] for c in contexts]
        x = sum(w * t for w, t in zip(weights, told)) >> 16
        p = SQUASH[max(-3072, min(x, 3071)) + 3072]
        bit = self.bit(p)
        error = 65536 * bit - p
        for n, t in enumerate(told):
            weights[n] += t * error + 8192 >> 14
        for c in contexts:
            self.learn(c, bit)
        return bit

    def magnitude(self, *context: object) -> int:
        """A number from 1 on."""
        for k in range(1, 15):
            if not self.plain(*context, k):
                return k
        return self.long()

    def mixed_magnitude(self, contexts: list[Key], chosen: Key) -> int:
        """A number from 1 on by three contexts."""
        for k in range(1, 15):
            if not self.mixed([(*c, k) for c in contexts], (*chosen, k)):
                return k
        return self.long()

    def long(self) -> int:
        """A number from 15 on."""
        length = 0
        while length < 17 and self.bit(32768):
            length += 1
        rest = 1
        for _ in range(length):
            rest = 2 * rest + self.bit(32768)
        return 14 + rest


@dataclass(frozen=True)
class Cell:
    """A sample with a force."""

    v: Vector
    a: int
    ahead: tuple[int, int, int]
    sizes: tuple[int, int] = (0, 0)
    pinned: int = 0
    """The step, in eighths of units, at which it was corrected last."""


NONE = Cell((0, 0, 0), 0, (0, 0, 0))


@dataclass
class Scan:
    """The walk over a grid: `axes`, the slowest first, and which are walked downwards."""

    shape: Position
    axes: tuple[int, int, int]
    down: tuple[bool, bool, bool]

    def turned(self, at: Position, whole: Position) -> Position:
        """A place of the grid in the scan, or, for axes 0 1 2, of the scan in the grid."""
        p, q, r = (whole[a] - 1 - at[a] if d else at[a] for a, d in zip(self.axes, self.down))
        return p, q, r

    def sample(self, at: Position) -> Position:
        """A sample of the grid in the scan."""
        x, y, z = (8 * n for n in brick_counts(self.shape))
        return self.turned(at, (x, y, z))

    def brick(self, at: Position) -> Position:
        """A brick of the grid in the scan."""
        return self.turned(at, brick_counts(self.shape))

    def back(self, at: Position) -> Position:
        """A sample of the scan in the grid."""
        out = [0, 0, 0]
        for n, (a, d) in enumerate(zip(self.axes, self.down)):
            out[a] = 8 * brick_counts(self.shape)[a] - 1 - at[n] if d else at[n]
        return out[0], out[1], out[2]


@dataclass
class Frame:
    """A frame while it is decoded."""

    scan: Scan
    lattice: Lattice
    slopes: list[int]
    usual: int
    mix: int
    weights: list[list[int]]
    coder: RangeCoder
    old: dict[Position, Vector]
    """Of the reference, what lies in listed bricks."""
    old_bricks: set[Position]
    last: Vector
    cells: dict[Position, Cell] = field(default_factory=dict)
    states: dict[Position, int] = field(default_factory=dict)
    """Of tiles: (p, Q, R)."""
    ways: dict[Position, int] = field(default_factory=dict)
    """Of bricks, how they are predicted."""
    last_ways: dict[tuple[int, int], int] = field(default_factory=dict)
    """The way told last at (Q, R)."""

    def cell(self, *at: int) -> Cell:
        return self.cells.get((at[0], at[1], at[2]), NONE)

    def made(self, v: Vector, a: int, sizes: tuple[int, int] = (0, 0), pinned: int = 0) -> Cell:
        """A cell, and what its force makes likely one step on along each axis of the scan."""
        inverse = (1 << 28) // a
        p, q, r = (a - ((v[axis] * inverse >> 14) * slope >> 14) for axis, slope in zip(self.scan.axes, self.slopes))
        return Cell(v, a, (p, q, r), sizes, pinned)

    # -- tiles ------------------------------------------------------------------------------------------------

    def decode_tile(self, p: int, brick: Position) -> None:
        """The tile of a brick in plane p."""
        _, tq, tr = brick
        lengths = [self.scan.shape[a] for a in self.scan.axes]
        wholes = [8 * brick_counts(self.scan.shape)[a] for a in self.scan.axes]
        first = [w - n if d else 0 for w, n, d in zip(wholes, lengths, self.scan.down)]
        end = [w if d else n for w, n, d in zip(wholes, lengths, self.scan.down)]
        if not first[0] <= p < end[0]:
            return
        whole_tile = [(q, r) for q in range(8 * tq, 8 * tq + 8) for r in range(8 * tr, 8 * tr + 8)]
        tile = [(q, r) for q, r in whole_tile if first[1] <= q < end[1] and first[2] <= r < end[2]]
        is_deep = int(any((p - 1, q, r) in self.cells for q, r in tile))
        is_old = int(any((p, q, r) in self.old for q, r in tile))
        listed = brick in self.old_bricks
        near = [self.states.get(t, EMPTY) for t in ((p - 1, tq, tr), (p, tq, tr - 1), (p, tq - 1, tr))]
        context = 3 * (near[0] + 4 * near[1] + 16 * near[2]) + is_old + listed
        state = self.tile_state(context, is_deep, is_old)
        self.states[p, tq, tr] = state
        if state == CODED and self.usual and brick not in self.ways:
            about = 5 * self.last_ways.get((tq, tr), 0) + self.last_ways.get((tq, tr - 1), 0)
            high = self.coder.plain("way", about)
            self.ways[brick] = 2 * high + self.coder.plain("way", about, high)
            self.last_ways[tq, tr] = 1 + self.ways[brick]
        for q, r in tile:
            if state == CODED:
                self.decode_sample(p, q, r, listed, self.ways.get(brick, -1))
            elif state == DEEPER and (p - 1, q, r) in self.cells:
                deep = self.cells[p - 1, q, r]
                self.cells[p, q, r] = Cell(deep.v, deep.a, deep.ahead)
            elif state == OLD and (p, q, r) in self.old:
                v = self.old[p, q, r]
                self.cells[p, q, r] = self.made(v, max(1, length_of(v)))

    def tile_state(self, context: int, is_deep: int, is_old: int) -> int:
        if self.coder.plain("coded", context):
            return CODED
        if not (is_deep or is_old) or not self.coder.plain("something", context):
            return EMPTY
        if is_deep and is_old:
            return OLD if self.coder.plain("old", context) else DEEPER
        return OLD if is_old else DEEPER

    # -- samples ----------------------------------------------------------------------------------------------

    def decode_sample(self, p: int, q: int, r: int, listed: bool, way: int) -> None:
        """A sample of a coded tile."""
        deep, up, left = self.cell(p - 1, q, r), self.cell(p, q - 1, r), self.cell(p, q, r - 1)
        faces = (deep, up, left)
        near = sum(c.a > 0 for c in faces)

        def number(*places: Position) -> int:
            return sum((at in self.cells) << i for i, at in enumerate(places))

        mask = number(
            (p - 1, q, r), (p, q - 1, r), (p, q, r - 1), (p - 1, q + 1, r), (p - 1, q, r + 1), (p, q - 1, r + 1)
        )
        wide = number((p - 1, q - 1, r), (p - 1, q, r - 1), (p, q - 1, r - 1), (p - 2, q, r))
        t = [c.ahead[way] for way, c in enumerate(faces)]
        if near:
            ahead = binned((sum(t), sum(t) >> 1, sum(t) * 21845 >> 16)[near - 1])
        else:
            ahead = wide
        then = 0
        if listed:
            about = sum(at in self.old for at in ((p, q, r + 1), (p, q, r - 1), (p, q - 1, r), (p - 1, q, r)))
            if (p, q, r) in self.old:
                then = 4 + (about == 4) + (about >= 3)
            else:
                then = 1 + (about >= 1) + (about >= 3)
        first = (ahead << 6 | mask) << 3 | then
        wider = wide | number((p, q - 2, r), (p, q, r - 2)) << 4
        bins = [binned(t[way]) if c.a else 0 for way, c in enumerate(faces)]
        third = ((bins[0] << 4 | bins[1] >> 1) << 4 | bins[2] >> 1) << 1 | (then >= 4)
        contexts: list[Key] = [("set", first), ("set wide", (wider << 6 | mask) << 3 | then), ("set bins", third)]
        here = self.coder.mixed(contexts, ("set", near << 3 | then))
        if here:
            cell = self.decode_residual((p, q, r), faces, near, then, way)
            self.cells[p, q, r] = cell
            self.last = cell.v

    def decode_residual(self, at: Position, faces: tuple[Cell, Cell, Cell], near: int, then: int, way: int) -> Cell:
        """The force of a sample."""
        coder, lattice = self.coder, self.lattice
        v, other, based, followed = self.expected(at, way)
        expected = v
        length = length_of(v)
        if length == 0:
            v, length = (v[0], v[1], 1), 1
        along = [c.sizes[0] for c in faces]
        across = [c.sizes[1] for c in faces]
        class_0 = class_1 = 7
        if near:
            class_0 = ENERGY_CLASS[min(31, 4 * sum(along) // near)]
            class_1 = ENERGY_CLASS[min(31, 2 * sum(across) // near)]
        loud = min(length >> 12, 15)
        still_class = ENERGY_CLASS[min(31, 3 * (sum(along) + sum(across)) // max(near, 1))]
        context = ((still_class << 2 | near) << 2 | min(loud, 3)) << 1 | (then >= 4)
        near_0 = sum(min(n, 3) << 2 * i for i, n in enumerate(along))
        near_1 = sum(min(n, 3) << 2 * i for i, n in enumerate(across))
        between = vector([b - a for a, b in zip(expected, other)])
        apart = min((32 * length_of(between) // (3 * lattice.step(length))).bit_length(), 7)
        pinned = fresh = min(max(lattice.step(length) >> 3, 1), 32767)
        pin = 0
        if followed is not None:
            pinned = followed.pinned
            pin = RATIO_CLASS[min(16 * pinned // fresh, 63)]
        context = context << 2 | pin >> 1
        quiet = 0
        for face in faces:
            quiet = 4 * quiet + (1 + min(sum(face.sizes), 2) if face.a else 0)
        second = (quiet << 3 | pin) << 3 | apart
        third = (apart << 4 | loud) << 2 | near
        contexts: list[Key] = [("still", context), ("still near", second), ("still apart", third)]
        still = coder.mixed(contexts, ("still", still_class))
        if still:
            return self.made(v, length, (0, 0), pinned)
        if based:
            v = other
            length = length_of(v)
            if length == 0:
                v, length = (v[0], v[1], 1), 1
            between = vector([-n for n in between])
        axes, step = along_axes(v, length), lattice.step(length)
        residual = [0, 0, 0]
        for c in range(3):
            to = sum(a * b for a, b in zip(between, axes[c])) >> 14
            toward, side = min((8 * abs(to) // step).bit_length(), 7), int(to < 0)
            r0, r1 = (min(abs(n), 3) for n in residual[:2])
            if c == 0:
                context = class_0 << 3 | min(loud, 7)
            elif c == 1:
                context = (class_1 << 2 | r0) << 2 | min(loud, 3)
            else:
                context = (class_1 << 2 | r0) << 2 | r1
            moving = 1
            if based or c < 2 or residual[0] or residual[1]:
                third = (toward << 3 | (class_1 if c else min(loud, 7))) << 2 | (0, r0, r1)[c]
                second = near_1 if c else near_0
                contexts = [("zero", c, context), ("zero near", c, second), ("zero toward", c, third)]
                moving = coder.mixed(contexts, ("zero", c, class_0))
            if moving:
                group = class_1 if c else class_0
                negative = coder.plain("sign", c, near, toward, side)
                agree = toward + 8 * (side == negative and toward > 0)
                last = min(abs(residual[c - 1]), 15) if c else loud
                contexts = [("size", c, group), ("size toward", c, agree, group), ("size last", c, last)]
                size = coder.mixed_magnitude(contexts, ("size", c))
                residual[c] = -size if negative else size
        a = lattice.amplitude_of(lattice.level_of(length) + 256 * residual[0])
        cross = lattice.cross_step(abs(a))
        found = rebuilt(a, residual[1] * cross, residual[2] * cross, axes)
        sizes = min(abs(residual[0]), 15), min(abs(residual[1]) + abs(residual[2]), 31)
        return self.made(found, max(1, length_of(found)), sizes, fresh)

    def expected(self, at: Position, way: int) -> tuple[Vector, Vector, bool, Cell | None]:
        """What is expected of a sample; another opinion; whether that is the blend of what is not followed; the cell
        that is followed."""
        followed: Cell | None = None
        chain: Vector | None = None
        mix = self.mix
        if way == 0 and at in self.old and not self.is_off(at):
            chain, mix = self.old[at], 0
        elif way >= 0:
            followed, chain = self.chain(at, (way or self.usual) - 1)
        blend, base = self.blend(at)
        if chain is None:
            return blend, bounded(list(base)), False, None
        return vector([c + ((b - c) * mix >> 6) for b, c in zip(blend, chain)]), blend, True, followed

    def is_off(self, at: Position) -> bool:
        """Whether the reference was off at the sample before, by more than a step."""
        before = (at[0] - 1, at[1], at[2])
        if before not in self.cells or before not in self.old:
            return False
        cell = self.cells[before]
        square = sum((x - y) ** 2 for x, y in zip(cell.v, self.old[before]))
        return square > self.lattice.step(cell.a) ** 2

    def chain(self, at: Position, axis: int) -> tuple[Cell | None, Vector | None]:
        """A neighbour, and what the law makes of it."""
        p, q, r = at
        faces = (self.cell(p - 1, q, r), self.cell(p, q - 1, r), self.cell(p, q, r - 1))
        for n in (axis, 0, 1, 2):
            if not faces[n].a:
                continue
            cell = faces[n]
            length = cell.ahead[n]
            if cell.a >= SATURATED:
                others = [(m, faces[m]) for m in range(3) if m != n and faces[m].a]
                told = [c.a if c.a >= SATURATED else c.ahead[m] for m, c in others]
                length = cell.a
                if told and sum(told) < len(told) * (SATURATED - 1024):
                    length = sum(told) // len(told)
            length = max(length, cell.a >> 3, max(1, self.lattice.floor >> 1))
            ratio = 16384 if length == cell.a else min((length << 14) // cell.a, 1 << 17)
            return cell, bounded([c * ratio + 8192 >> 14 for c in cell.v])
        return None, None

    def blend(self, at: Position) -> tuple[Vector, Vector]:
        """What all neighbours make likely, and the vector that the weights correct."""
        p, q, r = at
        deep, up, left = self.cell(p - 1, q, r), self.cell(p, q - 1, r), self.cell(p, q, r - 1)
        deep_up, deep_down = self.cell(p - 1, q - 1, r), self.cell(p - 1, q + 1, r)
        deep_left, deep_right = self.cell(p - 1, q, r - 1), self.cell(p - 1, q, r + 1)
        up_left, up_right = self.cell(p, q - 1, r - 1), self.cell(p, q - 1, r + 1)
        old = self.old.get(at)
        faces = [(way, c) for way, c in enumerate((deep, up, left)) if c.a]
        kind = sum(1 << way for way, _ in faces) + 8 * (old is not None)
        base = self.last
        if faces:
            total = sum(c.a for _, c in faces) * len(faces)
            ahead = sum(max(c.ahead[way], c.a >> 3) for way, c in faces)
            scale = min((ahead << 16) // total, 1 << 18)
            base = vector([sum(c.v[n] for _, c in faces) * scale + 32768 >> 16 for n in range(3)])
        elif old is not None:
            base = old
        else:
            for c in (deep_up, deep_down, deep_right, deep_left, up_right, up_left):
                if c.a:
                    base = c.v
                    break
        if not any(map(any, self.weights)):
            return bounded(list(base)), base
        w = self.weights[kind]
        sums, total = [32, 32, 32], 0
        for weight, c in zip(w, (deep, up, left, deep_down, deep_right, up_right)):
            if c.a:
                sums = [s + weight * x for s, x in zip(sums, c.v)]
                total += weight
        pairs = (
            (deep, self.cell(p - 2, q, r)), (up, deep_up), (left, deep_left), (left, up_left), (up, up_left)
        )  # fmt: skip
        for weight, (c, d) in zip(w[6:], pairs):
            if c.a and d.a:
                sums = [s + weight * (x - y) for s, x, y in zip(sums, c.v, d.v)]
        if old is not None:
            sums = [s + w[11] * x for s, x in zip(sums, old)]
            total += w[11]
            beside = ((p - 1, q, r), (p, q - 1, r), (p, q, r - 1))
            both = [(self.cells[b].v, self.old[b]) for b in beside if b in self.cells and b in self.old]
            if both:
                share = w[12] * (64 // len(both))
                sums = [s + (sum(x[n] - y[n] for x, y in both) * share >> 6) for n, s in enumerate(sums)]
        return bounded([b + (s - total * b >> 6) for b, s in zip(base, sums)]), base


def vector(v: list[int]) -> Vector:
    return v[0], v[1], v[2]


def bounded(v: list[int]) -> Vector:
    """A vector with each component within its limits."""
    return vector([max(-LIMIT, min(c, LIMIT)) for c in v])


def length_of(v: Vector) -> int:
    """The length of a vector in whole units."""
    return root(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])


def binned(t: int) -> int:
    """An amplitude in classes."""
    return max(0, min((28 * t >> 16) + 3, 31))


def decode_light(
    payload: bytes, shape: Position, lattice: Lattice, previous: Field | None, guess: Field | None
) -> Field:
    """A frame of model 1."""
    c = Cursor(payload)
    before = {} if previous is None else {b: inside(b, shape) for b in previous.bricks}
    support = decode_support(c.chunk(), shape, before)
    need(all((mask == inside(b, shape)).all() for b, mask in support.items()), "a brick listed in part")
    if not support:
        c.end()
        return Field()
    way = c.number("B")
    need(way < 32 and way & 3 < 3, "the direction of the scan")
    axes = (way & 3, *(a for a in range(3) if a != way & 3))
    scan = Scan(shape, axes, (bool(way & 4), bool(way & 8), bool(way & 16)))
    coded = [c.varint() for _ in range(3)]
    need(max(coded) < 1 << 18, "a slope")
    slopes = [-(n >> 1) - 1 if n & 1 else n >> 1 for n in coded]
    usual, mix = divmod(c.number("B"), 64)
    need(usual or not mix, "a mix with nothing to follow")
    flags = c.number("H")
    weights = [list(c.numbers("13b")) if flags >> n & 1 else [0] * 13 for n in range(16)]
    coder = RangeCoder(payload[c.at :])
    bricks = {scan.brick(b) for b in support}
    reference = guess if guess is not None else previous if previous is not None else Field()
    turned = {scan.sample(s): v for s, v in reference.vectors.items()}
    old = {s: v for s, v in turned.items() if (s[0] >> 3, s[1] >> 3, s[2] >> 3) in bricks}
    start = (0, 0, max(lattice.floor, 1))
    old_bricks = {scan.brick(b) for b in reference.bricks}
    frame = Frame(scan, lattice, slopes, usual, mix, weights, coder, old, old_bricks, start)
    for layer, i in product(sorted({b[0] for b in bricks}), range(8)):
        for brick in sorted(b for b in bricks if b[0] == layer):
            frame.decode_tile(8 * layer + i, brick)
    need(coder.place - 6 <= len(coder.data) <= coder.place, "the end of the code of a frame")
    vectors = {scan.back(s): cell.v for s, cell in frame.cells.items() if any(cell.v)}
    return Field(sorted(support), vectors)
