"""The pass over the voxels of a frame of coder `touch`, for the second decoder: support, prediction, residual.

Places, vectors and axes are those of the scan; vectors are in units.
"""

from __future__ import annotations

from bisect import bisect_right
from math import isqrt
from typing import NamedTuple

from touch_bits import Bits, Models, Place, ended, moved

__all__ = ["Frame", "Lattice", "borders"]

LIMIT, TOP, SATURATED, FEATURES, UNARY = (1 << 17) - 1, 1 << 16, (1 << 16) - (1 << 10), 13, 14
BEFORE = ((-1, 0, 0), (0, -1, 0), (0, 0, -1))
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


def joined(*digits_: tuple[int, int]) -> int:
    """A context of parts, the first the highest: each a value and how many there are."""
    out = 0
    for value, many in digits_:
        out = out * many + value
    return out


class Voxel:
    """What is gathered of a voxel before its force is told."""

    def __init__(self, frame: Frame, at: Place, known: bool) -> None:
        self.at, self.cells, self.old = at, frame.cells, frame.old
        self.faces = [frame.cells.get(moved(at, step)) for step in BEFORE]
        self.near = sum((cell is not None) << n for n, cell in enumerate(self.faces))
        self.count = self.near.bit_count()
        self.then = self.reference_here() if known else 0

    def held(self, *step: int) -> int:
        return int((self.at[0] + step[0], self.at[1] + step[1], self.at[2] + step[2]) in self.cells)

    def was(self, axis: int, step: int) -> int:
        x, y, z = (n + step * (c == axis) for c, n in enumerate(self.at))
        return int((x, y, z) in self.old)

    def reference_here(self) -> int:
        about = sum(self.was(axis, step) for axis in range(3) for step in (-1, 1))
        return 4 + (about >= 5) + (about == 6) if self.at in self.old else 1 + (about >= 1) + (about >= 3)


class Frame:
    """A frame while it is decoded."""

    def __init__(
        self, code: bytes, models: Models, weights: dict[int, list[int]], lattice: Lattice, slope: Place, axis: int
    ) -> None:
        self.bits, self.lattice, self.slope, self.axis = Bits(code, models), lattice, slope, axis
        self.weights = weights
        self.known: set[Place] = set()
        self.old: dict[Place, Place] = {}
        self.cells: dict[Place, Cell] = {}
        self.state, self.last = 0, (0, 0, 0)

    def end(self, count: int) -> None:
        ended(self.bits, count)

    def brick(self, brick: Place, inside: list[Place]) -> None:
        """A brick, whose samples within the grid are `inside`, in order."""
        known, state = brick in self.known, 0
        if known:
            context = self.state
            state = 2 if self.bits.code(("brick", context)) else self.bits.code(("brick", 4 + context))
            self.state = state
        if state == 2:
            for at in inside:
                if at in self.old:
                    self.store(at, self.old[at], 0, 0, 0)
            return
        blocks = self.blocks(brick, known)
        for at in inside:
            if blocks >> ((at[0] >> 2 & 1) * 4 + (at[1] >> 2 & 1) * 2 + (at[2] >> 2 & 1)) & 1:
                voxel = Voxel(self, at, known)
                if self.support(voxel):
                    self.voxel(voxel, state == 1)

    def store(self, at: Place, v: Place, along: int, across: int, fine: int) -> None:
        a = length_of(v)
        inverse = (1 << 28) // a
        x, y, z = (a - ((c * inverse >> 14) * s >> 14) for c, s in zip(v, self.slope))
        self.cells[at] = Cell(v, a, (x, y, z), along, across, fine)

    # -- support ------------------------------------------------------------------------------------------

    def blocks(self, brick: Place, known: bool) -> int:
        """Which sub-blocks of 4 x 4 x 4 voxels hold a force."""
        out = 0
        for n in range(8):
            first = (8 * brick[0] + (n & 4), 8 * brick[1] + 2 * (n & 2), 8 * brick[2] + 4 * (n & 1))
            sides = 0
            for c in range(3):
                bit = 4 >> c
                if n & bit:
                    side = out >> (n - bit) & 1
                else:
                    spans = [range(f - 1, f) if d == c else range(f, f + 4) for d, f in enumerate(first)]
                    side = any((x, y, z) in self.cells for x in spans[0] for y in spans[1] for z in spans[2])
                sides = sides << 1 | side
            then = 0
            if known:
                x, y, z = (range(f, f + 4) for f in first)
                then = 1 + any((i, j, k) in self.old for i in x for j in y for k in z)
            out |= self.bits.code(("block", then << 3 | sides)) << n
        return out

    def support(self, v: Voxel) -> int:
        """Whether a voxel holds a force."""
        held = v.held
        mask = v.near | held(-1, 1, 0) << 3 | held(-1, 0, 1) << 4 | held(0, -1, 1) << 5
        wide = held(-1, -1, 0) | held(-1, 0, -1) << 1 | held(0, -1, -1) << 2 | held(-2, 0, 0) << 3
        behind, then, own = held(0, 0, -2), v.then, int(v.then >= 4)
        ahead = [cell.ahead[n] if cell else None for n, cell in enumerate(v.faces)]
        bins = [likely(a) if a is not None else 0 for a in ahead]
        bin_ = likely(sum(a for a in ahead if a is not None) // v.count) if v.count else wide
        patch = sum(held(-1, i, j) for i in (-1, 0, 1) for j in (-1, 0, 1))
        row = held(0, -1, -1) + held(0, -1, 0) + held(0, -1, 1)
        around = 0
        if then:
            around = own
            for axis in range(3):
                around = around << 2 | v.was(axis, -1) << 1 | v.was(axis, 1)
        contexts = (
            (bin_ << 6 | mask) << 3 | then,
            ((wide | held(0, -2, 0) << 4 | behind << 5) << 6 | mask) << 3 | then,
            ((bins[0] << 4 | bins[1] >> 1) << 4 | bins[2] >> 1) << 1 | own,
            (around << 3 | v.near) << 2 | bin_ >> 3,
            (((patch << 2 | row) << 1 | behind) << 1 | v.near >> 2) << 3 | bin_ >> 2,
            (bins[0] << 6 | mask) << 1 | own,
        )
        return self.mix("held", 0, contexts, v.count << 3 | then)

    def mix(self, name: str, c: int, contexts: tuple[int, ...], chosen: int) -> int:
        """A bit by context n of table (name, n, c), for each n."""
        return self.bits.mix([(name, n, c, context) for n, context in enumerate(contexts)], (name, c, chosen))

    # -- prediction ---------------------------------------------------------------------------------------

    def chain(self, v: Voxel, axis: int) -> Place:
        """The force law followed from the neighbour before along an axis, which holds a force."""
        cell = v.faces[axis]
        assert cell is not None
        a = cell.length
        length = cell.ahead[axis] if a < SATURATED else at_top(v, axis, a)
        length = max(length, a >> 3, self.lattice.floor >> 1, 1)
        ratio = min((length << 14) // a, 1 << 17)
        x, y, z = (c * ratio + 8192 >> 14 for c in cell.vector)
        return limited(x, y, z)

    def follow(self, v: Voxel, trusted: bool) -> tuple[Place | None, int]:
        """What is expected without correction, and whence: the axis, 3 the reference, -1 nothing."""
        if trusted and v.at in self.old:
            cell, before = v.faces[0], self.old.get(moved(v.at, BEFORE[0]))
            off = (0, 0, 0) if cell is None or before is None else minus(cell.vector, before)
            if cell is None or dot(off, off) <= self.lattice.step(cell.length) ** 2:
                return self.old[v.at], 3
        if self.axis < 3:
            for axis in (self.axis, 0, 1, 2):
                if v.faces[axis]:
                    return self.chain(v, axis), axis
        return None, -1

    def first(self, v: Voxel) -> Place:
        """The base where no neighbour across a face holds a force."""
        if v.at in self.old:
            return self.old[v.at]
        for step in ((-1, -1, 0), (-1, 1, 0), (-1, 0, -1), (-1, 0, 1), (0, -1, -1), (0, -1, 1)):
            if moved(v.at, step) in self.cells:
                return self.cells[moved(v.at, step)].vector
        return self.last

    def mean(self, v: Voxel) -> tuple[Place, int]:
        """The base of neighbours, and the step there."""
        cells = [(cell, cell.ahead[n]) for n, cell in enumerate(v.faces) if cell]
        total = sum(cell.length for cell, _ in cells)
        expected = sum(max(ahead, cell.length >> 3) for cell, ahead in cells)
        scale = min((expected << 16) // (total * v.count), 1 << 17)
        x, y, z = (sum(cell.vector[k] for cell, _ in cells) * scale + 32768 >> 16 for k in range(3))
        return (x, y, z), self.lattice.step(expected // v.count)

    def features(self, v: Voxel, base: Place, inverse: int) -> list[Place]:
        """Differences of neighbours, 1/256 steps."""
        cells, at, nothing = self.cells, v.at, (0, 0, 0)

        def vector(*step: int) -> Place | None:
            cell = cells.get((at[0] + step[0], at[1] + step[1], at[2] + step[2]))
            return cell and cell.vector

        deep, up, left = vector(-1, 0, 0), vector(0, -1, 0), vector(0, 0, -1)
        made = []
        for one in (deep, up, left, vector(-1, 1, 0), vector(-1, 0, 1), vector(0, -1, 1)):
            made.append(minus(one, base) if one else nothing)
        for one, other in (
            (deep, vector(-2, 0, 0)), (up, vector(-1, -1, 0)), (left, vector(-1, 0, -1)),
            (left, vector(0, -1, -1)), (up, vector(0, -1, -1)),
        ):  # fmt: skip
            made.append(minus(one, other) if one and other else nothing)
        was, changes = self.old.get(at), []
        made.append(minus(was, base) if was else nothing)
        for step, one in zip(BEFORE, (deep, up, left)):
            before = self.old.get(moved(at, step))
            if was and one and before:
                changes.append(minus(one, before))
        out = [scaled(f, inverse) for f in made]
        total = (sum(c[0] for c in changes), sum(c[1] for c in changes), sum(c[2] for c in changes))
        return [*out, scaled(total, inverse // max(1, len(changes)))]

    def voxel(self, v: Voxel, trusted: bool) -> None:
        """The force of a voxel that holds one."""
        kind, features, inverse, step = -1, [], 0, 0
        if v.near:
            base, step = self.mean(v)
            inverse = (1 << 32) // step
            features = self.features(v, base, inverse)
            kind = v.near | (v.at in self.old) << 3
            weights = self.weights.setdefault(kind, [0] * FEATURES)
            sums = [sum(w * f[k] for w, f in zip(weights, features)) for k in range(3)]
            x, y, z = (b + ((s >> 16) * step >> 8) for b, s in zip(base, sums))
            blend = limited(x, y, z)
        else:
            base = blend = self.first(v)
        expected, source = self.follow(v, trusted)
        told = Residual(self, v, base, blend, expected, source)
        vector = told.decode()
        self.store(v.at, vector, told.along, told.across, told.fine)
        self.last = vector
        if kind < 0:
            return
        energy = (1 << 15) + sum(dot(f, f) for f in features)
        for k in range(3):
            error = clip((vector[k] - blend[k]) * inverse >> 24, -1023, 1023)
            gain = error * (8 << 24) // energy
            for n in range(FEATURES):
                weights[n] = clip(weights[n] + (features[n][k] * gain >> 14), -(1 << 20), 1 << 20)


def likely(length: int) -> int:
    """Class of a length that is likely."""
    return clip((length * 28 >> 16) + 3, 0, 31)


def at_top(v: Voxel, axis: int, a: int) -> int:
    """The length beside one at the top, as the other neighbours make it."""
    others = [(cell.length, cell.ahead[n]) for n, cell in enumerate(v.faces) if cell and n != axis]
    total = sum(b if b >= SATURATED else ahead for b, ahead in others)
    return total // len(others) if others and total < len(others) * (SATURATED - 1024) else a


def scaled(v: Place, inverse: int) -> Place:
    """A feature, 1/256 steps."""
    x, y, z = (clip(c * inverse >> 24, -4095, 4095) for c in v)
    return x, y, z


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
