"""The amplitude stream: levels of sent samples and runs of held ones in one alphabet (paper section 5.2).

Eq. 8 leaves most samples held, and a Huffman code spends one bit at least on each symbol. Departure: a run of
held samples is one symbol. Symbols 0..N-1 are levels; symbol N + j, written R_j, is a run of 2^j + b held
samples and is followed by b in j raw bits, j = 0..20. Longer runs are several symbols. The literal coder of
the paper, one zero symbol for each held sample, uses R_0 alone.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from touchfield.codec.huffman import HuffmanCode, bytes_of_words, check_used, words_of_bytes
from touchfield.errors import CorruptFile, InvalidArgument

if TYPE_CHECKING:
    from numpy.typing import NDArray

    RunStreams = tuple[NDArray[np.uint16], NDArray[np.uint32], NDArray[np.uint8]]

__all__ = ["RUN_SYMBOLS", "decode_runs", "encode_runs", "pack_runs", "unpack_runs"]

RUN_SYMBOLS = 21
"""R_0 to R_20: runs of up to 2^21 - 1 held samples in one symbol."""

_WRITEABLE: tuple[Literal["C"], Literal["W"]] = ("C", "W")  # a read-only array would be another type to the compiler

MAX_LEVELS = (1 << 16) - RUN_SYMBOLS


def _check_levels(level_count: int) -> None:
    if not 0 <= level_count <= MAX_LEVELS:
        raise InvalidArgument("level_count", repr(level_count), f"0 to {MAX_LEVELS}")


def pack_runs(
    sent: NDArray[np.bool_], levels: NDArray[np.uint16], level_count: int, *, single: bool = False
) -> RunStreams:
    """The symbols of a frame's amplitudes.

    Parameters
    ----------
    sent : bool [L]
        Per supported sample in scan order: sent, or held.
    levels : uint16 [sent.sum()]
        Level of each sent sample, below `level_count`.
    level_count : int
        N.
    single : bool
        One symbol R_0 for each held sample, as the paper prints it.

    Returns
    -------
    symbols : uint16 [m]
        Below N + `RUN_SYMBOLS`.
    extra_values : uint32 [m]
    extra_bits : uint8 [m]
        The raw bits that follow each symbol, and how many.

    Raises
    ------
    InvalidArgument
        If levels and sent flags do not agree, or a level is not below N.
    """
    from touchfield.codec.kernels import runs as kernels

    _check_levels(level_count)
    flags, chosen = np.asarray(sent), np.asarray(levels)
    if flags.dtype != np.bool_ or flags.ndim != 1 or chosen.dtype != np.uint16 or chosen.ndim != 1:
        raise InvalidArgument(
            "sent and levels",
            f"{flags.dtype} {flags.shape}, {chosen.dtype} {chosen.shape}",
            "bool [L], uint16 [sent]",
        )
    count = int(np.count_nonzero(flags))
    if count != len(chosen):
        raise InvalidArgument("levels", f"{len(chosen)}", f"{count}, one for each sent sample")
    if count and int(chosen.max()) >= level_count:
        raise InvalidArgument("levels", f"level {chosen.max()}", f"levels below {level_count}")
    flags, chosen = np.require(flags, None, _WRITEABLE), np.require(chosen, None, _WRITEABLE)
    return kernels.pack(flags, chosen, level_count, 0 if single else RUN_SYMBOLS - 1)


def unpack_runs(
    symbols: NDArray[np.uint16], extra_values: NDArray[np.uint32], level_count: int, sample_count: int
) -> tuple[NDArray[np.bool_], NDArray[np.uint16]]:
    """The inverse of `pack_runs`: sent flags, bool [sample_count], and levels, uint16 [sent.sum()].

    Raises
    ------
    CorruptFile
        If the symbols do not stand for exactly `sample_count` samples.
    """
    from touchfield.codec.kernels import runs as kernels

    _check_levels(level_count)
    s, v = np.require(symbols, np.uint16, _WRITEABLE), np.require(extra_values, np.uint32, _WRITEABLE)
    if s.ndim != 1 or s.shape != v.shape or sample_count < 0:
        raise InvalidArgument("symbols and extra_values", f"{s.shape}, {v.shape}", "[m] and [m]")
    sent = np.zeros(sample_count, np.bool_)
    levels = np.empty(min(len(s), sample_count), np.uint16)
    count = kernels.unpack(s, v, level_count, sent, levels)
    if count < 0:
        raise CorruptFile("amplitude symbols", "runs that do not fit", f"levels and runs of {sample_count} samples")
    return sent, levels[:count].copy()


def encode_runs(
    code: HuffmanCode,
    symbols: NDArray[np.uint16],
    extra_values: NDArray[np.uint32],
    extra_bits: NDArray[np.uint8],
) -> tuple[bytes, int]:
    """The codes of symbols, each followed by its raw bits: bytes and the number of bits.

    Raises
    ------
    InvalidArgument
        If a symbol has no code, or a value does not fit its bits.
    """
    from touchfield.codec.kernels import runs as kernels

    s, v, b = np.asarray(symbols), np.asarray(extra_values), np.asarray(extra_bits)
    typed = s.dtype == np.uint16 and v.dtype == np.uint32 and b.dtype == np.uint8
    if not typed or not s.shape == v.shape == b.shape == (len(s),):
        raise InvalidArgument("symbols", f"{s.dtype}, {v.dtype}, {b.dtype}", "uint16, uint32, uint8, each [m]")
    top = int(b.max(initial=0))
    if top >= RUN_SYMBOLS or (v >> b).any():
        raise InvalidArgument(
            "extra_values", f"values beyond {top} bits", f"values within 0 to {RUN_SYMBOLS - 1} bits"
        )
    longest = int(code.lengths.max(initial=0)) + top
    words = np.empty(len(s) * longest // 32 + 2, np.uint32)
    s, v, b = np.require(s, None, _WRITEABLE), np.require(v, None, _WRITEABLE), np.require(b, None, _WRITEABLE)
    bit_length = kernels.encode((s, v, b), code.codes, words)
    if bit_length < 0:
        raise InvalidArgument("symbols", "one without a code", "symbols that the code was fitted to")
    return bytes_of_words(words, bit_length), bit_length


def decode_runs(
    code: HuffmanCode, data: bytes, bit_length: int, sample_count: int, level_count: int
) -> tuple[NDArray[np.bool_], NDArray[np.uint16]]:
    """The inverse of `pack_runs` and `encode_runs` in one pass.

    Parameters
    ----------
    code : HuffmanCode
        Over `level_count` + `RUN_SYMBOLS` symbols.
    data : bytes
    bit_length : int
    sample_count : int
        L, the supported samples of the frame; the caller holds their mask already.
    level_count : int

    Returns
    -------
    sent : bool [L]
    levels : uint16 [sent.sum()]

    Raises
    ------
    TruncatedFile, CorruptFile
        If the bits are too few, too many or no codes, or do not stand for exactly L samples.
    """
    from touchfield.codec.kernels import runs as kernels

    where = "amplitude stream"
    _check_levels(level_count)
    if code.symbol_count != level_count + RUN_SYMBOLS:
        raise InvalidArgument(where, f"a code over {code.symbol_count} symbols", f"{level_count + RUN_SYMBOLS}")
    words = words_of_bytes(data, bit_length, where)
    sent = np.zeros(sample_count, np.bool_)
    levels = np.empty(min(sample_count, bit_length), np.uint16)
    used, count = kernels.decode(words, bit_length, code.decoder_table, level_count, sent, levels)
    if used == kernels.OVERRUN:
        raise CorruptFile(where, "a run beyond the last sample", f"{sample_count} samples")
    check_used(used, bit_length, where)
    return sent, levels[:count].copy()
