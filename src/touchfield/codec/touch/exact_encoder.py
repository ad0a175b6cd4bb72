"""The encoder of the exact mode, and its search for levels and a codebook."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from touchfield.arrays import Float32s, Float64s, Int64s
from touchfield.codec.kernels.bits import end_of, writer
from touchfield.codec.paper.directions import Codebook, codebook_names
from touchfield.codec.support import code_bricks, padded
from touchfield.codec.touch.exact import AS_THEY_ARE, BRICK_COUNTS, Palette, Told, components, frame_of, models_after
from touchfield.codec.touch.kernels import exact as kernels
from touchfield.medium import ForceField

Shares = tuple[float, float, float]
Bounds = Float64s

_TRIED: Final = ("ico5", "octa3", "ico3", "ico1", "ico2", "ico4", "octa1", "octa2", "ico8", "ico10")
_MOST_LEVELS: Final = (1 << 16) - 1


def encode_exact(frames: Sequence[ForceField]) -> Iterator[tuple[bytes, Shares]]:
    """Code frames to the bit, each after the one before.

    `frames`: at least one; all on one grid, and finite. A sample whose three components are all 0.0 holds no force;
    one of -0.0 does. Yields payloads, and the bits of support, amplitude and direction
    (of components that are told as they are, the first is the amplitude).
    """
    palette = _products(frames)
    later = palette or AS_THEY_ARE
    before: Told | None = None
    for frame in frames:
        if before is None and palette is None:
            palette = _products(frames[:1])
        payload, bits, before = _coded(frame, later if before else palette or later, before)
        yield payload, bits


def _coded(frame: ForceField, palette: Palette, before: Told | None) -> tuple[bytes, Shares, Told]:
    kept = frame.forces_n.view(np.uint32).any(axis=(1, 2, 3, 4))
    field = ForceField(frame.grid, frame.bricks[kept], frame.forces_n[kept])
    symbols, models = components(field.forces_n), models_after(before)
    if palette.book:
        held = symbols[:, 0] >= 0
        symbols = np.where(held, _symbols(field.forces_n.reshape(-1, 3), palette).T, -1).T.copy()
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
        codebook, found = Codebook.get(name), np.zeros((2, 0))
        for v in (vectors[0][:64], *vectors):
            bounds = _bounds(v, codebook)
            if not (bounds[0] <= bounds[1]).all() or not np.isfinite(bounds).all():
                break
            found = _distinct(np.concatenate([found, bounds], axis=1))
        else:
            levels = np.minimum(found.sum(axis=0) / 2, np.finfo(np.float32).max).astype(np.float32)
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


def _bounds(vectors: Float32s, codebook: Codebook) -> Bounds:
    """Between which levels the rounded products with the nearest vertices are vectors, float64 [2, n]."""
    vertices = codebook.vertices_float32[codebook.nearest(vectors)]
    v, d = np.abs(vectors.astype(np.float64)), np.abs(vertices.astype(np.float64))
    with np.errstate(all="ignore"):  # beside the largest float32, and where a vertex has a zero
        half = np.spacing(np.abs(vectors)).astype(np.float64) / 2
        low = np.where(d > 0, (v - half) / d, 0).max(axis=1)
        return np.stack([low, np.where(d > 0, (v + half) / d, np.inf).min(axis=1)])


def _distinct(bounds: Bounds) -> Bounds:
    """Bounds of levels, each once and ascending."""
    bounds = bounds[:, np.argsort(bounds.sum(axis=0))]
    middle = bounds.sum(axis=0)
    begins = np.flatnonzero(np.diff(middle, prepend=-1) > 2.0**-20 * middle)
    if not len(begins):
        return bounds
    return np.stack([np.maximum.reduceat(bounds[0], begins), np.minimum.reduceat(bounds[1], begins)])
