"""The exact mode: a field that is quantised already, to the bit of each float32 (docs/format/touch-exact.md).

A force is a few symbols, its planes: a level and a vertex of a direction codebook, whose float32 product it is, as
the coder `paper` makes them; or the places of its components in a list of values; or its components as they are.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from touchfield.codec import brick_list
from touchfield.codec.brick_list import check_end, code_bricks
from touchfield.codec.kernels.bits import Bits, fresh, reader
from touchfield.codec.paper.directions import Codebook, codebook_names
from touchfield.codec.touch.kernels import exact as kernels
from touchfield.errors import CorruptFile
from touchfield.medium import ForceField, Grid
from touchfield.medium.field import brick_keys

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Words = NDArray[np.uint32]
    Int64s = NDArray[np.int64]
    Int32s = NDArray[np.int32]

__all__ = ["Palette", "decode_exact"]

CODEBOOKS: Final = tuple(name for name in codebook_names() if "-" not in name)
MOST_VALUES: Final = 1 << 18
LARGEST_TABLE: Final = 22
FRAME_AT: Final = brick_list.CONTEXTS + kernels.VALUE_CONTEXTS
CONTEXTS: Final = FRAME_AT + kernels.CONTEXTS
SETS: Final = brick_list.SETS + kernels.SETS
_INFINITY: Final = 0x7F800000
_WHERE: Final = "exact frame"


def in_order(words: Words) -> Int64s:
    """Float32 bits as numbers that ascend with the value; -0.0 is -1."""
    signed = words.view(np.int32).astype(np.int64)
    return np.where(signed < 0, signed ^ 0x7FFFFFFF, signed)


def _words(numbers: Int64s) -> Words:
    """The inverse of `in_order`."""
    return np.where(numbers < 0, numbers ^ 0x7FFFFFFF, numbers).astype(np.int32).view(np.uint32)


class Palette(NamedTuple):
    """How forces become symbols.

    Attributes
    ----------
    values : int64 [k] or None
        Float32 bits in order (`in_order`), ascending: levels with vertices, else components; None for any.
    vertices : float32 [v, 3] or None
    """

    values: Int64s | None
    vertices: NDArray[np.float32] | None

    @property
    def sizes(self) -> Int64s:
        """How many symbols each plane has, int64 [planes]."""
        if self.values is None:
            return np.full(3, 1 << 32)
        return np.array([len(self.values)] * 3 if self.vertices is None else [len(self.values), len(self.vertices)])

    def forces(self, symbols: Int64s) -> Words:
        """Float32 bits, uint32 [n, 3], of symbols, int64 [n, planes]."""
        if self.values is None:
            return _words(symbols - (1 << 31))
        if self.vertices is None:
            return _words(self.values)[symbols]
        levels = _words(self.values).view(np.float32)
        return (levels[symbols[:, :1]] * self.vertices[symbols[:, 1]]).view(np.uint32)

    def symbols(self, words: Words) -> Int64s:
        """The inverse: the first that there are, or -1 in all planes."""
        numbers = in_order(words)
        if self.values is None:
            return numbers + (1 << 31)
        if self.vertices is None:
            return _places(self.values, numbers)
        pairs = np.stack(np.unravel_index(np.arange(self.sizes.prod()), self.sizes), axis=-1)
        products = in_order(self.forces(pairs))
        values, weights = np.unique(products), np.array([1 << 40, 1 << 20, 1])
        keys, first = np.unique(np.searchsorted(values, products) @ weights, return_index=True)
        place = _places(keys, _places(values, numbers) @ weights)[:, None]
        return np.where(place < 0, -1, pairs[first[place[:, 0]]])


def _places(values: Int64s, numbers: Int64s) -> Int64s:
    """Places of numbers, [n] or [n, 3], among ascending values; -1, in a whole row, where one is not among them."""
    place = np.minimum(np.searchsorted(values, numbers), len(values) - 1)
    held = values[place] == numbers
    return np.where(held.all(axis=1, keepdims=True) if held.ndim == 2 else held, place, -1)


def code_palette(bits: Bits, values: Int64s, codebook: int, most: int) -> Palette:
    """Write or read a palette.

    Parameters
    ----------
    bits : Bits
    values : int64 [k]
        In order, when writing.
    codebook : int
        1 + its place in `CODEBOOKS`, or 0.
    most : int
        Values, at most.

    Raises
    ------
    CorruptFile
        If there is no such palette.
    """
    head = np.array([len(values), codebook])
    kernels.code_numbers(bits, brick_list.CONTEXTS, head)
    count, codebook = (int(n) for n in head)
    if codebook > len(CODEBOOKS) or (codebook and not count):
        raise CorruptFile(_WHERE, f"codebook {codebook} of {count} levels", f"up to {len(CODEBOOKS)}")
    vertices = Codebook.get(CODEBOOKS[codebook - 1]).vertices_float32 if codebook else None
    most = min(most, MOST_VALUES // (1 if vertices is None else len(vertices)))
    if count > most:
        raise CorruptFile(_WHERE, f"{count} values", f"{most} at most")
    gaps = np.diff(values, prepend=~_INFINITY) - 1 if len(values) else np.zeros(count, np.int64)
    kernels.code_numbers(bits, brick_list.CONTEXTS, gaps)
    values = np.cumsum(gaps + 1) + ~_INFINITY
    if count and (values[-1] >= _INFINITY or (codebook and values[0] < 0)):
        raise CorruptFile(_WHERE, "a value that is not finite, or a negative level", "neither")
    return Palette(values if count else None, vertices)


def decode_exact(data: bytes, grid: Grid, previous: ForceField | None) -> ForceField:
    """The field that `encode_exact` wrote; `previous` is what it was given.

    Raises
    ------
    TruncatedFile, CorruptFile
        If the bytes are not what it writes. Memory is taken for the bricks that `brick_list` allows, some 32 KiB
        each, and 16 MiB.
    """
    if not data or data[0] > LARGEST_TABLE:
        raise CorruptFile(_WHERE, "no table of chances, or a larger one", f"2^{LARGEST_TABLE} at most")
    bits = reader(data[1:], fresh(CONTEXTS + (1 << data[0]), SETS))
    bricks = code_bricks(bits, 0, 0, grid.brick_shape, None, held_bricks(previous))
    forces, samples = np.zeros((len(bricks), 8, 8, 8, 3), np.float32), 512 * len(bricks)
    if samples:
        palette = code_palette(bits, np.zeros(0, np.int64), 0, 3 * samples)
        symbols = np.zeros((samples, len(palette.sizes)), np.int64)
        frame = frame_of(grid, bricks, palette, symbols, np.zeros(samples, np.uint8), previous)
        count = kernels.code_frame(bits, FRAME_AT, brick_list.SETS, (1 << data[0]) - 1, frame)
        if count < 0:
            raise CorruptFile(_WHERE, "a symbol that there is not, or the end of the bytes", f"{len(bricks)} bricks")
        words = palette.forces(symbols[:count])
        if not words.any(axis=1).all() or ((words & 0x7FFFFFFF) >= _INFINITY).any():
            raise CorruptFile(_WHERE, "a sample without force, or with one that is not finite", "forces")
        held = frame.places >= 0
        forces.reshape(-1, 3)[held] = words.view(np.float32)
        if not held.reshape(-1, 512).any(axis=1).all():
            raise CorruptFile(_WHERE, "a brick without force", "none")
    check_end(bits, len(bricks), _WHERE)
    return ForceField(grid, bricks, forces)


def held_bricks(field: ForceField | None) -> Int32s | None:
    """Bricks with a force."""
    return None if field is None else field.bricks[field.forces_n.view(np.uint32).any(axis=(1, 2, 3, 4))]


def frame_of(
    grid: Grid,
    bricks: Int32s,
    palette: Palette,
    symbols: Int64s,
    held: NDArray[np.uint8],
    previous: ForceField | None,
) -> kernels.Frame:
    """The work of the pass over the samples."""
    keys, shape, sizes = brick_keys(grid, bricks), np.array(grid.brick_shape), palette.sizes
    beside = bricks[:, None] + np.stack(np.unravel_index(np.arange(27), (3, 3, 3)), axis=-1) - 1
    around = _places(keys, brick_keys(grid, beside.reshape(-1, 3))).reshape(-1, 27)
    around[((beside < 0) | (beside >= shape)).any(axis=-1)] = -1
    before = np.full((0 if previous is None else len(held), len(sizes)), -2)
    if previous is not None:
        words = previous.forces_at(keys).view(np.uint32).reshape(-1, 3)
        there = words.any(axis=1)
        before[there] = palette.symbols(words[there])
    return kernels.Frame(
        around, np.minimum(np.array(grid.shape) - 8 * bricks.astype(np.int64), 8), held,
        np.full(len(held), -1, np.int32), before, symbols, sizes, np.zeros(len(symbols), np.uint8),
        np.zeros(1728, np.int32), np.zeros(1728, np.int32), np.zeros((6, 1 + len(sizes)), np.int64),
        np.zeros(1 + len(sizes)),
    )  # fmt: skip
