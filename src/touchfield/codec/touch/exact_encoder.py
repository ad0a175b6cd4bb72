"""The encoder of the exact mode, and its search for a palette."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from touchfield.codec.directions import Codebook
from touchfield.codec.touch import brick_list, exact
from touchfield.codec.touch.kernels import exact as kernels
from touchfield.codec.touch.kernels.bits import INPUTS, end_of, price, writer
from touchfield.errors import InvalidArgument

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.codec.touch.exact import Int64s, Words
    from touchfield.medium import ForceField

    Shares = tuple[float, float, float]
    Floats = NDArray[np.float32]

__all__ = ["encode_exact"]

_TRIED: Final = ("ico5", "octa3", "ico3", "ico1", "ico2", "ico4", "octa1", "octa2", "ico8", "ico10")
_MOST_MULTIPLE: Final = 1 << 18


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
    words = frame.forces_n.view(np.uint32).reshape(len(frame.bricks), 512, 3)
    words = words[words.any(axis=(1, 2))].reshape(-1, 3)
    return min(
        (_coded(frame, previous, words, p) for p in _palettes(words[words.any(axis=1)])), key=lambda c: len(c[0])
    )


class _Told(NamedTuple):
    """A palette, and what `exact.code_palette` writes of it."""

    palette: exact.Palette
    numbers: Int64s
    unit: int = 0
    codebook: int = 0


def _coded(frame: ForceField, previous: ForceField | None, words: Words, told: _Told) -> tuple[bytes, Shares]:
    bricks = frame.bricks[frame.forces_n.view(np.uint32).any(axis=(1, 2, 3, 4))]
    held, planes = words.any(axis=1), len(told.palette.sizes)
    count = int(held.sum())
    log = min((4096 + 8 * count * planes).bit_length(), exact.LARGEST_TABLE)
    room = 320 * len(bricks) + 2 * len(words) + (8 + 64 * planes) * count + 16 * len(told.numbers) + 64
    bits = writer(room, exact.CONTEXTS + (1 << log), exact.SETS, INPUTS)
    before = None if previous is None else previous.bricks
    brick_list.code_bricks(bits, 0, 0, frame.grid.brick_shape, bricks, before)
    palette_bits, spent = 0.0, np.zeros(3)
    if count:
        palette_bits = -price(bits)
        exact.code_palette(bits, *told[1:], 3 * len(words))
        palette_bits += price(bits)
        symbols = told.palette.symbols(words[held])
        work = exact.frame_of(frame.grid, bricks, told.palette, symbols, held.astype(np.uint8), previous)
        kernels.code_frame(bits, exact.FRAME_AT, brick_list.SETS, (1 << log) - 1, work)
        spent = work.spent
    payload = bytes([log]) + brick_list.padded(end_of(bits), len(bricks))
    forces = palette_bits + float(spent.sum())
    direction = forces * 2 / 3 if planes == 3 else float(spent[2] + spent[0] / 2)
    return payload, (8.0 * len(payload) - forces, forces - direction, direction)


def _palettes(words: Words) -> list[_Told]:
    """Palettes that hold all forces, of which one may be the best."""
    products = _products(words)
    if products is not None:
        return [products]
    values, found = np.unique(exact.in_order(words)), []
    if 0 < len(values) <= exact.MOST_VALUES:
        found.append(_Told(exact.Palette(values, None), *_in_units(values)))
    if not found or 4 * len(values) > 3 * len(words):
        found.append(_Told(exact.Palette(None, None), np.zeros(0, np.int64)))
    return found


def _in_units(values: Int64s) -> tuple[Int64s, int]:
    """Values in order as multiples of a unit, and the bits of the unit; as they are, and 0, where there is none."""
    sizes = np.where(values < 0, ~values, values).astype(np.uint32).view(np.float32)
    some = np.unique(sizes[sizes > 0]).astype(np.float64)
    for first in range(1, 257 if len(some) > 1 else 1):
        unit = some[0] / first
        for known in (some[len(some) >> 5], some[len(some) >> 1], some[-1]):
            unit = known / max(np.rint(known / unit), 1)
        parts = some[:: max(1, len(some) // 64)] / unit
        if some[-1] / unit > _MOST_MULTIPLE or (np.abs(parts - np.rint(parts)) > 1 / 64).any():
            continue
        for near in np.nextafter(np.float32(unit), np.array([unit, 0, np.inf], np.float32)):
            if near > 0:
                multiples = np.rint(sizes / np.float64(near))
                if np.array_equal(multiples.astype(np.float32) * near, sizes):
                    numbers = multiples.astype(np.int64)
                    return np.where(values < 0, ~numbers, numbers), int(near.view(np.uint32))
    return values, 0


def _products(words: Words) -> _Told | None:
    """Levels and a codebook of which all forces are products, or None."""
    vectors = words.view(np.float32)
    vectors = vectors[vectors.any(axis=1)]
    for name in _TRIED if len(vectors) else ():
        codebook = Codebook.get(name)
        if not len(_levels(vectors[:: max(1, len(vectors) // 64)], codebook)):
            continue
        levels = _levels(vectors, codebook)
        if 0 < len(levels) * len(codebook) <= exact.MOST_VALUES - len(codebook):
            levels = np.unique(levels.view(np.uint32)).astype(np.int64)
            if len(vectors) < len(words):
                levels = np.append(0, levels)
            palette = exact.Palette(levels, codebook.vertices_float32)
            if (palette.symbols(words) >= 0).all():
                return _Told(palette, *_in_units(levels), 1 + exact.CODEBOOKS.index(name))
    return None


def _levels(vectors: Floats, codebook: Codebook) -> Floats:
    """The levels whose rounded products vectors may be, ascending: each component bounds its level on both sides."""
    v, d = np.abs(vectors.astype(np.float64)), np.abs(codebook.vertices_float32[codebook.nearest(vectors)])
    half = np.spacing(np.abs(vectors)).astype(np.float64) / 2
    with np.errstate(all="ignore"):  # beside the largest float32, and where a vertex has a zero
        low = np.where(d > 0, (v - half) / d, 0).max(axis=1)
        high = np.where(d > 0, (v + half) / d, np.inf).min(axis=1)
    if not (low <= high).all() or not np.isfinite(high).all():
        return np.zeros(0, np.float32)
    order = np.argsort(low + high)
    low, high = low[order], high[order]
    begins = np.flatnonzero(np.diff(low + high, prepend=0) > 2.0**-20 * (low + high))
    middle = (np.maximum.reduceat(low, begins) + np.minimum.reduceat(high, begins)) / 2
    return np.minimum(middle, np.finfo(np.float32).max).astype(np.float32)
