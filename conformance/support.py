"""The support of a frame, and whole numbers: docs/format/bits.md."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray
from reading import TruncatedFile, need
from touch_bits import Bits, bricks, ended, moved

__all__ = ["Position", "Support", "numbers", "samples_of", "support", "support_alone", "whole_numbers"]

Position = tuple[int, int, int]
Support = dict[Position, NDArray[np.bool_]]
"""Bricks, ascending, and which of their samples are set, bool [8, 8, 8]."""

NEAR = [(-1, 0, 0), (0, -1, 0), (0, 0, -1), (-1, 0, 1), (0, -1, -1), (0, -1, 1), (-1, -1, 0), (-2, 0, 0), (0, -2, 0),
        (-1, 1, 0), (-1, 1, 1), (0, 0, -2)]  # fmt: skip
LATE = [(0, 0, 0), (0, 0, -1), (0, 0, 1), (0, -1, 0), (0, 1, 0), (-1, 0, 0), (1, 0, 0)]


def samples_of(held: Support) -> list[Position]:
    """The set samples as positions in the grid, in raster order."""
    return sorted((x, y, z) for b, mask in held.items() for x, y, z in (np.argwhere(mask) + 8 * np.array(b)).tolist())


def support(bits: Bits, shape: Position, before: Support) -> Support:
    """A support of a grid of so many samples; `before` is empty where none is known."""
    x, y, z = (-(-n // 8) for n in shape)
    out = {b: np.zeros((8, 8, 8), bool) for b in bricks(bits, (x, y, z), list(before))}
    old, held = set(samples_of(before)), set()
    for b, mask in out.items():
        for step in product(range(8), repeat=3):
            at = moved((8 * b[0], 8 * b[1], 8 * b[2]), step)
            if all(n < m for n, m in zip(at, shape)):
                near = sum((moved(at, s) in held) << k for k, s in enumerate(NEAR))
                late = sum((moved(at, s) in old) << k for k, s in enumerate(LATE))
                if bits.mix([("near", near), ("late", late << 3 | near & 7)], ("held", near & 7)):
                    held.add(at)
                    mask[step] = True
    need(len(bits.data) >= bits.place - 6, "the end of the code", TruncatedFile)
    need(all(mask.any() for mask in out.values()), "a brick without samples")
    return out


def support_alone(data: bytes, shape: Position, before: Support) -> Support:
    """The support that `data` tells to its end."""
    bits = Bits(data)
    out = support(bits, shape, before)
    ended(bits, len(out))
    return out


def numbers(bits: Bits, count: int, name: str = "") -> list[int]:
    """Whole numbers; those of another name have contexts of their own."""
    out = [0, 0, 0]
    for _ in range(count):
        r1, r2, r3 = out[:-4:-1]
        near = tuple(max(-2, min(r, 2)) for r in (r1, r2, r3))
        sizes = sized(r1, 10), sized(r2, 3)

        def bit(which: int) -> int:
            return bits.mix([(name, which), (name, near, which), (name, sizes, which)], (name, which))  # noqa: B023

        value = 0
        if bit(0):
            negative, length = bit(1), 1
            while bit(1 + min(length, 14)) and length < 62:
                length += 1
            value = 1 if length == 1 else (2 | bit(16 + min(length, 15))) << length - 2 | bits.even(length - 2)
            value = -value if negative else value
        out.append(value)
    return out[3:]


def sized(n: int, most: int) -> int:
    """The binary digits of a number, `most` at most, with its sign."""
    digits = min(abs(n).bit_length(), most)
    return -digits if n < 0 else digits


def whole_numbers(data: bytes, count: int) -> list[int]:
    """So many whole numbers, which `data` tells to its end."""
    bits = Bits(data)
    out = numbers(bits, count)
    ended(bits, 0)
    need(all(abs(n) < 1 << 30 for n in out), "a number that is too large")
    return out
