"""The encoder of the exact mode, and its search for a palette."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.codec import brick_list
from touchfield.codec.kernels.bits import end_of, fresh, price, writer
from touchfield.codec.paper.directions import Codebook
from touchfield.codec.touch import exact
from touchfield.codec.touch.exact import Palette
from touchfield.codec.touch.kernels import exact as kernels
from touchfield.errors import InvalidArgument

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.codec.touch.exact import Words
    from touchfield.medium import ForceField

    Shares = tuple[float, float, float]
    Found = tuple[Palette, int]  # and its codebook, as `exact.code_palette` wants it
    Floats = NDArray[np.float32]

__all__ = ["encode_exact"]

_TRIED: Final = ("ico5", "octa3", "ico3", "ico1", "ico2", "ico4", "octa1", "octa2", "ico8", "ico10")


def encode_exact(frame: ForceField, previous: ForceField | None) -> tuple[bytes, Shares]:
    """Code a field to the bit.

    Parameters
    ----------
    frame : ForceField
        A sample whose three components are all 0.0 holds no force; one of -0.0 does.
    previous : ForceField or None
        The frame before, on the same grid, which the decoder is given as well.

    Returns
    -------
    payload : bytes
    bits : (float, float, float)
        Of support, amplitude and direction; where components are told, a third of theirs is amplitude.

    Raises
    ------
    InvalidArgument
        If a force is not finite, or the grids are two.
    """
    if not np.isfinite(frame.forces_n).all():
        raise InvalidArgument("forces_n", "a force that is not finite", "finite newtons")
    if previous is not None and previous.grid != frame.grid:
        raise InvalidArgument("the frame before", "another grid", "the grid of the frame")
    every = frame.forces_n.view(np.uint32)
    words = every[every.any(axis=(1, 2, 3, 4))].reshape(-1, 3)
    found = _palettes(words[words.any(axis=1)])
    return min((_coded(frame, previous, words, *p) for p in found), key=lambda coded: len(coded[0]))


def _coded(
    frame: ForceField, previous: ForceField | None, words: Words, palette: Palette, codebook: int
) -> tuple[bytes, Shares]:
    bricks, held, planes = exact.held_bricks(frame), np.asarray(words.any(axis=1)), len(palette.sizes)
    count, values = int(held.sum()), np.zeros(0, np.int64) if palette.values is None else palette.values
    log = min((4096 + 8 * count * planes).bit_length(), exact.LARGEST_TABLE)
    room = 3 * len(words) + (8 + 64 * planes) * count + 16 * len(values) + 64
    bits = writer(room, fresh(exact.CONTEXTS + (1 << log), exact.SETS))
    bricks = brick_list.code_bricks(bits, 0, 0, frame.grid.brick_shape, bricks, exact.held_bricks(previous))
    palette_bits, spent = 0.0, np.zeros(3)
    if count:
        palette_bits = -price(bits)
        exact.code_palette(bits, values, codebook, 3 * len(words))
        palette_bits += price(bits)
        symbols = palette.symbols(words[held])
        work = exact.frame_of(frame.grid, bricks, palette, symbols, held.astype(np.uint8), previous)
        kernels.code_frame(bits, exact.FRAME_AT, brick_list.SETS, (1 << log) - 1, work)
        spent = work.spent
    payload = bytes([log]) + brick_list.padded(end_of(bits), len(bricks))
    forces = palette_bits + float(spent.sum())
    direction = forces * 2 / 3 if planes == 3 else float(spent[2] + spent[0] / 2)
    return payload, (8.0 * len(payload) - forces, forces - direction, direction)


def _palettes(words: Words) -> list[Found]:
    """Palettes that hold all forces, of which one may be the best."""
    products = _products(words)
    if products is not None:
        return [products]
    values = np.unique(exact.in_order(words))
    found: list[Found] = []
    if 0 < len(values) <= exact.MOST_VALUES:
        found.append((Palette(values, None), 0))
    if not found or 4 * len(values) > 3 * len(words):
        found.append((Palette(None, None), 0))
    return found


def _products(words: Words) -> Found | None:
    """Levels and a codebook of which all forces are products, or None."""
    vectors = words.view(np.float32)
    vectors = vectors[vectors.any(axis=1)]
    for name in _TRIED if len(vectors) else ():
        codebook = Codebook.get(name)
        if not len(_levels(vectors[:: max(1, len(vectors) // 64)], codebook)):
            continue
        levels = _levels(vectors, codebook)
        if 0 < len(levels) * len(codebook) <= exact.MOST_VALUES - len(codebook):
            values = np.unique(levels.view(np.uint32)).astype(np.int64)
            if len(vectors) < len(words):
                values = np.append(0, values)
            palette = Palette(values, codebook.vertices_float32)
            if (palette.symbols(words) >= 0).all():
                return palette, 1 + exact.CODEBOOKS.index(name)
    return None


def _levels(vectors: Floats, codebook: Codebook) -> Floats:
    """The levels whose rounded products vectors may be, ascending: each component bounds its level on both sides."""
    v, d = np.abs(vectors.astype(np.float64)), np.abs(codebook.vertices_float32[codebook.nearest(vectors)])
    with np.errstate(all="ignore"):  # beside the largest float32, and where a vertex has a zero
        half = np.spacing(np.abs(vectors)).astype(np.float64) / 2
        low = np.where(d > 0, (v - half) / d, 0).max(axis=1)
        high = np.where(d > 0, (v + half) / d, np.inf).min(axis=1)
    if not (low <= high).all() or not np.isfinite(high).all():
        return np.zeros(0, np.float32)
    order = np.argsort(low + high)
    low, high = low[order], high[order]
    begins = np.flatnonzero(np.diff(low + high, prepend=0) > 2.0**-20 * (low + high))
    middle = (np.maximum.reduceat(low, begins) + np.minimum.reduceat(high, begins)) / 2
    return np.minimum(middle, np.finfo(np.float32).max).astype(np.float32)
