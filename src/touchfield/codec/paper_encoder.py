"""The encoder of the paper's coder: one segment of frames to one body of bytes (figure 4).

source model (voxel) -> perceptual filter (deadband) -> quantise amplitude and direction apart -> difference
between frames -> entropy code. The device filter came before. Codebooks are trained on the whole segment and
transmitted; the Huffman codes are made when all its symbols are known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from touchfield.codec.directions import Codebook
from touchfield.codec.paper_format import CodedFrame, SegmentTables, write_body
from touchfield.codec.paper_frames import (
    DecodedFrame,
    FrameSymbols,
    Scan,
    Synthesis,
    amplitudes_n,
    scan_slots,
    scanned_n,
)
from touchfield.codec.runs import pack_runs
from touchfield.codec.segment import CodedSegment, FrameKind
from touchfield.codec.stage import amplitude_quantisers
from touchfield.codec.support import encode_support
from touchfield.measure.plug_in import entropy_bits
from touchfield.medium.field import brick_keys
from touchfield.perception.deadband import gate, gate_in_time

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.codec.paper_spec import PaperSpec
    from touchfield.codec.stage import Table
    from touchfield.medium import ForceField, Grid

__all__ = ["encode_segment"]

_LEAST_FORCE_N = 1e-6
_TRAINING_SAMPLES = 1 << 18


@dataclass
class _Coder:
    """The encoder's state within a segment."""

    synthesis: Synthesis
    spec: PaperSpec
    segment: Sequence[ForceField]
    intra: Table
    inter: Table | None = None
    original: ForceField | None = None
    decoded: DecodedFrame | None = None
    coded: list[CodedFrame] = field(default_factory=list)
    alone: list[CodedFrame] = field(default_factory=list)

    def add(self, frame: ForceField) -> None:
        """Code one frame, the cheaper way where there is a choice."""
        candidates = []
        if self.decoded is None or self.spec.choose_by_size or self.spec.interframe == "none":
            candidates.append(self._alone(frame))
            self.alone.append(candidates[0])
        if self.decoded is not None and self.spec.interframe == "closed":
            candidates.append(self._closed_loop(frame))
        if self.decoded is not None and self.spec.interframe == "open":
            candidates.append(self._open_loop(frame))
        best = min(candidates, key=self._estimated_bits) if len(candidates) > 1 else candidates[0]
        self.decoded = self.synthesis.rebuild(best.symbols, self._table(best), self.decoded)
        self.original = frame
        self.coded.append(best)

    def _alone(self, frame: ForceField) -> CodedFrame:
        return self._scanned(FrameKind.INTRA, frame, self.intra)

    def _open_loop(self, frame: ForceField) -> CodedFrame:
        assert self.original is not None
        if self.inter is None:
            self.inter = _fitted(self.spec, _changes_n(self.spec, self.segment))
        return self._scanned(FrameKind.DIFFERENCE, frame + self.original.scaled(-1), self.inter)

    def _scanned(self, kind: FrameKind, field: ForceField, table: Table) -> CodedFrame:
        """A field, or a field of differences, coded with nothing but its own scan to predict it."""
        vectors = scanned_n(field, self.synthesis.scan)
        levels = table.encode(amplitudes_n(vectors))
        directions = self.synthesis.codebook.nearest(vectors)
        sent = np.ones(len(vectors), bool)
        if self.spec.deadband != "none":
            decoded = table.levels_n[levels][:, None] * self.synthesis.codebook.vertices_float32[directions]
            sent = gate(vectors, self.spec.k, self.spec.deadband, decoded)
        support = encode_support(self.synthesis.grid, field.bricks, field.mask)
        symbols = FrameSymbols(kind, field.bricks, field.mask, sent, levels[sent], directions[sent])
        return CodedFrame(symbols, support)

    def _closed_loop(self, frame: ForceField) -> CodedFrame:
        assert self.decoded is not None
        slots = scan_slots(frame.bricks, frame.mask, self.synthesis.scan)
        vectors = frame.forces_n.reshape(-1, 3)[slots]
        reference = self.decoded.forces_at(self.synthesis.grid, frame.bricks).reshape(-1, 3)[slots]
        if self.spec.deadband == "none":
            sent = np.ones(len(vectors), bool)
        else:
            sent = gate_in_time(vectors, reference, self.spec.k)
        difference = (vectors - reference)[sent]
        amplitudes = amplitudes_n(difference)
        if self.inter is None:
            # what this frame sends corrects the quantiser too; what later ones send is known from the originals
            later = _changes_n(self.spec, self.segment[1:])
            self.inter = _fitted(self.spec, np.concatenate([amplitudes, later]))
        levels = self.inter.encode(amplitudes)
        directions = self.synthesis.codebook.nearest(difference)
        before = (self.decoded.bricks, self.decoded.mask)
        support = encode_support(self.synthesis.grid, frame.bricks, frame.mask, before)
        symbols = FrameSymbols(FrameKind.INTER, frame.bricks, frame.mask, sent, levels, directions)
        return CodedFrame(symbols, support)

    def _table(self, frame: CodedFrame) -> Table:
        table = self.intra if frame.symbols.kind == FrameKind.INTRA else self.inter
        assert table is not None
        return table

    def _estimated_bits(self, frame: CodedFrame) -> float:
        levels = len(self._table(frame).levels_n)
        symbols, _, extra_bits = pack_runs(
            frame.symbols.sent, frame.symbols.levels, levels, single=not self.spec.hold_runs
        )
        amplitude = entropy_bits(np.bincount(symbols)) * len(symbols) + int(extra_bits.sum())
        direction = entropy_bits(np.bincount(frame.symbols.directions)) * len(frame.symbols.directions)
        return amplitude + direction + 8 * len(frame.support)


def _fitted(spec: PaperSpec, amplitudes_n: NDArray[np.float32]) -> Table:
    """The amplitude quantiser that was asked for, trained on what will be sent."""
    top_n = float(amplitudes_n.max(initial=0.0))
    asked: dict[str, dict[str, float]] = {
        "lloyd-max": {"nq": spec.nq},
        "weber": {"k": spec.k, **_full_ladder(spec, top_n)},
        "uniform": {"step_n": max(top_n, _LEAST_FORCE_N) / (2**spec.nq - 1)},
    }
    return amplitude_quantisers()[spec.amplitude](**asked[spec.amplitude]).fit(amplitudes_n)


def _full_ladder(spec: PaperSpec, top_n: float) -> dict[str, float]:
    """What is asked of a Weber ladder beside k, where it is to take all levels of n_q.

    Which samples are sent is foreseen from the originals; one that was not may be larger by k than all that were.
    """
    if spec.weber_steps is None:
        return {}
    return {"steps": spec.weber_steps, "force_max_n": max(top_n, _LEAST_FORCE_N) * (1 + spec.k)}


def _sent_alone_n(spec: PaperSpec, frame: ForceField, scan: Scan) -> NDArray[np.float32]:
    """The vectors that the deadband lets through in a frame coded alone, as far as that is known beforehand."""
    vectors = scanned_n(frame, scan)
    if spec.deadband == "none" or not len(vectors):
        return vectors
    return vectors[gate(vectors, spec.k, spec.deadband, vectors)]


def _chosen_scan(spec: PaperSpec, segment: Sequence[ForceField]) -> Scan:
    if spec.scan != "auto":
        return Scan.X_FASTEST if spec.scan == "x" else Scan.Z_FASTEST
    first = next((f for f in segment if len(f.bricks)), segment[0])
    return min(Scan, key=lambda scan: len(_sent_alone_n(spec, first, scan)))


def _changes_n(spec: PaperSpec, segment: Sequence[ForceField]) -> NDArray[np.float32]:
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


def _thinned(amplitudes: NDArray[np.float32]) -> NDArray[np.float32]:
    """Every n-th sample, so that training costs no more on a long segment; the largest is kept."""
    step = -(-len(amplitudes) // _TRAINING_SAMPLES)
    return amplitudes if step <= 1 else np.append(amplitudes[::step], amplitudes.max())


def encode_segment(grid: Grid, frames: Sequence[ForceField], spec: PaperSpec) -> CodedSegment:
    """Code frames, at least one, as an independent segment."""
    synthesis = Synthesis(grid, Codebook.get(spec.directions), _chosen_scan(spec, frames))
    trained_on = frames[:1] if spec.interframe == "open" else frames
    sent = [amplitudes_n(_sent_alone_n(spec, f, synthesis.scan)) for f in trained_on]
    intra = _fitted(spec, _thinned(np.concatenate(sent)))
    coders = [_coded(_Coder(synthesis, spec, frames, intra))]
    if spec.choose_by_size and any(f.symbols.kind == FrameKind.INTRA for f in coders[0].coded[1:]):
        # taken frame by frame, a first costly difference hides the cheap ones that would follow it
        coders.append(_coded(_Coder(synthesis, replace(spec, choose_by_size=False), frames, intra)))
    ways = [(SegmentTables(c.intra, c.inter), c.coded) for c in coders]
    if spec.choose_by_size and any(f.symbols.kind != FrameKind.INTRA for f in coders[0].coded):
        ways.append((SegmentTables(intra, None), coders[0].alone))
    bodies = [write_body(synthesis, tables, coded, single_holds=not spec.hold_runs) for tables, coded in ways]
    return CodedSegment(*min(bodies, key=lambda made: len(made[0])))


def _coded(coder: _Coder) -> _Coder:
    for frame in coder.segment:
        coder.add(frame)
    return coder
