"""The part of the second decoder for the quick frame model of coder `touch`, number 0.

It shares the scan, the tiles and the arithmetic decoder with the light model, as the chapters do.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, field
from itertools import product

from reference_decoder import Cursor, Position, brick_counts, decode_support, inside, need
from reference_touch import LIMIT, Field, Lattice, Vector, root
from reference_touch_light import CODED, DEEPER, EMPTY, ENERGY_CLASS, OLD, SATURATED, RangeCoder, Scan, binned

__all__ = ["decode_quick"]

TOP = (1 << 18) - 1


@dataclass(frozen=True)
class Cell:
    """A sample with a force."""

    u: Vector
    a: int
    losses: tuple[int, int, int]
    v: Vector
    sizes: tuple[int, int] = (0, 0)
    mark: int = 0


def bounded(a: int, b: int, c: int) -> Vector:
    """A vector with each component within its limits."""
    x, y, z = (max(-LIMIT, min(n, LIMIT)) for n in (a, b, c))
    return x, y, z


def direction_of(v: Vector) -> tuple[Vector, int]:
    """Direction and amplitude of a vector."""
    a = max(1, root(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]))
    x, y, z = (c * ((1 << 34) // a) + (1 << 17) >> 18 for c in v)
    return (x, y, z), a


def axes_across(u: Vector) -> tuple[Vector, Vector]:
    """Two directions across u, of length one about."""
    g = (-u[1], u[0], 0) if abs(u[2]) < 58982 else (0, -u[2], u[1])
    n = min(1023, sum(c * c for c in g) >> 22)
    inverse = (1 << 32) // root((2 * n + 1) << 21)
    h = (g[0] * inverse >> 16, g[1] * inverse >> 16, g[2] * inverse >> 16)
    k = (u[1] * h[2] - u[2] * h[1] >> 16, u[2] * h[0] - u[0] * h[2] >> 16, u[0] * h[1] - u[1] * h[0] >> 16)
    return h, k


def moved(a: int, steps: int, borders: list[int]) -> int:
    """The amplitude so many steps from a."""
    if steps == 0:
        return a
    i, last = bisect_right(borders, 256 * a) - 1, len(borders) - 1
    j = i + 16 * steps
    if j < 0:
        return -min(borders[min(-j, last)] >> 8, TOP)
    return min(borders[min(j, last)] + 256 * a - borders[i] >> 8, TOP)


@dataclass
class Frame:
    """A frame while it is decoded."""

    scan: Scan
    lattice: Lattice
    slopes: list[int]
    usual: int
    coder: RangeCoder
    old: dict[Position, Vector]
    old_bricks: set[Position]
    last: tuple[Vector, int]
    cells: dict[Position, Cell] = field(default_factory=dict)
    states: dict[Position, int] = field(default_factory=dict)
    ways: dict[Position, int] = field(default_factory=dict)
    last_ways: dict[tuple[int, int], int] = field(default_factory=dict)

    def made(self, u: Vector, a: int, sizes: tuple[int, int] = (0, 0), mark: int = 0) -> Cell:
        """A cell of a direction and an amplitude."""
        v = bounded(*(c * a + 32768 >> 16 for c in u))
        p, q, r = (u[axis] * slope >> 16 for axis, slope in zip(self.scan.axes, self.slopes))
        return Cell(u, a, (p, q, r), v, sizes, mark)

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
        rows = range(max(8 * tq, first[1]), min(8 * tq + 8, end[1]))
        columns = range(max(8 * tr, first[2]), min(8 * tr + 8, end[2]))
        tile = list(product(rows, columns))
        is_deep = int(any((p - 1, q, r) in self.cells for q, r in tile))
        is_old = int(any((p, q, r) in self.old for q, r in tile))
        listed = brick in self.old_bricks
        near = [self.states.get(t, EMPTY) for t in ((p - 1, tq, tr), (p, tq, tr - 1), (p, tq - 1, tr))]
        context = 3 * (near[0] + 4 * near[1] + 16 * near[2]) + is_old + listed
        state = self.states[p, tq, tr] = self.tile_state(context, is_deep, is_old)
        if state == CODED and brick not in self.ways:
            about = 5 * self.last_ways.get((tq, tr), 0) + self.last_ways.get((tq, tr - 1), 0)
            high = self.coder.plain("way", about)
            self.ways[brick] = 2 * high + self.coder.plain("way", about, high)
            self.last_ways[tq, tr] = 1 + self.ways[brick]
        for q, r in tile:
            if state == CODED:
                self.decode_sample((p, q, r), listed, self.ways[brick])
            elif state == DEEPER and (p - 1, q, r) in self.cells:
                deep = self.cells[p - 1, q, r]
                self.cells[p, q, r] = self.made(deep.u, deep.a)
            elif state == OLD and (p, q, r) in self.old:
                v = self.old[p, q, r]
                cell = self.made(*direction_of(v))
                self.cells[p, q, r] = Cell(cell.u, cell.a, cell.losses, v)

    def tile_state(self, context: int, is_deep: int, is_old: int) -> int:
        """What a tile is."""
        if self.coder.plain("coded", context):
            return CODED
        if not (is_deep or is_old) or not self.coder.plain("something", context):
            return EMPTY
        if is_deep and is_old:
            return OLD if self.coder.plain("old", context) else DEEPER
        return OLD if is_old else DEEPER

    # -- samples ----------------------------------------------------------------------------------------------

    def decode_sample(self, at: Position, listed: bool, way: int) -> None:
        """A sample of a coded tile."""
        p, q, r = at
        faces = [self.cells.get(b) for b in ((p - 1, q, r), (p, q - 1, r), (p, q, r - 1))]

        def number(*places: Position) -> int:
            return sum((b in self.cells) << i for i, b in enumerate(places))

        mask = number(
            (p - 1, q, r), (p, q - 1, r), (p, q, r - 1), (p - 1, q + 1, r), (p - 1, q, r + 1), (p, q - 1, r + 1)
        )
        t = [cell.a - cell.losses[axis] for axis, cell in enumerate(faces) if cell]
        if t:
            ahead = binned((sum(t), sum(t) >> 1, sum(t) * 21845 >> 16)[len(t) - 1])
        else:
            ahead = number((p - 1, q - 1, r), (p - 1, q, r - 1), (p, q - 1, r - 1))
        then = 0
        if listed:
            about = sum(b in self.old for b in ((p, q, r + 1), (p, q, r - 1), (p, q - 1, r), (p - 1, q, r)))
            then = 4 + (about == 4) + (about >= 3) if at in self.old else 1 + (about >= 1) + (about >= 3)
        if self.coder.plain("held", ahead, mask, then):
            self.cells[at] = self.decode_residual(at, faces, then, way)
            self.last = self.cells[at].u, self.cells[at].a

    def decode_residual(self, at: Position, faces: list[Cell | None], then: int, way: int) -> Cell:
        """The force of a sample."""
        coder = self.coder
        u, a = self.expected(at, faces, way)
        near = sum(cell is not None for cell in faces)
        loud = min(3, a >> 14)
        share = (0, 65536, 32768, 21846)[near]
        m0 = sum(cell.sizes[0] for cell in faces if cell) * share >> 14
        m1 = sum(cell.sizes[1] for cell in faces if cell) * share >> 15
        c0, c1 = (ENERGY_CLASS[min(31, m)] if near else 7 for m in (m0, m1))
        quiet = ENERGY_CLASS[min(31, 3 * (m0 + 2 * m1) >> 2)]
        if coder.plain("still", quiet, near, loud, then >= 4):
            return self.made(u, a)
        aslant = coder.plain("aslant", c0, c1)
        along = mark = 0
        if not aslant or coder.plain("zero", 0, c0, loud):
            marks = sum(3**axis * cell.mark for axis, cell in enumerate(faces) if cell)
            mark = 1 + coder.plain("sign", marks)
            along = coder.magnitude("size", 0, c0) * (1 if mark == 1 else -1)
        a = moved(a, along, self.lattice.borders)
        sizes = min(15, abs(along)), 0
        if not aslant:
            if a <= 0:
                u, a = (-u[0], -u[1], -u[2]), max(1, -a)
            return self.made(u, a, sizes, mark)
        across = [0, 0]
        before = abs(along)
        for n in range(2):
            moving = 1
            if n == 0 or across[0]:
                moving = coder.plain("zero", 1 + n, c1, min(3, before))
            if moving:
                negative = coder.plain("sign", 27 + n)
                size = coder.magnitude("size", 1, c1)
                across[n] = -size if negative else size
            before = abs(across[0])
        step = self.lattice.cross_step(abs(a))
        s, t = (max(-(1 << 20), min(r * step, 1 << 20)) for r in across)
        h, k = axes_across(u)
        w = bounded(*(a * u[c] + s * h[c] + t * k[c] + 32768 >> 16 for c in range(3)))
        u, a = direction_of(w if any(w) else (0, 0, 1))
        return self.made(u, a, (sizes[0], min(31, abs(across[0]) + abs(across[1]))), mark)

    def expected(self, at: Position, faces: list[Cell | None], way: int) -> tuple[Vector, int]:
        """Direction and amplitude that are expected of a sample."""
        p, q, r = at
        if at in self.old and (way == 0 or not any(faces)):
            return direction_of(self.old[at])
        if not any(faces):
            beside = ((-1, -1, 0), (-1, 1, 0), (-1, 0, 1), (-1, 0, -1), (0, -1, 1), (0, -1, -1))
            for d in beside:
                other = self.cells.get((p + d[0], q + d[1], r + d[2]))
                if other:
                    return other.u, other.a
            return self.last
        told = {axis: self.ahead(cell, axis) for axis, cell in enumerate(faces) if cell}
        axis = next(n for n in ((way or self.usual) - 1, 0, 1, 2) if n in told)
        cell = faces[axis]
        assert cell is not None
        others = [told[n] for n in told if n != axis]
        if cell.a < SATURATED or not others:
            return cell.u, told[axis]
        total = sum(others) >> len(others) - 1
        return cell.u, total if total < SATURATED - 1024 else cell.a

    def ahead(self, cell: Cell, axis: int) -> int:
        """The amplitude that a cell makes likely one step on."""
        if cell.a >= SATURATED:
            return cell.a
        return min(max(cell.a - cell.losses[axis], cell.a >> 3, 1, self.lattice.floor >> 1), TOP)


def decode_quick(
    payload: bytes, shape: Position, lattice: Lattice, previous: Field | None, guess: Field | None
) -> Field:
    """A frame of model 0."""
    c = Cursor(payload)
    before = {} if previous is None else {b: inside(b, shape) for b in previous.bricks}
    support = decode_support(c.chunk(), shape, before)
    need(all((mask == inside(b, shape)).all() for b, mask in support.items()), "a brick listed in part")
    if not support:
        c.end()
        return Field()
    usual, way = divmod(c.number("B"), 32)
    need(way & 3 < 3, "the direction of the scan")
    need(1 <= usual <= 3, "the usual way")
    axes = (way & 3, *(a for a in range(3) if a != way & 3))
    scan = Scan(shape, axes, (bool(way & 4), bool(way & 8), bool(way & 16)))
    coded = [c.varint() for _ in range(3)]
    need(max(coded) < 1 << 18, "a slope")
    slopes = [-(n >> 1) - 1 if n & 1 else n >> 1 for n in coded]
    coder = RangeCoder(payload[c.at :])
    bricks = {scan.brick(b) for b in support}
    reference = guess if guess is not None else previous if previous is not None else Field()
    turned = {scan.sample(s): v for s, v in reference.vectors.items()}
    old = {s: v for s, v in turned.items() if (s[0] >> 3, s[1] >> 3, s[2] >> 3) in bricks}
    old_bricks = {scan.brick(b) for b in reference.bricks}
    start = (0, 0, 65536), max(lattice.floor, 1)
    frame = Frame(scan, lattice, slopes, usual, coder, old, old_bricks, start)
    for layer, i in product(sorted({b[0] for b in bricks}), range(8)):
        for brick in sorted(b for b in bricks if b[0] == layer):
            frame.decode_tile(8 * layer + i, brick)
    need(coder.place - 6 <= len(coder.data) <= coder.place, "the end of the code of a frame")
    return Field(sorted(support), {scan.back(s): cell.v for s, cell in frame.cells.items()})
