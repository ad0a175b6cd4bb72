"""Which palettes a field has: the encoder's part of the lossless model."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from touchfield.codec.paper.directions import Codebook
from touchfield.codec.touch.palette import (
    MOST_PRODUCTS,
    MOST_VALUES,
    MOST_VECTORS,
    Components,
    Octets,
    Palette,
    Products,
    Vectors,
)
from touchfield.codec.touch.palette_values import in_order

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Bits = NDArray[np.uint32]

__all__ = ["fitting_palettes"]

_CODEBOOKS = ("ico5", "octa3", "ico3", "ico1", "ico2", "ico4", "octa1", "octa2", "ico8", "ico10")
_TRIED = 64
_SAME_DIRECTION = 1e-12  # sine squared; rounding of products leaves less
_SAME_LEVEL = 2.0**-20
_LARGEST = float(np.finfo(np.float32).max)


def fitting_palettes(bits: Bits) -> list[Palette]:
    """Palettes that hold all vectors, float32 bits [n, 3]; the first are likely to be the best.

    Octets are offered where nothing else is likely to be smaller.
    """
    values = in_order(bits)
    if len(values) > MOST_VALUES:
        return [Octets()]
    components = Components(values)
    ranks = components.encode(bits).astype(np.int64)
    keys = np.unique(ranks @ np.array([1 << 40, 1 << 20, 1]))
    distinct = np.stack([keys >> 40, keys >> 20 & (1 << 20) - 1, keys & (1 << 20) - 1], axis=1).astype(np.int32)
    if len(distinct) <= MOST_VECTORS:
        products = _products(values[distinct])
        if products is not None:
            return [products]
    found: list[Palette] = []
    if len(distinct) <= min(MOST_VECTORS, len(bits) // 2):
        found.append(Vectors(values, distinct))
    if 2 * len(values) <= 3 * len(bits) or not found:
        found.append(components)
    if 4 * len(values) > 3 * len(bits):
        found.append(Octets())
    return found


def _products(distinct: Bits) -> Products | None:
    """Levels and codebook of which all vectors are products, or None."""
    vectors = distinct.view(np.float32)
    some = vectors[vectors.any(axis=1)]
    some = some[:: max(1, len(some) // _TRIED)]
    if not len(some):
        return None
    for name in _CODEBOOKS:
        codebook = Codebook.get(name)
        if _along(some, codebook.vertices_float32[codebook.nearest(some)]):
            levels = _levels(vectors, codebook)
            if levels is not None and len(levels) * len(codebook) <= MOST_PRODUCTS:
                products = Products(levels, name)
                if (products.encode(distinct) >= 0).all():
                    return products
    return None


def _along(vectors: NDArray[np.float32], directions: NDArray[np.float32]) -> bool:
    v, d = vectors.astype(np.float64), directions.astype(np.float64)
    across = (np.cross(v, d) ** 2).sum(axis=1)
    return bool((across <= _SAME_DIRECTION * (v * v).sum(axis=1)).all())


def _levels(vectors: NDArray[np.float32], codebook: Codebook) -> Bits | None:
    """The levels that rounded products allow: each vector's components bound its level on both sides."""
    held = vectors[vectors.any(axis=1)]
    directions = codebook.vertices_float32[codebook.nearest(held)]
    if not _along(held, directions):
        return None
    v, d = np.abs(held.astype(np.float64)), np.abs(directions.astype(np.float64))
    with np.errstate(all="ignore"):  # beside the largest float32, and where a vertex has a zero
        half = np.spacing(np.abs(held)).astype(np.float64) / 2
        low = np.where(d > 0, (v - half) / d, 0).max(axis=1)
        high = np.where(d > 0, (v + half) / d, np.inf).min(axis=1)
    if not np.isfinite(high).all():
        return None
    order = np.argsort(low + high)
    low, high = low[order], high[order]
    middle = (low + high) / 2
    begins = np.flatnonzero(np.diff(middle, prepend=0) > _SAME_LEVEL * middle)
    low, high = np.maximum.reduceat(low, begins), np.minimum.reduceat(high, begins)
    levels = np.minimum((low + high) / 2, _LARGEST).astype(np.float32)
    if len(held) < len(vectors):
        levels = np.append(levels, np.float32(0))
    bits: Bits = np.unique(levels.view(np.uint32))
    return bits
