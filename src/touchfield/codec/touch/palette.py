"""Palettes of the lossless model: how a field's float32 vectors become few symbols, each a small whole number.

Four kinds compete. *Products*: every vector is a level times a vertex of a direction codebook, rounded once, as the
coder `paper` makes them (section 5.2); its palette is the levels alone. *Vectors*: the distinct vectors.
*Components*: the distinct component values, three symbols a vector. *Octets*: the twelve bytes of a vector, where
nothing repeats. Values are told as multiples of a unit where they all are (as the coder `touch` makes them), or by
their float32 bits, and sign by sign; -0.0 is another value than 0.0.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar, Final

import numpy as np

from touchfield.codec.code_end import check_end
from touchfield.codec.paper.directions import Codebook, codebook_names
from touchfield.codec.touch.palette_values import VectorIndex, read_magnitudes, read_values, write_values
from touchfield.codec.varint import read_varint, write_varint
from touchfield.errors import CorruptFile, TruncatedFile

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Bits = NDArray[np.uint32]
    Symbols = NDArray[np.int32]

__all__ = [
    "MOST_VALUES",
    "MOST_VECTORS",
    "Components",
    "Octets",
    "Palette",
    "Products",
    "Vectors",
    "read_palette",
]

MOST_VECTORS: Final = 1 << 16
MOST_VALUES: Final = 1 << 18
MOST_PRODUCTS: Final = 1 << 18

_WHERE = "palette"


class Palette(ABC):
    """Vectors to symbols and back; all vectors are float32 bits, uint32 [n, 3]."""

    kind: ClassVar[int]
    """The first byte of `to_bytes`."""

    @property
    @abstractmethod
    def sizes(self) -> tuple[int, ...]:
        """How many symbols each plane has."""

    @abstractmethod
    def encode(self, bits: Bits) -> Symbols:
        """Symbols, int32 [n, planes]; -1 in all planes of a vector that the palette has not."""

    @abstractmethod
    def decode(self, symbols: Symbols) -> Bits:
        """The inverse, for symbols below `sizes`."""

    @abstractmethod
    def to_bytes(self) -> bytes:
        """The kind, and what its decoder needs."""


class Octets(Palette):
    """The bytes themselves: of each component the highest first."""

    kind = 0

    @property
    def sizes(self) -> tuple[int, ...]:
        """256, twelve times."""
        return (256,) * 12

    def encode(self, bits: Bits) -> Symbols:
        """Bytes, int32 [n, 12]."""
        return np.ascontiguousarray(bits, ">u4").view(np.uint8).reshape(-1, 12).astype(np.int32)

    def decode(self, symbols: Symbols) -> Bits:
        """The inverse."""
        return np.ascontiguousarray(symbols, np.int32).astype(np.uint8).view(">u4").reshape(-1, 3).astype(np.uint32)

    def to_bytes(self) -> bytes:
        """The kind alone."""
        return bytes([self.kind])


@dataclass(frozen=True)
class Components(Palette):
    """Distinct component values.

    Attributes
    ----------
    values : uint32 [k]
        Float32 bits, ascending in value.
    """

    values: Bits
    kind = 1

    @property
    def sizes(self) -> tuple[int, ...]:
        """k, three times."""
        return (len(self.values),) * 3

    @cached_property
    def _order(self) -> NDArray[np.int64]:
        return np.argsort(self.values)

    def encode(self, bits: Bits) -> Symbols:
        """Ranks of the components, int32 [n, 3]."""
        order = self._order
        place = np.searchsorted(self.values, bits, sorter=order)
        found = order[np.minimum(place, len(order) - 1)]
        held = (self.values[found] == bits).all(axis=1, keepdims=True)
        return np.where(held, found, -1).astype(np.int32)

    def decode(self, symbols: Symbols) -> Bits:
        """Values of ranks."""
        return self.values[symbols]

    def to_bytes(self) -> bytes:
        """The kind and the values."""
        return bytes([self.kind]) + write_values(self.values)


@dataclass(frozen=True)
class Vectors(Palette):
    """Distinct vectors.

    Attributes
    ----------
    values : uint32 [k]
        Float32 bits of the component values, ascending in value.
    ranks : int32 [p, 3]
        The vectors, of ranks in `values`, ascending.
    """

    values: Bits
    ranks: Symbols
    kind = 2

    @property
    def sizes(self) -> tuple[int, ...]:
        """p."""
        return (len(self.ranks),)

    @cached_property
    def _index(self) -> VectorIndex:
        return VectorIndex(self.values[self.ranks])

    def encode(self, bits: Bits) -> Symbols:
        """Places of vectors, int32 [n, 1]."""
        return self._index.find(bits).astype(np.int32)[:, None]

    def decode(self, symbols: Symbols) -> Bits:
        """Vectors of places."""
        return self.values[self.ranks[symbols[:, 0]]]

    def to_bytes(self) -> bytes:
        """The kind, the values, and the ranks in the code of a frame's symbols, each vector beside the last."""
        from touchfield.codec.kernels import touch_palette as kernels

        ranks = self.ranks.copy()
        sizes = (len(self.values),) * 3
        none = np.zeros((0, 3), np.int32)
        _, coder, _ = kernels.code_symbols(None, ranks, none, _in_line(len(ranks)), sizes)
        place, end = coder.tail()
        data = coder.buffer[:place].tobytes() + end
        head = bytes([self.kind]) + write_values(self.values)
        return head + write_varint(len(ranks)) + write_varint(len(data)) + data


@dataclass(frozen=True)
class Products(Palette):
    """A level times a vertex, rounded once to float32.

    Attributes
    ----------
    levels : uint32 [l]
        Float32 bits, ascending, not negative.
    codebook : str
        Its name; the vertices are `Codebook.vertices_float32`.
    """

    levels: Bits
    codebook: str
    kind = 3

    @property
    def _vertices(self) -> NDArray[np.float32]:
        return Codebook.get(self.codebook).vertices_float32

    @property
    def sizes(self) -> tuple[int, ...]:
        """Levels, vertices."""
        return (len(self.levels), len(self._vertices))

    @cached_property
    def _index(self) -> VectorIndex:
        products = self.levels.view(np.float32)[:, None, None] * self._vertices[None]
        return VectorIndex(products.reshape(-1, 3).view(np.uint32))

    def encode(self, bits: Bits) -> Symbols:
        """Levels and vertices, int32 [n, 2]."""
        place = self._index.find(bits)
        level, vertex = np.divmod(place, len(self._vertices))
        return np.where(place[:, None] < 0, -1, np.stack([level, vertex], axis=1)).astype(np.int32)

    def decode(self, symbols: Symbols) -> Bits:
        """The products."""
        products = self.levels.view(np.float32)[symbols[:, :1]] * self._vertices[symbols[:, 1]]
        return np.asarray(products, np.float32).view(np.uint32)

    def to_bytes(self) -> bytes:
        """The kind, the length of the name, the name, and the levels."""
        name = self.codebook.encode("ascii")
        return bytes([self.kind, len(name)]) + name + write_values(self.levels)


def read_palette(data: bytes, at: int, count: int) -> tuple[Palette, int]:
    """The palette at `at` for a frame of `count` vectors, and the offset behind it.

    No palette has more entries than the frame has numbers: memory is bounded by the frame's.

    Raises
    ------
    TruncatedFile, CorruptFile
        If it is none.
    """
    if at >= len(data):
        raise TruncatedFile(_WHERE, f"the end of the bytes at offset {at}", "its kind")
    kind, at = data[at], at + 1
    if kind == Octets.kind:
        return Octets(), at
    if kind == Components.kind:
        values, at = read_values(data, at, min(3 * count, MOST_VALUES))
        return Components(values), at
    if kind == Vectors.kind:
        return _read_vectors(data, at, count)
    if kind == Products.kind:
        return _read_products(data, at, count)
    raise CorruptFile(_WHERE, f"kind {kind}", "0 (octets), 1 (components), 2 (vectors) or 3 (products)")


def _read_vectors(data: bytes, at: int, count: int) -> tuple[Palette, int]:
    from touchfield.codec.kernels import touch_palette as kernels

    most = min(count, MOST_VECTORS)
    values, at = read_values(data, at, 3 * most)
    length, at = read_varint(data, at, f"{_WHERE}, vectors", most + 1)
    size, at = read_varint(data, at, f"{_WHERE}, bytes of the vectors")
    if size > len(data) - at:
        raise TruncatedFile(_WHERE, f"{len(data) - at} bytes", f"{size} bytes of vectors")
    ranks = np.zeros((length, 3), np.int32)
    code = np.frombuffer(data, np.uint8, size, at).copy()
    none = np.zeros((0, 3), np.int32)
    status, coder, _ = kernels.code_symbols(code, ranks, none, _in_line(length), (len(values),) * 3)
    check_end(status, coder.tail(), data[at : at + size], f"{_WHERE}, vectors")
    keys = ranks.astype(np.int64) @ np.array([1 << 40, 1 << 20, 1])
    if length == 0 or (np.diff(keys) <= 0).any():
        raise CorruptFile(_WHERE, "vectors that do not ascend", "at least one, ascending")
    return Vectors(values, ranks), at + size


def _read_products(data: bytes, at: int, count: int) -> tuple[Palette, int]:
    size = data[at] if at < len(data) else 0
    name = data[at + 1 : at + 1 + size].decode("ascii", "replace")
    if name not in codebook_names():
        raise CorruptFile(f"{_WHERE}, codebook", repr(name), "a direction codebook")
    most = min(count, MOST_PRODUCTS // len(Codebook.get(name)))
    levels, at = read_magnitudes(data, at + 1 + size, most)
    return Products(levels, name), at


def _in_line(count: int) -> NDArray[np.int32]:
    """Neighbours of a list: the one before."""
    near = np.full((count, 6), -1, np.int32)
    near[:, 0] = np.arange(count) - 1
    return near
