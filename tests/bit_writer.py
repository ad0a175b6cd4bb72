"""Codes that no encoder writes: the second decoder's steps, with a range coder that writes.

`Writer` takes the bits of a code one by one, in the order in which `conformance/` reads them.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from touchfield.codec.support import Bricks, encode_support
from touchfield.medium import Grid

CONFORMANCE = str(Path(__file__).resolve().parents[1] / "conformance")
if CONFORMANCE not in sys.path:
    sys.path.append(CONFORMANCE)
touch_bits: Any = importlib.import_module("touch_bits")
reference: Any = importlib.import_module("support")


class Recorder(touch_bits.Bits):  # type: ignore[misc]
    """A reader that lists the bits it reads."""

    def __init__(self, data: bytes) -> None:
        super().__init__(data)
        self.bits: list[int] = []

    def narrow(self, p: int) -> int:
        """A bit of the code."""
        self.bits.append(super().narrow(p))
        return self.bits[-1]


class Writer(touch_bits.Bits):  # type: ignore[misc]
    """A writer of the given bits; a function that reads a code then writes it."""

    def __init__(self, bits: Iterable[int]) -> None:
        super().__init__(b"")
        self.low, self.words, self.queue = 0, 0, iter(bits)
        self.most = 1 << 40  # bricks that may be listed

    def narrow(self, p: int) -> int:
        """The next of the given bits."""
        bit, bound = next(self.queue), (self.range >> 16) * p
        self.low, self.range = (self.low, bound) if bit else (self.low + bound, self.range - bound)
        if self.range < 1 << 32:
            self.low, self.range, self.words = self.low << 16, self.range << 16, self.words + 1
        return bit

    def check(self) -> None:
        """What is written has no end."""

    def finish(self, bricks: int = 0) -> bytes:
        """The shortest code, padded to the length that so many bricks have at least."""
        assert next(self.queue, None) is None
        for count in (0, 2, 4, 6):
            spare = (1 << (48 - 8 * count)) - 1
            end = (self.low + spare) & ~spare
            if end < self.low + self.range:
                break
        data = end.to_bytes(2 * self.words + 6, "big")
        written, rest = data[: 2 * self.words], data[2 * self.words :].rstrip(b"\0")
        return (written + rest).ljust(-(-(bricks - 64) // 16), b"\0")


def number_bits(numbers: Iterable[int]) -> Iterator[int]:
    """The bits of whole numbers, as docs/format/bits.md codes them."""
    for number in numbers:
        size, length = abs(number), abs(number).bit_length()
        yield int(number != 0)
        if number:
            yield int(number < 0)
            yield from [1] * (length - 1) + [0] * (length < 62)
            yield from (size >> n & 1 for n in reversed(range(length - 1)))


def coded_numbers(numbers: Sequence[int]) -> bytes:
    """The code of whole numbers of any size below 2^62."""
    bits = Writer(number_bits(numbers))
    reference.numbers(bits, len(numbers))
    return bits.finish()


def support_bits(grid: Grid, support: Bricks, previous: Bricks | None = None) -> tuple[list[int], int]:
    """The bits of a support, and how many of them are those of its list of bricks."""
    bits = Recorder(encode_support(grid, *support, previous))
    before = reference.NOTHING if previous is None else _reference_support(previous)
    touch_bits.bricks(bits, grid.shape, before.bricks)
    count = len(bits.bits)
    bits = Recorder(bits.data)
    reference.support(bits, grid.shape, before)
    return bits.bits, count


def _reference_support(support: Bricks) -> Any:
    bricks, mask = support
    brick, *sample = np.nonzero(mask)
    positions = sorted(map(tuple, (8 * bricks[brick] + np.stack(sample, axis=1)).tolist()))
    return reference.Support(list(map(tuple, bricks.tolist())), positions)


def empty_bricks(grid: Grid, support: Bricks) -> bytes:
    """The code of the bricks of a support without any sample."""
    bits, count = support_bits(grid, support)
    writer = Writer(bits[:count] + [0] * (len(bits) - count))
    touch_bits.bricks(writer, grid.shape)
    for brick in support[0].tolist():
        for _ in reference.samples_of(tuple(brick), grid.shape):
            writer.mix([("near", 0), ("late", 0, 0)], ("held", 0))
    return writer.finish(len(support[0]))


Steps = tuple[np.ndarray, np.ndarray, np.ndarray]
"""A frame of a vibration: positions int32 [n, 3] in raster order, steps of amplitude [n], and hertz [n]."""


def vibration_body(grid: Grid, frames: Sequence[Steps]) -> bytes:
    """The body of VIBR of any steps and frequencies."""
    bits, bricks, previous = list[int](), 0, None
    values: list[list[int]] = [[], []]
    known: list[dict[tuple[int, ...], int]] = [{}, {}]
    for positions, *rows in frames:
        support = _bricks_of(positions)
        bits += support_bits(grid, support, previous)[0]
        bricks, previous = bricks + 16 + len(support[0]), support
        for n, row in enumerate(rows):
            places = list(map(tuple, positions.tolist()))
            own = dict(zip(places, row.tolist(), strict=True))
            before = [0, *row.tolist()]
            values[n] += [own[at] - known[n].get(at, before[i]) for i, at in enumerate(places)]
            known[n] = own
    writer, before_support = (
        Writer([*bits, *number_bits(values[0]), *number_bits(values[1])]),
        reference.NOTHING,
    )
    for _ in frames:
        before_support = reference.support(writer, grid.shape, before_support)
    for name, row in zip(("amplitudes", "frequencies"), values, strict=True):
        reference.numbers(writer, len(row), name)
    return writer.finish(bricks)


def _bricks_of(positions: np.ndarray) -> Bricks:
    bricks, slots = np.unique(positions >> 3, axis=0, return_inverse=True)
    mask = np.zeros((len(bricks), 8, 8, 8), np.bool_)
    mask[(slots.reshape(-1), *(positions & 7).T)] = True
    return bricks.astype(np.int32).reshape(-1, 3), mask


def coded_poses(numbers: Sequence[Sequence[int]], orders: Sequence[int]) -> bytes:
    """Poses in steps [frames][7], as docs/format/objects.md codes them, of any size and order."""
    table = [[int(n) for n in row] for row in numbers]
    parts = [("", [*orders, *table[0]])]
    for c, order in enumerate(orders):
        moved = [row[c] - table[0][c] for row in table]
        for _ in range(min(order, 3)):
            moved = [b - a for a, b in zip([0, *moved], moved)]
        if order:
            parts.append((str(c), moved[1:]))
    writer = Writer([bit for _, row in parts for bit in number_bits(row)])
    for name, row in parts:
        reference.numbers(writer, len(row), name)
    return writer.finish()
