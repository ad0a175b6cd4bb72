"""The part of the second decoder for coder `touch` that makes a guess of a surface, column by column."""

from __future__ import annotations

from dataclasses import dataclass, field

from reference_decoder import Coder, Cursor, Models, Position, brick_counts, need
from reference_touch import LIMIT, Field, Vector, root

__all__ = ["synthesised"]

HEAD_LIMITS = (1 << 17, 1 << 20, 1 << 20, 1 << 20, 1 << 12, 1 << 14, 1 << 16, 1 << 17)
FAR = 1 << 24
PRESENT, STILL, MODE, TWO, XY, START, AMPLITUDE, BEND, HALF, START_2, XY_2, AMPLITUDE_2 = range(12)
WEST, NORTH, CORNER, EAST = range(4)

Place = tuple[int, int]


def bounded(value: int, low: int, high: int) -> int:
    return max(low, min(value, high))


@dataclass
class Surface:
    """One surface of a column: its start, its point of the disc, its amplitude and its direction."""

    z: int
    xy: Place
    amplitude: int
    errors: list[list[int]]
    """How far the four predictors were off, of the point and of the start."""

    @property
    def direction(self) -> Vector:
        """Along the axes across, and outward, 1/16384."""
        x, y = self.xy
        square = x * x + y * y
        if square > 1 << 29:
            scale = (23170 << 14) // root(square)
            x, y = x * scale >> 14, y * scale >> 14
            square = x * x + y * y
        side = root((1 << 28) - (square >> 2))
        return x * side >> 14, y * side >> 14, max(820, 16384 - (square >> 15))


@dataclass
class Column:
    """What a column was told to be."""

    first: Surface
    bend: int
    still: bool
    sizes: tuple[int, int, int, int]
    """Of the residuals: of the point, the start, the amplitude and the bend."""
    second: Surface | None = None

    @property
    def whole(self) -> int:
        """The amplitude of all."""
        return self.first.amplitude + (self.second.amplitude if self.second else 0)


@dataclass
class Columns:
    """All columns while they are decoded."""

    coder: Coder
    models: Models
    heads: list[int]
    made: dict[Place, Column] = field(default_factory=dict)
    last: Column | None = None

    def bit(self, kind: int, node: int, first: int, second: int) -> int:
        chosen = 22 * kind + node
        return self.models.mixed(64 * chosen + first, 32 * chosen + second, chosen)

    def number(self, kind: int, first: int, second: int) -> int:
        """A whole number."""
        if not self.bit(kind, 0, first, second):
            return 0
        sign = -1 if self.bit(kind, 1, first, second) else 1
        size = 1
        while size <= 20 and self.bit(kind, 1 + size, first, second):
            size += 1
        if size <= 20:
            return sign * size
        digits, rest = 0, 1
        while digits < 24 and self.coder.bit(32768):
            digits += 1
        for _ in range(digits):
            rest = 2 * rest + self.coder.bit(32768)
        return sign * (20 + rest)

    # -- one column -------------------------------------------------------------------------------------------

    def decode(self, at: Place) -> None:
        """A column, if it is there."""
        i, j = at
        places = [(i, j - 1), (i - 1, j), (i - 1, j - 1), (i - 1, j + 1)]
        if j & 7 == 7 and i & 7:
            places[EAST] = (-1, -1)  # of a tile to come
        beside = [self.made.get(p) for p in places]
        mask = sum((c is not None) << 3 - n for n, c in enumerate(beside))
        at_edge = 2 * (i & 7 == 0) + (j & 7 == 0)
        if self.bit(PRESENT, 0, mask, 4 * at_edge + (mask >> 2)):
            self.made[at] = self.last = self.column(beside)

    def column(self, beside: list[Column | None]) -> Column:
        few = min(sum(c is not None for c in beside), 3)
        still_mask = sum((c is not None and c.still) << 3 - n for n, c in enumerate(beside))
        twos = sum((c is not None and c.second is not None) << 3 - n for n, c in enumerate(beside))
        west, north = beside[WEST], beside[NORTH]
        torn = twos >> 2 > 0
        torn |= west is not None and north is not None and abs(west.first.z - north.first.z) > 768
        two = self.bit(TWO, 0, twos, 4 * torn + few)
        mode = 0
        if torn:
            mode = self.bit(MODE, 0, twos >> 2, two)
            mode = 2 * mode + self.bit(MODE, 1 + mode, twos >> 2, two)
        sides = sides_of(mode, beside)
        moved = 1
        if not two:
            moved = self.bit(STILL, 0, 4 * still_mask + few, 4 * min(still_mask.bit_count(), 3) + few)

        def sizes(which: int, most: int) -> int:
            a, b = (min(c.sizes[which], most) if c else most for c in (west, north))
            return a * (most + 1) + b

        heads, r = self.heads, [0] * 5
        if moved:
            r[0] = self.number(XY, sizes(0, 4), few)
            r[1] = self.number(XY, 25 + sizes(0, 4), 4 + 4 * near(r[0]) + few)
        guesses, xy = self.expected_xy(sides)
        x, y = (bounded(e + n * heads[5], -32767, 32767) for e, n in zip(xy, r))
        surface = Surface(0, (x, y), 0, [])
        starts, z = self.expected_start(sides, surface.direction)
        amplitude = self.expected_amplitude(sides, two)
        if moved:
            turned = max(near(r[0]), near(r[1]))
            r[2] = self.number(START, sizes(1, 6), 4 * turned + few)
            r[3] = self.number(HALF if two else AMPLITUDE, sizes(2, 4), 4 * near(r[2]) + turned)
            if not two:
                r[4] = self.number(BEND, sizes(3, 3), 4 * near(r[2]) + near(r[3]))
        surface.z = bounded(z + r[2] * heads[4], -FAR, FAR)
        step = self.amplitude_step(heads[0] if two else amplitude)
        surface.amplitude = bounded(amplitude + r[3] * step, 1, LIMIT)
        surface.errors = [[512] * 4, [256] * 4]
        for q in guesses:
            off = abs(guesses[q][0] - x) + abs(guesses[q][1] - y)
            surface.errors[0][q] = min(off >> 3, 8191)
            surface.errors[1][q] = min(abs(starts[q] - surface.z), 8191)
        told = (abs(r[0]) + abs(r[1]), abs(r[2]), abs(r[3]), abs(r[4]))
        made = Column(surface, bounded(r[4], -7, 24), not moved, told)
        if two:
            made.second = self.second(surface, beside, 4 * (twos > 0) + near(r[2]))
        return made

    def second(self, one: Surface, beside: list[Column | None], context: int) -> Surface:
        """The second surface of a column."""
        others = [c.second for c in beside if c and c.second]
        if others:
            z, x, y = (sum(n) // len(others) for n in zip(*((s.z, *s.xy) for s in others)))
        else:
            deepest = one.z + 768
            z, x, y = deepest + 768, *one.xy
            for c in beside:
                if c and c.first.z > deepest:
                    deepest = c.first.z
                    z, x, y = c.first.z, *c.first.xy
        top = self.heads[0]
        amplitude = max(top >> 4, top - one.amplitude)
        r_z = self.number(START_2, context, 0)
        r_x = self.number(XY_2, context, 0)
        r_y = self.number(XY_2, 8 + context, 1 + near(r_x))
        r_a = self.number(AMPLITUDE_2, context, 0)
        point = tuple(bounded(v + r * self.heads[5], -32767, 32767) for v, r in ((x, r_x), (y, r_y)))
        amplitude = bounded(amplitude + r_a * self.amplitude_step(top), 1, LIMIT)
        return Surface(bounded(z + r_z * self.heads[4], -FAR, FAR), point, amplitude, one.errors)

    # -- what is expected -------------------------------------------------------------------------------------

    def elsewhere(self, sides: list[Column | None]) -> Column | None:
        """The column to go by where there is none to the west and north."""
        return sides[EAST] or sides[CORNER] or self.last

    def expected_xy(self, sides: list[Column | None]) -> tuple[dict[int, list[int]], list[int]]:
        """What the predictors say of the point, and what is expected."""
        guesses: dict[int, list[int]] = {q: [] for q in known(sides)}
        out = []
        for c in range(2):
            a, b, corner = (side.first.xy[c] if side else 0 for side in sides[:3])
            told = (a, b, a + b - corner, a + b >> 1)
            for q, one in guesses.items():
                one.append(told[q])
            out.append(blended({q: told[q] for q in guesses}, sides, 0))
        if not guesses:
            other = self.elsewhere(sides)
            out = list(other.first.xy) if other else [0, 0]
        return guesses, out

    def expected_start(self, sides: list[Column | None], u: Vector) -> tuple[dict[int, int], int]:
        """The same of the start of a column whose direction is known."""
        told = [0, 0, 0, 0]
        for n, (component, ratio) in enumerate(((1, self.heads[3]), (0, self.heads[2]))):
            side = sides[n]
            if side:
                v = side.first.direction
                own, other = (bounded(d[component] * ratio // d[2], -4096, 4096) for d in (u, v))
                told[n] = side.first.z + (own + other >> 1)
        west, north, corner = (side.first.z if side else 0 for side in sides[:3])
        told[2], told[3] = west + north - corner, told[0] + told[1] >> 1
        starts = {q: told[q] for q in known(sides)}
        if starts:
            return starts, blended(starts, sides, 1)
        other_side = self.elsewhere(sides)
        return starts, other_side.first.z if other_side else 0

    def expected_amplitude(self, sides: list[Column | None], two: int) -> int:
        top = self.heads[0]
        if two:
            return top >> 1
        west, north, corner = sides[:3]
        if not west or not north:
            one = west or north
            return min(top, one.whole) if one else top
        a, b = west.whole, north.whole
        c = corner.whole if corner else a
        return min(sorted((a, b, a + b - c))[1], top)

    def amplitude_step(self, amplitude: int) -> int:
        return max(1, amplitude * self.heads[6] >> 16)


def near(r: int) -> int:
    return min(abs(r), 3)


def sides_of(mode: int, beside: list[Column | None]) -> list[Column | None]:
    """The columns that a column is predicted from."""
    if mode == 0:
        return beside
    out: list[Column | None] = [None] * 4
    if mode < 3:
        need(beside[mode - 1], "a column predicted from none")
        out[mode - 1] = beside[mode - 1]
        return out
    for n in (WEST, NORTH):
        other = beside[n]
        if other and other.second:
            out[n] = Column(other.second, 0, False, (0, 0, 0, 0))
            return out
    raise ValueError("a column predicted from a second surface that is not there")


def known(sides: list[Column | None]) -> list[int]:
    """The predictors that have what they need."""
    west, north = bool(sides[WEST]), bool(sides[NORTH])
    both = west and north
    return [q for q, there in enumerate((west, north, both and bool(sides[CORNER]), both)) if there]


def blended(told: dict[int, int], sides: list[Column | None], which: int) -> int:
    """The mean of what predictors say, by how well each did."""
    total = weight = 0
    for q, value in told.items():
        error = 24 + sum(c.first.errors[which][q] for c in sides if c)
        w = max(1, (1 << 30) // (error * error))
        total += w * value
        weight += w
    return (2 * total + weight) // (2 * weight) if weight else 0


# -- the whole --------------------------------------------------------------------------------------------


def synthesised(data: bytes, shape: Position) -> Field:
    """The guess that `data` makes."""
    c = Cursor(data)
    way = c.number("B")
    need(way < 6, "the axis of a surface")
    axis, inverted = way >> 1, bool(way & 1)
    across = [a for a in range(3) if a != axis]
    heads = [c.varint() for _ in HEAD_LIMITS]
    need(all(n < limit for n, limit in zip(heads, HEAD_LIMITS)), "a head of a surface")
    rows, row = (brick_counts(shape)[a] for a in across)
    tiles: list[int] = []
    runs = c.varint()
    need(1 <= runs < len(data), "runs of tiles")
    for n in range(runs):
        begin = (tiles[-1] + 2 if n else 0) + c.varint()
        count = c.varint() + 1
        need(begin + count <= rows * row and len(tiles) + count <= len(data), "tiles beyond the grid, or too many")
        tiles += range(begin, begin + count)
    coder = Coder(data[c.at :])
    columns = Columns(coder, Models(coder), heads)
    for tile in tiles:
        for k in range(64):
            at = (8 * (tile // row) + (k >> 3), 8 * (tile % row) + (k & 7))
            if at[0] < shape[across[0]] and at[1] < shape[across[1]]:
                columns.decode(at)
    frame = laid_down(columns, (axis, inverted, across), shape)
    code = data[: c.at] + coder.data[: coder.used] + coder.ending()
    least = max(len(tiles), -(-len(frame.bricks) // 4))
    need(data == code.ljust(least, b"\0"), "the end of a surface")
    return frame


def laid_down(columns: Columns, view: tuple[int, bool, list[int]], shape: Position) -> Field:
    """The forces of all columns."""
    axis, inverted, across = view
    depth, heads = shape[axis], columns.heads
    vectors: dict[Position, Vector] = {}
    first_of: dict[Place, int] = {}
    for (i, j), column in columns.made.items():
        surfaces = [(column.first, 8 + column.bend)]
        if column.second:
            surfaces.append((column.second, 8))
        first = max(0, (min(s.z for s, _ in surfaces) >> 8) + 1)
        tile = (i >> 3, j >> 3)
        first_of[tile] = min(first_of.get(tile, depth), first)
        deep = []
        for s, steep in surfaces:
            u = s.direction
            growth = max(16, (heads[1] * u[2] >> 14) * steep // 8)
            deep.append((s, [s.amplitude * n + 8192 >> 14 for n in u], growth))
        for t in range(first, depth):
            shares = [min(65536, max(0, (t << 8) - s.z) * growth >> 8) for s, _, growth in deep]
            if sum(share * s.amplitude for share, (s, _, _) in zip(shares, deep)) <= heads[7] << 16:
                continue
            told = [
                bounded(sum(share * d[n] for share, (_, d, _) in zip(shares, deep)) + 32768 >> 16, -LIMIT, LIMIT)
                for n in range(3)
            ]
            at, force = [0, 0, 0], [0, 0, 0]
            at[across[0]], at[across[1]], at[axis] = i, j, depth - 1 - t if inverted else t
            force[across[0]], force[across[1]], force[axis] = told[0], told[1], told[2] if inverted else -told[2]
            if any(force):
                vectors[at[0], at[1], at[2]] = (force[0], force[1], force[2])
    bricks = []
    for (a, b), first in first_of.items():
        low, high = (0, -(-(depth - first) // 8)) if inverted else (first // 8, -(-depth // 8))
        for n in range(low, high) if first < depth else ():
            at = [0, 0, 0]
            at[across[0]], at[across[1]], at[axis] = a, b, n
            bricks.append((at[0], at[1], at[2]))
    return Field(sorted(bricks), vectors)
