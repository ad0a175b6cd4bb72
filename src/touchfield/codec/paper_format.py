"""How the paper's coder lays a segment out in bytes, written and read by the same tables."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from touchfield.codec.directions import Codebook
from touchfield.codec.huffman import HuffmanCode, decode_plain, encode_plain
from touchfield.codec.paper_frames import FrameSymbols, Scan, Synthesis
from touchfield.codec.runs import RUN_SYMBOLS, decode_runs, encode_runs, pack_runs
from touchfield.codec.segment import FrameCost, FrameKind, FrameStats
from touchfield.codec.stage import table_from_bytes
from touchfield.codec.support import decode_support
from touchfield.codec.varint import read_varint, write_varint
from touchfield.errors import CorruptFile, TruncatedFile
from touchfield.measure.rate import BitAccount

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.codec.runs import RunStreams
    from touchfield.codec.stage import Table
    from touchfield.medium import Grid

__all__ = ["CHAPTER", "BodyReader", "CodedFrame", "SegmentTables", "write_body"]

CHAPTER = """\
## The body of a segment: coder `paper`

`HEAD.coder_parameters` is the name of the direction codebook, ASCII. `varint` is an unsigned number in groups
of seven bits, the lowest first, the top bit of a byte telling that another follows. A *chunk* is a varint
length in bytes and that many bytes. A *bit chunk* is a varint length in bits and as many bytes as hold them,
the first bit in the top of the first byte, the rest of the last byte zero.

| part | form | what |
|---|---|---|
| kinds | u8 | bit 0: an intra table set follows; bit 1: an inter table set follows; bit 2: scan order |
| table set | chunk, chunk, chunk | amplitude levels; Huffman lengths of the amplitude stream; of the directions |
| frame, repeated `frame_count` times | | |
| kind | u8 | 0 intra, 1 inter, 2 difference |
| support | chunk | the support code: of the frame, or of the differences in kind 2 |
| amplitudes | bit chunk | per supported sample in scan order: a level, or a run of holds |
| directions | bit chunk | for each sent sample, the index of its direction |

Scan order is raster: with bit 2 clear x runs fastest, then y, then z; with it set z, then y, then x.

Intra frames use the intra set, the others the inter set. The first frame is intra. Symbols 0 to N-1 of the
amplitude stream are levels; symbol N+j is a run of 2^j + b held samples, b being the j raw bits that follow it.

- **intra** (0): a sent sample is level times direction; a held one repeats the last sent (zero before the first).
- **inter** (1): the support is coded given the previous support. Sent: the decoded previous force at that
  voxel (zero where there was none) plus level times direction. Held: the decoded previous force.
- **difference** (2): decoded as intra, then added to the decoded previous frame.

Products and sums are float32, in the order written; the symbols before them are whole numbers throughout. The
sections below give every part to the last bit.
"""

_INTRA_SET, _INTER_SET, _SCAN_BIT = 1, 2, 4

MOST_NEWTONS = 1e6
"""No level lies above it, so that sums over any number of frames stay finite."""


@dataclass(frozen=True)
class CodedFrame:
    """A frame's symbols with its coded support."""

    symbols: FrameSymbols
    support: bytes


@dataclass(frozen=True)
class SegmentTables:
    """The amplitude tables of a segment; None where no frame needs one."""

    intra: Table | None
    inter: Table | None


@dataclass(frozen=True)
class _Parts:
    """A frame's chunks, not decoded yet; of bit chunks the bytes and the number of bits."""

    cost: FrameCost
    support: bytes
    amplitudes: tuple[bytes, int]
    directions: tuple[bytes, int]


@dataclass(frozen=True)
class _TableSet:
    amplitude: Table
    amplitude_code: HuffmanCode
    direction_code: HuffmanCode

    def to_bytes(self) -> bytes:
        return b"".join(
            _chunk(part)
            for part in (
                self.amplitude.to_bytes(),
                self.amplitude_code.to_bytes(),
                self.direction_code.to_bytes(),
            )
        )


def _chunk(data: bytes) -> bytes:
    return write_varint(len(data)) + data


def _bit_chunk(data: bytes, bit_length: int) -> bytes:
    return write_varint(bit_length) + data


# -- writing ----------------------------------------------------------------------------------------------


def write_body(
    synthesis: Synthesis, tables: SegmentTables, frames: Sequence[CodedFrame], *, single_holds: bool
) -> tuple[bytes, tuple[FrameStats, ...]]:
    """The body of a segment, and what each frame cost."""
    sets, packed = {}, {}
    for kind, table in ((_INTRA_SET, tables.intra), (_INTER_SET, tables.inter)):
        mine = [f for f in frames if _set_of(f.symbols.kind) == kind]
        if table is None or not mine:
            continue
        amplitude_counts = np.zeros(len(table.levels_n) + RUN_SYMBOLS, np.int64)
        direction_counts = np.zeros(len(synthesis.codebook), np.int64)
        for f in mine:
            streams = pack_runs(f.symbols.sent, f.symbols.levels, len(table.levels_n), single=single_holds)
            packed[id(f)] = streams
            amplitude_counts += np.bincount(streams[0], minlength=len(amplitude_counts))
            direction_counts += np.bincount(f.symbols.directions, minlength=len(direction_counts))
        sets[kind] = _TableSet(table, HuffmanCode.fit(amplitude_counts), HuffmanCode.fit(direction_counts))
    first = sum(sets) | (_SCAN_BIT if synthesis.scan == Scan.Z_FASTEST else 0)
    parts = [bytes([first]), *(sets[kind].to_bytes() for kind in sorted(sets))]
    stats = []
    for f in frames:
        chosen = sets[_set_of(f.symbols.kind)]
        data, stat = _write_frame(f, chosen, packed[id(f)])
        parts.append(data)
        stats.append(stat)
    return b"".join(parts), tuple(stats)


def _set_of(kind: FrameKind) -> int:
    return _INTRA_SET if kind == FrameKind.INTRA else _INTER_SET


def _write_frame(frame: CodedFrame, tables: _TableSet, streams: RunStreams) -> tuple[bytes, FrameStats]:
    symbols = frame.symbols
    amplitudes, amplitude_bits = encode_runs(tables.amplitude_code, *streams)
    directions, direction_bits = encode_plain(tables.direction_code, symbols.directions)
    data = b"".join(
        (
            bytes([symbols.kind]),
            _chunk(frame.support),
            _bit_chunk(amplitudes, amplitude_bits),
            _bit_chunk(directions, direction_bits),
        )
    )
    bits = BitAccount(8 * len(frame.support), amplitude_bits, direction_bits)
    bits += BitAccount(side=8 * len(data) - bits.total)
    return data, FrameStats(symbols.kind, len(symbols.sent), len(symbols.levels), bits)


# -- reading ----------------------------------------------------------------------------------------------


class BodyReader:
    """Reads a segment's body from front to back.

    Raises
    ------
    CorruptFile, TruncatedFile
        If the bytes contradict themselves or end too early.
    """

    def __init__(self, body: bytes, grid: Grid, codebook: Codebook) -> None:
        self._data, self._at = body, 0
        self._grid, self._codebook = grid, codebook
        (kinds,) = self._take(1, "kinds")
        if kinds & ~(_INTRA_SET | _INTER_SET | _SCAN_BIT):
            raise CorruptFile("SEGM.body", f"kinds {kinds:#x}", "bits 0 to 2 only")
        self.synthesis = Synthesis(grid, codebook, Scan.Z_FASTEST if kinds & _SCAN_BIT else Scan.X_FASTEST)
        self._sets = {kind: self._table_set() for kind in (_INTRA_SET, _INTER_SET) if kinds & kind}

    def amplitude(self, kind: FrameKind) -> Table:
        """The amplitude table of a kind of frame."""
        return self._set(kind).amplitude

    def frames(self, frame_count: int) -> Iterator[tuple[FrameSymbols, FrameStats]]:
        """The symbols of each frame in turn; the last one must end the body.

        The consumer passes nothing back: the support of the previous frame is kept here.
        """
        previous = None
        for i in range(frame_count):
            symbols, stats = self._frame(previous, first=i == 0)
            if symbols.kind != FrameKind.DIFFERENCE:
                previous = (symbols.bricks, symbols.mask)
            yield symbols, stats
        self._check_end()

    def costs(self, frame_count: int) -> Iterator[FrameCost]:
        """What each frame costs, without decoding it: as fast as the bytes are read."""
        for i in range(frame_count):
            yield self._parts(first=i == 0).cost
        self._check_end()

    def _parts(self, *, first: bool) -> _Parts:
        began = self._at
        (number,) = self._take(1, "frame kind")
        if number > 2 or (first and number != FrameKind.INTRA):
            raise CorruptFile("SEGM.body frame kind", str(number), "0 in the first frame, 0 to 2 in others")
        support = self._chunk("support")
        amplitudes = self._bit_chunk("amplitudes")
        directions = self._bit_chunk("directions")
        bits = BitAccount(8 * len(support), amplitudes[1], directions[1])
        bits += BitAccount(side=8 * (self._at - began) - bits.total)
        return _Parts(FrameCost(FrameKind(number), bits), support, amplitudes, directions)

    def _check_end(self) -> None:
        if self._at != len(self._data):
            raise CorruptFile("SEGM.body", f"{len(self._data) - self._at} bytes after the last frame", "none")

    def _frame(
        self, previous: tuple[NDArray[np.int32], NDArray[np.bool_]] | None, *, first: bool
    ) -> tuple[FrameSymbols, FrameStats]:
        parts = self._parts(first=first)
        kind = parts.cost.kind
        tables = self._set(kind)
        bricks, mask = decode_support(parts.support, self._grid, previous if kind == FrameKind.INTER else None)
        supported = int(np.count_nonzero(mask))
        sent, levels = decode_runs(
            tables.amplitude_code, *parts.amplitudes, supported, len(tables.amplitude.levels_n)
        )
        directions = decode_plain(tables.direction_code, *parts.directions, len(levels))
        symbols = FrameSymbols(kind, bricks, mask, sent, levels, directions)
        return symbols, FrameStats(kind, supported, len(levels), parts.cost.bits)

    def _set(self, kind: FrameKind) -> _TableSet:
        chosen = self._sets.get(_set_of(kind))
        if chosen is None:
            raise CorruptFile("SEGM.body", f"a frame of kind {kind} and no table set for it", "its table set")
        return chosen

    def _table_set(self) -> _TableSet:
        amplitude = table_from_bytes(self._chunk("amplitude levels"))
        if amplitude.levels_n[-1] > MOST_NEWTONS:
            raise CorruptFile(
                "SEGM.body amplitude levels", f"{amplitude.levels_n[-1]} N", f"at most {MOST_NEWTONS} N"
            )
        lengths = self._chunk("amplitude code")
        amplitude_code = _whole_code(lengths, len(amplitude.levels_n) + RUN_SYMBOLS)
        direction_code = _whole_code(self._chunk("direction code"), len(self._codebook.vertices))
        return _TableSet(amplitude, amplitude_code, direction_code)

    def _take(self, count: int, what: str) -> bytes:
        taken = self._data[self._at : self._at + count]
        if len(taken) < count:
            raise TruncatedFile(f"SEGM.body {what}", f"{len(taken)} bytes", f"{count} bytes")
        self._at += count
        return taken

    def _chunk(self, what: str) -> bytes:
        length, self._at = read_varint(self._data, self._at, f"SEGM.body {what}")
        return self._take(length, what)

    def _bit_chunk(self, what: str) -> tuple[bytes, int]:
        bit_length, self._at = read_varint(self._data, self._at, f"SEGM.body {what}")
        return self._take((bit_length + 7) // 8, what), bit_length


def _whole_code(data: bytes, symbol_count: int) -> HuffmanCode:
    code, end = HuffmanCode.from_bytes(data, 0, symbol_count)
    if end != len(data):
        raise CorruptFile("SEGM.body code lengths", f"{len(data) - end} bytes too many", "none")
    return code
