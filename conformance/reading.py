"""What all parts of the conformance decoder share: reading bytes in order, the errors of a faulty file, and
bricks (blocks of 8x8x8 samples).
"""

import re
import struct
from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
Place = tuple[int, ...]
Forces = dict[Place, Array]
"""Forces by the places of their samples, newtons, float32 [3]."""
Bricks = dict[Place, Array]
"""Bricks of forces by their places, float32 [8, 8, 8, 3]."""


class FaultyFile(ValueError):
    """A file that is to be refused."""


class ForeignFile(FaultyFile):
    """It is something else."""


class TruncatedFile(FaultyFile):
    """It ends too early."""


class CorruptFile(FaultyFile):
    """Its bytes contradict themselves."""


class UnsupportedVersion(FaultyFile):
    """It is of another version, or needs a part that this decoder has not."""


def need(condition: object, message: str, kind: type[FaultyFile] = CorruptFile) -> None:
    """Refuse the file unless `condition` holds."""
    if not condition:
        raise kind(message)


class Cursor:
    """A run of bytes, read from the first to the last and not beyond; `short` is the error of one that
    ends.
    """

    def __init__(self, data: bytes, short: type[FaultyFile] = TruncatedFile) -> None:
        self.data, self.at, self.short = data, 0, short

    def take(self, size: int) -> bytes:
        need(
            size <= len(self.data) - self.at,
            f"{size} bytes wanted, {len(self.data) - self.at} left",
            self.short,
        )
        self.at += size
        return self.data[self.at - size : self.at]

    def numbers(self, codes: str) -> tuple[Any, ...]:
        """Little-endian numbers by their letters in `struct`."""
        return struct.unpack("<" + codes, self.take(struct.calcsize("<" + codes)))

    def number(self, code: str) -> Any:
        return self.numbers(code)[0]

    def text(self, most: int, least: int = 0, control: str = r"[\x00-\x1f\x7f-\x9f]") -> str:
        """A `str` without control characters."""
        size = self.number("H")
        need(least <= size <= most, f"a text of {size} bytes")
        try:
            text = self.take(size).decode("utf-8")
        except UnicodeDecodeError:
            raise CorruptFile("a text that is not UTF-8") from None
        need(not re.search(control, text), "a control character in a text")
        return text

    def varint(self, limit: int = 1 << 56, least: int = 0) -> int:
        """A varint of at least `least`, below `limit`."""
        value = 0
        for place in range(8):
            byte: int = self.number("B")
            value |= (byte & 127) << (7 * place)
            if byte < 128:
                need(byte or not place, "a varint that is not in its shortest form")
                need(least <= value < limit, f"a number of {value}, which is to be {least} to {limit - 1}")
                return value
        raise CorruptFile("a varint of more than 8 bytes")

    def chunk(self, least: int = 0) -> bytes:
        """A varint of at least `least`, and so many bytes."""
        return self.take(self.varint(least=least))

    def rest(self) -> bytes:
        """All that is left."""
        return self.take(len(self.data) - self.at)

    def end(self) -> None:
        """Refuse the file if bytes are left over."""
        need(self.at == len(self.data), f"{len(self.data) - self.at} bytes too many")


def moved(at: Sequence[int], step: Sequence[int]) -> Place:
    """A place and a step from it."""
    return at[0] + step[0], at[1] + step[1], at[2] + step[2]


def brick_of(at: Place) -> Place:
    """The brick of a sample."""
    return at[0] >> 3, at[1] >> 3, at[2] >> 3


def inside(at: Place) -> Place:
    """The place of a sample in its brick."""
    return at[0] & 7, at[1] & 7, at[2] & 7


def samples_of(brick: Place, shape: Place) -> list[Place]:
    """The samples of a brick within a grid of so many, in raster order."""
    return list(product(*(range(8 * n, min(8 * n + 8, m)) for n, m in zip(brick, shape))))


def in_bricks(forces: Forces) -> Bricks:
    """Bricks of the forces of samples."""
    out: Bricks = {}
    for at, force in forces.items():
        out.setdefault(brick_of(at), np.zeros((8, 8, 8, 3), np.float32))[inside(at)] = force
    return out


def laid_out(bricks: Bricks, shape: Place) -> Array:
    """Bricks as a dense array, newtons, float32 [nx, ny, nz, 3]."""
    dense = np.zeros((*(-(-n // 8) * 8 for n in shape), 3), np.float32)
    for (i, j, k), forces in bricks.items():
        dense[8 * i : 8 * i + 8, 8 * j : 8 * j + 8, 8 * k : 8 * k + 8] = forces
    return dense[: shape[0], : shape[1], : shape[2]]
