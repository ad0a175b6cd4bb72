"""Decodes the frames of a segment written by coder `paper`, the coder of the paper by Moustakas and Lalos:
Huffman codes to symbols, symbols to forces.

docs/format/paper.md defines every byte. A frame is coded in one of three ways:

* ``INTRA``: on its own. Samples are in raster order; a sample within the deadband of the last sent one is
  held (eq. 8).
* ``INTER``: closed loop. The reference is the decoded previous frame at the same voxel; a voxel within the
  deadband of it is held, otherwise the quantised difference is sent.
* ``DIFFERENCE``: the paper's open loop. The field of differences between two originals is coded like a frame
  of its own and added to the decoded previous frame; errors accumulate.

"Huffman coding is applied to the amplitude and direction streams" (section 5.2). The codes are canonical, so
that a table consists of code lengths only, of at most 24 bits each.

Departure: with eq. 8 most samples are held, and a Huffman code spends at least one bit on each symbol;
therefore a run of held samples is one symbol. Symbols 0 to N-1 are levels; symbol N + j is a run of 2^j + b
held samples and is followed by b in j raw bits, j = 0 to 20. Longer runs are several symbols. The literal
coder, which writes one zero symbol for each held sample, uses only j = 0. A stream of directions has no runs.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Bools, Float32s, Int32s, Int64s
from touchfield.codec.paper.directions import Codebook
from touchfield.codec.paper.quantisers import AmplitudeLevels
from touchfield.codec.segment import BitAccount, FrameCost, FrameKind
from touchfield.codec.support import decode_numbers, decode_support
from touchfield.codec.varint import Parts
from touchfield.compute.native import native
from touchfield.errors import CorruptFile, InvalidArgument
from touchfield.medium import ForceField, Grid
from touchfield.medium.budget import zero_forces
from touchfield.medium.field import brick_keys, field_without_empty_bricks
from touchfield.medium.samples import raster_slots

MAX_CODE_BITS: Final = 24
"""Maximum length of a Huffman code."""

RUN_SYMBOLS: Final = 21  # runs of up to 2^21 - 1 held samples in one symbol


class BitStream(NamedTuple):
    """Bits in bytes, highest bit first; the last byte is padded with zeros."""

    data: bytes
    bit_length: int


@dataclass(frozen=True, eq=False)
class HuffmanCode:
    """A prefix code over the symbols 0 to n-1.

    `lengths`, uint8 [n]: bits of each symbol's code; 0 for symbols that do not occur. A single symbol has
    length 1. InvalidArgument if the lengths do not form a complete prefix code of at most 24 bits.
    """

    lengths: NDArray[np.uint8]

    def __post_init__(self) -> None:
        count = np.bincount(self.lengths, minlength=MAX_CODE_BITS + 1)
        kraft = sum(
            int(n) << (MAX_CODE_BITS - bits) for bits, n in enumerate(count[: MAX_CODE_BITS + 1]) if bits
        )
        present = int(count[1:].sum())
        if len(count) > MAX_CODE_BITS + 1 or not (
            kraft == 1 << MAX_CODE_BITS or present == 0 or present == count[1] == 1
        ):
            raise InvalidArgument("Huffman code", f"lengths {count.tolist()}", "a complete prefix code")

    @classmethod
    def from_bytes(cls, data: bytes, symbol_count: int) -> HuffmanCode:
        """Read the lengths of a code (`codec.support.decode_numbers`).

        CorruptFile or TruncatedFile if they are invalid.
        """
        lengths = decode_numbers(data, symbol_count)
        if symbol_count and not 0 <= lengths.min() <= lengths.max() <= MAX_CODE_BITS:
            raise CorruptFile(
                "Huffman code", f"a length of {lengths.min()} or {lengths.max()} bits", "0 to 24"
            )
        try:
            return cls(lengths.astype(np.uint8))
        except InvalidArgument as error:
            raise CorruptFile(
                "Huffman code", error.found, error.expected, "The file was changed or cut."
            ) from None

    @cached_property
    def tables(self) -> tuple[Int64s, Int64s, NDArray[np.uint16]]:
        """Decoding tables of the canonical code.

        `limits`, int64 [25]: for each length, the smallest code of 24 bits that has no prefix of that length
        or less. `ranks`, int64 [25]: for each length, the offset from a code to its index in `order`.
        `order`, uint16 [any]: the symbols that occur, in the order of their codes: shorter codes first, then
        by symbol.
        """
        limits, ranks = np.zeros((2, MAX_CODE_BITS + 1), np.int64)
        code = rank = 0
        for bits in range(1, MAX_CODE_BITS + 1):
            ranks[bits] = rank - code
            count = int(np.count_nonzero(self.lengths == bits))
            code, rank = code + count, rank + count
            limits[bits] = code << (MAX_CODE_BITS - bits)
            code *= 2
        order = np.argsort(self.lengths, kind="stable").astype(np.uint16)
        return limits, ranks, order[np.count_nonzero(self.lengths == 0) :].copy()  # aligned


def decode_symbols(
    code: HuffmanCode, bits: BitStream, sample_count: int, level_count: int
) -> tuple[Bools, NDArray[np.uint16]]:
    """Decode a stream of amplitudes or directions.

    Returns bool [sample_count], True for samples that are sent, and the levels of these, uint16 [any]. The
    symbols of `code` from `level_count` on are runs; a stream without runs has as many levels as symbols.
    CorruptFile if the bits are not the codes of exactly `sample_count` samples.
    """
    where, mend = "Huffman stream", "The file was changed or cut."
    if len(bits.data) != -(-bits.bit_length // 8):
        raise CorruptFile(where, f"{len(bits.data)} bytes", f"{bits.bit_length} bits", mend)
    sent = np.zeros(sample_count, np.bool_)
    levels = np.empty(min(sample_count, bits.bit_length), np.uint16)
    used, count = native.decode_huffman(bits.data, *code.tables, level_count, sent, levels)
    spare = -bits.bit_length % 8
    if used != bits.bit_length or (spare and bits.data[-1] & ((1 << spare) - 1)):
        raise CorruptFile(where, "bits that do not fit", f"codes of {sample_count} samples, then zeros", mend)
    return sent, levels[:count].copy()


@dataclass(frozen=True)
class FrameSymbols:
    """Symbols of a frame in the stream."""

    kind: FrameKind
    support: bytes  # the code of bricks and mask
    bricks: Int32s  # [n, 3]
    mask: Bools  # [n, 8, 8, 8]; the support (in a DIFFERENCE frame, that of the differences)
    sent: Bools  # [L]; for each supported sample in raster order: True if sent, False if held
    # levels, directions: [sent.sum()]; amplitude level and direction index of the sent samples
    levels: NDArray[np.uint16]
    directions: NDArray[np.uint16]


def rebuild_frame(
    grid: Grid, symbols: FrameSymbols, levels_n: Float32s, codebook: Codebook, previous: ForceField | None
) -> ForceField:
    """Reconstruct a frame from symbols and the decoded frame before, in float32."""
    slots = raster_slots(symbols.bricks, symbols.mask)
    values = levels_n[symbols.levels][:, None] * codebook.vertices_float32[symbols.directions]
    forces = zero_forces(len(symbols.bricks))
    flat = forces.reshape(-1, 3)
    if symbols.kind == FrameKind.INTER:
        assert previous is not None
        reference = previous.forces_at(brick_keys(grid, symbols.bricks)).reshape(-1, 3)
        flat[slots] = reference[slots]
        flat[slots[symbols.sent]] += values
        return field_without_empty_bricks(grid, symbols.bricks, forces)
    latest = np.cumsum(symbols.sent)  # held samples repeat the last sent value, or zero before the first
    flat[slots] = np.concatenate([np.zeros((1, 3), np.float32), values])[latest]
    scanned = field_without_empty_bricks(grid, symbols.bricks, forces)
    if symbols.kind == FrameKind.INTRA:
        return scanned
    assert previous is not None
    return previous + scanned


INTRA_SET: Final = 1
INTER_SET: Final = 2

MAX_NEWTONS: Final = 1e6  # upper limit of levels, so that sums over any number of frames stay finite


def set_of(kind: FrameKind) -> int:
    """The table set of a kind of frame."""
    return INTRA_SET if kind == FrameKind.INTRA else INTER_SET


@dataclass(frozen=True)
class TableSet:
    """Levels and codes of the frames of a kind."""

    levels: AmplitudeLevels
    amplitude_code: HuffmanCode
    direction_code: HuffmanCode


class FrameParts(NamedTuple):
    """Parts of a frame, not decoded yet."""

    kind: FrameKind
    support: bytes
    streams: tuple[BitStream, ...]  # amplitudes and directions, or the numbers of a stage
    runs: int = 0  # number of runs in the stage `runs`


class SegmentReader(ABC):
    """Sequential reader of a segment, frame by frame.

    CorruptFile or TruncatedFile if the bytes are invalid.
    """

    def __init__(self, body: bytes, grid: Grid) -> None:
        self._parts, self._grid = Parts(body), grid

    def frames(self, frame_count: int) -> Iterator[tuple[FrameParts, FrameCost]]:
        """Yield the frames in order, with their costs.

        The body must end with the last frame.
        """
        for i in range(frame_count):
            start = self._parts.position
            frame = self._next(first=i == 0)
            bits = BitAccount(8 * len(frame.support), *(stream.bit_length for stream in frame.streams))
            bits += BitAccount(side=8 * (self._parts.position - start) - bits.total)
            yield frame, FrameCost(frame.kind, bits)
        self._parts.check_end()

    @abstractmethod
    def field(self, frame: FrameParts) -> ForceField:
        """Decode a frame; frames must be decoded in order."""

    @abstractmethod
    def _next(self, *, first: bool) -> FrameParts: ...


class BodyReader(SegmentReader):
    """Reader of a segment without a stage."""

    def __init__(self, body: bytes, grid: Grid, codebook: Codebook) -> None:
        super().__init__(body, grid)
        self._codebook = codebook
        self._previous_support: tuple[Int32s, Bools] | None = None
        self._decoded: ForceField | None = None
        (kinds,) = self._parts.take(1, "kinds")
        if kinds & ~(INTRA_SET | INTER_SET):
            raise CorruptFile("SEGM.body", f"kinds {kinds:#x}", "bits 0 and 1 only")
        self._sets = {kind: self._table_set() for kind in (INTRA_SET, INTER_SET) if kinds & kind}

    def levels(self, kind: FrameKind) -> AmplitudeLevels:
        """The amplitude levels of a kind of frame."""
        return self._set(kind).levels

    def symbols(self, frame: FrameParts) -> FrameSymbols:
        """Decode the symbols of a frame; frames must be decoded in order."""
        kind, (amplitudes, directions), tables = frame.kind, frame.streams, self._set(frame.kind)
        bricks, mask = decode_support(
            frame.support, self._grid, self._previous_support if kind == FrameKind.INTER else None
        )
        sent, levels = decode_symbols(tables.amplitude_code, amplitudes, int(mask.sum()), len(tables.levels))
        _, directions_of_sent = decode_symbols(
            tables.direction_code, directions, len(levels), len(self._codebook)
        )
        if kind != FrameKind.DIFFERENCE:
            self._previous_support = bricks, mask
        return FrameSymbols(kind, frame.support, bricks, mask, sent, levels, directions_of_sent)

    def field(self, frame: FrameParts) -> ForceField:
        """Decode a frame; frames must be decoded in order."""
        symbols = self.symbols(frame)
        levels_n = self.levels(symbols.kind).levels_n
        self._decoded = rebuild_frame(self._grid, symbols, levels_n, self._codebook, self._decoded)
        return self._decoded

    def _next(self, *, first: bool) -> FrameParts:
        (number,) = self._parts.take(1, "frame kind")
        if number > 2 or (first and number != FrameKind.INTRA):
            raise CorruptFile("SEGM.body frame kind", str(number), "0 in the first frame, 0 to 2 in others")
        support = self._parts.chunk("support")
        return FrameParts(FrameKind(number), support, (self._bits("amplitudes"), self._bits("directions")))

    def _bits(self, part: str) -> BitStream:
        bit_length = self._parts.varint(part)
        return BitStream(self._parts.take((bit_length + 7) // 8, part), bit_length)

    def _set(self, kind: FrameKind) -> TableSet:
        table_set = self._sets.get(set_of(kind))
        if table_set is None:
            raise CorruptFile("SEGM.body", f"a frame of kind {kind} and no table set for it", "its table set")
        return table_set

    def _table_set(self) -> TableSet:
        data, where = self._parts.chunk("amplitude levels"), "SEGM.body amplitude levels"
        count = len(data) // 4
        if len(data) % 4 or not 1 <= count <= (1 << 16) - RUN_SYMBOLS:
            raise CorruptFile(where, f"{len(data)} bytes", "4 for each of 1 to 65515 levels")
        try:
            levels = AmplitudeLevels(np.frombuffer(data, "<f4"))
        except InvalidArgument as error:
            raise CorruptFile(where, error.found, error.expected) from None
        if levels.levels_n[-1] > MAX_NEWTONS:
            raise CorruptFile(where, f"{levels.levels_n[-1]} N", f"at most {MAX_NEWTONS} N")
        amplitude_code = HuffmanCode.from_bytes(self._parts.chunk("amplitude code"), count + RUN_SYMBOLS)
        direction_code = HuffmanCode.from_bytes(self._parts.chunk("direction code"), len(self._codebook))
        return TableSet(levels, amplitude_code, direction_code)
