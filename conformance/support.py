"""Decodes the support of a frame, index is the set of samples that have a force, and coded whole numbers, as
docs/format/bits.md says."""

from typing import NamedTuple

import numpy as np
from reading import Place, need, samples_of
from touch_bits import FACES, Bits, bricks, mask_of

NEAR = [
    *FACES[:3],
    (-1, 0, 1),
    (0, -1, -1),
    (0, -1, 1),
    (-1, -1, 0),
    (-2, 0, 0),
    (0, -2, 0),
    (-1, 1, 0),
    (-1, 1, 1),
    (0, 0, -2),
]


class Support(NamedTuple):
    """The bricks of a frame, ascending, and its samples, in raster order."""

    bricks: list[Place]
    samples: list[Place]


NOTHING = Support([], [])


def support(bits: Bits, shape: Place, before: Support) -> Support:
    """A support of a grid of so many samples; `before` is empty where none is known."""
    listed, samples_before, is_set = bricks(bits, shape, before.bricks), set(before.samples), set[Place]()
    for brick in listed:
        for at in samples_of(brick, shape):
            near, around_before = mask_of(is_set, at, NEAR), mask_of(samples_before, at, [(0, 0, 0), *FACES])
            if bits.mix([("near", near), ("around_before", around_before, near & 7)], ("set", near & 7)):
                is_set.add(at)
        bits.need(any(at in is_set for at in samples_of(brick, shape)), "a brick without samples")
    bits.check()
    return Support(listed, sorted(is_set))


def support_alone(data: bytes, shape: Place, before: Support) -> Support:
    """The support that `data` codes to its end."""
    bits = Bits(data)
    out = support(bits, shape, before)
    bits.end(len(out.bricks))
    return out


def signed_digits(n: int, max_digits: int) -> int:
    """The binary digits of a number, at most `max_digits`, with its sign."""
    return int(np.sign(n)) * min(n.bit_length(), max_digits)


def numbers(bits: Bits, count: int, name: str = "") -> list[int]:
    """Whole numbers; those of another name have contexts of their own."""
    out = [0, 0, 0]
    for _ in range(count):
        near, sizes = (
            tuple(max(-2, min(r, 2)) for r in out[-3:]),
            (signed_digits(out[-1], 10), signed_digits(out[-2], 3)),
        )

        def bit(index: int) -> int:
            return bits.mix([(name, index), (name, near, index), (name, sizes, index)], (name, index))  # noqa: B023

        value = 0
        if bit(0):
            is_negative, length = bit(1), 1
            while bit(1 + min(length, 14)) and length < 62:
                length += 1
            value = (
                1 if length == 1 else (2 | bit(16 + min(length, 15))) << length - 2 | bits.even(length - 2)
            )
            value = -value if is_negative else value
        out.append(value)
    return out[3:]


def whole_numbers(data: bytes, count: int) -> list[int]:
    """So many whole numbers, which `data` codes to its end."""
    bits = Bits(data)
    out = numbers(bits, count)
    bits.end(0)
    need(all(abs(n) < 1 << 30 for n in out), "a number that is too large")
    return out
