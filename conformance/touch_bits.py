"""Bits, step by step as docs/format/bits.md: a range decoder, adaptive chances, their mixing; lists of bricks.

All numbers are Python's; none needs more than 63 bits.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from collections.abc import Collection, Hashable, Iterable, Sequence

from reading import TruncatedFile, need

__all__ = ["Bits", "Models", "Place", "bricks", "ended", "marks", "moved"]

ONE, LEAST, FLOOR, REACH, LIMIT = 1 << 48, 1 << 32, 4, 3071, 255
FIRST_WEIGHT = 14000
DECAY = 2139111403

Place = tuple[int, ...]


def tables() -> tuple[list[int], list[int]]:
    """The logistic function from -12 to 12 in 1/256, and its inverse at the middle of each 1/4096."""
    power, half = 1 << 31, []
    for _ in range(REACH + 1):
        whole = (1 << 31) + power
        half.append(((1 << 47) + (whole >> 1)) // whole)
        power = power * DECAY >> 31
    squash = [65536 - p for p in reversed(half[1:])] + half
    return [limited(p) for p in squash], [bisect_left(squash, 16 * n + 8) - REACH for n in range(4096)]


def limited(p: int) -> int:
    """A chance that leaves room for both bits."""
    return max(FLOOR, min(p, 65536 - FLOOR))


SQUASH, STRETCH = tables()


class Models:
    """Chances, of 2^22, with how often they learnt, and sets of weights; made when they are first asked for."""

    def __init__(self) -> None:
        self.chances: dict[Hashable, tuple[int, int]] = {}
        self.weights: dict[Hashable, list[int]] = {}


class Bits:
    """Bits of a code, behind whose end there are zeros. Contexts and sets of weights have any names."""

    def __init__(self, data: bytes, models: Models | None = None) -> None:
        self.data, self.place, self.range = data, 6, ONE
        self.x = int.from_bytes(data[:6].ljust(6, b"\0"), "big")
        self.models = models or Models()

    def narrow(self, p: int) -> int:
        """A bit that is 1 with chance p / 65536."""
        bound = (self.range >> 16) * p
        bit = int(self.x < bound)
        self.x, self.range = (self.x, bound) if bit else (self.x - bound, self.range - bound)
        if self.range < LEAST:
            word = self.data[self.place : self.place + 2].ljust(2, b"\0")
            self.x, self.range = self.x << 16 | int.from_bytes(word, "big"), self.range << 16
            self.place += 2
        return bit

    def seen(self, context: Hashable) -> tuple[int, int]:
        """The chance of a context, of 2^22, and how often it was learnt."""
        return self.models.chances.get(context, (1 << 21, 0))

    def learn(self, context: Hashable, bit: int) -> None:
        """Move a chance towards a bit."""
        chance, count = self.seen(context)
        chance += (bit * 4194303 - chance) * ((1 << 20) // (2 * count + 3)) >> 19
        self.models.chances[context] = chance, min(count + 1, LIMIT)

    def code(self, context: Hashable) -> int:
        """A bit by one context."""
        bit = self.narrow(limited(self.seen(context)[0] >> 6))
        self.learn(context, bit)
        return bit

    def mix(self, contexts: Sequence[Hashable], chosen: Hashable) -> int:
        """A bit by several contexts, mixed by a set of weights."""
        weights = self.models.weights.setdefault(chosen, [FIRST_WEIGHT] * len(contexts))
        logits = [STRETCH[self.seen(c)[0] >> 10] for c in contexts]
        total = sum(x * w for x, w in zip(logits, weights)) >> 16
        p = SQUASH[max(-REACH, min(total, REACH)) + REACH]
        bit = self.narrow(p)
        error = (bit << 16) - p
        for n, (context, logit) in enumerate(zip(contexts, logits)):
            weights[n] += logit * error + 8192 >> 14
            self.learn(context, bit)
        return bit

    def even(self, count: int) -> int:
        """A number of even bits, the highest first."""
        out = 0
        for _ in range(count):
            out = out << 1 | self.narrow(32768)
        return out

    def gamma(self, most: int) -> int:
        """A number above 0 in Elias' gamma code, of `most` digits behind the first."""
        digits = 0
        while digits < most and self.even(1):
            digits += 1
        return 1 << digits | self.even(digits)


# -- lists of bricks --------------------------------------------------------------------------------------

EIGHT = [(n >> 2, n >> 1 & 1, n & 1) for n in range(8)]
FACES = [(-1, 0, 0), (0, -1, 0), (0, 0, -1), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
EDGES = [(-1, -1, 0), (-1, 1, 0), (-1, 0, -1), (-1, 0, 1), (0, -1, -1), (0, -1, 1)]


def allowed(size: int) -> int:
    """Bricks that a payload may list."""
    return 64 + 16 * size


def moved(at: Sequence[int], step: Sequence[int]) -> Place:
    """A place and a step from it."""
    return at[0] + step[0], at[1] + step[1], at[2] + step[2]


def marks(held: Collection[Place], at: Place, steps: Iterable[Place]) -> int:
    """Which places beside one are held, the first the lowest bit."""
    return sum((moved(at, step) in held) << n for n, step in enumerate(steps))


def bricks(bits: Bits, shape: Place, before: Iterable[Place] = ()) -> list[Place]:
    """A list of bricks, ascending; `shape` counts the bricks of the grid, `before` is a list known before."""
    boxes = [(0, 0, 0)] * bits.code(("list", 0))
    for level in reversed(range((max(shape) - 1).bit_length())):
        known = {(b[0] >> level, b[1] >> level, b[2] >> level) for b in before}
        size = [((n - 1) >> level) + 1 for n in shape]
        children = [(moved((2 * b[0], 2 * b[1], 2 * b[2]), c), b) for b in boxes for c in EIGHT]
        family = {box: parent for box, parent in sorted(children) if all(n < m for n, m in zip(box, size))}
        boxes = told(bits, family, known)
        need(len(boxes) <= allowed(len(bits.data)), "more bricks than the bytes may list")
    return boxes


def told(bits: Bits, family: dict[Place, Place], known: Collection[Place]) -> list[Place]:
    """The boxes of a level that hold bricks, of those whose parents do."""
    left, found = Counter(family.values()), dict.fromkeys(family.values(), 0)
    state = dict.fromkeys(family, 2)
    for box, parent in family.items():
        faces = edges = changed = 0
        for n, step in enumerate(FACES):
            place = moved(box, step)
            near = state.get(place, 0)
            faces = 3 * faces + near
            if n < 3:
                edges = 2 * edges + near
                changed = 2 * changed + (near ^ int(place in family and place in known))
        for step in EDGES:
            edges = 2 * edges + state.get(moved(box, step), 0)
        old = int(box in known)
        left[parent] -= 1
        state[box] = 1
        if found[parent] or left[parent]:
            contexts = [1 + (0 if old else faces), 730 + edges, 1242 + 8 * old + changed]
            contexts.append(1258 + 2 * old + (found[parent] > 0))
            state[box] = bits.mix([("list", c) for c in contexts], ("list", old))
        found[parent] += state[box]
    return [box for box in family if state[box]]


def ended(bits: Bits, count: int) -> None:
    """Refuse bytes that end before the code of `count` bricks, or go on behind it."""
    size = len(bits.data)
    need(size >= bits.place - 6, "the end of the code", TruncatedFile)
    most = max(bits.place, -(-(count - 64) // 16))
    need(size <= most and not any(bits.data[bits.place :]), "bytes behind the code")
