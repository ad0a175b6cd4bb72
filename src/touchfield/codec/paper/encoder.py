"""Encoder of coder `paper`: turns the force fields of a segment into bytes, in the steps of the paper's
figure 4.

source model (voxel) -> perceptual filter (deadband) -> separate quantisation of amplitude and direction ->
difference between frames -> entropy code. The device filter has been applied before. Amplitude levels are
trained on the segment and transmitted; the Huffman codes are built from all its symbols. Stages (`decoder`)
replace all of this.
"""

from __future__ import annotations

import heapq
import struct
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Bools, Float32s, Float64s, Int64s
from touchfield.codec.paper import quantisers
from touchfield.codec.paper.body import (
    INTER_SET,
    INTRA_SET,
    MAX_CODE_BITS,
    MAX_NEWTONS,
    RUN_SYMBOLS,
    BitStream,
    FrameSymbols,
    HuffmanCode,
    TableSet,
    rebuild_frame,
    set_of,
)
from touchfield.codec.paper.decoder import BY_BRICK, GRAIN, LEVELS, ORDER
from touchfield.codec.paper.directions import Codebook
from touchfield.codec.paper.quantisers import AmplitudeLevels, amplitudes_n
from touchfield.codec.paper.spec import PaperSpec
from touchfield.codec.segment import BitAccount, CodedSegment, FrameKind, FrameStats
from touchfield.codec.support import MAX_NUMBER, encode_numbers, encode_support
from touchfield.codec.varint import chunk, write_varint
from touchfield.compute.native import native
from touchfield.errors import InvalidArgument
from touchfield.measure.estimators import entropy_bits
from touchfield.medium import ForceField, Grid
from touchfield.medium.field import brick_keys
from touchfield.medium.grid import BRICK
from touchfield.perception.weber import gate, gate_in_time

_MIN_FORCE_N: Final = 1e-6
_TRAINING_SAMPLES: Final = 1 << 18


class PaperEncoder:
    """Encoder of the segments of one stream.

    InvalidArgument if there is no such direction codebook.
    """

    name = "paper"

    def __init__(self, grid: Grid, spec: PaperSpec) -> None:
        self._grid, self._spec = grid, spec.for_device(is_array=False)
        if spec.stage == "none":
            Codebook.get(self._spec.directions)

    @property
    def parameters(self) -> bytes:
        """The name of the direction codebook or of the stage, which the decoder needs."""
        return (self._spec.directions if self._spec.stage == "none" else self._spec.stage).encode("ascii")

    def encode_segment(self, frames: Sequence[ForceField]) -> CodedSegment:
        """Code one independent group of frames, at least one.

        InvalidArgument if a force is not finite, or, without a stage, an amplitude exceeds the 10^6 N that a
        file can store.
        """
        spec = self._spec
        for i, frame in enumerate(frames):
            _check_range(frame, i, MAX_NEWTONS if spec.stage == "none" else float(np.finfo(np.float32).max))
        if spec.stage != "none":
            return encode_staged(frames, spec.stage, spec.step_n)
        trained_on = frames[:1] if spec.interframe == "open" else frames
        sent = [amplitudes_n(_sent_alone_n(spec, f)) for f in trained_on]
        intra = _fit_levels(spec, _thin(np.concatenate(sent)))
        coder = _SegmentCoder(self._grid, spec, frames, {INTRA_SET: intra})
        count = len(Codebook.get(spec.directions))
        return write_body(count, coder.levels, coder.coded, single_holds=not spec.hold_runs)


def _check_range(frame: ForceField, index: int, limit_n: float) -> None:
    with np.errstate(over="ignore"):  # an overflow of float32 exceeds every limit
        largest_n = float(amplitudes_n(frame.forces_n.reshape(-1, 3)).max(initial=0.0))
    if not largest_n <= limit_n:  # also true for NaN
        raise InvalidArgument(
            f"frame {index}", f"a force of {largest_n:.3g} N", f"finite newtons, {limit_n:g} at most"
        )


class _SegmentCoder:
    """State of coding the frames of a segment one after another."""

    def __init__(
        self, grid: Grid, spec: PaperSpec, segment: Sequence[ForceField], levels: dict[int, AmplitudeLevels]
    ) -> None:
        self.grid, self.spec, self.segment, self.levels = grid, spec, segment, levels
        self.decoded: ForceField | None = None
        self.coded: list[FrameSymbols] = []
        self._codebook = Codebook.get(spec.directions)
        for i, frame in enumerate(self.segment):
            candidates = []
            if i == 0 or self.spec.choose_by_size or self.spec.interframe == "none":
                candidates.append(self._encode_scan(FrameKind.INTRA, frame))
            if i and self.spec.interframe == "closed":
                candidates.append(self._encode_closed_loop(frame))
            if i and self.spec.interframe == "open":
                if INTER_SET not in self.levels:
                    self.levels[INTER_SET] = _fit_levels(self.spec, _changes_n(self.spec, self.segment))
                candidates.append(
                    self._encode_scan(FrameKind.DIFFERENCE, frame + self.segment[i - 1].scaled(-1))
                )
            best = min(candidates, key=self._estimated_bits) if len(candidates) > 1 else candidates[0]
            self.decoded = rebuild_frame(
                self.grid, best, self.levels[set_of(best.kind)].levels_n, self._codebook, self.decoded
            )
            self.coded.append(best)

    def _encode_scan(self, kind: FrameKind, field: ForceField) -> FrameSymbols:
        """Code a field, or a field of differences, with its own samples as the reference."""
        vectors, table = field.vectors_n(), self.levels[set_of(kind)]
        levels, directions = table.encode(amplitudes_n(vectors)), self._codebook.nearest(vectors)
        sent = np.ones(len(vectors), bool)
        if self.spec.deadband != "none":
            decoded = table.levels_n[levels][:, None] * self._codebook.vertices_float32[directions]
            sent = gate(vectors, self.spec.k, self.spec.deadband, decoded)
        support = encode_support(self.grid, field.bricks, field.mask)
        return FrameSymbols(kind, support, field.bricks, field.mask, sent, levels[sent], directions[sent])

    def _encode_closed_loop(self, frame: ForceField) -> FrameSymbols:
        assert self.decoded is not None
        previous, vectors = self.coded[-1], frame.vectors_n()
        reference = self.decoded.forces_at(brick_keys(self.grid, frame.bricks)).reshape(-1, 3)[
            frame.raster_slots()
        ]
        sent = np.ones(len(vectors), bool)
        if self.spec.deadband != "none":
            sent = gate_in_time(vectors, reference, self.spec.k)
        difference = (vectors - reference)[sent]
        amplitudes = amplitudes_n(difference)
        if INTER_SET not in self.levels:
            # train on what this frame sends, and on the changes between later originals
            later = _changes_n(self.spec, self.segment[1:])
            self.levels[INTER_SET] = _fit_levels(self.spec, np.concatenate([amplitudes, later]))
        levels = self.levels[INTER_SET].encode(amplitudes)
        support = encode_support(self.grid, frame.bricks, frame.mask, (previous.bricks, previous.mask))
        directions = self._codebook.nearest(difference)
        return FrameSymbols(FrameKind.INTER, support, frame.bricks, frame.mask, sent, levels, directions)

    def _estimated_bits(self, symbols: FrameSymbols) -> float:
        count = len(self.levels[set_of(symbols.kind)])
        packed, _, extra = pack_runs(symbols.sent, symbols.levels, count, single=not self.spec.hold_runs)
        amplitude = entropy_bits(np.bincount(packed)) * len(packed) + int(extra.sum())
        direction = entropy_bits(np.bincount(symbols.directions)) * len(symbols.directions)
        return amplitude + direction + 8 * len(symbols.support)


def _fit_levels(spec: PaperSpec, amplitudes_n: Float32s) -> AmplitudeLevels:
    """Amplitude quantiser of a spec, trained on the amplitudes that will be sent."""
    top_n = float(amplitudes_n.max(initial=0.0))
    if spec.amplitude == "lloyd-max":
        return quantisers.lloyd_max_levels(amplitudes_n, spec.nq)
    if spec.amplitude == "uniform":
        return quantisers.uniform_levels(max(top_n, _MIN_FORCE_N) / (2**spec.nq - 1), top_n)
    if spec.weber_steps is not None:
        # the sent samples are estimated from the originals; one that is sent in fact may be larger by k
        top_n = max(top_n, _MIN_FORCE_N) * (1 + spec.k)
    return quantisers.weber_levels(quantisers.weber_ladder(spec.k, top_n, spec.weber_steps))


def _sent_alone_n(spec: PaperSpec, frame: ForceField) -> Float32s:
    """Vectors that the deadband passes in a frame coded on its own.

    They are estimated from the original forces.
    """
    vectors = frame.vectors_n()
    if spec.deadband == "none" or not len(vectors):
        return vectors
    return vectors[gate(vectors, spec.k, spec.deadband, vectors)]


def _changes_n(spec: PaperSpec, segment: Sequence[ForceField]) -> Float32s:
    """Amplitudes of changes above the deadband between originals, pooled over a segment."""
    amplitudes = [np.zeros(0, np.float32)]
    for previous, frame in pairwise(segment):
        change = frame + previous.scaled(-1)
        vectors = change.vectors_n()
        if spec.interframe == "closed" and spec.deadband != "none":
            bricks, slots = brick_keys(change.grid, change.bricks), change.raster_slots()
            current, earlier = (f.forces_at(bricks).reshape(-1, 3)[slots] for f in (frame, previous))
            vectors = vectors[gate_in_time(current, earlier, spec.k) & (current != 0).any(axis=1)]
        amplitudes.append(amplitudes_n(vectors))
    return _thin(np.concatenate(amplitudes))


def _thin(amplitudes: Float32s) -> Float32s:
    """Every n-th amplitude and the largest, to bound the time of training."""
    step = -(-len(amplitudes) // _TRAINING_SAMPLES)
    return amplitudes if step <= 1 else np.append(amplitudes[::step], amplitudes.max())


_LONGEST_RUN = (1 << RUN_SYMBOLS) - 1


def fitted_code(counts: Int64s) -> HuffmanCode:
    """Huffman code for symbols that occur `counts` times, int64 [n].

    Counts are repeatedly halved, which makes them more similar, until no code has more than 24 bits.
    """
    lengths = np.zeros(len(counts), np.uint8)
    present = np.flatnonzero(counts)
    weights = np.asarray(counts)[present]
    while len(present):
        depths = _depths(weights.tolist())
        if max(depths) <= MAX_CODE_BITS:
            lengths[present] = depths
            break
        weights = (weights + 1) // 2
    return HuffmanCode(lengths)


def _depths(weights: list[int]) -> list[int]:
    """Code length of each symbol in bits."""
    heap = [(weight, i) for i, weight in enumerate(weights)]
    heapq.heapify(heap)
    above: dict[int, int] = {}
    for parent in range(len(weights), 2 * len(weights) - 1):
        (weight_i, i), (weight_j, j) = heapq.heappop(heap), heapq.heappop(heap)
        above[i] = above[j] = parent
        heapq.heappush(heap, (weight_i + weight_j, parent))
    depth = {heap[0][1]: 0}
    for node in range(2 * len(weights) - 3, -1, -1):
        depth[node] = depth[above[node]] + 1
    return [max(1, depth[i]) for i in range(len(weights))]


def pack_runs(
    sent: Bools, levels: NDArray[np.uint16], level_count: int, *, single: bool
) -> tuple[Int64s, Int64s, Int64s]:
    """Symbols of the samples of a frame, with runs of held samples packed.

    `sent` is bool [L]; `levels` are those of the sent samples. With `single` each held sample is a symbol of
    its own. Returns the symbols, the values of the raw bits after each, and the numbers of these bits.
    """
    index = np.arange(len(sent))
    since = index - np.maximum.accumulate(np.where(sent, index, -1)) - 1  # held samples before this one
    starts = np.flatnonzero(sent | (since % (1 if single else _LONGEST_RUN) == 0))
    runs = np.diff(starts, append=len(sent))
    bits = np.frexp(runs)[1].astype(np.int64) - 1
    symbols, values = level_count + bits, runs - (1 << bits)
    symbols[sent[starts]] = levels
    return symbols, values, bits


def encode_symbols(
    code: HuffmanCode, symbols: NDArray[Any], values: Int64s | int = 0, extra: Int64s | int = 0
) -> BitStream:
    """Code symbols [m], each followed by ``extra[i]`` raw bits of ``values[i]``."""
    from touchfield.codec.paper.kernels import pack_bits

    _, ranks, order = code.tables
    codes = np.zeros(len(code.lengths), np.int64)
    codes[order] = np.arange(len(order)) - ranks[code.lengths[order]]
    written, lengths = (codes[symbols] << extra) | values, code.lengths[symbols].astype(np.int64) + extra
    bit_length = int(lengths.sum())
    out = np.zeros(-(-bit_length // 8), np.uint8)
    pack_bits(written, lengths, out)
    return BitStream(out.tobytes(), bit_length)


def write_body(
    direction_count: int,
    levels: Mapping[int, AmplitudeLevels],
    frames: Sequence[FrameSymbols],
    *,
    single_holds: bool,
) -> CodedSegment:
    """Body of a segment, with the cost of each frame.

    `levels` are the amplitude levels of the table sets `INTRA_SET` and `INTER_SET`.
    """
    kinds, tables, packed = 0, b"", {}
    sets = {}
    for kind in (INTRA_SET, INTER_SET):
        of_kind = [symbols for symbols in frames if set_of(symbols.kind) == kind]
        if not of_kind:
            continue
        quantiser = levels[kind]
        amplitude_counts = np.zeros(len(quantiser) + RUN_SYMBOLS, np.int64)
        direction_counts = np.zeros(direction_count, np.int64)
        for symbols in of_kind:
            streams = packed[id(symbols)] = pack_runs(
                symbols.sent, symbols.levels, len(quantiser), single=single_holds
            )
            amplitude_counts += np.bincount(streams[0], minlength=len(amplitude_counts))
            direction_counts += np.bincount(symbols.directions, minlength=direction_count)
        if quantiser.levels_n.max(initial=0.0) > MAX_NEWTONS:  # differences are up to twice a force
            found = f"a change of {quantiser.levels_n.max():.3g} N from frame to frame"
            raise InvalidArgument("frames", found, f"{MAX_NEWTONS:g} N at most")
        table_set = sets[kind] = TableSet(
            quantiser, fitted_code(amplitude_counts), fitted_code(direction_counts)
        )
        kinds |= kind
        tables += chunk(quantiser.levels_n.astype("<f4").tobytes())
        for code in (table_set.amplitude_code, table_set.direction_code):
            tables += chunk(encode_numbers(code.lengths))
    parts, stats = [bytes([kinds]), tables], []
    for symbols in frames:
        tables_of_kind = sets[set_of(symbols.kind)]
        amplitudes = encode_symbols(tables_of_kind.amplitude_code, *packed[id(symbols)])
        directions = encode_symbols(tables_of_kind.direction_code, symbols.directions)
        data = bytes([symbols.kind]) + chunk(symbols.support)
        data += b"".join(write_varint(s.bit_length) + s.data for s in (amplitudes, directions))
        bits = BitAccount(8 * len(symbols.support), amplitudes.bit_length, directions.bit_length)
        bits += BitAccount(side=8 * len(data) - bits.total)
        parts.append(data)
        stats.append(FrameStats(symbols.kind, bits, len(symbols.sent), len(symbols.levels)))
    return CodedSegment(b"".join(parts), tuple(stats))


_PASSES = 4
_ROUNDING = 1 / 3  # rounding offset of the DCT: a coefficient below two thirds of a step becomes 0


def encode_staged(frames: Sequence[ForceField], stage: str, step_n: float) -> CodedSegment:
    """Code frames as a segment of a stage.

    InvalidArgument if the step is too fine for the forces.
    """
    parts, stats = [struct.pack("<d", step_n)], []
    for frame in frames:
        support = encode_support(frame.grid, frame.bricks, frame.mask)
        numbers, runs = _numbers(frame, stage, step_n)
        if np.abs(numbers).max(initial=0) > MAX_NUMBER:
            raise InvalidArgument("step_n", f"{step_n:g} N", "at least 2^-20 of the largest component")
        code = encode_numbers(numbers)
        data = chunk(support) + (write_varint(runs) if stage == "runs" else b"") + chunk(code)
        bits = BitAccount(8 * len(support), 8 * len(code))
        bits += BitAccount(side=8 * len(data) - bits.total)
        parts.append(data)
        stats.append(FrameStats(FrameKind.INTRA, bits, frame.support_count, frame.support_count))
    return CodedSegment(b"".join(parts), tuple(stats))


def _numbers(frame: ForceField, stage: str, step_n: float) -> tuple[Int64s, int]:
    """Numbers of a frame, int64 [any], and its number of runs."""
    if stage in BY_BRICK:
        filled = _fill_bricks(frame) / step_n
        coefficients = _to_wavelet(_round_steps(filled)) if stage == "wavelet" else _to_dct(filled)
        return coefficients.reshape(-1, BRICK**3, 3)[:, ORDER].transpose(2, 1, 0).reshape(-1), 0
    vectors = frame.vectors_n().astype(np.float64) / step_n
    if stage == "adpcm":
        grains = np.ascontiguousarray(_round_steps(vectors * GRAIN).T)
        residuals = np.zeros_like(grains)
        for values, out in zip(grains, residuals, strict=True):
            native.adpcm(values, out, False)
        return residuals.reshape(-1), 0
    points = _round_steps(vectors)
    if stage == "dpcm":
        return np.diff(points, axis=0, prepend=np.zeros((1, 3), np.int64)).T.reshape(-1), 0
    starts = np.flatnonzero(np.append(True, (points[1:] != points[:-1]).any(axis=1))[: len(points)])
    lengths = np.diff(starts, append=len(points)) - 1
    return np.concatenate([lengths, points[starts].T.reshape(-1)]), len(starts)


def _round_steps(steps: Float64s) -> Int64s:
    limited = np.clip(steps, -float(1 << 40), float(1 << 40))  # the caller refuses numbers that are too large
    return np.rint(limited).astype(np.int64)


def _fill_bricks(frame: ForceField) -> Float64s:
    """Forces [n, 8, 8, 8, 3], with smooth values outside the support.

    Samples outside the support start as the mean of the brick; each pass replaces them by the mean of their
    neighbours.
    """
    supported = frame.mask[..., None]
    x = frame.forces_n.astype(np.float64)
    mean = x.sum(axis=(1, 2, 3)) / np.maximum(frame.mask.sum(axis=(1, 2, 3)), 1)[:, None]
    x = np.where(supported, x, mean[:, None, None, None, :])
    for _ in range(_PASSES):
        p = np.pad(x, ((0, 0), (1, 1), (1, 1), (1, 1), (0, 0)), mode="edge")
        neighbours = (
            p[:, :-2, 1:-1, 1:-1] + p[:, 2:, 1:-1, 1:-1] + p[:, 1:-1, :-2, 1:-1] + p[:, 1:-1, 2:, 1:-1]
        )
        x = np.where(supported, x, (neighbours + p[:, 1:-1, 1:-1, :-2] + p[:, 1:-1, 1:-1, 2:]) / 6)
    return x


def _to_wavelet(points: Int64s) -> Int64s:
    out = points.copy()
    for level in range(LEVELS):
        size = BRICK >> level
        for axis in (1, 2, 3):
            x = np.moveaxis(out[:, :size, :size, :size], axis, 0)
            even = x[0::2]
            detail = x[1::2] - ((even + np.concatenate([even[1:], even[-1:]])) >> 1)
            coarse = even + ((np.concatenate([detail[:1], detail[:-1]]) + detail + 2) >> 2)
            x[...] = np.concatenate([coarse, detail])
    return out


def _to_dct(steps: Float64s) -> Int64s:
    from scipy.fft import dctn

    spectrum = dctn(steps, axes=(1, 2, 3), norm="ortho") if len(steps) else steps
    return np.sign(spectrum).astype(np.int64) * _round_steps(np.floor(np.abs(spectrum) + _ROUNDING))
