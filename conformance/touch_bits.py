"""The part of the second decoder for coder `touch` that reads bits and the list of bricks, in plain Python."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np

__all__ = ["LIST_CONTEXTS", "LIST_SETS", "Bits", "bricks"]

Place = tuple[int, int, int]

LIST_CONTEXTS, LIST_SETS = 1 + 729 + 512 + 16 + 4, 2
_FACES = ((-1, 0, 0), (0, -1, 0), (0, 0, -1), (1, 0, 0), (0, 1, 0), (0, 0, 1))
_EDGES = ((-1, -1, 0), (-1, 1, 0), (-1, 0, -1), (-1, 0, 1), (0, -1, -1), (0, -1, 1))


def _tables() -> tuple[list[int], list[int]]:
    """65536 / (1 + e^-x) for x = -3072/256 to 3071/256, and its inverse for the middles of 4096 steps."""
    one = step = term = 1 << 96
    for k in range(1, 20):
        term //= 256 * k
        step += term
    power, half = one, []
    for _ in range(3072):
        half.append((65536 * power + (one + power) // 2) // (one + power))
        power = power * step >> 96
    below = [65536 - p for p in reversed(half[1:])]
    squash = [below[0], *below, *half]
    stretch = np.searchsorted(squash, 16 * np.arange(4096) + 8) - 3072
    return [min(max(p, 4), 65532) for p in squash], stretch.tolist()


SQUASH, STRETCH = _tables()


class Bits:
    """A binary range decoder with its models; behind the end of `data` there are zeros."""

    def __init__(self, data: bytes, contexts: int, sets: int, inputs: int) -> None:
        self.data, self.place, self.range = data, 6, 1 << 48
        self.x = int.from_bytes(data[:6].ljust(6, b"\0"), "big")
        self.chances, self.seen = [1 << 21] * contexts, [0] * contexts
        self.weights = [[78643 // inputs] * 8 for _ in range(sets)]

    def narrow(self, p: int) -> int:
        """A bit that is 1 with the chance p / 65536."""
        bound = (self.range >> 16) * p
        bit = int(self.x < bound)
        if bit:
            self.range = bound
        else:
            self.range -= bound
            self.x -= bound
        if self.range < 1 << 32:
            word = self.data[self.place : self.place + 2].ljust(2, b"\0")
            self.x, self.range, self.place = (
                self.x << 16 | int.from_bytes(word, "big"),
                self.range << 16,
                self.place + 2,
            )
        return bit

    def learn(self, context: int, bit: int) -> None:
        rate = (1 << 19) * 2 // (2 * self.seen[context] + 3)
        self.chances[context] += ((4194303 * bit - self.chances[context]) * rate) >> 19
        self.seen[context] += self.seen[context] < 255

    def code(self, context: int) -> int:
        """A bit by the chance of one context."""
        bit = self.narrow(min(max(self.chances[context] >> 6, 4), 65532))
        self.learn(context, bit)
        return bit

    def mix(self, contexts: Sequence[int], chosen: int) -> int:
        """A bit by several contexts, mixed by a set of weights."""
        weights = self.weights[chosen]
        logits = [STRETCH[self.chances[context] >> 10] for context in contexts]
        x = sum(logit * w for logit, w in zip(logits, weights)) >> 16
        p = SQUASH[min(max(x, -3072), 3071) + 3072]
        bit = self.narrow(p)
        for n, context in enumerate(contexts):
            weights[n] += (logits[n] * ((bit << 16) - p) + 8192) >> 14
            self.learn(context, bit)
        return bit

    def even(self, count: int) -> int:
        """So many even bits, the highest first."""
        out = 0
        for _ in range(count):
            out = out << 1 | self.narrow(32768)
        return out


def bricks(bits: Bits, shape: Place) -> list[Place]:
    """A list of bricks of a grid of `shape` bricks, none known before; its chances and weights are the first ones."""
    boxes: list[Place] = [(0, 0, 0)] if bits.code(0) else []
    for level in range((max(shape) - 1).bit_length() - 1, -1, -1):
        size = [((n - 1) >> level) + 1 for n in shape]
        children = [
            tuple(2 * p + c for p, c in zip(box, child)) for box in boxes for child in product((0, 1), repeat=3)
        ]
        left = dict.fromkeys(boxes, 0)
        listed = sorted(key for key in children if all(k < n for k, n in zip(key, size)))
        for key in listed:
            left[tuple(k >> 1 for k in key)] += 1
        state, found = dict.fromkeys(listed, 2), dict.fromkeys(boxes, 0)
        for key in listed:
            faces, edges = 0, 0
            for n, step in enumerate(_FACES):
                told = state.get(tuple(k + s for k, s in zip(key, step)), 0)
                faces = faces * 3 + told
                edges = edges << 1 | told if n < 3 else edges
            changed = edges
            for step in _EDGES:
                edges = edges << 1 | state.get(tuple(k + s for k, s in zip(key, step)), 0)
            parent, bit = tuple(k >> 1 for k in key), 1
            left[parent] -= 1
            if found[parent] or left[parent]:
                bit = bits.mix((1 + faces, 730 + edges, 1242 + changed, 1258 + (found[parent] > 0)), 0)
            state[key] = bit
            found[parent] += bit
        boxes = [key for key in listed if state[key]]
    return boxes
