"""The body of a segment of coder `paper` as it is written, with Huffman codes made for its symbols."""

from __future__ import annotations

import heapq
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Bools, Int64s
from touchfield.codec.numbers import encode_numbers
from touchfield.codec.paper.body import INTER_SET, INTRA_SET, FrameSymbols, TableSet, set_of
from touchfield.codec.paper.huffman import RUN_SYMBOLS, BitStream, HuffmanCode
from touchfield.codec.paper.kernels.loops import LONGEST, pack_bits
from touchfield.codec.paper.quantisers import AmplitudeLevels
from touchfield.codec.rate import BitAccount
from touchfield.codec.segment import CodedSegment, FrameStats
from touchfield.codec.varint import chunk, write_varint

_LONGEST_RUN = (1 << RUN_SYMBOLS) - 1


def fitted_code(counts: Int64s) -> HuffmanCode:
    """Huffman's code for symbols that occur `counts` times, int64 [n]; more alike where it had more than 24 bits."""
    lengths = np.zeros(len(counts), np.uint8)
    present = np.flatnonzero(counts)
    weights = np.asarray(counts)[present]
    while len(present):
        depths = _depths(weights.tolist())
        if max(depths) <= LONGEST:
            lengths[present] = depths
            break
        weights = (weights + 1) // 2
    return HuffmanCode(lengths)


def _depths(weights: list[int]) -> list[int]:
    """Bits of the code of each symbol."""
    heap = [(weight, i) for i, weight in enumerate(weights)]
    heapq.heapify(heap)
    above: dict[int, int] = {}
    for parent in range(len(weights), 2 * len(weights) - 1):
        (one, i), (other, j) = heapq.heappop(heap), heapq.heappop(heap)
        above[i] = above[j] = parent
        heapq.heappush(heap, (one + other, parent))
    depth = {heap[0][1]: 0}
    for node in range(2 * len(weights) - 3, -1, -1):
        depth[node] = depth[above[node]] + 1
    return [max(1, depth[i]) for i in range(len(weights))]


def code_bytes(code: HuffmanCode) -> bytes:
    """A code as its lengths (`codec.numbers`)."""
    return encode_numbers(code.lengths)


def pack_runs(
    sent: Bools, levels: NDArray[np.uint16], level_count: int, *, single: bool
) -> tuple[Int64s, Int64s, Int64s]:
    """The symbols of the samples bool [L], with the raw bits behind each: symbols, values, and numbers of bits.

    `levels` are those of the sent samples; with `single` each held sample is a symbol of its own.
    """
    index = np.arange(len(sent))
    since = index - np.maximum.accumulate(np.where(sent, index, -1)) - 1  # held samples before this one
    at = np.flatnonzero(sent | (since % (1 if single else _LONGEST_RUN) == 0))
    runs = np.diff(at, append=len(sent))
    bits = np.frexp(runs)[1].astype(np.int64) - 1
    symbols, values = level_count + bits, runs - (1 << bits)
    symbols[sent[at]] = levels
    return symbols, values, bits


def encode_symbols(
    code: HuffmanCode, symbols: NDArray[Any], values: Int64s | int = 0, extra: Int64s | int = 0
) -> BitStream:
    """The codes of symbols [m], each followed by ``extra[i]`` raw bits of ``values[i]``."""
    _, ranks, order = code.tables
    codes = np.zeros(len(code.lengths), np.int64)
    codes[order] = np.arange(len(order)) - ranks[code.lengths[order]]
    written, lengths = (codes[symbols] << extra) | values, code.lengths[symbols].astype(np.int64) + extra
    bit_length = int(lengths.sum())
    out = np.zeros(-(-bit_length // 8), np.uint8)
    pack_bits(written, lengths, out)
    return BitStream(out.tobytes(), bit_length)


@dataclass(frozen=True)
class CodedFrame:
    """A frame's symbols with its coded support."""

    symbols: FrameSymbols
    support: bytes


def write_body(
    direction_count: int,
    levels: Mapping[int, AmplitudeLevels],
    frames: Sequence[CodedFrame],
    *,
    single_holds: bool,
) -> CodedSegment:
    """The body of a segment, and what each frame cost; `levels` are by `INTRA_SET` and `INTER_SET`."""
    kinds, tables, packed = 0, b"", {}
    sets = {}
    for kind in (INTRA_SET, INTER_SET):
        mine = [f.symbols for f in frames if set_of(f.symbols.kind) == kind]
        if not mine:
            continue
        chosen = levels[kind]
        amplitude_counts = np.zeros(len(chosen) + RUN_SYMBOLS, np.int64)
        direction_counts = np.zeros(direction_count, np.int64)
        for symbols in mine:
            streams = packed[id(symbols)] = pack_runs(symbols.sent, symbols.levels, len(chosen), single=single_holds)
            amplitude_counts += np.bincount(streams[0], minlength=len(amplitude_counts))
            direction_counts += np.bincount(symbols.directions, minlength=direction_count)
        made = sets[kind] = TableSet(chosen, fitted_code(amplitude_counts), fitted_code(direction_counts))
        kinds |= kind
        tables += chunk(chosen.levels_n.astype("<f4").tobytes())
        tables += chunk(code_bytes(made.amplitude_code)) + chunk(code_bytes(made.direction_code))
    parts, stats = [bytes([kinds]), tables], []
    for f in frames:
        symbols, chosen_set = f.symbols, sets[set_of(f.symbols.kind)]
        amplitudes = encode_symbols(chosen_set.amplitude_code, *packed[id(symbols)])
        directions = encode_symbols(chosen_set.direction_code, symbols.directions)
        data = bytes([symbols.kind]) + chunk(f.support)
        data += b"".join(write_varint(s.bit_length) + s.data for s in (amplitudes, directions))
        bits = BitAccount(8 * len(f.support), amplitudes.bit_length, directions.bit_length)
        bits += BitAccount(side=8 * len(data) - bits.total)
        parts.append(data)
        stats.append(FrameStats(symbols.kind, len(symbols.sent), len(symbols.levels), bits))
    return CodedSegment(b"".join(parts), tuple(stats))
