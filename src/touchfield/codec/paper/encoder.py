"""The encoder of the paper's coder: one segment of frames to one body of bytes (figure 4).

source model (voxel) -> perceptual filter (deadband) -> quantise amplitude and direction apart -> difference
between frames -> entropy code. The device filter came before. Codebooks are trained on the whole segment and
transmitted; the Huffman codes are made when all its symbols are known. Stages are coded in `stage_encoder`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Final

import numpy as np

from touchfield.arrays import Float32s
from touchfield.codec.paper import quantisers
from touchfield.codec.paper.body import INTER_SET, INTRA_SET, FrameSymbols, rebuilt, set_of
from touchfield.codec.paper.body_writer import CodedFrame, pack_runs, write_body
from touchfield.codec.paper.directions import Codebook
from touchfield.codec.paper.quantisers import AmplitudeLevels, amplitudes_n
from touchfield.codec.paper.spec import PaperSpec
from touchfield.codec.paper.stage_encoder import encode_staged
from touchfield.codec.segment import CodedSegment, FrameKind
from touchfield.codec.support import encode_support
from touchfield.measure.estimators import entropy_bits
from touchfield.medium import ForceField, Grid
from touchfield.medium.field import brick_keys
from touchfield.perception.weber import gate, gate_in_time

_LEAST_FORCE_N: Final = 1e-6
_TRAINING_SAMPLES: Final = 1 << 18


class PaperEncoder:
    """Codes segments of one stream; InvalidArgument if there is no such direction codebook."""

    name = "paper"

    def __init__(self, grid: Grid, spec: PaperSpec) -> None:
        self._grid, self._spec = grid, spec.for_device(is_array=False)
        if spec.stage == "none":
            Codebook.get(self._spec.directions)

    @property
    def parameters(self) -> bytes:
        """Knowledge of the decoder beside the bodies: the name of the direction codebook, or of the stage."""
        return (self._spec.directions if self._spec.stage == "none" else self._spec.stage).encode("ascii")

    def encode_segment(self, frames: Sequence[ForceField]) -> CodedSegment:
        """Code one independent group of frames, at least one."""
        spec = self._spec
        if spec.stage != "none":
            return encode_staged(frames, spec.stage, spec.step_n)
        trained_on = frames[:1] if spec.interframe == "open" else frames
        sent = [amplitudes_n(_sent_alone_n(spec, f)) for f in trained_on]
        intra = _fitted(spec, _thinned(np.concatenate(sent)))
        coder = _Coder(self._grid, spec, frames, {INTRA_SET: intra})
        count = len(Codebook.get(spec.directions))
        return write_body(count, coder.levels, coder.coded, single_holds=not spec.hold_runs)


@dataclass
class _Coder:
    """The frames of a segment, coded one after another."""

    grid: Grid
    spec: PaperSpec
    segment: Sequence[ForceField]
    levels: dict[int, AmplitudeLevels]
    decoded: ForceField | None = None
    coded: list[CodedFrame] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._codebook = Codebook.get(self.spec.directions)
        for i, frame in enumerate(self.segment):
            candidates = []
            if i == 0 or self.spec.choose_by_size or self.spec.interframe == "none":
                candidates.append(self._scanned(FrameKind.INTRA, frame))
            if i and self.spec.interframe == "closed":
                candidates.append(self._closed_loop(frame))
            if i and self.spec.interframe == "open":
                if INTER_SET not in self.levels:
                    self.levels[INTER_SET] = _fitted(self.spec, _changes_n(self.spec, self.segment))
                candidates.append(self._scanned(FrameKind.DIFFERENCE, frame + self.segment[i - 1].scaled(-1)))
            best = min(candidates, key=self._estimated_bits) if len(candidates) > 1 else candidates[0]
            self.decoded = rebuilt(self.grid, best.symbols, self._levels(best).levels_n, self._codebook, self.decoded)
            self.coded.append(best)

    def _scanned(self, kind: FrameKind, field: ForceField) -> CodedFrame:
        """A field, or a field of differences, coded with nothing but its own scan to predict it."""
        vectors, table = field.vectors_n(), self.levels[set_of(kind)]
        levels, directions = table.encode(amplitudes_n(vectors)), self._codebook.nearest(vectors)
        sent = np.ones(len(vectors), bool)
        if self.spec.deadband != "none":
            decoded = table.levels_n[levels][:, None] * self._codebook.vertices_float32[directions]
            sent = gate(vectors, self.spec.k, self.spec.deadband, decoded)
        support = encode_support(self.grid, field.bricks, field.mask)
        return CodedFrame(FrameSymbols(kind, field.bricks, field.mask, sent, levels[sent], directions[sent]), support)

    def _closed_loop(self, frame: ForceField) -> CodedFrame:
        assert self.decoded is not None
        before, vectors = self.coded[-1].symbols, frame.vectors_n()
        reference = self.decoded.forces_at(brick_keys(self.grid, frame.bricks)).reshape(-1, 3)[frame.raster_slots()]
        sent = np.ones(len(vectors), bool)
        if self.spec.deadband != "none":
            sent = gate_in_time(vectors, reference, self.spec.k)
        difference = (vectors - reference)[sent]
        amplitudes = amplitudes_n(difference)
        if INTER_SET not in self.levels:
            # what this frame sends corrects the quantiser too; what later ones send is known from the originals
            later = _changes_n(self.spec, self.segment[1:])
            self.levels[INTER_SET] = _fitted(self.spec, np.concatenate([amplitudes, later]))
        levels = self.levels[INTER_SET].encode(amplitudes)
        support = encode_support(self.grid, frame.bricks, frame.mask, (before.bricks, before.mask))
        directions = self._codebook.nearest(difference)
        return CodedFrame(FrameSymbols(FrameKind.INTER, frame.bricks, frame.mask, sent, levels, directions), support)

    def _levels(self, frame: CodedFrame) -> AmplitudeLevels:
        return self.levels[set_of(frame.symbols.kind)]

    def _estimated_bits(self, frame: CodedFrame) -> float:
        symbols = frame.symbols
        packed, _, extra = pack_runs(
            symbols.sent, symbols.levels, len(self._levels(frame)), single=not self.spec.hold_runs
        )
        amplitude = entropy_bits(np.bincount(packed)) * len(packed) + int(extra.sum())
        direction = entropy_bits(np.bincount(symbols.directions)) * len(symbols.directions)
        return amplitude + direction + 8 * len(frame.support)


def _fitted(spec: PaperSpec, amplitudes_n: Float32s) -> AmplitudeLevels:
    """The amplitude quantiser that was asked for, trained on what will be sent."""
    top_n = float(amplitudes_n.max(initial=0.0))
    if spec.amplitude == "lloyd-max":
        return quantisers.lloyd_max_levels(amplitudes_n, spec.nq)
    if spec.amplitude == "uniform":
        return quantisers.uniform_levels(max(top_n, _LEAST_FORCE_N) / (2**spec.nq - 1), top_n)
    if spec.weber_steps is not None:
        # which samples are sent is foreseen from the originals; one that was not may be larger by k
        top_n = max(top_n, _LEAST_FORCE_N) * (1 + spec.k)
    return quantisers.weber_levels(quantisers.weber_ladder(spec.k, top_n, spec.weber_steps))


def _sent_alone_n(spec: PaperSpec, frame: ForceField) -> Float32s:
    """The vectors that the deadband lets through in a frame coded alone, as far as that is known beforehand."""
    vectors = frame.vectors_n()
    if spec.deadband == "none" or not len(vectors):
        return vectors
    return vectors[gate(vectors, spec.k, spec.deadband, vectors)]


def _changes_n(spec: PaperSpec, segment: Sequence[ForceField]) -> Float32s:
    """The amplitudes of what changes perceptibly from one original to the next, pooled over a segment."""
    kept = [np.zeros(0, np.float32)]
    for before, frame in pairwise(segment):
        change = frame + before.scaled(-1)
        vectors = change.vectors_n()
        if spec.interframe == "closed" and spec.deadband != "none":
            bricks, slots = brick_keys(change.grid, change.bricks), change.raster_slots()
            now, then = (f.forces_at(bricks).reshape(-1, 3)[slots] for f in (frame, before))
            vectors = vectors[gate_in_time(now, then, spec.k) & (now != 0).any(axis=1)]
        kept.append(amplitudes_n(vectors))
    return _thinned(np.concatenate(kept))


def _thinned(amplitudes: Float32s) -> Float32s:
    """Every n-th sample, so that training costs no more on a long segment; the largest is kept."""
    step = -(-len(amplitudes) // _TRAINING_SAMPLES)
    return amplitudes if step <= 1 else np.append(amplitudes[::step], amplitudes.max())
