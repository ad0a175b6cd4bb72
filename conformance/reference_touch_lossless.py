"""The part of the second decoder for frame model 3 of coder `touch`, fields that are kept to the bit."""

from __future__ import annotations

import struct
from collections.abc import Callable

import numpy as np
from reference_decoder import (
    CERTAIN,
    RATES,
    SQUASH,
    STRETCH,
    Coder,
    Cursor,
    Forces,
    Models,
    Position,
    codebook,
    decode_support,
    need,
)

__all__ = ["decode_lossless"]

Bits = tuple[int, int, int]
"""A vector as the bits of three float32."""
Symbols = tuple[int, ...]
Near = list[tuple[int, ...]]

INFINITY = 0x7F800000
SIGN = 1 << 31
MASK_22 = (1 << 22) - 1


# -- whole numbers and values -----------------------------------------------------------------------------


def ended(coder: Coder, data: bytes) -> None:
    need(data[coder.used :] == coder.ending(), "the end of a code")


def whole_numbers(data: bytes, count: int) -> list[int]:
    """Numbers of up to 31 bits."""
    coder = Coder(data)
    models = Models(coder)
    out, last, before = [], 0, 0
    for _ in range(count):
        node = 1
        for _ in range(5):
            node = 2 * node + models.mixed(32 * last + node, 32 * (32 * last + before) + node, node)
        length = node - 32
        value = int(length > 0)
        for place in range(1, length):
            if place <= 3:
                low = value & 7
                a, b = 2048 + 8 * length + low, 65536 + 8 * length + low
                value = 2 * value + models.mixed(a, b, 32 + low)
            else:
                value = 2 * value + coder.bit(32768)
        out.append(value)
        before, last = last, length
    ended(coder, data)
    return out


def values_of(c: Cursor, most: int) -> list[int]:
    """Values as float32 bits, ascending; at most `most` of them."""
    unit = np.float32(c.number("f"))
    need(unit >= 0, "the unit of values")
    count = c.varint()
    need(1 <= count <= most, f"{count} values")
    numbers = whole_numbers(c.chunk(), 2 * count)
    magnitudes, last = [], -1
    for gap in numbers[:count]:
        last += gap + 1
        magnitudes.append(last)
    need(last <= ((1 << 18) - 1 if unit > 0 else INFINITY - 1), "a value beyond all limits")
    if unit > 0:
        with np.errstate(over="ignore"):
            products = np.array(magnitudes, np.float32) * unit
        magnitudes = products.view(np.uint32).tolist()
        ascend = all(a < b for a, b in zip(magnitudes, magnitudes[1:]))
        need(ascend and magnitudes[-1] < INFINITY, "multiples that are not distinct or not finite")
    signs = numbers[count:]
    need(all(1 <= s <= 3 for s in signs), "a sign that there is not")
    negative = [SIGN | m for m, s in zip(magnitudes, signs) if s & 2]
    values = negative[::-1] + [m for m, s in zip(magnitudes, signs) if s & 1]
    need(len(values) <= most, f"{len(values)} values")
    return values


# -- palettes ---------------------------------------------------------------------------------------------


class Palette:
    """Vectors as symbols of one or more planes."""

    def __init__(self, sizes: Symbols, decode: Callable[[Symbols], Bits], encode: Callable[[Bits], Symbols | None]):
        self.sizes, self.decode, self.encode = sizes, decode, encode
        """`encode` gives None for a vector that the palette has not."""


def read_palette(c: Cursor, count: int) -> Palette:
    """The palette of a frame of `count` vectors."""
    kind = c.number("B")
    if kind == 0:

        def octets(v: Bits) -> Symbols:
            return tuple(struct.pack(">3I", *v))

        return Palette((256,) * 12, lambda s: struct.unpack(">3I", bytes(s)), octets)
    if kind == 1:
        values = values_of(c, min(3 * count, 1 << 18))
        rank = {v: i for i, v in enumerate(values)}

        def ranks(v: Bits) -> Symbols | None:
            return tuple(rank[n] for n in v) if all(n in rank for n in v) else None

        return Palette((len(values),) * 3, lambda s: (values[s[0]], values[s[1]], values[s[2]]), ranks)
    if kind == 2:
        return table(vectors_of(c, min(count, 1 << 16)))
    need(kind == 3, f"a palette of kind {kind}")
    name = c.take(c.number("B")).decode("ascii")
    vertices = codebook(name)
    levels = values_of(c, min(count, (1 << 18) // len(vertices)))
    need(levels[-1] < SIGN and min(levels) < SIGN and max(levels) < SIGN, "a negative level")
    floats = np.array(levels, np.uint32).view(np.float32)
    products = (floats[:, None, None] * vertices).view(np.uint32).reshape(-1, 3).tolist()
    places: dict[Bits, int] = {}
    for i, v in enumerate(products):
        places.setdefault((v[0], v[1], v[2]), i)
    n = len(vertices)

    def product_of(s: Symbols) -> Bits:
        v = products[s[0] * n + s[1]]
        return v[0], v[1], v[2]

    def place_of(v: Bits) -> Symbols | None:
        return divmod(places[v], n) if v in places else None

    return Palette((len(levels), n), product_of, place_of)


def table(vectors: list[Bits]) -> Palette:
    """The palette of a list."""
    place = {v: i for i, v in enumerate(vectors)}
    return Palette((len(vectors),), lambda s: vectors[s[0]], lambda v: (place[v],) if v in place else None)


def vectors_of(c: Cursor, most: int) -> list[Bits]:
    """Distinct vectors, ascending."""
    values = values_of(c, 3 * most)
    count = c.varint()
    need(1 <= count <= most, f"{count} vectors")
    data = c.chunk()
    near = [(i - 1, -1, -1, -1, -1, -1) for i in range(count)]
    ranks = symbols_of(data, (len(values),) * 3, near, [None] * count)
    need(all(a < b for a, b in zip(ranks, ranks[1:])), "vectors that do not ascend")
    return [(values[a], values[b], values[c]) for a, b, c in ranks]


# -- symbols ----------------------------------------------------------------------------------------------


def stirred(*numbers: int) -> int:
    """A hash of numbers."""
    h = numbers[0]
    for value in numbers[1:]:
        t = ((h ^ value) & MASK_22) * 0x2F0B4C47 + value
        h = (t ^ t >> 19) & MASK_22
    return h


class Hashed:
    """Contexts in a table, any number of them mixed."""

    def __init__(self, coder: Coder, symbols: int) -> None:
        self.coder, self.size = coder, 1 << 12
        while self.size < min(1 << 22, 16 * symbols):
            self.size *= 2
        self.chances: dict[int, list[int]] = {}
        self.weights: dict[int, list[int]] = {}

    def bit(self, contexts: list[int], chosen: int) -> int:
        places = [c & (self.size - 1) for c in contexts]
        weights = self.weights.setdefault(chosen, [19660] * 14)
        told = [STRETCH[self.chances.setdefault(at, [1 << 21, 0])[0] >> 10] for at in places]
        x = sum(w * t for w, t in zip(weights, told)) >> 16
        p = SQUASH[max(-3072, min(x, 3071)) + 3072]
        bit = self.coder.bit(p)
        error = 65536 * bit - p
        for n, (at, t) in enumerate(zip(places, told)):
            weights[n] = max(-(1 << 22), min(weights[n] + (t * error + 8192 >> 14), 1 << 22))
            one = self.chances[at]
            one[0] += (CERTAIN * bit - one[0]) * RATES[one[1]] >> 19
            one[1] = min(one[1] + 1, 160)
        return bit


def symbols_of(data: bytes, sizes: Symbols, near: Near, previous: list[Symbols | None]) -> list[Symbols]:
    """The symbols of samples; `near` are those before each in z, y, x, zy, zx, yx, or -1."""
    coder = Coder(data)
    hashed = Hashed(coder, len(near) * len(sizes))
    out: list[Symbols] = []
    how: list[int] = []
    for i, beside in enumerate(near):
        t = previous[i]
        z, y, x = (out[j] if j >= 0 else None for j in beside[:3])
        pairs = ((z, y), (z, x), (y, x), (t, z), (t, y), (t, x))
        zy, zx, yx, tz, ty, tx = (a is not None and a == b for a, b in pairs)
        there = (t is not None) + 2 * (z is not None) + 4 * (y is not None) + 8 * (x is not None)
        pattern = there + sum(same << 4 + n for n, same in enumerate((zy, zx, yx, tz, ty, tx)))
        ways = 0
        for j in beside[:3]:
            ways = 6 * ways + (how[j] if j >= 0 else 5)
        z0, y0, x0, t0 = (s[0] + 1 if s is not None else 0 for s in (z, y, x, t))
        z1 = z[-1] + 1 if z is not None else 0
        candidates = ((t, False), (z, tz), (y, zy or ty), (x, zx or yx or tx))
        for c, (candidate, told) in enumerate(candidates):
            if candidate is None or told:
                continue
            contexts = [
                stirred(1, c, pattern), stirred(2, c, ways, pattern & 15), stirred(3, c, z0, z1),
                stirred(4, c, y0, x0, z0), stirred(5, c, t0, z0), stirred(6, c, ways, pattern),
            ]  # fmt: skip
            if hashed.bit(contexts, c):
                out.append(candidate)
                how.append(c)
                break
        else:
            made: list[int] = []
            for p in range(len(sizes)):
                made.append(one_symbol(hashed, sizes, i, p, (out, near, t), made))
            out.append(tuple(made))
            how.append(4)
    ended(coder, data)
    return out


def one_symbol(
    hashed: Hashed, sizes: Symbols, i: int, p: int, known: tuple[list[Symbols], Near, Symbols | None], made: list[int]
) -> int:
    """A symbol bit by bit."""
    out, near, before = known

    def plus_one(j: int) -> int:
        return out[j][p] + 1 if j >= 0 else 0

    jz, jy, jx, jzy, jzx, _ = near[i]
    z, y, x = plus_one(jz), plus_one(jy), plus_one(jx)
    t = before[p] + 1 if before is not None else 0
    one = made[p - 1] + 1 if p > 0 else 0
    two = made[p - 2] + 1 if p > 1 else 0
    base = stirred(7, p)
    seeds = [
        base, stirred(base, 1, z), stirred(base, 2, y), stirred(base, 3, x), stirred(base, 4, z, y, x),
        stirred(base, 5, one if p else z, two if p else x), stirred(base, 6, t, z), stirred(base, 7, z, one, two),
    ]  # fmt: skip
    first, third = z or y or x or t, y or x or t
    count = (z > 0) + (y > 0) + (x > 0)
    zz = plus_one(near[jz][0]) if jz >= 0 else 0
    yy = plus_one(near[jy][1]) if jy >= 0 else 0
    guesses = [
        first,
        z + y - plus_one(jzy) if z and y and jzy >= 0 else first,
        z + x - plus_one(jzx) if z and x and jzx >= 0 else third or first,
        t or ((z + y + x) // count if count else 0),
        2 * z - zz if z and zz else first,
        2 * y - yy if y and yy else third,
    ]
    spread = 0
    for a, b in ((z, y), (z, x), (y, x)):
        if a and b:
            spread = abs(a - b)
            break
    spread = min(spread.bit_length(), 15)
    for n, guess in enumerate(guesses):
        seeds.append(stirred(base, 8 + n, spread if n & 1 else count, int(guess > 0)))
    guesses = [max(0, min(guess - 1, sizes[p] - 1)) for guess in guesses]
    width = (sizes[p] - 1).bit_length()
    node = 1
    for left in reversed(range(width)):
        contexts = [stirred(seed, node) for seed in seeds[:8]]
        prefix, agree = node - (1 << width - 1 - left), 0
        for seed, guess in zip(seeds[8:], guesses):
            ahead = max(-2, min(prefix - (guess >> left + 1), 2))
            agree += ahead == 0
            contexts.append(stirred(seed, ((ahead + 2) * 8 + (4 * guess >> left & 7)) * 32 + left))
        node = 2 * node + hashed.bit(contexts, 4 + (20 * p + left) * 7 + agree)
    symbol = node - (1 << width)
    need(symbol < sizes[p], "a symbol that there is not")
    return symbol


# -- a frame ----------------------------------------------------------------------------------------------


def decode_lossless(payload: bytes, shape: Position, previous: Forces | None) -> Forces:
    """The forces of a frame, to the bit."""
    c = Cursor(payload)
    before = {} if previous is None else bits_of(previous)
    old_support: dict[Position, np.ndarray] = {}
    for s in sorted(before):
        mask = old_support.setdefault(brick_of(s), np.zeros((8, 8, 8), bool))
        mask[tuple(n & 7 for n in s)] = True
    support = decode_support(c.chunk(), shape, {b: old_support[b] for b in sorted(old_support)})
    if not support:
        c.end()
        return {}
    samples = [
        (8 * b[0] + x, 8 * b[1] + y, 8 * b[2] + z)
        for b, mask in support.items()
        for x, y, z in np.argwhere(mask).tolist()
    ]
    kind = c.number("B")
    if kind == 0:
        vectors = [c.numbers("3I") for _ in samples]
        c.end()
    else:
        need(kind == 1, f"forces of kind {kind}")
        palette = read_palette(c, len(samples))
        places = {s: i for i, s in enumerate(samples)}
        near = [tuple(before_in(places, support, s, step) for step in STEPS) for s in samples]
        old: list[Symbols | None] = [None] * len(samples)
        if previous is not None:
            old = [palette.encode(before.get(s, (0, 0, 0))) for s in samples]
        vectors = [palette.decode(s) for s in symbols_of(payload[c.at :], palette.sizes, near, old)]
    need(all(any(v) and all(n & ~SIGN < INFINITY for n in v) for v in vectors), "a force of zero, or not finite")
    forces: Forces = {b: np.zeros((8, 8, 8, 3), np.float32) for b in support}
    for s, v in zip(samples, vectors):
        forces[brick_of(s)][tuple(n & 7 for n in s)] = np.array(v, np.uint32).view(np.float32)
    return forces


STEPS = ((0, 0, 1), (0, 1, 0), (1, 0, 0), (0, 1, 1), (1, 0, 1), (1, 1, 0))


def brick_of(s: Position) -> Position:
    return s[0] >> 3, s[1] >> 3, s[2] >> 3


def before_in(places: dict[Position, int], support: dict[Position, np.ndarray], s: Position, step: Position) -> int:
    """The sample before by a step, -1 where none is; every brick on the way, along x, y, z, must be there."""
    at = list(s)
    for axis in range(3):
        at[axis] -= step[axis]
        if brick_of((at[0], at[1], at[2])) not in support:
            return -1
    return places.get((at[0], at[1], at[2]), -1)


def bits_of(forces: Forces) -> dict[Position, Bits]:
    """The vectors of a frame that are not zero, whose bits count."""
    out = {}
    for (bx, by, bz), brick in forces.items():
        bits = brick.view(np.uint32)
        for x, y, z in np.argwhere(bits.any(axis=-1)).tolist():
            a, b, c = bits[x, y, z].tolist()
            out[8 * bx + x, 8 * by + y, 8 * bz + z] = (a, b, c)
    return out
