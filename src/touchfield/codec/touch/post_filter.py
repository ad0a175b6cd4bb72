"""The post filter of coder `touch`: what its 26 neighbours tell of a force after the frame is decoded.

A frame model predicts a force from those coded before it alone; once the frame is there, the others have something
to say as well, and steps of the lattice can be smoothed. The encoder sends the few terms of a linear filter that
are worth their two bytes (`post_filter_fit`); `post_filter_format` tells the bytes. Not in the paper, whose field is
smooth only where its quantiser leaves it so (section 4.2).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.codec.touch.fixed_field import FixedField
from touchfield.errors import CorruptFile, TruncatedFile
from touchfield.medium.field import brick_keys
from touchfield.parallel import for_chunks

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.codec.touch.frame_model import Known
    from touchfield.codec.touch.lattice import Lattice
    from touchfield.medium import Grid

    Int64s = NDArray[np.int64]

__all__ = [
    "GROUPS",
    "TERMS",
    "Terms",
    "clip_of",
    "filtered",
    "links_of",
    "members",
    "read_terms",
    "size_of",
    "with_filter",
    "write_terms",
]

GROUPS: Final = 56
"""Sets of neighbours that share a weight."""

TERMS: Final = 3 * GROUPS + 1
"""Clipped difference, difference and outside for each group; and the force itself."""

_WHERE: Final = "SEGM.body filter"
_NEIGHBOURS: Final = 26
_CHUNK: Final = 32


@dataclass(frozen=True)
class Terms:
    """A filter.

    Attributes
    ----------
    numbers : tuple of int
        Of the terms, ascending, 0 to 168.
    codes : tuple of int
        Their weights as `size_of` tells, 0 to 255.
    """

    numbers: tuple[int, ...]
    codes: tuple[int, ...]

    def weights(self) -> tuple[Int64s, int]:
        """Of each neighbour, int64 [26, 3], and of the force itself; 1/2^14."""
        found, own = np.zeros((_NEIGHBOURS, 3), np.int64), 0
        for number, code in zip(self.numbers, self.codes, strict=True):
            kind, group = divmod(number, GROUPS)
            if kind == 3:
                own = size_of(code)
            else:
                found[members()[group], kind] += size_of(code)
        return found, own


def size_of(code: int) -> int:
    """The weight of a byte, 1/2^14: a sign, four bits of exponent, three of mantissa."""
    size = (8 + (code & 7)) << (code >> 3 & 15)
    return -size if code & 128 else size


@cache
def members() -> NDArray[np.bool_]:
    """Which neighbours each group holds, bool [56, 26]; the neighbours are in ascending order, x slowest."""
    offsets = np.stack(np.unravel_index(np.delete(np.arange(27), 13), (3, 3, 3)), axis=-1) - 1
    sizes = np.abs(offsets)
    one = np.eye(_NEIGHBOURS, dtype=bool)
    groups = [*one, *(one[:13] | one[:12:-1])]
    groups += [sizes @ [4, 2, 1] == n for n in range(1, 8)]
    groups += [sizes.sum(axis=1) == n for n in range(1, 4)]
    groups += [np.ones(_NEIGHBOURS, bool)]
    groups += [offsets[:, axis] == side for axis in range(3) for side in (-1, 1)]
    return np.stack(groups)


def write_terms(terms: Terms) -> bytes:
    """As `post_filter_format` tells."""
    return bytes(b for pair in zip(terms.numbers, terms.codes, strict=True) for b in pair)


def read_terms(data: bytes) -> Terms:
    """The inverse.

    Raises
    ------
    CorruptFile, TruncatedFile
        If the bytes are not what `write_terms` writes.
    """
    if len(data) % 2:
        raise TruncatedFile(_WHERE, f"{len(data)} bytes", "two for each term")
    numbers, codes = tuple(data[::2]), tuple(data[1::2])
    if any(b <= a for a, b in zip(numbers, numbers[1:], strict=False)):
        raise CorruptFile(_WHERE, f"terms {', '.join(map(str, numbers))}", "ascending terms")
    if numbers and numbers[-1] >= TERMS:
        raise CorruptFile(_WHERE, f"term {numbers[-1]}", f"below {TERMS}")
    return Terms(numbers, codes)


def clip_of(lattice: Lattice) -> int:
    """Where differences are clipped, units."""
    return lattice.floor >> 1


def links_of(grid: Grid, bricks: NDArray[np.int32]) -> Int64s:
    """For each brick those at the 27 places around it, int64 [n, 27], x slowest, or -1."""
    keys = brick_keys(grid, bricks)
    links = np.full((len(bricks), 27), -1, np.int64)
    if not len(bricks):
        return links
    shape = np.array(grid.brick_shape)
    for i in range(27):
        there = bricks.astype(np.int64) + np.array([i // 9 - 1, i // 3 % 3 - 1, i % 3 - 1])
        inside = ((there >= 0) & (there < shape)).all(axis=1)
        wanted = (there[:, 0] * shape[1] + there[:, 1]) * shape[2] + there[:, 2]
        at = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
        links[:, i] = np.where(inside & (keys[at] == wanted), at, -1)
    return links


def filtered(field: FixedField, terms: Terms, grid: Grid, lattice: Lattice) -> FixedField:
    """The field after the filter; the support is the same."""
    from touchfield.codec.kernels import touch_post_filter as kernels

    weights, own = terms.weights()
    used = np.flatnonzero(weights.any(axis=1))
    places = np.where(used < 13, used, used + 1)
    apart = ((places // 9 - 1) * kernels.EDGE + places // 3 % 3 - 1) * kernels.EDGE + places % 3 - 1
    out = np.zeros_like(field.vectors)
    links, vectors = links_of(grid, field.bricks), np.ascontiguousarray(field.vectors)
    what = vectors, links, apart, weights[used], own, clip_of(lattice), out
    for_chunks(kernels.filter_bricks, len(field.bricks), *what, chunk=_CHUNK)
    return FixedField(field.bricks, out)


def with_filter(data: bytes, field: FixedField, known: Known) -> FixedField:
    """The field after the filter of a frame; as it is where there is none."""
    return filtered(field, read_terms(data), known.grid, known.lattice) if data else field
