"""The part of the second decoder for the exact mode of coder `touch`: docs/format/touch-exact.md, step by step."""

from __future__ import annotations

from itertools import product

import numpy as np
from decode_paper import Forces, codebook
from reading import need
from support import Position
from touch_bits import Bits, bricks, ended, moved

__all__ = ["decode_exact"]

CODEBOOKS = [f"ico{n}" for n in range(1, 21)] + [f"octa{n}" for n in range(1, 6)]
INFINITY = 0x7F800000

Symbols = list[int]


NUMBERS_AT, FRAME_AT = 0, 33 * 64
COPY_AT = FRAME_AT + 4096 + 1024
TABLE_AT = COPY_AT + 4 * 625
NEAR = [(-1, 0, 0), (0, -1, 0), (0, 0, -1), (-1, 0, 1), (0, -1, -1), (0, -1, 1), (-1, -1, 0), (-2, 0, 0), (0, -2, 0),
        (-1, 1, 0), (-1, 1, 1), (0, 0, -2)]  # fmt: skip
LATE = [(0, 0, 0), (0, 0, -1), (0, 0, 1), (0, -1, 0), (0, 1, 0), (-1, 0, 0), (1, 0, 0)]
BESIDE = [(0, 0, -1), (0, -1, 0), (-1, 0, 0), (0, -1, -1), (-1, 0, -1)]


def stirred(h: int, *values: int) -> int:
    """A hash of 22 bits."""
    for value in values:
        t = ((h ^ value) & 4194303) * 0x2F0B4C47 + value
        h = (t ^ (t >> 19)) & 4194303
    return h


def in_order(words: np.ndarray) -> np.ndarray:
    """Float32 bits as numbers that ascend with the value."""
    n = words.view(np.int32).astype(np.int64)
    return np.where(n < 0, n ^ 0x7FFFFFFF, n)


def words_of(numbers: np.ndarray) -> np.ndarray:
    """The inverse, as float32."""
    n = np.asarray(numbers, np.int64)
    return np.where(n < 0, n ^ 0x7FFFFFFF, n).astype(np.int32).view(np.float32)


def numbers(bits: Bits, count: int) -> list[int]:
    """Numbers below 2^32."""
    out, last = [], 0
    for _ in range(count):
        node = 1
        for _ in range(6):
            node = 2 * node + bits.code(NUMBERS_AT + 64 * last + node)
        last = min(node - 64, 32)
        out.append(1 << last - 1 | bits.even(last - 1) if last else 0)
    return out


class Palette:
    """Forces of symbols, and symbols of forces."""

    def __init__(self, bits: Bits, most: int) -> None:
        count, book = numbers(bits, 2)
        need(book <= len(CODEBOOKS) and (count or not book), "a codebook")
        self.vertices = codebook(CODEBOOKS[book - 1]) if book else None
        need(count <= min(most, (1 << 18) // (len(self.vertices) if book else 1)), f"{count} values")
        self.values = np.cumsum(np.array(numbers(bits, count), np.int64) + 1) - INFINITY - 1
        if count:
            need(self.values[-1] < INFINITY and (not book or self.values[0] >= 0), "values")
        self.sizes = [count, len(self.vertices)] if book else [count or 1 << 32] * 3
        self.places = {v: n for n, v in enumerate(self.values.tolist())}
        self.pairs: dict[tuple[int, ...], Symbols] = {}
        for level in range(count if book else 0):
            products = in_order((words_of(self.values)[level] * self.vertices).view(np.uint32)).tolist()
            for vertex, vector in enumerate(products):
                self.pairs.setdefault(tuple(vector), [level, vertex])

    def forces(self, symbols: list[Symbols]) -> np.ndarray:
        """Float32 [n, 3]."""
        s = np.array(symbols, np.int64).reshape(-1, len(self.sizes))
        if self.vertices is not None:
            return words_of(self.values)[s[:, :1]] * self.vertices[s[:, 1]]
        return words_of(self.values[s] if len(self.values) else s - (1 << 31))

    def symbols(self, force: np.ndarray) -> Symbols:
        """Those of a force; -1 in all planes where there are none."""
        vector = in_order(force.view(np.uint32)).tolist()
        if self.vertices is not None:
            return self.pairs.get(tuple(vector), [-1, -1])
        if not len(self.values):
            return [n + (1 << 31) for n in vector]
        found = [self.places.get(n, -1) for n in vector]
        return found if min(found) >= 0 else [-1] * 3


class Frame:
    """The samples of a frame, by place."""

    def __init__(self, bits: Bits, mask: int, palette: Palette, before: dict[Position, Symbols]) -> None:
        self.bits, self.mask, self.palette, self.before = bits, mask, palette, before
        self.symbols: dict[Position, Symbols] = {}
        self.how: dict[Position, int] = {}

    def hashed(self, h: int) -> int:
        """The context of a hash."""
        return TABLE_AT + (h & self.mask)

    def sample(self, at: Position) -> None:
        """Read a sample."""
        near = sum((moved(at, step) in self.symbols) << k for k, step in enumerate(NEAR))
        late = sum((moved(at, step) in self.before) << k for k, step in enumerate(LATE))
        if not self.bits.mix([FRAME_AT + near, FRAME_AT + 4096 + (late << 3 | near & 7)], (near & 7)):
            return
        none = [-1] * len(self.palette.sizes)
        beside = [moved(at, step) for step in BESIDE]
        told = [self.before.get(at, none), *(self.symbols.get(b, none) for b in beside)]
        same = [0 if told[c][0] < 0 else 1 + told.index(told[c]) for c in range(4)]
        pattern = sum(n * 5 ** (3 - c) for c, n in enumerate(same))
        z, y, x = (self.how.get(b, 5) for b in beside[:3])
        ways = 36 * z + 6 * y + x
        for c in range(4):
            if same[c] == c + 1:
                contexts = [COPY_AT + 625 * c + pattern, self.hashed(stirred(c, ways, pattern))]
                contexts.append(self.hashed(stirred(4 + c, told[0][0], told[1][0])))
                if self.bits.mix(contexts, 8 + c):
                    self.symbols[at], self.how[at] = told[c], c
                    return
        out: Symbols = []
        for p in range(len(none)):
            out.append(self.symbol(p, [n[p] for n in told], out))
        self.symbols[at], self.how[at] = out, 4

    def symbol(self, p: int, told: list[int], out: Symbols) -> int:
        """Read one symbol; `out` are those of the planes before."""
        t, z, y, x, zy, zx = told
        last = next((n for n in (y, x, t) if n >= 0), t)
        first = z if z >= 0 else last
        there = sum(n >= 0 for n in (z, y, x))
        spread = abs(z - y) if min(z, y) >= 0 else abs(z - x) if min(z, x) >= 0 else 0
        guesses = [
            z + y - zy if min(z, y, zy) >= 0 else first,
            z + x - zx if min(z, x, zx) >= 0 else last if last >= 0 else first,
            t if t >= 0 else sum(n for n in (z, y, x) if n >= 0) // max(there, 1),
        ]
        base, spread = stirred(8, 4 * p + there), min(spread.bit_length(), 15)
        marks = [stirred(base, spread), stirred(base, 16 + spread), stirred(base, 32 + spread)]
        seeds = [stirred(9, p), stirred(10, p, z), stirred(11, p, out[p - 1] if p else z, out[0] if p > 1 else x)]
        size = self.palette.sizes[p]
        width, node = (size - 1).bit_length(), 1
        for left in reversed(range(width)):
            depth = width - 1 - left
            if depth == 20:
                node = node << left + 1 | self.bits.even(left + 1)
                break
            contexts = []
            for guess, mark in zip(guesses, marks):
                guess = min(max(guess, 0), size - 1)
                ahead = min(max(node - (1 << depth) - (guess >> left + 1), -2), 2)
                contexts.append(stirred(mark, ((ahead + 2) * 8 + (guess << 2 >> left & 7)) * 32 + left))
            contexts += [stirred(seed, node) for seed in seeds]
            node = 2 * node + self.bits.mix([self.hashed(h) for h in contexts], 12 + 20 * p + depth)
        need(node - (1 << width) < size, "a symbol that there is not")
        return node - (1 << width)


def decode_exact(data: bytes, shape: Position, previous: Forces | None) -> Forces:
    """The forces of a frame of a grid of so many samples, to the bit."""
    need(data and data[0] <= 22, "the size of the table")
    bits = Bits(data[1:])
    x, y, z = (-(-n // 8) for n in shape)
    listed = bricks(bits, (x, y, z), list(previous or {}))
    if not listed:
        ended(bits, 0)
        return {}
    palette = Palette(bits, 1536 * len(listed))
    before: dict[Position, Symbols] = {}
    for b in set(listed) & set(previous or {}):
        forces = (previous or {})[b]
        for i, j, k in np.argwhere(forces.view(np.uint32).any(axis=-1)).tolist():
            before[8 * b[0] + i, 8 * b[1] + j, 8 * b[2] + k] = palette.symbols(forces[i, j, k])
    frame = Frame(bits, (1 << data[0]) - 1, palette, before)
    out: Forces = {}
    for b in listed:
        first = (8 * b[0], 8 * b[1], 8 * b[2])
        for step in product(range(8), repeat=3):
            at = moved(first, step)
            if all(n < m for n, m in zip(at, shape)):
                frame.sample(at)
        out[b] = np.zeros((8, 8, 8, 3), np.float32)
    for at, force in zip(frame.symbols, palette.forces(list(frame.symbols.values()))):
        need(np.isfinite(force).all() and force.view(np.uint32).any(), "a force of zero, or not finite")
        out[at[0] >> 3, at[1] >> 3, at[2] >> 3][at[0] & 7, at[1] & 7, at[2] & 7] = force
    need(all(brick.view(np.uint32).any() for brick in out.values()), "a brick without force")
    ended(bits, len(listed))
    return out
