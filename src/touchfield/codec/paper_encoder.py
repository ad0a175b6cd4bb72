"""The encoder of the paper's coder: one segment of frames to one body of bytes (figure 4).

source model (voxel) -> perceptual filter (deadband) -> quantise amplitude and direction apart -> difference
between frames -> entropy code. The device filter came before. Codebooks are trained once in a segment, on its
first frame of each kind, and transmitted; the Huffman codes are made when all symbols of the segment are known.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from touchfield.codec.directions import Codebook
from touchfield.codec.paper_format import CodedFrame, FrameStats, SegmentTables, write_body
from touchfield.codec.paper_frames import DecodedFrame, FrameKind, FrameSymbols, amplitudes_n, rebuild
from touchfield.codec.quantisers import fit_amplitudes
from touchfield.codec.runs import pack_runs
from touchfield.codec.support import encode_support
from touchfield.measure.entropy import entropy_bits
from touchfield.perception.deadband import gate, gate_in_time

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.codec.paper_spec import PaperSpec
    from touchfield.codec.stage import Table
    from touchfield.medium import ForceField, Grid

__all__ = ["CodedSegment", "encode_segment"]


@dataclass(frozen=True)
class CodedSegment:
    """A coded segment, and what each of its frames cost."""

    body: bytes
    frames: tuple[FrameStats, ...]


@dataclass
class _Coder:
    """The encoder's state within a segment."""

    grid: Grid
    spec: PaperSpec
    codebook: Codebook
    intra: Table | None = None
    inter: Table | None = None
    original: ForceField | None = None
    decoded: DecodedFrame | None = None
    coded: list[CodedFrame] = field(default_factory=list)

    def add(self, frame: ForceField) -> None:
        """Code one frame, the cheaper way where there is a choice."""
        candidates = []
        if self.decoded is None or self.spec.choose_by_size or self.spec.interframe == "none":
            candidates.append(self._alone(frame))
        if self.decoded is not None and self.spec.interframe == "closed":
            candidates.append(self._closed_loop(frame))
        if self.decoded is not None and self.spec.interframe == "open":
            candidates.append(self._open_loop(frame))
        best = min(candidates, key=self._estimated_bits)
        table = self.intra if best.symbols.kind == FrameKind.INTRA else self.inter
        assert table is not None
        self.decoded = rebuild(self.grid, best.symbols, table, self.codebook, self.decoded)
        self.original = frame
        self.coded.append(best)

    def _support(self, frame: ForceField, predicted: bool) -> tuple[NDArray[np.bool_], bytes]:
        mask = frame.mask
        previous = (self.decoded.bricks, self.decoded.mask) if predicted and self.decoded is not None else None
        return mask, encode_support(self.grid, frame.bricks, mask, previous)

    def _alone(self, frame: ForceField) -> CodedFrame:
        vectors = frame.vectors_n()
        amplitudes = amplitudes_n(vectors)
        if self.intra is None:
            self.intra = self._trained(vectors, amplitudes)
        sent, levels, directions = self._gated(vectors, amplitudes, self.intra)
        mask, support = self._support(frame, predicted=False)
        symbols = FrameSymbols(FrameKind.INTRA, frame.bricks, mask, sent, levels[sent], directions[sent])
        return CodedFrame(symbols, support)

    def _open_loop(self, frame: ForceField) -> CodedFrame:
        assert self.original is not None
        difference = frame + self.original.scaled(-1)
        vectors = difference.vectors_n()
        amplitudes = amplitudes_n(vectors)
        if self.inter is None:
            self.inter = self._trained(vectors, amplitudes)
        sent, levels, directions = self._gated(vectors, amplitudes, self.inter)
        mask, support = self._support(difference, predicted=False)
        symbols = FrameSymbols(FrameKind.DIFFERENCE, difference.bricks, mask, sent, levels[sent], directions[sent])
        return CodedFrame(symbols, support)

    def _closed_loop(self, frame: ForceField) -> CodedFrame:
        assert self.decoded is not None
        slots = frame.raster_slots()
        vectors = frame.forces_n.reshape(-1, 3)[slots]
        reference = self.decoded.forces_at(self.grid, frame.bricks).reshape(-1, 3)[slots]
        if self.spec.deadband == "none":
            sent = np.ones(len(vectors), bool)
        else:
            sent = gate_in_time(vectors, reference, self.spec.k)
        difference = (vectors - reference)[sent]
        amplitudes = amplitudes_n(difference)
        if self.inter is None:
            self.inter = fit_amplitudes(self.spec, amplitudes)
        levels = self.inter.encode(amplitudes)
        directions = self.codebook.nearest(difference)
        mask, support = self._support(frame, predicted=True)
        symbols = FrameSymbols(FrameKind.INTER, frame.bricks, mask, sent, levels, directions)
        return CodedFrame(symbols, support)

    def _trained(self, vectors: NDArray[np.float32], amplitudes: NDArray[np.float32]) -> Table:
        """The amplitude codebook for what the deadband will send, as far as that is known beforehand."""
        if self.spec.deadband != "none" and len(vectors):
            amplitudes = amplitudes[gate(vectors, self.spec.k, self.spec.deadband, vectors)]
        return fit_amplitudes(self.spec, amplitudes)

    def _gated(
        self, vectors: NDArray[np.float32], amplitudes: NDArray[np.float32], table: Table
    ) -> tuple[NDArray[np.bool_], NDArray[np.uint16], NDArray[np.uint16]]:
        levels = table.encode(amplitudes)
        directions = self.codebook.nearest(vectors)
        if self.spec.deadband == "none":
            return np.ones(len(vectors), bool), levels, directions
        decoded = table.levels_n[levels][:, None] * self.codebook.vertices_float32[directions]
        return gate(vectors, self.spec.k, self.spec.deadband, decoded), levels, directions

    def _estimated_bits(self, frame: CodedFrame) -> float:
        table = self.intra if frame.symbols.kind == FrameKind.INTRA else self.inter
        assert table is not None
        symbols, _, extra_bits = self.packed(frame, table)
        amplitude = entropy_bits(np.bincount(symbols)) * len(symbols) + int(extra_bits.sum())
        direction = entropy_bits(np.bincount(frame.symbols.directions)) * len(frame.symbols.directions)
        return amplitude + direction + 8 * len(frame.support)

    def packed(
        self, frame: CodedFrame, table: Table
    ) -> tuple[NDArray[np.uint16], NDArray[np.uint32], NDArray[np.uint8]]:
        """The amplitude stream of a frame: levels, and runs of held samples."""
        return pack_runs(
            frame.symbols.sent, frame.symbols.levels, len(table.levels_n), single=not self.spec.hold_runs
        )


def encode_segment(grid: Grid, frames: Iterable[ForceField], spec: PaperSpec) -> CodedSegment:
    """Code frames, at least one, as an independent segment."""
    coder = _Coder(grid, spec, Codebook.get(spec.directions))
    for frame in frames:
        coder.add(frame)
    tables = SegmentTables(coder.intra, coder.inter)
    body, stats = write_body(coder.codebook, tables, coder.coded, single_holds=not spec.hold_runs)
    return CodedSegment(body, stats)
