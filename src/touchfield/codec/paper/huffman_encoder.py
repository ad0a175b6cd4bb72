"""Huffman codes made for symbols, and how they are written; the inverse is in `huffman`."""

from __future__ import annotations

import heapq
from typing import TYPE_CHECKING, Any

import numpy as np

from touchfield.codec.numbers import encode_numbers
from touchfield.codec.paper.huffman import LONGEST, RUN_SYMBOLS, BitStream, HuffmanCode

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Int64s = NDArray[np.int64]

__all__ = ["code_bytes", "encode_symbols", "fitted_code", "pack_runs"]

_LONGEST_RUN = (1 << RUN_SYMBOLS) - 1


def fitted_code(counts: Int64s) -> HuffmanCode:
    """The best code for symbols that occur `counts` times, int64 [n], by Huffman's merging.

    Where a code would be longer than 24 bits, the counts are made more alike until none is.
    """
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
    sent: NDArray[np.bool_], levels: NDArray[np.uint16], level_count: int, *, single: bool
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
    from touchfield.codec.paper.kernels.bits import pack_bits

    _, ranks, order = code.tables
    codes = np.zeros(len(code.lengths), np.int64)
    codes[order] = np.arange(len(order)) - ranks[code.lengths[order]]
    written, lengths = (codes[symbols] << extra) | values, code.lengths[symbols].astype(np.int64) + extra
    bit_length = int(lengths.sum())
    out = np.zeros(-(-bit_length // 8), np.uint8)
    pack_bits(written, lengths, out)
    return BitStream(out.tobytes(), bit_length)
