"""Encoder of the coder `touch`: frames to the body of a segment, which is written only when it keeps its
promise.

Each frame is coded in closed loop by the ways that `frame_encoder` tries; every voxel of what a decoder
makes of it is compared with the original, and what is beyond the promise is sent apart. Then the finished
body is decoded as any receiver would, and compared once more. In the exact mode levels and a codebook are
searched for of which all forces are products.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from touchfield.arrays import Float32s, Float64s, Int64s
from touchfield.codec.kernels import end_of, writer
from touchfield.codec.paper.directions import Codebook, codebook_names
from touchfield.codec.segment import CodedSegment, FrameStats, Worst
from touchfield.codec.support import code_bricks, padded
from touchfield.codec.touch.body import (
    BodyReader,
    FrameRecord,
    exception_numbers,
    exceptions_of,
    shares_of,
    write_body,
    write_parameters,
)
from touchfield.codec.touch.decoder import NAME, TouchDecoder
from touchfield.codec.touch.frame import (
    AS_THEY_ARE,
    BRICK_COUNTS,
    Palette,
    Told,
    components,
    frame_of,
    models_after,
)
from touchfield.codec.touch.frame_encoder import Chooser, lattice_for
from touchfield.codec.touch.kernels import exact as kernels
from touchfield.codec.touch.lattice import MOST_NEWTONS, Lattice
from touchfield.codec.touch.promise import Compared, compared, hidden_of
from touchfield.codec.touch.spec import TouchSpec
from touchfield.errors import InvalidArgument
from touchfield.medium import ForceField, Grid

_STANDING = 0.02  # share of the mask by which a standing world may differ from its anchor


class TouchEncoder:
    """Codes segments of one stream; any number of threads may use it at once."""

    name = NAME

    def __init__(self, grid: Grid, spec: TouchSpec) -> None:
        self._grid, self._spec = grid, spec

    @property
    def parameters(self) -> bytes:
        """`HEAD.coder_parameters`: what was asked for."""
        return write_parameters(self._spec)

    def encode_segment(
        self, frames: Iterable[ForceField], anchor: ForceField | None = None, longest_n: float | None = None
    ) -> CodedSegment:
        """Code frames, at least one, as an independent segment.

        Where `longest_n` is given, which no force of any frame is longer than, frames are coded as they come.
        `anchor` is a field near the first frame, to be coded in its place: segments of a world that stands,
        which share one, begin with the same bytes, and so with the same forces. The promise is about the
        frames all the same. InvalidArgument if a force is NaN, infinite or beyond 2^120 N, or a frame has
        another grid.
        """
        came: list[ForceField] = []
        if longest_n is None or self._spec.mode == "lossless":
            came = list(frames)
            longest_n, frames = max(self._longest_n(i, frame) for i, frame in enumerate(came)), came
        if self._spec.mode == "lossless":
            runs = [[frame] for frame in came] if self._spec.interframe == "off" else [came]
            coded_runs = [(i > 0, *coded) for run in runs for i, coded in enumerate(encode_exact(run))]
            exact = [FrameRecord(inter, b"", payload, shares_of(bits)) for inter, payload, bits in coded_runs]
            return self._sealed(came, None, exact, None)
        if (
            anchor is not None
        ):  # its unit, if that will do: segments that share an anchor shall share the lattice
            mine = self._longest_n(0, anchor)
            longest_n = longest_n if longest_n > 1.01 * mine else mine
        lattice = lattice_for(self._spec, longest_n)
        chooser = Chooser(self._grid, self._spec, lattice)
        came, records, seen = [], [], []
        for i, frame in enumerate(frames):
            self._longest_n(i, frame)
            came.append(frame)
            hidden_n, taken = hidden_of(frame, self._spec), frame if i or anchor is None else anchor
            coded, inter, guess = chooser.add(
                taken, hidden_n if taken is frame else hidden_of(taken, self._spec)
            )
            field = coded.decoded.field(self._grid, lattice.unit_n)
            result = compared(frame, field, self._spec, hidden_n=hidden_n)
            apart = exceptions_of(frame, result.keys, result.places)
            records.append(FrameRecord(inter, guess, coded.payload, shares_of(coded.bits), apart))
            seen.append(result)
        is_known = self._spec.effort == "fast" and not any(len(result.keys) for result in seen)
        # a decoder makes what was compared, bit for bit
        return self._sealed(came, lattice, records, seen if is_known else None)

    def with_exact_samples(
        self, segment: CodedSegment, frames: Sequence[ForceField], samples: Sequence[Int64s]
    ) -> CodedSegment:
        """A segment in which some samples of each frame are exact, whatever else it lost there.

        `frames` are those that were coded. `samples`: numbers of each frame's, int64 [m], 512 times the key
        of the brick plus the sample within it. They are sent as the outliers of the frames, which predict
        nothing, so that all else decodes as before. InvalidArgument in mode "lossless", in which every sample
        is exact.
        """
        if self._spec.mode == "lossless":
            raise InvalidArgument("exact samples", "them in mode lossless", "a mode that loses something")
        reader = BodyReader(segment.body, self._grid, exact=False)
        records = []
        for record, frame, wanted in zip(reader.records(len(frames)), frames, samples, strict=True):
            numbers = np.union1d(exception_numbers(self._grid, record.exceptions), wanted).astype(np.int64)
            sent = exceptions_of(frame, numbers >> 9, numbers & 511)
            records.append(replace(record, exceptions=sent))
        return self._sealed(frames, reader.lattice, records, None)

    def anchor(self, frame: ForceField, before: ForceField | None) -> ForceField:
        """The anchor before, where no force differs by more than a small share of the mask, or else this
        frame.
        """
        if before is None or self._spec.mode not in ("mask", "mask-direction") or frame.grid != before.grid:
            return frame
        k, f0_n = max(_STANDING * self._spec.k, 0.001), _STANDING * self._spec.f0_n
        result = compared(frame, before, replace(self._spec, mode="mask", k=k, f0_n=f0_n, support="movable"))
        return frame if len(result.keys) else before

    def _longest_n(self, index: int, frame: ForceField) -> float:
        if frame.grid != self._grid:
            found = f"a grid of {frame.grid.shape}"
            raise InvalidArgument(f"frame {index}", found, f"that of the stream, {self._grid.shape}")
        vectors = frame.forces_n.reshape(-1, 3)
        longest_n = math.sqrt(np.einsum("ni,ni->n", vectors, vectors, dtype=np.float64).max(initial=0.0))
        if not longest_n <= MOST_NEWTONS:  # NaN is not, either
            raise InvalidArgument(
                f"frame {index}", f"a force of {longest_n:.3g} N", "finite newtons, 2^120 at most"
            )
        return longest_n

    def _sealed(
        self,
        frames: Sequence[ForceField],
        lattice: Lattice | None,
        records: Sequence[FrameRecord],
        results: Sequence[Compared] | None,
    ) -> CodedSegment:
        """The body whose decoded frames keep the promise, and the worst voxel; `results` if they are known."""
        if results is None:
            decoder = TouchDecoder(self._grid, self.parameters)
            pairs = zip(frames, decoder.frames(write_body(lattice, records, None), len(frames)), strict=True)
            results = [compared(*pair, self._spec, hidden_n=hidden_of(pair[0], self._spec)) for pair in pairs]
            if any(len(one.keys) for one in results):
                raise AssertionError("a body that does not keep the promise when it is decoded")
        frame = max(range(len(results)), key=lambda i: results[i].worst)
        worst = Worst(min(results[frame].worst, 1.0), frame, results[frame].voxel)
        costs = (record.cost for record in records)
        stats = (
            FrameStats(c.kind, c.bits, f.decoded, f.decoded) for c, f in zip(costs, results, strict=True)
        )
        known = None if self._spec.mode == "nmse" else worst
        return CodedSegment(write_body(lattice, records, known), tuple(stats), known)


_Shares = tuple[float, float, float]
_TRIED: Final = ("ico5", "octa3", "ico3", "ico1", "ico2", "ico4", "octa1", "octa2", "ico8", "ico10")
_MOST_LEVELS: Final = (1 << 16) - 1


def encode_exact(frames: Sequence[ForceField]) -> Iterator[tuple[bytes, _Shares]]:
    """Code frames to the bit, each after the one before.

    `frames`: at least one; all on one grid, and finite. A sample whose three components are all 0.0 holds no
    force; one of -0.0 does. Yields payloads, and the bits of support, amplitude and direction
    (of components that are told as they are, the first is the amplitude).
    """
    every, before = _products(frames), None
    for frame in frames:
        palette = every or (None if before else _products(frames[:1])) or AS_THEY_ARE
        payload, bits, before = _coded(frame, palette, before)
        yield payload, bits


def _coded(frame: ForceField, palette: Palette, before: Told | None) -> tuple[bytes, _Shares, Told]:
    kept = frame.forces_n.view(np.uint32).any(axis=(1, 2, 3, 4))
    field = ForceField(frame.grid, frame.bricks[kept], frame.forces_n[kept])
    symbols, models = components(field.forces_n), models_after(before)
    if palette.book:
        there = symbols[:, 0] >= 0
        symbols = np.where(there, _symbols(field.forces_n.reshape(-1, 3), palette).T, -1).T.copy()
    head = bytes([palette.book])
    if palette.book and before is None:
        head += len(palette.levels).to_bytes(2, "little") + palette.levels.astype("<f4").tobytes()
    work = frame_of(field.grid, field.bricks, palette, symbols, before)
    bits = writer(320 * len(field.bricks) + 64 * symbols.size + 64, models)
    code_bricks(bits, 0, 0, field.grid.brick_shape, field.bricks, before and before.field.bricks)
    kernels.code_samples(bits, work)
    payload = head + padded(end_of(bits), BRICK_COUNTS * len(field.bricks))
    amplitude, direction = 8 * len(head) + float(work.spent[1]), float(work.spent[2])
    shares = 8 * len(payload) - amplitude - direction, amplitude, direction
    return payload, shares, Told(field, palette, symbols, models)


def _products(frames: Sequence[ForceField]) -> Palette | None:
    """Levels and a codebook of which all forces are products, and more than there are levels; or None."""
    vectors = [frame.forces_n.reshape(-1, 3) for frame in frames]
    vectors = [v[v.view(np.uint32).any(axis=1)] for v in vectors]
    for name in _TRIED:
        codebook, intervals = Codebook.get(name), np.zeros((2, 0))
        for v in (vectors[0][:64], *vectors):
            bounds = _bounds(v, codebook)
            if not (bounds[0] <= bounds[1]).all() or not np.isfinite(bounds).all():
                break
            intervals = _distinct(np.concatenate([intervals, bounds], axis=1))
        else:
            levels = np.minimum(intervals.sum(axis=0) / 2, np.finfo(np.float32).max).astype(np.float32)
            palette = Palette(1 + codebook_names().index(name), levels)
            if 0 < len(levels) < min(sum(map(len, vectors)), _MOST_LEVELS) and all(
                np.array_equal(palette.forces(_symbols(v, palette)).view(np.uint32), v.view(np.uint32))
                for v in vectors
            ):
                return palette
    return None


def _symbols(vectors: Float32s, palette: Palette) -> Int64s:
    """The level and the vertex, int64 [n, 2], of vectors that the palette has."""
    levels = palette.levels.astype(np.float64)
    level = np.searchsorted(levels[1:] + levels[:-1], _bounds(vectors, palette.codebook).sum(axis=0))
    return np.stack([level, palette.codebook.nearest(vectors)], axis=1).astype(np.int64)


def _bounds(vectors: Float32s, codebook: Codebook) -> Float64s:
    """Between which levels the rounded products with the nearest vertices are vectors, float64 [2, n]."""
    vertices = codebook.vertices_float32[codebook.nearest(vectors)]
    v, d = np.abs(vectors.astype(np.float64)), np.abs(vertices.astype(np.float64))
    with np.errstate(all="ignore"):  # beside the largest float32, and where a vertex has a zero
        half = np.spacing(np.abs(vectors)).astype(np.float64) / 2
        low = np.where(d > 0, (v - half) / d, 0).max(axis=1)
        return np.stack([low, np.where(d > 0, (v + half) / d, np.inf).min(axis=1)])


def _distinct(bounds: Float64s) -> Float64s:
    """Float64s of levels, each once and ascending."""
    bounds = bounds[:, np.argsort(bounds.sum(axis=0))]
    middle = bounds.sum(axis=0)
    begins = np.flatnonzero(np.diff(middle, prepend=-1) > 2.0**-20 * middle)
    if not len(begins):
        return bounds
    return np.stack([np.maximum.reduceat(bounds[0], begins), np.minimum.reduceat(bounds[1], begins)])
