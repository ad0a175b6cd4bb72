"""The body of a segment of coder `paper`, as it is written; the inverse is in `body`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from touchfield.codec.paper.body import INTER_SET, INTRA_SET, TableSet, set_of
from touchfield.codec.paper.huffman import RUN_SYMBOLS
from touchfield.codec.paper.huffman_encoder import code_bytes, encode_symbols, fitted_code, pack_runs
from touchfield.codec.rate import BitAccount
from touchfield.codec.segment import CodedSegment, FrameStats
from touchfield.codec.varint import chunk, write_varint

if TYPE_CHECKING:
    from touchfield.codec.paper.frames import FrameSymbols
    from touchfield.codec.paper.quantisers import AmplitudeLevels

__all__ = ["CodedFrame", "write_body"]


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
