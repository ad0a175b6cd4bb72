"""Fields as the compiled queries read them: *cells* of 9^3 samples, found by a hash table.

Each brick of 8^3 samples is kept with the first samples of the bricks behind it, so that the eight corners of any
point lie in one place: about twice the bytes of the bricks.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.medium.budget import memory_budget_bytes
from touchfield.medium.grid import BRICK
from touchfield.parallel import for_chunks

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from touchfield.medium.field import ForceField

    Int64s = NDArray[np.int64]
    Float64s = NDArray[np.float64]

__all__ = ["CellPool"]

_BYTES_PER_CELLS: Final = (BRICK + 1) ** 3 * 3 * 4
_CORNERS: Final = np.stack(np.meshgrid(*[np.arange(2)] * 3, indexing="ij"), axis=-1).reshape(8, 3)


@dataclass(frozen=True)
class CellPool:
    """The fields of some objects as the kernels read them, one behind the other (`kernels.placed`).

    Attributes
    ----------
    lattices : float64 [objects, 6]; Spacing, and the corner of the object's box of bricks in its own frame, metres.
    boxes : int64 [objects, 5]
    starts : int64 [objects + 1]
    bricks : int32 [n, 3]; Of cells, from the corner.
    cells : float32 [n * 9 * 9 * 9 * 3]
    held : uint64 [n, 8]
    tables : int64 [m, 2]
    """

    lattices: Float64s
    boxes: Int64s
    starts: Int64s
    bricks: NDArray[np.int32]
    cells: NDArray[np.float32]
    held: NDArray[np.uint64]
    tables: Int64s

    @classmethod
    def of(cls, field: ForceField, beside: ForceField | None = None) -> CellPool:
        """The pool of one field; with room for `beside`, too, so that both pools have their cells in one order."""
        from touchfield.medium.kernels import placed as kernels

        spacing = np.asarray(field.grid.spacing_m)
        every_field = [one for one in (field, beside) if one is not None and len(one.bricks)]
        if not every_field:
            lattice = np.concatenate([spacing, field.grid.origin_m])[None]
            none = np.zeros((0, 3), np.int32), np.zeros(0, np.float32), np.zeros((0, 8), np.uint64)
            return cls(lattice, np.zeros((1, 5), np.int64), np.zeros(2, np.int64), *none, np.zeros((0, 2), np.int64))
        near = [one.bricks for one in every_field]
        for one in every_field:  # samples at the beginning of a brick are corners of cells of the brick before
            for corner in _CORNERS[1:]:
                begins = tuple(0 if c else slice(None) for c in corner)
                is_near = one.mask[(slice(None), *begins)].reshape(len(one.bricks), -1).any(axis=1)
                near.append(one.bricks[is_near] - corner.astype(np.int32))
        every = np.concatenate(near).astype(np.int64)
        low = every.min(axis=0)
        box = every.max(axis=0) - low + 1
        keys = np.unique(_keys(every - low, box))
        bricks = np.stack(np.unravel_index(keys, tuple(box)), axis=1)
        own = np.append(_keys(field.bricks - low, box), -1)  # never empty: the last is no brick
        sources = np.full((len(bricks), 8), -1, np.int64)
        for c, corner in enumerate(_CORNERS):
            behind = bricks + corner
            wanted = _keys(behind, box)
            slot = np.searchsorted(own[:-1], wanted)
            sources[:, c] = np.where((own[slot] == wanted) & (behind < box).all(axis=1), slot, -1)
        _check_cells(len(bricks))
        cells = np.zeros((len(bricks), *[BRICK + 1] * 3, 3), np.float32)
        held = np.zeros((len(bricks), BRICK), np.uint64)
        for_chunks(kernels.cells_of, len(bricks), sources, field.forces_n, cells, held, chunk=64)
        shift = 64 - max(2, (4 * len(keys) - 1).bit_length())
        table = np.full((1 << (64 - shift), 2), -1, np.int64)
        kernels.hash_table(keys, shift, table)
        corner_m = field.grid.to_m(low * BRICK)
        return cls(
            np.concatenate([spacing, corner_m])[None],
            np.array([[*box, 0, shift]]),
            np.array([0, len(bricks)]),
            bricks.astype(np.int32),
            cells.reshape(-1),
            held,
            table,
        )

    @classmethod
    def joined(cls, pools: Sequence[CellPool]) -> CellPool:
        """Several as one, in their order."""
        if len(pools) == 1:
            return pools[0]
        first = np.cumsum([0, *(len(p.bricks) for p in pools)])
        _check_cells(int(first[-1]))
        tables = np.concatenate([p.tables for p in pools])
        boxes = np.concatenate([p.boxes for p in pools])
        boxes[:, 3] = np.cumsum([0, *(len(p.tables) for p in pools[:-1])])
        for begin, before, one in zip(boxes[:, 3], first, pools):
            slots = tables[begin : begin + len(one.tables), 1]
            slots[slots >= 0] += before
        return cls(
            np.concatenate([p.lattices for p in pools]),
            boxes,
            first,
            np.concatenate([p.bricks for p in pools]),
            np.concatenate([p.cells for p in pools]),
            np.concatenate([p.held for p in pools]),
            tables,
        )


def _keys(bricks: NDArray[np.integer[Any]], box: Int64s) -> Int64s:
    """Places within a box of bricks, x slowest, int64 [n]."""
    keys: Int64s = (bricks[:, 0] * box[1] + bricks[:, 1]) * box[2] + bricks[:, 2]
    return keys


def _check_cells(count: int) -> None:
    """Whether there is memory for `count` bricks of cells."""
    needed, allowed = count * _BYTES_PER_CELLS, memory_budget_bytes()
    if needed > allowed:
        found, expected = f"{needed / 2**30:.1f} GiB of cells", f"at most {allowed / 2**30:.1f} GiB"
        mend = "Set TOUCHFIELD_MEMORY_GIB; what is encoded takes less with a smaller --nw."
        raise InvalidArgument("haptic objects", found, expected, mend)
