"""The part of the second decoder for the max frame model of coder `touch`, number 2.

Everything is told in the coordinates of the pass: (z, y, x), the slowest axis first; vectors are (x, y, z). Names are
those of the chapter.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import permutations, product
from typing import Any

import numpy as np
from reference_decoder import (
    CERTAIN,
    RATES,
    SQUASH,
    STRETCH,
    Coder,
    Cursor,
    Position,
    brick_counts,
    decode_support,
    inside,
    need,
)
from reference_touch import LIMIT, Field, Lattice, Vector, along_axes, rebuilt, root

__all__ = ["Learnt", "decode_max"]

Told = tuple[int, int]
"""Which context, and its value."""

ZERO: Vector = (0, 0, 0)
SATURATED = 64512
NEAR = [*product((-1,), (-1, 0, 1), (-1, 0, 1)), (0, -1, -1), (0, -1, 0), (0, -1, 1), (0, 0, -1)]
DISTANCE = [z * z + y * y + x * x for z, y, x in NEAR]
ONCE = [256 // d for d in DISTANCE]
TWICE = [256 // d**2 for d in DISTANCE]
FAR = [(0, 0, -2), (0, -2, 0), (-2, 0, 0), (0, -1, 2), (-1, 0, 2), (-1, 2, 0), (0, -2, 1), (-2, 1, 0), (-2, 0, 1)]
ABOUT = [(0, 0, 0), (0, 0, -1), (0, 0, 1), (0, -1, 0), (0, 1, 0), (-1, 0, 0), (1, 0, 0)]
ALL: list[Position] = [(z, y, x) for z in (-1, 0, 1) for y in (-1, 0, 1) for x in (-1, 0, 1)]
WINDOW = [
    (o, max(1, 24 // sum(c * c for c in o)))
    for o in product((-2, -1, 0), range(-2, 3), range(-2, 3))
    if o < (0, 0, 0) and sum(map(abs, o)) <= 4
]
WINDOW.sort(key=lambda one: sum(c * c for c in one[0]))
X, Y, Z = 12, 10, 4
BESIDE = [NEAR[X], NEAR[Y], NEAR[Z]]


def bounded(n: int, low: int, high: int) -> int:
    """The number of low to high that is nearest to n."""
    return max(low, min(n, high))


def plus(at: Position, offset: Position) -> Position:
    """A place at a distance from another."""
    return at[0] + offset[0], at[1] + offset[1], at[2] + offset[2]


def vector(x: int, y: int, z: int) -> Vector:
    """Three whole numbers."""
    return int(x), int(y), int(z)


def dot(a: Vector, b: Vector) -> int:
    """The inner product."""
    return sum(m * n for m, n in zip(a, b))


def less(a: Vector, b: Vector) -> Vector:
    """a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def half(n: int) -> int:
    """Half octaves."""
    b = n.bit_length()
    return 2 * b + (n >> (b - 2) & 1 if b >= 2 else 0)


def level(n: int) -> int:
    """One of 16 levels, half an octave each."""
    return bounded(half(n) - 6, 0, 15)


def squash(x: int) -> int:
    """The chance of a logit."""
    return SQUASH[bounded(x, -3072, 3071) + 3072]


def logit(p: int) -> int:
    """The logit of a chance of 65536."""
    return STRETCH[bounded(p, 0, 65535) >> 4]


def below(b: int, centre: int, spread: int) -> int:
    """The chance that a logistic variable lies below b."""
    return squash(256 * (b - centre) // spread)


def within(centre: int, spread: int) -> int:
    """The chance of a component of 0."""
    return max(8, below(128, centre, spread) - below(-128, centre, spread))


# -- what is learnt ---------------------------------------------------------------------------------------


class Model:
    """Chances, weights and maps of mixed bits."""

    def __init__(self) -> None:
        self.chances: dict[int, list[int]] = {}
        self.weights: dict[int, list[int]] = {}
        self.maps: dict[int, list[int]] = {}

    def bit(
        self, coder: Coder, contexts: list[tuple[int, int]], more: list[int], sets: tuple[int, int], n: int
    ) -> int:
        """The next bit."""
        states = []
        for i, c in contexts:
            h = (c >> 4 ^ c >> 27) & 0xFFFFFFFF
            slot = 65536 * i + ((2654435761 * h & 0xFFFFFFFF) >> 16 ^ c & 15)
            states.append(self.chances.setdefault(slot, [1 << 21, 0]))
        inputs = [*(STRETCH[s[0] >> 10] for s in states), *more, 77]
        weights = [self.weights.setdefault(w, [10486] * 40) for w in sets]
        x1, x2 = (bounded(sum(w * t for w, t in zip(one, inputs)) >> 16, -3072, 3071) for one in weights)
        x = x1 + x2 >> 1
        place = bounded(x + 2048, 0, 4095)
        i, r = place >> 7, place & 127
        one = self.maps.setdefault(n, [squash(128 * (j - 16)) for j in range(33)])
        p = 154 * squash(x) + 102 * (one[i] * (128 - r) + one[i + 1] * r >> 7) >> 8
        bit = coder.bit(bounded(p, 4, 65532))
        for w, e in zip(weights, (65536 * bit - squash(x1), 65536 * bit - squash(x2))):
            for j, t in enumerate(inputs):
                w[j] += t * e + 8192 >> 14
        one[i] += (65536 * bit - one[i]) * (128 - r) // 6400
        one[i + 1] += (65536 * bit - one[i + 1]) * r // 6400
        for s in states:
            s[0] += (CERTAIN * bit - s[0]) * RATES[s[1]] >> 19
            s[1] = min(s[1] + 1, 160)
        return bit


class Transitions:
    """How a force changes to its neighbours."""

    def __init__(self, slope: int) -> None:
        corners = list(product(range(17), range(8)))
        self.change = {
            (i, j): bounded(4096 * i + ((128 * j - 448) * slope >> 8), 0, 65536) - 4096 * i for i, j in corners
        }
        self.deviation = dict.fromkeys(corners, 6000)
        self.weight = dict.fromkeys(corners, 768)
        self.chance = dict.fromkeys(corners, 45875)

    @staticmethod
    def corners(a: int, q: int) -> list[tuple[tuple[int, int], int]]:
        """The four corners about, and their shares."""
        place, m = min(a, 65535) >> 4, bounded(2 * (q + 448), 0, 1791)
        i, r, j, s = place >> 8, place & 255, m >> 8, m & 255
        return [((i + y, j + x), (r if y else 256 - r) * (s if x else 256 - s)) for y, x in product((0, 1), repeat=2)]

    def look_up(self, a: int, q: int) -> tuple[int, int, int]:
        """Change, deviation and chance."""
        found = self.corners(a, q)
        tables = self.change, self.deviation, self.chance
        c, d, p = (sum(t[at] * w for at, w in found) >> 16 for t in tables)
        return c, d, p

    def learn_chance(self, a: int, q: int, held: int) -> None:
        """A neighbour holds a force, or none."""
        place, m = min(a, 65535) >> 4, bounded(2 * (q + 448), 0, 1791)
        at = (place >> 8) + (place >> 7 & 1), (m >> 8) + (m >> 7 & 1)
        self.chance[at] += (65535 * held - self.chance[at]) // 50

    def learn_change(self, a: int, q: int, change: int) -> None:
        """The force changed so."""
        for at, share in self.corners(a, q):
            w = share >> 8
            if w > 12:
                self.weight[at] = total = min(self.weight[at] + w, 102400)
                off = change - self.change[at]
                self.change[at] += off * w // total
                self.deviation[at] += (abs(off) - self.deviation[at]) * w // total


class Sums:
    """What least squares has seen of all samples."""

    def __init__(self) -> None:
        self.a = np.zeros((19, 19), np.int64)
        self.b = np.zeros(19, np.int64)
        self.slow = [0] * 19


@dataclass
class Learnt:
    """What goes from one frame of a segment to the next."""

    support: Model = field(default_factory=Model)
    residual: Model = field(default_factory=Model)
    transitions: dict[int, Transitions] = field(default_factory=dict)
    sums: dict[int, Sums] = field(default_factory=dict)


def descend(a: list[list[int]], b: list[int], prior: list[int], ridge: int, x: list[int]) -> None:
    """One round of coordinate descent."""
    for i in range(len(b)):
        g = (b[i] << 14) - sum(m * n for m, n in zip(a[i], x)) + ridge * (prior[i] - x[i])
        stiff = a[i][i] + ridge
        if stiff > 0:
            x[i] = bounded(x[i] + g // stiff, -65536, 65536)


# -- the frame --------------------------------------------------------------------------------------------


class Other:
    """Another field in the pass: what it has within the box."""

    def __init__(self, vectors: dict[Position, Vector]) -> None:
        self.vectors = vectors

    def size(self, at: Position) -> int:
        v = self.vectors.get(at, ZERO)
        return max(1, root(dot(v, v))) if any(v) else 0


@dataclass
class Turn:
    """The way a pass runs through a grid."""

    shape: Position
    number: int

    def __post_init__(self) -> None:
        self.axes = list(permutations(range(3)))[self.number >> 3]
        self.down = [bool(self.number >> i & 1) for i in range(3)]

    def place(self, at: Position, whole: Position) -> Position:
        """A place of the grid as (z, y, x)."""
        z, y, x = (whole[a] - 1 - at[a] if d else at[a] for a, d in zip(self.axes, self.down))
        return z, y, x

    def brick(self, at: Position) -> Position:
        return self.place(at, brick_counts(self.shape))

    def whole(self) -> Position:
        x, y, z = (8 * n for n in brick_counts(self.shape))
        return x, y, z

    def sample(self, at: Position) -> Position:
        return self.place(at, self.whole())

    def force(self, v: Vector) -> Vector:
        z, y, x = (-v[a] if d else v[a] for a, d in zip(self.axes, self.down))
        return x, y, z

    def back(self, at: Position, v: Vector) -> tuple[Position, Vector]:
        """Sample and vector in the grid."""
        place, force = [0, 0, 0], [0, 0, 0]
        for i, (a, d) in enumerate(zip(self.axes, self.down)):
            place[a] = self.whole()[a] - 1 - at[i] if d else at[i]
            force[a] = -v[2 - i] if d else v[2 - i]
        return (place[0], place[1], place[2]), (force[0], force[1], force[2])

    def is_inside(self, at: Position) -> bool:
        (x, y, z), _ = self.back(at, ZERO)
        return x < self.shape[0] and y < self.shape[1] and z < self.shape[2] and min(x, y, z) >= 0


@dataclass
class Mark:
    """What a held sample leaves."""

    sizes: tuple[int, int, int] = (0, 0, 0)
    pin: int = 0
    along: list[int] = field(default_factory=lambda: [0] * 5)
    across: list[int] = field(default_factory=lambda: [0] * 5)


NOTHING = Mark()


@dataclass
class View:
    """What the neighbours of a sample say."""

    at: Position
    a: list[int]
    q: list[int]
    k: int
    bits: int
    odds: int = 0
    length: int = 0
    surest: int = 0
    least: int = 1 << 40
    taylor: Vector = ZERO
    mean: Vector = ZERO


@dataclass
class Frame:
    """A frame while it is decoded."""

    turn: Turn
    lattice: Lattice
    metric: list[int]
    slope: int
    share: int
    learnt: Learnt
    coder: Coder
    before: Other
    guess: Other
    inter: int
    vectors: dict[Position, Vector] = field(default_factory=dict)
    sizes: dict[Position, int] = field(default_factory=dict)
    marks: dict[Position, Mark] = field(default_factory=dict)
    rows: dict[Position, Any] = field(default_factory=dict)
    last: Vector = (0, 0, -21845)

    def __post_init__(self) -> None:
        self.transitions = self.learnt.transitions.setdefault(self.turn.number, Transitions(self.slope))
        self.sums = self.learnt.sums.setdefault(self.turn.number, Sums())
        self.m = 19 if self.inter else 15

    def a(self, at: Position) -> int:
        return self.sizes.get(at, 0)

    def v(self, at: Position) -> Vector:
        return self.vectors.get(at, ZERO)

    def mark(self, at: Position) -> Mark:
        return self.marks.get(at, NOTHING)

    def hold(self, at: Position, v: Vector, mark: Mark) -> None:
        """A sample with a force."""
        self.vectors[at], self.sizes[at] = v, max(1, root(dot(v, v)))
        self.marks[at] = mark
        self.last = v

    # -- bricks -------------------------------------------------------------------------------------------

    def flag(self, first: int, second: int, sets: tuple[int, int], n: int) -> int:
        return self.learnt.residual.bit(self.coder, [(10, first), (11, second)], [], sets, n)

    def state(self, brick: Position, z: int, way_before: int, way_above: int) -> tuple[Other | None, int]:
        """From where a brick is copied, else 1 + its way, 0 for none; where the copy is of the plane before, -1."""
        tile = [(z - 1, 8 * brick[1] + y, 8 * brick[2] + x) for y, x in product(range(0, 8, 2), repeat=2)]
        full = sum(at in self.vectors for at in tile) // 4
        inter = self.inter
        if self.flag(4 * full + inter, inter, (380, 381 + full), 180):
            if not inter or not self.flag(256 + 4 * full + inter, 256 + inter, (386, 387 + full), 181):
                return None, -1
            if inter < 3:
                return (self.before if inter & 1 else self.guess), 0
            return (self.guess if self.flag(512 + full, 512, (392, 393 + full), 182) else self.before), 0
        found = 0
        for j in range(3):
            first = 16 * (1024 + 8 * full + way_before) + (1 << j) + found
            second = 16 * (1024 + 8 * way_above + way_before) + (1 << j) + found
            found = 2 * found + self.flag(first, second, (398, 399 + j), 183 + j)
        return None, min(found, 5)

    def copy(self, at: Position, source: Other | None) -> None:
        """A sample of a copied brick."""
        below_it = (at[0] - 1, at[1], at[2])
        v = source.vectors.get(at, ZERO) if source else self.v(below_it)
        if any(v):
            self.hold(at, v, Mark((0, 0, 0), self.mark(below_it).pin, [4] * 5, [4] * 5))

    # -- samples ------------------------------------------------------------------------------------------

    def view(self, at: Position) -> View:
        """What the neighbours say."""
        places = [plus(at, o) for o in NEAR]
        a = [self.a(p) for p in places]
        one = View(at, a, [0] * 13, sum(n > 0 for n in a), sum((n > 0) << i for i, n in enumerate(a)))
        weight = total = odds = odds_weight = length = 0
        taylor, mean = [0, 0, 0], [0, 0, 0]
        for n, place in enumerate(places):
            if not a[n]:
                continue
            v = self.vectors[place]
            q = one.q[n] = sum(c * d * m for c, d, m in zip(v, NEAR[n][::-1], self.metric)) // a[n]
            change, deviation, chance = self.transitions.look_up(a[n], q)
            odds, odds_weight = odds + ONCE[n] * logit(chance), odds_weight + ONCE[n]
            f, deviation = max(a[n] + change, 1300), max(deviation, 1)
            w = (TWICE[n] << 24) // (deviation * deviation + 1600000) + 1
            if deviation < one.least:
                one.least, one.surest = deviation, f
            scale = (f << 12) // a[n]
            taylor = [t + w * (c * scale >> 12) for t, c in zip(taylor, v)]
            mean = [t + TWICE[n] * c for t, c in zip(mean, v)]
            length, weight, total = length + w * f, weight + w, total + TWICE[n]
        if one.k:
            one.taylor, one.mean = vector(*(t // weight for t in taylor)), vector(*(t // total for t in mean))
            one.length, one.odds = length // weight, odds // odds_weight
        return one

    def is_held(self, one: View) -> int:
        """The support bit."""
        at, k, bits = one.at, one.k, one.bits
        o, t, s = 0, 40, 40
        if k:
            o = bounded(2 * one.odds + 128 >> 8, -8, 8) + 9
            t, s = bounded((29 * one.length >> 16) + 10, 0, 39), bounded((23 * one.surest >> 16) + 8, 0, 31)

        def size(a: int) -> int:
            return 1 + min(a >> 12, 14) if a else 0

        qx, qy, qz = (size(one.a[n]) for n in (X, Y, Z))
        gx, gy, gz = (bounded(one.q[n] + 256 >> 6, 0, 15) if one.a[n] else 9 for n in (X, Y, Z))
        far = sum((plus(at, d) in self.vectors) << i for i, d in enumerate(FAR))
        cross = sum((bits >> (2 * i + 1) & 1) << i for i in range(4))
        contexts = [
            bits, 512 * bits + far, 64 * (64 * o + t) + s, 32 * (32 * qz + qy) + qx,
            16 * (16 * (16 * qz + gz) + (bits >> 9)) + cross, 512 * (16 * qx + gx) + 16 * qy + gy,
            8 * (16 * o + k) + (far & 7), 32 * (16 * qz + gz) + o,
        ]  # fmt: skip
        told = list(enumerate(contexts))
        for bit, field_ in ((1, self.before), (2, self.guess)):
            if not self.inter & bit:
                continue
            seven = sum((plus(at, d) in field_.vectors) << i for i, d in enumerate(ABOUT))
            every = sum((plus(at, d) in field_.vectors) << i for i, d in enumerate(ALL))
            qo = size(field_.size(at))
            both = 32 * (32 * qo + o) + qz
            if bit == 1:
                wide = 32 * (32 * (32 * qo + qz) + qx) + qy
                told += [(8, every), (9, 64 * seven + t), (10, both), (11, 8192 * seven + bits), (12, wide)]
            else:
                told += [(13, every), (14, both), (15, 32 * (64 * seven + s) + qo), (16, 8192 * seven + bits)]
        family = int(self.inter > 0)
        if not k and not family:
            return self.learnt.support.bit(self.coder, told[:2], [0], (32, 2), o)
        return self.learnt.support.bit(self.coder, told, [one.odds], (family, 16 * family + k + 2), o)

    def candidates(self, one: View) -> list[Vector]:
        """What may be weighed."""
        at, t = one.at, one.taylor

        def sum_of(*terms: tuple[int, Position]) -> Vector:
            """Of vectors at distances (x, y, z)."""
            out = [0, 0, 0]
            for w, (x, y, z) in terms:
                place = plus(at, (z, y, x))
                if place not in self.vectors:
                    return t
                out = [n + w * c for n, c in zip(out, self.vectors[place])]
            return vector(*out)

        x, y, z = (1, (-1, 0, 0)), (1, (0, -1, 0)), (1, (0, 0, -1))
        made = [
            t, one.mean, sum_of(x), sum_of(y), sum_of(z),
            sum_of((2, z[1]), (-1, (0, 0, -2))), sum_of((2, x[1]), (-1, (-2, 0, 0))),
            sum_of((2, y[1]), (-1, (0, -2, 0))), sum_of(x, y, (-1, (-1, -1, 0))),
            sum_of(x, z, (-1, (-1, 0, -1))), sum_of(y, z, (-1, (0, -1, -1))), sum_of((1, (1, 0, -1))),
            sum_of((1, (0, 1, -1))), sum_of((1, (-1, 0, -1))), sum_of((1, (0, -1, -1))), sum_of((1, (1, -1, 0))),
        ]  # fmt: skip
        for other in (self.before, self.guess):
            if at not in other.vectors:
                made += [t, t]
                continue
            here = other.vectors[at]
            beside = [plus(at, o) for o in BESIDE]
            off = [
                less(self.vectors[p], other.vectors[p]) for p in beside if p in self.vectors and p in other.vectors
            ]
            u = [sum(d[c] for d in off) // max(1, len(off)) for c in range(3)]
            made += [here, vector(*(n + c for n, c in zip(here, u)))]
        if not one.k and at in self.guess.vectors:
            made[0] = made[18]
        return made

    def fitted(self, at: Position, cut: Any) -> list[int]:
        """The weights of the candidates."""
        m, sums = self.m, self.sums
        near = [(self.rows[p], w) for o, w in WINDOW if (p := plus(at, o)) in self.rows][:24]
        a, b = np.zeros((m, m), np.int64), np.zeros(m, np.int64)
        if near:
            rows = np.concatenate([cut(row) for row, _ in near])
            weighed = rows * np.repeat(np.array([w for _, w in near], np.int64), 3)[:, None]
            a, b = weighed[:, 1:].T @ rows[:, 1:], weighed[:, 1:].T @ rows[:, 0]
        trace = int(np.trace(a))
        all_a, all_b = sums.a[:m, :m], sums.b[:m]
        known = int(np.trace(all_a >> 3))
        if known > 0:
            share = 4096 * (trace + 64) // (2 * known + 1)
            b = b + ((all_b >> 3) * share >> 12)
            a = a + ((all_a >> 3) * share >> 12)
        slow = sums.slow[:m]
        descend(all_a.tolist(), all_b.tolist(), slow, 0, slow)
        sums.slow[:m] = slow
        x = list(slow)
        for _ in range(4):
            descend(a.tolist(), b.tolist(), slow, (trace >> 10) + 200, x)
        return x

    def experts(self, one: View, c: list[Vector], x: list[int], way: int) -> list[Vector]:
        """The five predictions."""

        def by(weights: list[int]) -> Vector:
            moved = (sum(w * (one_c[n] - c[0][n]) for w, one_c in zip(weights, c[1:])) for n in range(3))
            p = vector(*(bounded(n + (s + 8192 >> 14), -LIMIT, LIMIT) for n, s in zip(c[0], moved)))
            return p if dot(p, p) <= 81920**2 else c[0]

        fourth, first = by(x), by(self.sums.slow)
        zeroth = vector(*(m + n >> 1 for m, n in zip(fourth, first)))
        third = c[19] if self.inter & 2 else c[17] if self.inter & 1 else c[1]
        n = {2: Y, 3: X}.get(way, Z)
        a, second = one.a[n], c[0]
        if a:
            v = self.vectors[plus(one.at, NEAR[n])]
            if a >= SATURATED:
                length = a if one.length >= 63488 else one.length
            else:
                length = max(a + (self.slope * one.q[n] >> 8), 656)
            second = vector(*(e if length == a else e * length // a for e in v))
        other = {4: self.guess, 5: self.before}.get(way)
        if other and one.at in other.vectors and not self.is_off(one.at, other):
            second = other.vectors[one.at]
        if way:
            zeroth, second = second, zeroth
            zeroth = vector(*(m + ((n - m) * self.share >> 8) for m, n in zip(zeroth, second)))
        return [zeroth, first, second, third, fourth]

    def is_off(self, at: Position, other: Other) -> bool:
        """Whether another field was wrong at the sample before along z."""
        z = plus(at, NEAR[Z])
        if z not in self.vectors or z not in other.vectors:
            return False
        d = less(self.vectors[z], other.vectors[z])
        return dot(d, d) > self.lattice.step(other.size(z)) ** 2

    def decode_sample(self, at: Position, way: int) -> None:
        """A sample of a brick that is no copy; `way` is 1 + the brick's, 0 for none."""
        one = self.view(at)
        held = self.is_held(one)
        close = [n for n in range(13) if one.a[n] and DISTANCE[n] <= 2]
        if one.k and (one.k < 13 or not held):
            for n in close:
                self.transitions.learn_chance(one.a[n], one.q[n], held)
        if not held:
            return
        if not one.k:
            one.taylor = one.mean = self.before.vectors.get(at, self.last)
        c = self.candidates(one)
        step = self.lattice.step(root(dot(c[0], c[0])))
        shift = 0
        while step >> shift >= 64:
            shift += 1

        def cut(row: Any) -> Any:
            return np.clip(row + ((1 << shift) >> 1) >> shift, -1023, 1023)

        x = self.fitted(at, cut)
        experts = self.experts(one, c, x, way)
        v, mark = self.residual(one, c, experts, int(way > 0))
        differences = [less(v, c[0])] + [less(n, c[0]) for n in c[1 : self.m + 1]]
        row = self.rows[at] = np.array(differences, np.int64).T
        fresh = cut(row)
        a, b = self.sums.a[: self.m, : self.m], self.sums.b[: self.m]
        a += 8 * (fresh[:, 1:].T @ fresh[:, 1:]) - (a >> 13)
        b += 8 * (fresh[:, 1:].T @ fresh[:, 0]) - (b >> 13)
        if (a.diagonal() > 1 << 32).any():
            a >>= 1
            b >>= 1
        self.hold(at, v, mark)
        for n in close:
            self.transitions.learn_change(one.a[n], one.q[n], self.sizes[at] - one.a[n])

    # -- the residual -------------------------------------------------------------------------------------

    def residual(self, one: View, c: list[Vector], experts: list[Vector], w: int) -> tuple[Vector, Mark]:
        """The force, and its mark."""
        p = vector(*(bounded(c, -LIMIT, LIMIT) for c in experts[0]))
        if dot(p, p) < 64:
            p = (p[0], p[1], p[2] - 16)
        a = root(dot(p, p))
        need(a < 1 << 18, "a prediction beyond any force")
        axes, step = along_axes(p, a), self.lattice.step(a)
        code = Residual(self, one, c, experts, p, a, axes, step, w)
        r = code.decode()
        v = p
        if any(r):
            length = self.lattice.amplitude_of(self.lattice.level_of(a) + 256 * r[0]) if r[0] else a
            cross = self.lattice.cross_step(abs(length))
            limit = 4 * LIMIT // cross
            v = rebuilt(length, bounded(r[1], -limit, limit) * cross, bounded(r[2], -limit, limit) * cross, axes)
            v = v if any(v) else (0, 0, 1)
        mark = Mark(vector(*(min(200, abs(n)) for n in r)), step if any(r) else code.pin)
        for j, expert in enumerate(experts):
            d = vector(*(bounded(16 * n // step, -3000, 3000) for n in less(v, expert)))
            t = dot(d, axes[0]) >> 14
            mark.along[j] = min(6400, t * t >> 4)
            mark.across[j] = min(6400, max(0, dot(d, d) - t * t) >> 5)
        return v, mark


class Residual:
    """Contexts and bits of one residual."""

    def __init__(
        self, frame: Frame, one: View, c: list[Vector], experts: list[Vector], p: Vector, a: int,
        axes: tuple[Vector, Vector, Vector], step: int, w: int,
    ) -> None:  # fmt: skip
        self.frame, self.w = frame, w
        marks = [(TWICE[n], frame.mark(plus(one.at, NEAR[n]))) for n in range(13) if one.a[n]]
        total = sum(t for t, _ in marks)
        mr = (256 * sum(t * m.sizes[0] for t, m in marks) + 13107) // (total + 128)
        mt = (128 * sum(t * (m.sizes[1] + m.sizes[2]) for t, m in marks) + 13107) // (total + 128)
        if not total:
            mr, mt = max(mr, 512), max(mt, 512)
        unseen = 0 if total else 24640
        self.qr, self.qt, self.qa, self.qn = level(mr), level(mt), min(a >> 12, 15), one.k
        self.qv = level((min(one.least, 1 << 20) << 7) // step) if one.k else 16

        def apart(v: Vector) -> int:
            return level(256 * root(dot(less(v, p), less(v, p))) // step)

        m = frame.m
        width = sum(dot(less(n, p), less(n, p)) for n in c[: m + 1]) // (m + 1)
        self.sp = level(256 * root(width) // step)
        old = frame.before.vectors.get(one.at)
        held = [one.a[n] > 0 for n in (X, Y, Z)]
        self.mm = held[0] + 2 * held[1] + 4 * held[2] + 8 * (old is not None)
        self.ps = apart(old) if old else 100 + apart(c[18]) if frame.inter & 2 else 300 + frame.inter
        beside = [frame.mark(plus(one.at, o)) for o in BESIDE]
        x, y, z = (min(2, sum(m.sizes)) for m in beside)
        self.quiet = 9 * x + 3 * y + z
        self.trio = []
        for n in range(3):
            x, y, z = (min(3, m.sizes[n]) for m in beside)
            self.trio.append(16 * x + 4 * y + z)
        self.rx, self.ry, self.rz = (
            bounded(half(16 * m.pin // step) - 6, 1, 15) if h else 0 for m, h in zip(beside, held)
        )
        pinned = [(t, t * m.pin) for t, m, h in zip((1, 1, 2), beside, held) if h]
        self.pin = sum(n for _, n in pinned) // sum(t for t, _ in pinned) if pinned else step
        self.centre = [
            [bounded(256 * (dot(less(e, p), axis) >> 14) // step, -100000, 100000) for e in experts] for axis in axes
        ]
        self.spread = []
        for n in range(3):
            errors = [sum(t * (m.across if n else m.along)[j] for t, m in marks) for j in range(5)]
            told = [root(4096 * ((e + 616 + unseen) // (total + 77) + 1)) >> 1 for e in errors]
            self.spread.append([max(12, s) for s in told])

    def bit(self, contexts: list[int], more: list[int], sets: tuple[int, int], n: int) -> int:
        told = list(enumerate(contexts))
        return self.frame.learnt.residual.bit(self.frame.coder, told, more, sets, n)

    def decode(self) -> Vector:
        """The residual."""
        qr, qt, sp, qa, qn, qv, mm, ps = self.qr, self.qt, self.sp, self.qa, self.qn, self.qv, self.mm, self.ps
        rx, ry, rz = self.rx, self.ry, self.rz
        contexts = [
            32 * (16 * qr + sp) + qt, 32 * (16 * qr + qt) + qv, 16 * (16 * sp + qa) + mm, 16 * ps + qr,
            16 * (16 * qn + mm) + qa, 16 * self.quiet + mm, 16 * (16 * ps + sp) + qa,
            16 * (32 * qa + qv) + self.quiet % 9, 16 * (16 * rz + ry) + rx, 16 * (16 * rz + qr) + qa,
        ]  # fmt: skip
        more = []
        for j in range(5):
            chance = 65536
            for n in range(3):
                chance = chance * within(self.centre[n][j], self.spread[n][j]) >> 16
            more.append(logit(65536 - chance))
        w = self.w
        if not self.bit([8 * n + 4 * w for n in contexts], more, (w, 2 + qr), 120 + qt):
            return ZERO
        r: list[int] = []
        for c in range(3):
            q = qt if c else qr
            b = sum(f * min(3, abs(n)) for f, n in zip((4, 1), r))
            spread = self.spread[c]
            if c == 2:
                spread = [(4 * s + 128 * min(abs(r[1]), 20)) // 5 + 1 for s in self.spread[1]]
            u1, u2 = (bounded(3 * self.centre[c][j] >> 9, -3, 3) + 3 for j in (2, 3))
            contexts = [
                16 * (16 * q + sp) + b, 16 * (16 * qr + qt) + b if c else 32 * (16 * qr + qt) + qv,
                16 * (16 * (16 * sp + qa) + mm) + b, 16 * (16 * ps + q) + b, 16 * (16 * (16 * qn + mm) + qa) + b,
                16 * (16 * self.trio[c] + mm) + b, 16 * (16 * (7 * u1 + u2) + q) + b,
                16 * (16 * (32 * qa + qv) + q) + b, 16 * (16 * (16 * rz + q) + qa) + b,
                16 * (16 * (16 * rz + ry) + rx) + b,
            ]  # fmt: skip
            contexts = [32 * (8 * n + 4 * w + c + 1) for n in contexts]
            r.append(self.component(c, contexts, spread, min(q >> 1, 7), must=c == 2 and not any(r)))
        return vector(*r)

    def component(self, c: int, contexts: list[int], spread: list[int], g: int, *, must: bool) -> int:
        """One component."""
        base, centre = 20 + 60 * c, self.centre[c]
        if not must:
            more = [logit(65536 - within(m, s)) for m, s in zip(centre, spread)]
            if not self.bit(contexts, more, (base, base + 1 + g), 30 * c + g):
                return 0
        more = []
        for m, s in zip(centre, spread):
            up, down = 65536 - below(128, m, s), below(-128, m, s)
            more.append(logit((up << 16) // max(1, up + down)))
        positive = self.bit([n + 1 for n in contexts], more, (base + 9, base + 10 + g), 30 * c + 8 + g)
        sign = 1 if positive else -1
        for k in range(1, 20):
            more = []
            for m, s in zip(centre, spread):
                least = 65536 - below(256 * k - 128, sign * m, s)
                more.append(logit((65536 - below(256 * k + 128, sign * m, s) << 16) // max(1, least)))
            sets = base + 17 + min(k, 6), base + 24 + g
            if not self.bit([n + 1 + k for n in contexts], more, sets, 30 * c + 16 + min(k, 7)):
                return sign * k
        coder, length, rest = self.frame.coder, 0, 1
        while length < 20 and coder.bit(32768):
            length += 1
        for _ in range(length):
            rest = 2 * rest + coder.bit(32768)
        return sign * (19 + rest)


# -- the whole --------------------------------------------------------------------------------------------


def decode_max(
    data: bytes, shape: Position, lattice: Lattice, others: tuple[Field | None, Field | None], learnt: Learnt | None
) -> tuple[Field, Learnt | None]:
    """A frame, given the previous one and the guess, and what is learnt by now, which is changed."""
    c = Cursor(data)
    number, *metric = c.numbers("4B")
    need(number < 48, "an orientation")
    slope = c.varint()
    need(slope <= 65536, "a slope")
    listed = decode_support(c.chunk(), shape, {})
    need(all((mask == inside(b, shape)).all() for b, mask in listed.items()), "a brick that is not whole")
    if not listed:
        c.end()
        return Field(), learnt
    sides = sorted(max(b[i] for b in listed) - min(b[i] for b in listed) + 1 for i in range(3))
    need(sides[1] * sides[2] <= 64 * len(listed) + 1024, "bricks too far apart")
    share = c.number("B")
    coder, turn = Coder(data[c.at :]), Turn(shape, number)
    bricks = sorted(turn.brick(b) for b in listed)
    low = [min(b[i] for b in bricks) for i in range(3)]
    high = [max(b[i] for b in bricks) for i in range(3)]

    def in_box(brick: Position) -> bool:
        return all(m <= b <= n for m, b, n in zip(low, turn.brick(brick), high))

    made, inter = [], 0
    for n, other in enumerate(others):
        near = {b for b in other.bricks if in_box(b)} if other else set()
        inter |= (len(near) > 0) << n
        there = other.vectors.items() if other else ()
        made.append(
            Other({turn.sample(s): turn.force(v) for s, v in there if (s[0] >> 3, s[1] >> 3, s[2] >> 3) in near})
        )
    learnt = learnt or Learnt()
    frame = Frame(
        turn, lattice, [m + 1 for m in metric], slope, share, learnt, coder, made[0], made[1], inter
    )  # fmt: skip
    decode_bricks(frame, bricks)
    need(coder.data == coder.data[: coder.used] + coder.ending(), "the end of the code of a frame")
    vectors = dict(turn.back(at, v) for at, v in frame.vectors.items())
    return Field(sorted(listed), vectors), learnt


def decode_bricks(frame: Frame, bricks: list[Position]) -> None:
    """All samples of the pass."""
    states: dict[Position, tuple[Other | None, int]] = {}
    previous = dict(zip(bricks[1:], bricks))
    layers = sorted({b[0] for b in bricks})
    for z in (8 * layer + i for layer in layers for i in range(8)):
        rows = sorted({b[1] for b in bricks if b[0] == z >> 3})
        for y in (8 * row + i for row in rows for i in range(8)):
            for brick in (b for b in bricks if b[:2] == (z >> 3, y >> 3)):
                for at in ((z, y, 8 * brick[2] + i) for i in range(8)):
                    if not frame.turn.is_inside(at):
                        continue
                    if brick not in states:
                        above = (brick[0] - 1, brick[1], brick[2])
                        ways = (states[b][1] if b in states else 0 for b in (previous.get(brick), above))
                        states[brick] = frame.state(brick, z, *(max(0, w) for w in ways))
                    source, way = states[brick]
                    if source or way < 0:
                        frame.copy(at, source)
                    else:
                        frame.decode_sample(at, way)
