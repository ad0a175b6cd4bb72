"""The arithmetic decoder with two mixed models, whole numbers, and the support of a frame: docs/format/paper.md."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import product

import numpy as np
from numpy.typing import NDArray
from reading import Cursor, TruncatedFile, need

__all__ = ["Coder", "Models", "Position", "Support", "decode_support", "samples_of", "whole_numbers"]

Position = tuple[int, int, int]
Support = dict[Position, NDArray[np.bool_]]
"""Bricks, ascending, and which of their samples are set, bool [8, 8, 8]."""


def logistic_tables() -> tuple[list[int], list[int]]:
    """Squash of -3072 .. 3071, and stretch of 0 .. 4095, by whole numbers."""
    one = 1 << 96
    step = term = one
    for n in range(1, 20):
        term //= 256 * n
        step += term
    power, upper = one, []
    for _ in range(3072):
        upper.append((65536 * power + (one + power) // 2) // (one + power))
        power = power * step >> 96
    squash = [65536 - upper[max(1, min(-x, 3071))] if x < 0 else upper[x] for x in range(-3072, 3072)]
    stretch, x = [], -3072
    for n in range(4096):
        while squash[x + 3072] < 16 * n + 8:
            x += 1
        stretch.append(x)
    return [max(4, min(s, 65532)) for s in squash], stretch


SQUASH, STRETCH = logistic_tables()
RATES = [(1 << 20) // (2 * n + 3) for n in range(161)]
CERTAIN = (1 << 22) - 1


@dataclass
class Coder:
    """The arithmetic decoder: an interval of 48 bits."""

    data: bytes
    used: int = 0
    low: int = 0
    high: int = (1 << 48) - 1
    value: int = field(init=False)

    def __post_init__(self) -> None:
        self.value = int.from_bytes(self.data[:6].ljust(6, b"\0"), "big")

    def bit(self, p: int) -> int:
        """The next bit, whose chance to be 1 is p / 65536."""
        span = self.high - self.low
        middle = self.low + (span >> 16) * p + ((span & 65535) * p >> 16)
        bit = int(self.value <= middle)
        if bit:
            self.high = middle
        else:
            self.low = middle + 1
        while self.low >> 40 == self.high >> 40:
            byte = self.data[self.used + 6] if self.used + 6 < len(self.data) else 0
            need(self.used < len(self.data), "the end of the code", TruncatedFile)
            self.used += 1
            mask = (1 << 48) - 1
            self.value = (self.value << 8 & mask) | byte
            self.low = self.low << 8 & mask
            self.high = (self.high << 8 & mask) | 255
        return bit

    def ending(self) -> bytes:
        """The fewest bytes that name a number within the interval."""
        for count in range(7):
            unit_size = 1 << (48 - 8 * count)
            number = -(-self.low // unit_size) * unit_size
            if number <= self.high:
                return number.to_bytes(7, "big")[1 : 1 + count]
        raise AssertionError("an empty interval")


class Models:
    """Two models of chances that are mixed."""

    def __init__(self, coder: Coder) -> None:
        self.coder = coder
        self.chances: dict[tuple[int, int], int] = {}
        self.visits: dict[tuple[int, int], int] = {}
        self.weights: dict[int, list[int]] = {}

    def learn(self, context: tuple[int, int], bit: int) -> None:
        chance, seen = self.chances.get(context, 1 << 21), self.visits.get(context, 0)
        self.chances[context] = chance + ((CERTAIN * bit - chance) * RATES[seen] >> 19)
        self.visits[context] = min(seen + 1, 160)

    def sure(self, first: int) -> int | None:
        """A bit by the first model alone, where that is sure of itself."""
        chance = self.chances.get((0, first), 1 << 21)
        if self.visits.get((0, first), 0) < 30 or 8192 <= chance <= CERTAIN - 8192:
            return None
        bit = self.coder.bit(max(4, min(chance >> 6, 65532)))
        self.learn((0, first), bit)
        return bit

    def mixed(self, first: int, second: int, chosen: int) -> int:
        """A bit by both models."""
        a, b = (STRETCH[self.chances.get(c, 1 << 21) >> 10] for c in ((0, first), (1, second)))
        weights = self.weights.setdefault(chosen, [40960, 40960])
        x = weights[0] * a + weights[1] * b >> 16
        p = SQUASH[max(-3072, min(x, 3071)) + 3072]
        bit = self.coder.bit(p)
        error = 65536 * bit - p
        weights[0] += a * error + 8192 >> 14
        weights[1] += b * error + 8192 >> 14
        self.learn((0, first), bit)
        self.learn((1, second), bit)
        return bit


def check_end(data: bytes, wanted: bytes) -> None:
    """Refuse a code that is not what was read of it."""
    need(len(data) >= len(wanted), "the end of the code", TruncatedFile)
    need(data == wanted, "bytes behind the end of the code")


def whole_numbers(data: bytes, count: int) -> list[int]:
    """So many whole numbers, which `data` tells to its end."""
    coder = Coder(data)
    models = Models(coder)
    numbers: list[int] = []
    a = b = 0
    for _ in range(count):
        node = 1
        for _ in range(5):
            node = 2 * node + models.mixed(32 * a + node, 32 * (32 * a + b) + node, node)
        digits = node - 32
        v = int(digits > 0)
        for i in range(digits - 1):
            if i < 3:
                h = v % 8
                bit = models.mixed(2048 + 8 * digits + h, 65536 + 8 * digits + h, 32 + h)
            else:
                bit = coder.bit(32768)
            v = 2 * v + bit
        a, b = digits, a
        numbers.append(-(v + 1) // 2 if v % 2 else v // 2)
    check_end(data, data[: coder.used] + coder.ending())
    return numbers


def brick_counts(shape: Position) -> Position:
    """Bricks along x, y, z."""
    x, y, z = (-(-n // 8) for n in shape)
    return x, y, z


def inside(brick: Position, shape: Position) -> NDArray[np.bool_]:
    """Which samples of a brick lie within the grid, bool [8, 8, 8]."""
    x, y, z = (8 * b + np.arange(8) < n for b, n in zip(brick, shape))
    return x[:, None, None] & y[None, :, None] & z[None, None, :]


def samples_of(brick: Position, mask: NDArray[np.bool_]) -> list[Position]:
    """The set samples of a brick as positions in the grid."""
    return [(x, y, z) for x, y, z in (np.argwhere(mask) + 8 * np.array(brick)).tolist()]


def decode_support(data: bytes, shape: Position, previous: Support) -> Support:
    """The support in `data`; `previous` is empty where none is given."""
    c = Cursor(data)
    count = c.varint()
    nx, ny, nz = brick_counts(shape)
    need(count <= nx * ny * nz, f"{count} bricks")
    need(count <= 4 * len(data), f"{count} bricks in {len(data)} bytes", TruncatedFile)
    if count == 0:
        c.end()
        return {}
    listed = nx * ny * nz > 128 * count + 4096
    bricks = brick_list(c, (nx, ny, nz), count) if listed else {}
    coder = Coder(data[c.at :])
    if not listed:
        bricks = brick_states(coder, (nx, ny, nz), count, shape, previous)
    support = decode_samples(coder, bricks, shape, previous)
    check_end(data, (data[: c.at + coder.used] + coder.ending()).ljust(-(-count // 4), b"\0"))
    return {brick: support[brick] for brick in sorted(support)}


def brick_list(c: Cursor, counts: Position, count: int) -> dict[Position, bool]:
    """Bricks by the gaps between them, and whether each is full."""
    bricks, key = {}, -1
    for _ in range(count):
        value = c.varint()
        key += (value >> 1) + 1
        need(key < math.prod(counts), "a brick beyond the grid")
        rest, z = divmod(key, counts[2])
        x, y = divmod(rest, counts[1])
        bricks[x, y, z] = bool(value & 1)
    return bricks


def brick_states(
    coder: Coder, counts: Position, count: int, shape: Position, previous: Support
) -> dict[Position, bool]:
    """Which bricks hold samples, and whether each is full."""
    models = Models(coder)
    before = {b: 2 if (mask == inside(b, shape)).all() else 1 for b, mask in previous.items()}
    states: dict[Position, int] = {}

    def state(x: int, y: int, z: int) -> int:
        return states.get((x, y, z), 0)

    for x, y, z in product(range(counts[0]), range(counts[1]), reversed(range(counts[2]))):
        if len(states) == count:
            break
        old = before.get((x, y, z), 0)
        near = 9 * state(x, y, z + 1) + 3 * state(x, y - 1, z) + state(x - 1, y, z)
        far = ((x, y - 1, z - 1), (x - 1, y, z - 1), (x - 1, y + 1, z), (x - 1, y - 1, z))
        wide = sum((state(*b) > 0) << i for i, b in enumerate(far))
        c = 2 * (3 * near + old)
        if models.mixed(c, 16 * c + wide, 2 * old):
            states[x, y, z] = 1 + models.mixed(c + 1, 16 * (c + 1) + wide, 2 * old + 1)
    need(len(states) == count, "fewer bricks than were counted")
    return {brick: s == 2 for brick, s in states.items()}


FIRST = (
    (-1, 0, 0), (-1, 0, -1), (0, -1, 1), (0, -1, 0), (0, -1, -1), (-1, -1, 0),
    (-2, 0, 2), (-1, 1, 0), (-1, 1, -1), (-2, -2, 0), (0, -2, 1), (0, 0, 1),
)  # fmt: skip
WEIGHTS = ((-1, 0, 0), (0, -1, 0), (0, 0, 1))
SECOND = (
    (-1, 0, 1), (-1, 0, 0), (-1, 0, -1), (-1, 0, -2), (0, -1, 1), (0, -1, 0), (0, -1, -1), (0, -1, -2),
    (0, 0, 4), (0, 0, 3), (0, 0, 2), (0, 0, 1), (-2, 0, 0), (0, -2, 0),
)  # fmt: skip
BEFORE = ((0, 0, 1), (0, 0, 0), (0, 0, -1), (-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0))


def decode_samples(coder: Coder, bricks: dict[Position, bool], shape: Position, previous: Support) -> Support:
    """The samples of all bricks."""
    models = Models(coder)
    support = {b: inside(b, shape) if full else np.zeros((8, 8, 8), bool) for b, full in bricks.items()}
    known = {s for b, mask in support.items() for s in samples_of(b, mask)}
    before = {s for b, mask in previous.items() for s in samples_of(b, mask)}

    def number(samples: set[Position], at: Position, offsets: tuple[Position, ...]) -> int:
        x, y, z = at
        return sum(((x + dx, y + dy, z + dz) in samples) << i for i, (dx, dy, dz) in enumerate(offsets))

    for brick in sorted(bricks, key=lambda b: (b[0], b[1], -b[2])):
        if bricks[brick]:
            continue
        places = sorted(samples_of(brick, inside(brick, shape)), key=lambda s: (s[0], s[1], -s[2]))
        for at in places:
            first = number(known, at, FIRST)
            bit = models.sure(first)
            if bit is None:
                chosen = number(known, at, WEIGHTS)
                if previous:
                    second = number(before, at, BEFORE) | chosen << len(BEFORE)
                else:
                    second = number(known, at, SECOND)
                bit = models.mixed(first, second, chosen)
            if bit:
                known.add(at)
                support[brick][tuple(i & 7 for i in at)] = True
        held = np.count_nonzero(support[brick])
        need(0 < held < len(places), "a brick that is empty or full and should not be")
    return support
