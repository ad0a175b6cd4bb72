"""The residual of a voxel of coder `touch`, for the second decoder: cells, their lattice, and how a force is told.

Places, vectors and axes are those of the scan; vectors are in units.
"""

from __future__ import annotations

from bisect import bisect_right
from math import isqrt
from typing import TYPE_CHECKING, NamedTuple

from touch_bits import Place, moved

if TYPE_CHECKING:
    from touch_frame import Frame, Voxel

__all__ = ["Cell", "Lattice", "Residual", "borders", "clip", "dot", "length_of", "limited", "minus"]

LIMIT, UNARY = (1 << 17) - 1, 14
Table = tuple[int, ...]
CLASS: Table = (1, 2, 4, 7, 11, 16, 24)
RATIO: Table = (17, 18, 20, 23, 27, 32, 45)
SIDE: Table = (1, 2, 3, 5, 8, 12, 20)


class Lattice(NamedTuple):
    """Steps of a segment; `border` are the lengths at each sixteenth of a step, 1/256 units."""

    unit_n: float
    floor: int
    rate: int
    cross_floor: int
    cross_rate: int
    border: list[int]

    def step(self, length: int) -> int:
        return max(self.floor, length * self.rate >> 16)

    def cross_step(self, length: int) -> int:
        return max(self.cross_floor, length * self.cross_rate >> 16)

    def level(self, length: int) -> int:
        """The warped length, 1/256 steps."""
        x = min(length, (1 << 18) - 1) << 8
        n = bisect_right(self.border, x) - 1
        return 16 * n + (x - self.border[n]) * 16 // (self.border[n + 1] - self.border[n])

    def length(self, level: int) -> int:
        """The inverse; below zero it is a force the other way."""
        size = min(abs(level), 16 * (len(self.border) - 1) - 1)
        low, high = self.border[size >> 4], self.border[(size >> 4) + 1]
        length = low + ((high - low) * (size & 15) >> 4) + 128 >> 8
        return length if level >= 0 else -length


def borders(floor: int, rate: int) -> list[int]:
    out = [0]
    while out[-1] <= 1 << 26:
        out.append(out[-1] + max(1, max(floor << 8, out[-1] * rate >> 16) >> 4))
    return out


class Cell(NamedTuple):
    """A voxel that is decoded: its force, what the law makes of its length one step on, and how it was corrected."""

    vector: Place
    length: int
    ahead: Place
    along: int
    across: int
    fine: int


def length_of(v: tuple[int, ...]) -> int:
    return max(1, isqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]))


def clip(value: int, low: int, high: int) -> int:
    return max(low, min(value, high))


def limited(x: int, y: int, z: int) -> Place:
    """A vector within the limit of components."""
    return clip(x, -LIMIT, LIMIT), clip(y, -LIMIT, LIMIT), clip(z, -LIMIT, LIMIT)


def minus(a: Place, b: Place) -> Place:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def dot(a: tuple[int, ...], b: tuple[int, ...]) -> int:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def digits(n: int) -> int:
    return min(n.bit_length(), 7)


def mean_class(sum_: int, count: int, scale: int) -> int:
    """Class of a mean size of residuals; 7 where there is none."""
    return bisect_right(CLASS, sum_ * scale // count) if count else 7


class Residual:
    """The residual of a voxel; `along`, `across` and `fine` are what its cell keeps of it."""

    def __init__(
        self, frame: Frame, v: Voxel, base: Place, blend: Place, expected: Place | None, source: int
    ) -> None:
        self.frame, self.v, self.source, self.blend = frame, v, source, blend
        self.expected = expected or blend
        self.based = expected is not None
        self.length = length_of(self.expected)
        self.step = frame.lattice.step(self.length)
        self.other = minus(blend if self.based else base, self.expected)
        self.apart = self.distance(self.other)
        self.loud = min(self.length >> 12, 15)
        sizes = [(cell.along, cell.across) if cell else (0, 0) for cell in v.faces]
        self.sizes = [sum(min(s[n], 3) << 2 * c for c, s in enumerate(sizes)) for n in range(2)]
        self.total = sum(min(n, 3) for s in sizes for n in s)
        self.group = [mean_class(sum(s[n] for s in sizes), v.count, 4 >> n) for n in range(2)]
        self.along = self.across = 0
        self.fine = self.fresh = clip(self.step >> 3, 1, 32767)
        self.pin = 0
        cell = v.faces[source] if 0 <= source < 3 else None
        if cell:
            self.fine = cell.fine
            self.pin = bisect_right(RATIO, min(self.fine * 16 // self.fresh, 63))

    def distance(self, d: Place) -> int:
        """Class of a distance."""
        return digits((length_of(d) << 3) // self.step)

    def decode(self) -> Place:
        if self.still():
            return self.expected
        self.fine = self.fresh
        self.aim()
        steps: list[int] = []
        for c in range(3):
            steps.append(self.component(c, steps))
        self.along, self.across = min(abs(steps[0]), 15), min(abs(steps[1]) + abs(steps[2]), 31)
        lattice = self.frame.lattice
        along = lattice.length(self.level + 256 * steps[0])
        cross = lattice.cross_step(abs(along))
        parts = (along, steps[1] * cross, steps[2] * cross)
        x, y, z = (dot(parts, column) + 8192 >> 14 for column in zip(*self.axes))
        return limited(x, y, z)

    def still(self) -> int:
        """Whether what is expected stands."""
        v = self.v

        def quiet(*step: int) -> int:
            cell = v.cells.get((v.at[0] + step[0], v.at[1] + step[1], v.at[2] + step[2]))
            return 1 + min(cell.along + cell.across, 2) if cell else 0

        faces = quiet(-1, 0, 0) << 4 | quiet(0, -1, 0) << 2 | quiet(0, 0, -1)
        edges = 3 * min(quiet(-1, -1, 0), 2) + min(quiet(-1, 0, -1), 2)
        one = two = far = 7
        for axis in range(3):
            if v.faces[axis] and axis != self.source:
                one, two = self.distance(minus(self.frame.chain(v, axis), self.expected)), one
        if v.at in v.old and self.source != 3:
            far = self.distance(minus(v.old[v.at], self.expected))
        quietness = mean_class(self.total, v.count, 3)
        contexts = (
            (((quietness << 2 | v.count) << 2 | min(self.loud, 3)) << 1 | (v.then >= 4)) << 2 | self.pin >> 1,
            (faces << 3 | self.pin) << 3 | self.apart,
            (self.apart << 4 | self.loud) << 2 | v.count,
            ((far << 3 | v.then) << 3 | self.apart) << 3 | quietness,
            ((one << 3 | two) << 3 | self.apart) << 3 | self.pin,
            (edges << 6 | faces) << 3 | self.apart,
        )
        return self.frame.mix("still", 0, contexts, quietness << 1 | (far < 7))

    def aim(self) -> None:
        """Turn to the blend: level and axes, and on which side of it other predictions lie."""
        lattice, v = self.frame.lattice, self.v
        centre = self.blend if any(self.blend) else (0, 0, 1)
        if self.based:
            self.other = minus((0, 0, 0), self.other)
        length = length_of(centre)
        self.level, self.step = lattice.level(length), lattice.step(length)
        self.axes = axes_along(centre, length)
        others: list[Place | None] = [self.frame.chain(v, n) if v.faces[n] else None for n in range(3)]
        for one, two, both in (((0, -1, 0), (0, 0, -1), (0, -1, -1)), ((-1, 0, 0), (0, 0, -1), (-1, 0, -1))):
            cells = [v.cells.get(moved(v.at, step)) for step in (one, two, both)]
            a, b, c = (cell.vector if cell else None for cell in cells)
            others.append(minus(minus(a, c), minus((0, 0, 0), b)) if a and b and c else None)
        others.append(v.old.get(v.at))
        self.sides = [[self.side(other, centre, axis) for other in others] for axis in self.axes]

    def side(self, other: Place | None, centre: Place, axis: Place) -> int:
        """Class of a distance along an axis, 7 is none."""
        if other is None:
            return 15
        d = (dot(minus(other, centre), axis) >> 12) // self.step
        size = bisect_right(SIDE, abs(d))
        return 7 - size if d < 0 else 7 + size

    def component(self, c: int, steps: list[int]) -> int:
        """Component c of the residual, behind those before it."""
        d = dot(self.other, self.axes[c]) >> 14
        toward, side = digits((abs(d) << 3) // self.step), int(d < 0)
        if (self.based or c < 2 or any(steps)) and not self.moving(c, toward, steps):
            return 0
        negative = self.sign(c, toward << 1 | side, steps)
        size = self.size(c, toward | (side == negative and toward > 0) << 3, negative, steps)
        return -size if negative else size

    def pair(self, c: int, n: int) -> int:
        return self.sides[c][2 * n] << 4 | self.sides[c][2 * n + 1]

    def moving(self, c: int, toward: int, steps: list[int]) -> int:
        group, sizes = self.group[min(c, 1)], self.sizes[min(c, 1)]
        told = self.loud >> 2
        if c:
            told = min(abs(steps[0]), 3) << 2 | (min(abs(steps[1]), 3) if c == 2 else 0)
        contexts = (
            group << 4 | told,
            sizes << 4 | told,
            (toward << 3 | group) << 4 | told,
            (toward << 3 | self.apart) << 3 | self.pin,
            (self.apart << 3 | group) << 4 | told,
            *(self.pair(c, n) << 1 | (group > 3) for n in range(3)),
        )
        return self.frame.mix("zero", c, contexts, group)

    def sign(self, c: int, lies: int, steps: list[int]) -> int:
        turn = 1 + (steps[-1] > 0) if c and steps[-1] else 0
        contexts = (lies << 2 | self.v.count, lies << 3 | self.apart, lies << 2 | turn)
        return self.frame.mix("sign", c, (*contexts, *(self.pair(c, n) for n in range(3))), 0)

    def size(self, c: int, toward: int, negative: int, steps: list[int]) -> int:
        last, group = min(abs(steps[-1]), 15) if c else self.loud, self.group[min(c, 1)]
        one, two = (14 - s if negative and s < 15 else s for s in (self.sides[c][0], self.sides[c][2]))
        rows = (group, toward << 3 | group, last, (toward & 7) << 3 | self.apart, one << 4 | two)
        for n in range(UNARY):
            if not self.frame.mix("size", c, tuple(row << 4 | n for row in rows), n):
                return n + 1
        return UNARY + self.frame.bits.gamma(17)


def axes_along(p: Place, length: int) -> list[Place]:
    """Unit vectors, 1/16384, along a vector and across it."""
    e0, e1, e2 = e = unit(p, length)
    h = unit((-e1, e0, 0) if abs(e2) < 14746 else (0, -e2, e1))
    k = (e1 * h[2] - e2 * h[1] >> 14, e2 * h[0] - e0 * h[2] >> 14, e0 * h[1] - e1 * h[0] >> 14)
    return [e, h, k]


def unit(v: Place, length: int = 0) -> Place:
    inverse = (1 << 44) // (length or length_of(v))
    x, y, z = (c * inverse + (1 << 29) >> 30 for c in v)
    return x, y, z
