"""The body of a segment of coder `paper` as it is read, and the forces that its symbols stand for (figure 4).

docs/format/paper.md tells every byte. A frame is coded in one of three ways:

* ``INTRA``: alone. Samples in raster order; a sample within the deadband of the last sent one is held (eq. 8).
* ``INTER``: closed loop. The reference is the decoded previous frame at the same voxel; a voxel within the
  deadband of it is held, otherwise the quantised difference is sent.
* ``DIFFERENCE``: the paper's open loop. The field of differences between two originals is coded like a frame of
  its own and added to the decoded previous frame; errors add up.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Bools, Float32s, Int32s
from touchfield.codec.paper.directions import Codebook
from touchfield.codec.paper.huffman import RUN_SYMBOLS, BitStream, HuffmanCode, decode_symbols
from touchfield.codec.paper.quantisers import AmplitudeLevels
from touchfield.codec.rate import BitAccount
from touchfield.codec.segment import FrameCost, FrameKind, FrameStats
from touchfield.codec.support import decode_support
from touchfield.codec.varint import Parts
from touchfield.errors import CorruptFile, InvalidArgument
from touchfield.medium import ForceField, Grid
from touchfield.medium.budget import zero_forces
from touchfield.medium.field import brick_keys
from touchfield.medium.kernels import raster_slots

Mask = Bools


@dataclass(frozen=True)
class FrameSymbols:
    """Symbols of a frame that go into the stream."""

    kind: FrameKind
    bricks: Int32s  # [n, 3]
    mask: Mask  # [n, 8, 8, 8]; the support (of the differences, in a DIFFERENCE frame)
    sent: Bools  # [L]; per supported sample in raster order: sent, or held
    # levels, directions: [sent.sum()]; amplitude level and direction index of the sent samples
    levels: NDArray[np.uint16]
    directions: NDArray[np.uint16]


def field_of(grid: Grid, bricks: Int32s, forces_n: Float32s) -> ForceField:
    """Forces [n, 8, 8, 8, 3] as a field; bricks whose forces are all zero are left out."""
    held = forces_n.any(axis=(1, 2, 3, 4))
    return ForceField(grid, bricks[held], forces_n[held])


def rebuilt(
    grid: Grid, symbols: FrameSymbols, levels_n: Float32s, codebook: Codebook, previous: ForceField | None
) -> ForceField:
    """One frame from its symbols, its amplitude levels and the decoded frame before; all arithmetic is of float32."""
    slots = raster_slots(symbols.bricks, symbols.mask)
    values = levels_n[symbols.levels][:, None] * codebook.vertices_float32[symbols.directions]
    forces = zero_forces(len(symbols.bricks))
    flat = forces.reshape(-1, 3)
    if symbols.kind == FrameKind.INTER:
        assert previous is not None
        before = previous.forces_at(brick_keys(grid, symbols.bricks)).reshape(-1, 3)
        flat[slots] = before[slots]
        flat[slots[symbols.sent]] += values
        return field_of(grid, symbols.bricks, forces)
    latest = np.cumsum(symbols.sent)  # the last sent value is held; zero before the first
    flat[slots] = np.concatenate([np.zeros((1, 3), np.float32), values])[latest]
    alone = field_of(grid, symbols.bricks, forces)
    if symbols.kind == FrameKind.INTRA:
        return alone
    assert previous is not None
    return previous + alone


INTRA_SET: Final = 1
INTER_SET: Final = 2

MOST_NEWTONS: Final = 1e6  # no level lies above it, so that sums over any number of frames stay finite


def set_of(kind: FrameKind) -> int:
    """The table set that a kind of frame takes."""
    return INTRA_SET if kind == FrameKind.INTRA else INTER_SET


@dataclass(frozen=True)
class TableSet:
    """Levels and codes of the frames of a kind."""

    levels: AmplitudeLevels
    amplitude_code: HuffmanCode
    direction_code: HuffmanCode


@dataclass(frozen=True)
class _Frame:
    """A frame's parts, not decoded yet."""

    cost: FrameCost
    support: bytes
    amplitudes: BitStream
    directions: BitStream


class BodyReader:
    """A segment without a stage; CorruptFile or TruncatedFile for other bytes than the writer's."""

    def __init__(self, body: bytes, grid: Grid, codebook: Codebook) -> None:
        self._parts, self._grid, self._codebook = Parts(body), grid, codebook
        (kinds,) = self._parts.take(1, "kinds")
        if kinds & ~(INTRA_SET | INTER_SET):
            raise CorruptFile("SEGM.body", f"kinds {kinds:#x}", "bits 0 and 1 only")
        self._sets = {kind: self._table_set() for kind in (INTRA_SET, INTER_SET) if kinds & kind}

    def levels(self, kind: FrameKind) -> AmplitudeLevels:
        """The amplitude levels of a kind of frame."""
        return self._set(kind).levels

    def fields(self, frame_count: int) -> Iterator[tuple[ForceField, FrameStats]]:
        """The frames in turn, decoded."""
        field = None
        for symbols, stats in self.frames(frame_count):
            field = rebuilt(self._grid, symbols, self.levels(symbols.kind).levels_n, self._codebook, field)
            yield field, stats

    def frames(self, frame_count: int) -> Iterator[tuple[FrameSymbols, FrameStats]]:
        """The symbols of each frame in turn; the last one must end the body."""
        previous: tuple[Int32s, Bools] | None = None
        for i in range(frame_count):
            frame = self._frame(first=i == 0)
            kind = frame.cost.kind
            tables = self._set(kind)
            bricks, mask = decode_support(frame.support, self._grid, previous if kind == FrameKind.INTER else None)
            supported = int(np.count_nonzero(mask))
            sent, levels = decode_symbols(tables.amplitude_code, frame.amplitudes, supported, len(tables.levels))
            _, directions = decode_symbols(tables.direction_code, frame.directions, len(levels), len(self._codebook))
            if kind != FrameKind.DIFFERENCE:
                previous = (bricks, mask)
            symbols = FrameSymbols(kind, bricks, mask, sent, levels, directions)
            yield symbols, FrameStats(kind, supported, len(levels), frame.cost.bits)
        self._parts.check_end()

    def costs(self, frame_count: int) -> Iterator[FrameCost]:
        """Cost of each frame, without decoding it."""
        for i in range(frame_count):
            yield self._frame(first=i == 0).cost
        self._parts.check_end()

    def _frame(self, *, first: bool) -> _Frame:
        began = self._parts.at
        (number,) = self._parts.take(1, "frame kind")
        if number > 2 or (first and number != FrameKind.INTRA):
            raise CorruptFile("SEGM.body frame kind", str(number), "0 in the first frame, 0 to 2 in others")
        support = self._parts.chunk("support")
        amplitudes, directions = self._bits("amplitudes"), self._bits("directions")
        bits = BitAccount(8 * len(support), amplitudes.bit_length, directions.bit_length)
        bits += BitAccount(side=8 * (self._parts.at - began) - bits.total)
        return _Frame(FrameCost(FrameKind(number), bits), support, amplitudes, directions)

    def _bits(self, what: str) -> BitStream:
        bit_length = self._parts.varint(what)
        return BitStream(self._parts.take((bit_length + 7) // 8, what), bit_length)

    def _set(self, kind: FrameKind) -> TableSet:
        chosen = self._sets.get(set_of(kind))
        if chosen is None:
            raise CorruptFile("SEGM.body", f"a frame of kind {kind} and no table set for it", "its table set")
        return chosen

    def _table_set(self) -> TableSet:
        told = self._parts.chunk("amplitude levels")
        count = len(told) // 4
        if len(told) % 4 or not 1 <= count <= (1 << 16) - RUN_SYMBOLS:
            raise CorruptFile("SEGM.body amplitude levels", f"{len(told)} bytes", "4 for each of 1 to 65515 levels")
        try:
            levels = AmplitudeLevels(np.frombuffer(told, "<f4"))
        except InvalidArgument as error:
            raise CorruptFile("SEGM.body amplitude levels", error.found, error.expected) from None
        if levels.levels_n[-1] > MOST_NEWTONS:
            found = f"{levels.levels_n[-1]} N"
            raise CorruptFile("SEGM.body amplitude levels", found, f"at most {MOST_NEWTONS} N")
        amplitude_code = HuffmanCode.from_bytes(self._parts.chunk("amplitude code"), count + RUN_SYMBOLS)
        direction_code = HuffmanCode.from_bytes(self._parts.chunk("direction code"), len(self._codebook))
        return TableSet(levels, amplitude_code, direction_code)
