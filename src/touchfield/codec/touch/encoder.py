"""Encoder of the coder `touch`: frames to a segment within the error bound.

Each frame is coded in closed loop in the modes that `frame_encoder` tries. Every decoded voxel is compared
with the original, and those outside the bound are sent as outliers. Then the finished body is decoded as a
receiver would, and compared again (effort "fast" skips this if there are no outliers). The exact mode
searches for amplitude levels and a direction codebook whose products are all forces.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from touchfield.arrays import Float32s, Float64s, Int64s
from touchfield.codec.kernels import finish, writer
from touchfield.codec.paper.directions import Codebook, codebook_names
from touchfield.codec.segment import CodedSegment, FrameStats, MaxError
from touchfield.codec.support import code_bricks, pad_payload
from touchfield.codec.touch.body import (
    BodyReader,
    FrameRecord,
    bit_fractions,
    encode_outliers,
    outlier_numbers,
    write_body,
    write_parameters,
)
from touchfield.codec.touch.decoder import NAME, TouchDecoder
from touchfield.codec.touch.error_bound import Comparison, compare_frames, masked_error_n
from touchfield.codec.touch.frame import (
    BRICK_WEIGHT,
    COMPONENTS,
    DecodedFrame,
    Palette,
    components,
    exact_frame,
    models_after,
)
from touchfield.codec.touch.frame_encoder import ModeDecision, lattice_for
from touchfield.codec.touch.kernels import exact as kernels
from touchfield.codec.touch.lattice import MAX_NEWTONS, Lattice
from touchfield.codec.touch.spec import TouchSpec
from touchfield.errors import InvalidArgument
from touchfield.medium import ForceField, Grid

_KEY_FRAME_MARGIN = 0.02  # fraction of the mask by which a static scene may differ from its key frame


class TouchEncoder:
    """Encoder of the segments of one stream; thread-safe."""

    name = NAME

    def __init__(self, grid: Grid, spec: TouchSpec) -> None:
        self._grid, self._spec = grid, spec

    @property
    def parameters(self) -> bytes:
        """`HEAD.coder_parameters` for the spec."""
        return write_parameters(self._spec)

    def encode_segment(
        self,
        frames: Iterable[ForceField],
        key_frame: ForceField | None = None,
        longest_n: float | None = None,
    ) -> CodedSegment:
        """Code frames, at least one, as an independent segment.

        `longest_n` is an upper limit of the length of all forces; if it is given, frames are coded as they
        arrive. `key_frame` is a field close to the first frame, coded in its place: segments of a static
        scene that share one start with the same bytes, and so with the same forces. The error bound
        nevertheless applies to the original frames. InvalidArgument if a force is NaN, infinite or above
        2^120 N, or a frame has another grid.
        """
        originals: list[ForceField] = []
        if longest_n is None or self._spec.mode == "lossless":
            originals = list(frames)
            longest_n, frames = max(self._longest_n(i, frame) for i, frame in enumerate(originals)), originals
        if self._spec.mode == "lossless":
            runs = [[frame] for frame in originals] if self._spec.interframe == "off" else [originals]
            coded_runs = [(i > 0, *coded) for run in runs for i, coded in enumerate(encode_exact(run))]
            exact = [
                FrameRecord(inter, b"", payload, bit_fractions(bits)) for inter, payload, bits in coded_runs
            ]
            return self._finish(originals, None, exact, None)
        # keep its unit if possible, so that segments with one key frame share a lattice
        if key_frame is not None:
            key_longest_n = self._longest_n(0, key_frame)
            longest_n = longest_n if longest_n > 1.01 * key_longest_n else key_longest_n
        lattice = lattice_for(self._spec, longest_n)
        decision = ModeDecision(self._grid, self._spec, lattice)
        originals, records, results = [], [], []
        for i, frame in enumerate(frames):
            self._longest_n(i, frame)
            originals.append(frame)
            hidden_n = key_hidden_n = masked_error_n(frame, self._spec)
            coded_field = frame
            if i == 0 and key_frame is not None and key_frame is not frame:
                coded_field, key_hidden_n = key_frame, masked_error_n(key_frame, self._spec)
            coded, inter, base_layer = decision.encode(coded_field, key_hidden_n)
            field = coded.decoded.field(self._grid, lattice.unit_n)
            result = compare_frames(frame, field, self._spec, hidden_n=hidden_n)
            outliers = encode_outliers(frame, result.keys, result.samples)
            records.append(FrameRecord(inter, base_layer, coded.payload, bit_fractions(coded.bits), outliers))
            results.append(result)
        is_known = self._spec.effort == "fast" and not any(len(result.keys) for result in results)
        # a decoder would produce the compared fields bit for bit, so they need not be decoded again
        return self._finish(originals, lattice, records, results if is_known else None)

    def with_exact_samples(
        self, segment: CodedSegment, frames: Sequence[ForceField], samples: Sequence[Int64s]
    ) -> CodedSegment:
        """The segment, with the given samples of each frame made exact.

        `frames` are those that were coded. `samples`: int64 [m] for each frame; a sample is numbered 512
        times the key of its brick plus its index within the brick. These samples are sent as outliers, from
        which nothing is predicted, so that everything else decodes as before. InvalidArgument in mode
        "lossless", in which every sample is exact.
        """
        if self._spec.mode == "lossless":
            raise InvalidArgument("exact samples", "them in mode lossless", "a mode that loses something")
        reader = BodyReader(segment.body, self._grid, exact=False)
        records = []
        for record, frame, exact in zip(reader.records(len(frames)), frames, samples, strict=True):
            numbers = np.union1d(outlier_numbers(self._grid, record.outliers), exact).astype(np.int64)
            outliers = encode_outliers(frame, numbers >> 9, numbers & 511)
            records.append(replace(record, outliers=outliers))
        return self._finish(frames, reader.lattice, records, None)

    def key_frame(self, frame: ForceField, previous: ForceField | None) -> ForceField:
        """`previous` if every force of `frame` is close to it, else `frame`.

        "Close" is a small fraction of the mask.
        """
        if (
            previous is None
            or self._spec.mode not in ("mask", "mask-direction")
            or frame.grid != previous.grid
        ):
            return frame
        k, f0_n = max(_KEY_FRAME_MARGIN * self._spec.k, 0.001), _KEY_FRAME_MARGIN * self._spec.f0_n
        strict = replace(self._spec, mode="mask", k=k, f0_n=f0_n, support="movable")
        result = compare_frames(frame, previous, strict)
        return frame if len(result.keys) else previous

    def _longest_n(self, index: int, frame: ForceField) -> float:
        if frame.grid != self._grid:
            found = f"a grid of {frame.grid.shape}"
            raise InvalidArgument(f"frame {index}", found, f"that of the stream, {self._grid.shape}")
        vectors = frame.forces_n.reshape(-1, 3)
        longest_n = math.sqrt(np.einsum("ni,ni->n", vectors, vectors, dtype=np.float64).max(initial=0.0))
        if not longest_n <= MAX_NEWTONS:  # also true for NaN
            raise InvalidArgument(
                f"frame {index}", f"a force of {longest_n:.3g} N", "finite newtons, 2^120 at most"
            )
        return longest_n

    def _finish(
        self,
        frames: Sequence[ForceField],
        lattice: Lattice | None,
        records: Sequence[FrameRecord],
        results: Sequence[Comparison] | None,
    ) -> CodedSegment:
        """The finished segment.

        It is decoded and checked, unless `results`, the comparisons of its frames, are given.
        """
        if results is None:
            decoder = TouchDecoder(self._grid, self.parameters)
            pairs = zip(frames, decoder.frames(write_body(lattice, records, None), len(frames)), strict=True)
            results = [
                compare_frames(frame, decoded, self._spec, hidden_n=masked_error_n(frame, self._spec))
                for frame, decoded in pairs
            ]
            if any(len(result.keys) for result in results):
                raise AssertionError("the decoded body violates the error bound")
        frame = max(range(len(results)), key=lambda i: results[i].max_error_ratio)
        max_error = MaxError(min(results[frame].max_error_ratio, 1.0), frame, results[frame].voxel)
        costs = (record.cost for record in records)
        stats = (
            FrameStats(c.kind, c.bits, f.decoded, f.decoded) for c, f in zip(costs, results, strict=True)
        )
        stated = None if self._spec.mode == "nmse" else max_error
        return CodedSegment(write_body(lattice, records, stated), tuple(stats), stated)


_BitCounts = tuple[float, float, float]
_CODEBOOKS: Final = ("ico5", "octa3", "ico3", "ico1", "ico2", "ico4", "octa1", "octa2", "ico8", "ico10")
_MAX_LEVELS: Final = (1 << 16) - 1


def encode_exact(frames: Sequence[ForceField]) -> Iterator[tuple[bytes, _BitCounts]]:
    """Code frames losslessly, each predicted from the one before.

    `frames`: at least one; all on one grid, and finite. A sample whose three components are all 0.0 has no
    force; one with a -0.0 has. Yields for each frame the payload, and the bits of support, amplitude and
    direction (if components are coded, the first counts as the amplitude).
    """
    common, previous = _find_palette(frames), None
    for frame in frames:
        palette = common or (None if previous else _find_palette(frames[:1])) or COMPONENTS
        payload, bits, previous = _encode_exact_frame(frame, palette, previous)
        yield payload, bits


def _encode_exact_frame(
    frame: ForceField, palette: Palette, previous: DecodedFrame | None
) -> tuple[bytes, _BitCounts, DecodedFrame]:
    has_force = frame.forces_n.view(np.uint32).any(axis=(1, 2, 3, 4))
    field = ForceField(frame.grid, frame.bricks[has_force], frame.forces_n[has_force])
    symbols, models = components(field.forces_n), models_after(previous)
    if palette.book:
        supported = symbols[:, 0] >= 0
        symbols = np.where(supported, _symbols(field.forces_n.reshape(-1, 3), palette).T, -1).T.copy()
    head = bytes([palette.book])
    if palette.book and previous is None:
        head += len(palette.levels).to_bytes(2, "little") + palette.levels.astype("<f4").tobytes()
    work = exact_frame(field.grid, field.bricks, palette, symbols, previous)
    bits = writer(320 * len(field.bricks) + 64 * symbols.size + 64, models)
    code_bricks(bits, 0, 0, field.grid.brick_shape, field.bricks, previous and previous.field.bricks)
    kernels.code_samples(bits, work)
    payload = head + pad_payload(finish(bits), BRICK_WEIGHT * len(field.bricks))
    amplitude, direction = 8 * len(head) + float(work.spent[1]), float(work.spent[2])
    counts = 8 * len(payload) - amplitude - direction, amplitude, direction
    return payload, counts, DecodedFrame(field, palette, symbols, models)


def _find_palette(frames: Sequence[ForceField]) -> Palette | None:
    """Find levels and a codebook whose products are all forces.

    None if no codebook fits, there is no force, or there are too many levels.
    """
    vectors = [frame.forces_n.reshape(-1, 3) for frame in frames]
    vectors = [v[v.view(np.uint32).any(axis=1)] for v in vectors]
    for name in _CODEBOOKS:
        codebook, intervals = Codebook.get(name), np.zeros((2, 0))
        for v in (vectors[0][:64], *vectors):
            bounds = _bounds(v, codebook)
            if not (bounds[0] <= bounds[1]).all() or not np.isfinite(bounds).all():
                break
            intervals = _merge_bounds(np.concatenate([intervals, bounds], axis=1))
        else:
            levels = np.minimum(intervals.sum(axis=0) / 2, np.finfo(np.float32).max).astype(np.float32)
            palette = Palette(1 + codebook_names().index(name), levels)
            if 0 < len(levels) < min(sum(map(len, vectors)), _MAX_LEVELS) and all(
                np.array_equal(palette.forces(_symbols(v, palette)).view(np.uint32), v.view(np.uint32))
                for v in vectors
            ):
                return palette
    return None


def _symbols(vectors: Float32s, palette: Palette) -> Int64s:
    """Level and vertex, int64 [n, 2], of vectors that the palette can represent."""
    levels = palette.levels.astype(np.float64)
    level = np.searchsorted(levels[1:] + levels[:-1], _bounds(vectors, palette.codebook).sum(axis=0))
    return np.stack([level, palette.codebook.nearest(vectors)], axis=1).astype(np.int64)


def _bounds(vectors: Float32s, codebook: Codebook) -> Float64s:
    """Range of levels that give each vector, float64 [2, n].

    The product of such a level with the nearest vertex rounds to the vector.
    """
    vertices = codebook.vertices_float32[codebook.nearest(vectors)]
    v, d = np.abs(vectors.astype(np.float64)), np.abs(vertices.astype(np.float64))
    with np.errstate(all="ignore"):  # overflow at the largest float32, and division by zero components
        half = np.spacing(np.abs(vectors)).astype(np.float64) / 2
        low = np.where(d > 0, (v - half) / d, 0).max(axis=1)
        return np.stack([low, np.where(d > 0, (v + half) / d, np.inf).min(axis=1)])


def _merge_bounds(bounds: Float64s) -> Float64s:
    """Ranges of distinct levels, ascending: overlapping ranges are intersected."""
    bounds = bounds[:, np.argsort(bounds.sum(axis=0))]
    middle = bounds.sum(axis=0)
    starts = np.flatnonzero(np.diff(middle, prepend=-1) > 2.0**-20 * middle)
    if not len(starts):
        return bounds
    return np.stack([np.maximum.reduceat(bounds[0], starts), np.minimum.reduceat(bounds[1], starts)])
