"""How the coder `touch` lays a segment out in bytes, written and read by the same tables."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING, Final

from touchfield.codec.segment import FrameCost, FrameKind
from touchfield.codec.touch.lattice import Lattice
from touchfield.codec.touch.models import LOSSLESS, MAX
from touchfield.codec.touch.promise import Worst
from touchfield.codec.touch.scale import (
    FLOOR_LIMIT,
    LEAST_RATE,
    LEAST_UNIFORM,
    MOST_NEWTONS,
    RATE_LIMIT,
    SMALLEST_UNIT_N,
)
from touchfield.codec.varint import read_varint, write_varint
from touchfield.errors import CorruptFile, TruncatedFile
from touchfield.measure.rate import BitAccount

if TYPE_CHECKING:
    from touchfield.medium import Grid

__all__ = ["CHAPTER", "BodyReader", "FrameRecord", "GuessKind", "TouchCost", "shares_of", "write_body"]

CHAPTER: Final = """\
| part | form | what |
|---|---|---|
| flags | u8 | bit 0: the worst voxel follows |
| unit | f32 | newtons of a unit, 2^-126 to 2^104; this and the four steps are absent in mode lossless |
| floor, rate, cross floor, cross rate | varint each | the lattice; floors 1 to 65535, rates below 131072; floor is \
21 or more, or rate 64 or more |
| worst ratio | u16 | the largest error over what is allowed, times 65535, rounded up; with flag bit 0 |
| worst voxel | varint, varint, varint, varint | its frame in the segment, and x, y, z; with flag bit 0 |
| frame, repeated `frame_count` times | | |
| how | u8 | bits 0-2: frame model; bit 3: the previous frame is known to it; bits 4-5: guess; bit 6: exceptions; \
bit 7: filter |
| shares | u8, u8 | of the payload's bits, those of support and of amplitude, in 1/255; for information |
| guess | chunk | what makes the guess; where there is one |
| payload | chunk | the code of the frame model |
| filter | chunk | with bit 7 |
| exceptions | chunk | with bit 6 |

The guess is 0 none, 1 the previous frame with blocks moved, 2 a field made from a surface. The first frame of a
segment knows no previous frame and has no guess 1. Frame model 3 is that of mode lossless; it has no guess, no
filter and no exceptions. What a frame model that learns has learnt in the last frame it coded in the segment is known
to it where bit 3 is set; elsewhere it begins anew.
"""

_WHERE: Final = "SEGM.body"
_WORST_FLAG: Final = 1
_RATIOS: Final = 65535
_MODEL, _INTER, _GUESS_SHIFT, _EXCEPTIONS, _FILTER = 7, 8, 4, 64, 128


class GuessKind(IntEnum):
    """What a guess was made from; the number is what the file holds."""

    NONE = 0
    MOTION = 1
    SURFACE = 2


@dataclass(frozen=True)
class TouchCost(FrameCost):
    """What a frame cost, and how it was coded.

    Attributes
    ----------
    guess : GuessKind
    model : int
        The frame model's number.
    guess_bits, exception_bits : int
        The bits of what makes the guess, `BitAccount.models`; and of the side bits those of voxels sent apart.
    """

    guess: GuessKind
    model: int
    guess_bits: int
    exception_bits: int


@dataclass(frozen=True)
class FrameRecord:
    """A frame as a body holds it.

    Attributes
    ----------
    model : int
    inter : bool
        Whether the model knows the previous frame.
    guess_kind : GuessKind
    guess, payload, exceptions, filter : bytes
    shares : (int, int)
        Support and amplitude of the payload, 1/255.
    """

    model: int
    inter: bool
    guess_kind: GuessKind
    guess: bytes
    payload: bytes
    shares: tuple[int, int]
    exceptions: bytes = b""
    filter: bytes = b""

    @property
    def kind(self) -> FrameKind:
        """Whether the frame can be decoded alone."""
        needs = self.inter or self.guess_kind == GuessKind.MOTION
        return FrameKind.INTER if needs else FrameKind.INTRA

    def to_bytes(self) -> bytes:
        """As `CHAPTER` tells."""
        how = self.model | _INTER * self.inter | self.guess_kind << _GUESS_SHIFT
        how |= (_EXCEPTIONS if self.exceptions else 0) | (_FILTER if self.filter else 0)
        parts = [bytes([how, *self.shares])]
        if self.guess_kind:
            parts.append(_chunk(self.guess))
        parts.append(_chunk(self.payload))
        if self.filter:
            parts.append(_chunk(self.filter))
        if self.exceptions:
            parts.append(_chunk(self.exceptions))
        return b"".join(parts)

    @property
    def cost(self) -> TouchCost:
        """What the frame costs; exceptions, filter and lengths are side bits."""
        total, payload = 8 * len(self.to_bytes()), 8 * len(self.payload)
        support = payload * self.shares[0] // 255
        amplitude = payload * self.shares[1] // 255
        models = 8 * len(self.guess)
        direction = payload - support - amplitude
        bits = BitAccount(support, amplitude, direction, total - payload - models, models=models)
        return TouchCost(self.kind, bits, self.guess_kind, self.model, models, 8 * len(self.exceptions))


def shares_of(bits: tuple[float, float, float]) -> tuple[int, int]:
    """Support and amplitude of the bits of support, amplitude and direction, 1/255."""
    total = sum(bits)
    if not total > 0:
        return 255, 0
    support = round(255 * bits[0] / total)
    return support, min(round(255 * bits[1] / total), 255 - support)


def _chunk(data: bytes) -> bytes:
    return write_varint(len(data)) + data


# -- writing ----------------------------------------------------------------------------------------------


def write_body(lattice: Lattice | None, records: Sequence[FrameRecord], worst: Worst | None) -> bytes:
    """The body of a segment; `lattice` is None in mode "lossless"."""
    parts = [bytes([_WORST_FLAG if worst else 0])]
    if lattice is not None:
        steps = (lattice.floor, lattice.rate, lattice.cross_floor, lattice.cross_rate)
        parts += [struct.pack("<f", lattice.unit_n), *map(write_varint, steps)]
    if worst is not None:
        ratio = min(_RATIOS, math.ceil(worst.ratio * _RATIOS))
        parts += [struct.pack("<H", ratio), *map(write_varint, (worst.frame, *worst.voxel))]
    return b"".join([*parts, *(record.to_bytes() for record in records)])


# -- reading ----------------------------------------------------------------------------------------------


class BodyReader:
    """Reads a segment's body from front to back.

    Attributes
    ----------
    lattice : Lattice or None
    worst : Worst or None

    Raises
    ------
    CorruptFile, TruncatedFile
        If the bytes contradict themselves or end too early.
    """

    def __init__(self, body: bytes, grid: Grid, *, lossless: bool) -> None:
        self._data, self._at, self._lossless = body, 0, lossless
        (flags,) = self._take(1, "flags")
        if flags & ~_WORST_FLAG:
            raise CorruptFile(f"{_WHERE} flags", f"{flags:#x}", "bit 0 only")
        self.lattice = None if lossless else self._lattice()
        self.worst = self._worst(grid) if flags & _WORST_FLAG else None

    def records(self, frame_count: int) -> Iterator[FrameRecord]:
        """The frames in turn, not decoded; the last one must end the body."""
        if self.worst is not None and self.worst.frame >= frame_count:
            raise CorruptFile(f"{_WHERE} worst frame", str(self.worst.frame), f"below {frame_count}")
        for i in range(frame_count):
            yield self._record(first=i == 0)
        if self._at != len(self._data):
            raise CorruptFile(_WHERE, f"{len(self._data) - self._at} bytes after the last frame", "none")

    def _record(self, *, first: bool) -> FrameRecord:
        how, support, amplitude = self._take(3, "frame")
        model, inter, guess = how & _MODEL, bool(how & _INTER), how >> _GUESS_SHIFT & 3
        if model > LOSSLESS or guess > GuessKind.SURFACE:
            raise CorruptFile(f"{_WHERE} frame", f"{how:#x}", "a frame model of 0 to 3 and a guess of 0 to 2")
        if (model == LOSSLESS) != self._lossless or (self._lossless and (guess or how >= _EXCEPTIONS)):
            found = f"frame model {model}" + " with a guess" * bool(guess)
            found += " with exceptions" * (how >> 6 & 1) + " with a filter" * (how >> 7)
            raise CorruptFile(f"{_WHERE} frame", found, "3 alone" if self._lossless else f"0 to {MAX}")
        if first and (inter or guess == GuessKind.MOTION):
            raise CorruptFile(f"{_WHERE} frame", "a first frame that needs the one before", "one that stands alone")
        if support + amplitude > 255:
            raise CorruptFile(f"{_WHERE} frame shares", f"{support} and {amplitude}", "255 together at most")
        made_from = self._chunk("guess") if guess else b""
        payload = self._chunk("payload")
        terms = self._chunk("filter") if how & _FILTER else b""
        if how & _FILTER and not terms:
            raise CorruptFile(f"{_WHERE} filter", "an empty chunk", "one term at least")
        exceptions = b""
        if how & _EXCEPTIONS:
            exceptions = self._chunk("exceptions")
            if not exceptions:
                raise CorruptFile(f"{_WHERE} exceptions", "an empty chunk", "one exception at least")
        return FrameRecord(
            model, inter, GuessKind(guess), made_from, payload, (support, amplitude), exceptions, terms
        )

    def _lattice(self) -> Lattice:
        (unit_n,) = struct.unpack("<f", self._take(4, "unit"))
        if not SMALLEST_UNIT_N <= unit_n <= MOST_NEWTONS / 65536:
            raise CorruptFile(f"{_WHERE} unit", f"{unit_n} N", "2^-126 to 2^104 N")
        steps = []
        for what, least, limit in (
            ("floor", 1, FLOOR_LIMIT),
            ("rate", 0, RATE_LIMIT),
            ("cross floor", 1, FLOOR_LIMIT),
            ("cross rate", 0, RATE_LIMIT),
        ):
            value = self._varint(what, limit)
            if value < least:
                raise CorruptFile(f"{_WHERE} {what}", str(value), f"{least} or more")
            steps.append(value)
        if steps[0] < LEAST_UNIFORM and steps[1] < LEAST_RATE:
            found = f"a floor of {steps[0]} with a rate of {steps[1]}"
            raise CorruptFile(f"{_WHERE} lattice", found, f"{LEAST_UNIFORM} or {LEAST_RATE} at least")
        return Lattice(unit_n, *steps)

    def _worst(self, grid: Grid) -> Worst:
        (ratio,) = struct.unpack("<H", self._take(2, "worst ratio"))
        frame = self._varint("worst frame", 1 << 16)
        x, y, z = (self._varint("worst voxel", n) for n in grid.shape)
        return Worst(ratio / _RATIOS, frame, (x, y, z))

    def _varint(self, what: str, limit: int) -> int:
        value, self._at = read_varint(self._data, self._at, f"{_WHERE} {what}", limit)
        return value

    def _take(self, count: int, what: str) -> bytes:
        taken = self._data[self._at : self._at + count]
        if len(taken) < count:
            raise TruncatedFile(f"{_WHERE} {what}", f"{len(taken)} bytes", f"{count} bytes")
        self._at += count
        return taken

    def _chunk(self, what: str) -> bytes:
        length, self._at = read_varint(self._data, self._at, f"{_WHERE} {what}")
        return self._take(length, what)
