"""Decodes single bits as docs/format/bits.md says: a range decoder with adaptive probabilities, their mixing,
and lists of bricks (blocks of 8x8x8 samples).

All numbers are Python's; none needs more than 63 bits. Contexts and sets of weights have any names.
"""

from bisect import bisect_left
from collections import Counter, defaultdict
from collections.abc import Collection, Hashable, Iterable, Sequence
from itertools import product
from operator import mul

from reading import Place, TruncatedFile, moved, need

MAX_LOGIT = 3071


def limited_probability(p: int) -> int:
    """A probability at which both bits can be coded."""
    return max(4, min(p, 65532))


def tables() -> tuple[list[int], list[int]]:
    """The logistic function from -12 to 12 in 1/256, and its inverse at the middle of each 1/4096."""
    power, half = 1 << 31, []
    for _ in range(MAX_LOGIT + 1):
        whole = (1 << 31) + power
        half.append(((1 << 47) + (whole >> 1)) // whole)
        power = power * 2139111403 >> 31
    squash = [65536 - p for p in reversed(half[1:])] + half
    return [limited_probability(p) for p in squash], [
        bisect_left(squash, 16 * n + 8) - MAX_LOGIT for n in range(4096)
    ]


SQUASH, STRETCH = tables()
RATES = [(1 << 20) // (2 * n + 3) for n in range(256)]  # of a context with count n


class Models:
    """Contexts (a probability, in 1/2^22, and a count) and sets of weights; each is made at its first use."""

    def __init__(self) -> None:
        self.probabilities = defaultdict[Hashable, list[int]](lambda: [1 << 21, 0])
        self.weights = dict[Hashable, list[int]]()


class Bits:
    """Bits of a code; zeros follow its end."""

    def __init__(self, data: bytes, models: Models | None = None) -> None:
        self.data, self.place, self.range = data, 6, 1 << 48
        self.x = int.from_bytes(data[:6].ljust(6, b"\0"), "big")
        self.models = models or Models()
        self.max_bricks = 64 + 16 * len(data)  # bricks that may be listed

    def narrow(self, p: int) -> int:
        """A bit that is 1 with probability p / 65536."""
        bound = (self.range >> 16) * p
        bit = int(self.x < bound)
        self.x, self.range = (self.x, bound) if bit else (self.x - bound, self.range - bound)
        if self.range < 1 << 32:
            word = self.data[self.place : self.place + 2].ljust(2, b"\0")
            self.x, self.range = self.x << 16 | int.from_bytes(word, "big"), self.range << 16
            self.place += 2
        return bit

    def learn(self, seen: list[list[int]], bit: int) -> None:
        """Move probabilities towards a bit."""
        for own in seen:
            probability, times = own
            own[0] = probability + ((bit * 4194303 - probability) * RATES[times] >> 19)
            if times < 255:
                own[1] = times + 1

    def code(self, context: Hashable) -> int:
        """A bit by one context."""
        own = self.models.probabilities[context]
        bit = self.narrow(limited_probability(own[0] >> 6))
        self.learn([own], bit)
        return bit

    def mix(self, contexts: Sequence[Hashable], chosen: Hashable) -> int:
        """A bit by several contexts, mixed by a set of weights."""
        probabilities, weights = (
            self.models.probabilities,
            self.models.weights.setdefault(chosen, [14000] * len(contexts)),
        )
        seen = [probabilities[context] for context in contexts]
        logits = [STRETCH[own[0] >> 10] for own in seen]
        total = sum(map(mul, logits, weights)) >> 16
        p = SQUASH[max(-MAX_LOGIT, min(total, MAX_LOGIT)) + MAX_LOGIT]
        bit = self.narrow(p)
        error = (bit << 16) - p
        for n, logit in enumerate(logits):
            weights[n] += logit * error + 8192 >> 14
        self.learn(seen, bit)
        return bit

    def even(self, count: int) -> int:
        """A number of even bits, the highest first."""
        out = 0
        for _ in range(count):
            out = out << 1 | self.narrow(32768)
        return out

    def gamma(self, max_digits: int) -> int:
        """A number above 0 in Elias' gamma code, of `max_digits` digits behind the first."""
        digits = 0
        while digits < max_digits and self.even(1):
            digits += 1
        return 1 << digits | self.even(digits)

    def check(self) -> None:
        """Refuse a code that ends too early."""
        need(self.place <= len(self.data) + 6, "the end of the code", TruncatedFile)

    def need(self, condition: object, message: str) -> None:
        """Refuse what was decoded unless `condition` holds; after the end of the bytes it is cut short."""
        if not condition:
            self.check()
        need(condition, message)

    def end(self, bricks: int, tiles: int = 0) -> None:
        """Refuse bytes that end before the code, or go on after it.

        It lists `bricks` bricks, and has columns of `tiles` tiles.
        """
        self.check()
        max_size = max(self.place, -(-(bricks - 64) // 16), tiles - 64)
        need(len(self.data) <= max_size and not any(self.data[self.place :]), "bytes behind the code")


# -- lists of bricks ---------------------------------------------------------------------------------------

FACES = [(-1, 0, 0), (0, -1, 0), (0, 0, -1), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
EDGES = [(-1, -1, 0), (-1, 1, 0), (-1, 0, -1), (-1, 0, 1), (0, -1, -1), (0, -1, 1)]


def mask_of(places: Collection[Place], at: Place, steps: Iterable[Place]) -> int:
    """Which places at some steps from `at` are among `places`, the first the lowest bit."""
    (x, y, z), out = at, 0
    for n, (i, j, k) in enumerate(steps):
        if (x + i, y + j, z + k) in places:
            out |= 1 << n
    return out


def bricks(bits: Bits, shape: Place, before: Collection[Place] = ()) -> list[Place]:
    """A list of bricks of a grid of so many samples, ascending; `before` is a list known before."""
    boxes: list[Place] = [(0, 0, 0)] * bits.code(("list", 0))
    for level in reversed(range((max(shape) - 1 >> 3).bit_length())):
        known, last = {tuple(n >> level for n in b) for b in before}, [n - 1 >> level + 3 for n in shape]
        children = sorted((moved(moved(b, b), c), b) for b in boxes for c in product((0, 1), repeat=3))
        family = {box: parent for box, parent in children if all(n <= m for n, m in zip(box, last))}
        left, found, state = Counter(family.values()), Counter[Place](), dict.fromkeys(family, 2)
        for box, parent in family.items():
            is_known, places = box in known, [moved(box, step) for step in FACES]
            faces = [state.get(at, 0) for at in places]
            edges = faces[:3] + [state.get(moved(box, step), 0) for step in EDGES]
            changed = [near ^ (at in family and at in known) for near, at in zip(faces[:3], places)]
            contexts = [("faces", *(0 if is_known else near for near in faces)), ("edges", *edges)]
            contexts += [("changed", is_known, *changed), ("found", is_known, found[parent] > 0)]
            left[parent] -= 1
            state[box] = bits.mix(contexts, ("list", is_known)) if found[parent] or left[parent] else 1
            found[parent] += state[box]
        boxes = [box for box in family if state[box]]
        bits.need(len(boxes) <= bits.max_bricks, "more bricks than the bytes may list")
    return boxes
