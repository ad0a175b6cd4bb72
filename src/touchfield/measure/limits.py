"""Estimates the fewest bits that a coder could spend on a medium, from entropies of its symbols, so that real
coders can be compared with them.

Theory sections 4 and 5. For the same symbols S = Q(F) over all voxels of all frames the bounds are H(S) of
the voxel and of the object, and H(S | causal neighbours) with and without the previous frame. All are plug-in
estimates of the rate of an ideal coder with that context. A rate that is certainly attainable is that of an
actual file of the coder `touch` in its exact mode.

A coder that visits the voxels in raster order (x slowest, z fastest) knows, at each voxel, the neighbours
with no greater index along any axis. Neighbourhoods are nested corners of the 2^3 cube of such neighbours:

========== ========== ==========================================================
name       neighbours positions
========== ========== ==========================================================
none       0          none: H(S)
previous   1          the one before in raster order, (0, 0, -1); see `scan_axis`
axes       3          one before along each axis
corner     7          all of {-1, 0}^3 but the voxel itself
========== ========== ==========================================================

and each may include the co-located voxel of the previous frame. Voxels outside the grid, and before the first
frame, have symbol 0, so that all quantities are over the same voxels. The estimate is H(S, c) - H(c) over one
exact count, so that the plug-in H(S | c) falls as c grows, for any data. For the same reason it is *too low*:
contexts dilute, and a context that occurs once costs nothing. `ContextEntropy` reports the dilution.

Time: one pass over the frames, which may be lazy. Memory: two frames and the different joint cells
(`CellCounter`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Int32s, Int64s
from touchfield.errors import InvalidArgument
from touchfield.measure.estimators import entropy_bits
from touchfield.measure.field_symbols import Fields, FieldSymbols, Frames
from touchfield.measure.quantity import Quantity
from touchfield.medium.budget import memory_budget_bytes
from touchfield.medium.field import brick_keys, bricks_of, neighbour_slots
from touchfield.medium.grid import BRICK, Grid

NEIGHBOURHOODS: Final = {"none": 0, "previous": 1, "axes": 3, "corner": 7}
"""Names, and the number of causal neighbours of each."""

_SYMBOL, _PREVIOUS_FRAME = 0, 8  # columns of a row; 1 to 7 are the neighbours
_BRICKS_AT_ONCE = 1024
_FIRST_KEYS = 1 << 12
_MAX_KEYS = 1 << 30
_NO_FRAME = np.zeros((0, 8, 8, 8), np.int32)


class CellCounter:
    """Counter of rows of `columns` symbols, packed as by the kernels.

    A symbol has `bits` bits, at most 32. `zeros` counts the rows of zeros only, whose number is known without
    visiting them.
    """

    def __init__(self, columns: int, bits: int) -> None:
        self.columns, self.bits = columns, bits
        self._per_word = 64 // bits
        self.word_count = -(-columns // self._per_word)
        self.zeros = 0
        self._used = 0
        self._allocate(_FIRST_KEYS)

    def _allocate(self, size: int) -> None:
        needed = size * (8 * self.word_count + 16)
        if size > _MAX_KEYS or needed > memory_budget_bytes() // 2:
            raise InvalidArgument(
                "joint cells",
                f"more than {size // 2} different ones",
                f"up to {memory_budget_bytes() // 2} bytes",
                "Give fewer frames or a coarser quantiser, or set TOUCHFIELD_MEMORY_GIB.",
            )
        self._slots = np.full(2 * size, -1, np.int32)
        self._keys = np.zeros((size, self.word_count), np.uint64)
        self._counts = np.zeros(size, np.int64)

    def add(self, rows: NDArray[np.uint64], weights: Int64s | None = None) -> None:
        """Count rows, uint64 [n, words], each once or as often as its weight.

        No row may consist of zeros only.
        """
        from touchfield.measure.kernels import insert

        times = np.zeros(0, np.int64) if weights is None else weights
        done = 0
        while True:
            done, self._used = insert(rows, times, done, self._slots, self._keys, self._counts, self._used)
            if done == len(rows):
                return
            keys, counts = self._keys[: self._used], self._counts[: self._used]
            self._allocate(2 * len(self._keys))
            _, self._used = insert(keys, counts, 0, self._slots, self._keys, self._counts, 0)

    @property
    def samples(self) -> int:
        """n, the number of rows counted."""
        return int(self._counts[: self._used].sum()) + self.zeros

    def counts(self) -> Int64s:
        """Return the count of each cell, int64 [K].

        The count of the all-zero row is last, if there is one.
        """
        counts = self._counts[: self._used]
        return np.append(counts, self.zeros) if self.zeros else counts.copy()

    def marginal(self, columns: tuple[int, ...]) -> CellCounter:
        """Return the counter of some columns alone; the other columns are 0."""
        mask = np.zeros(self.word_count, np.uint64)
        for c in columns:
            mask[c // self._per_word] |= np.uint64(((1 << self.bits) - 1) << (c % self._per_word * self.bits))
        out = CellCounter(self.columns, self.bits)
        rows, weights = self._keys[: self._used] & mask, self._counts[: self._used]
        empty = ~rows.any(axis=1)
        out.add(rows[~empty], weights[~empty])
        out.zeros = self.zeros + int(weights[empty].sum())
        return out


def scan_axis(grid: Grid) -> int:
    """Return the axis of the raster's lines.

    z, or the last axis with more than one sample.
    """
    return max((axis for axis in range(3) if grid.shape[axis] > 1), default=2)


def _reached_bricks(frame: FieldSymbols, previous: FieldSymbols | None) -> Int32s:
    """Return the bricks in which a symbol, its context or its predecessor is not 0.

    int32 [n, 3].
    """
    bricks = frame.bricks[frame.symbols.any(axis=(1, 2, 3))]
    corners = (bricks[:, None] + np.array(list(np.ndindex(2, 2, 2)), np.int32)).reshape(-1, 3)
    if previous is not None:
        corners = np.concatenate([corners, previous.bricks])
    keys = np.unique(brick_keys(frame.grid, corners[(corners < frame.grid.brick_shape).all(axis=1)]))
    return bricks_of(frame.grid, keys)


@dataclass(frozen=True)
class ContextEntropy:
    """H(S | c) and its dilution.

    `neighbourhood`: one of `NEIGHBOURHOODS`. `previous_frame`: whether c includes the co-located voxel of the
    previous frame. `per_voxel`: bit/sample over all voxels. `contexts`: number of different c. `cells`:
    number of different (S, c), K of the dilution. `informed`: number of voxels where S or any part of c is
    not 0, n of the dilution; the others are all one cell. `once`: number of cells that occur only once.
    """

    neighbourhood: str
    previous_frame: bool
    per_voxel: Quantity
    contexts: int
    cells: int
    informed: int
    once: int

    @property
    def is_diluted(self) -> bool:
        """True for fewer than ten informed voxels per cell.

        The plug-in estimate is then far below the truth.
        """
        return self.informed < 10 * self.cells


class ContextCounter:
    """Counter of voxels with the widest context.

    Every narrower context is a marginal of that count. Memory beyond the frames grows with the different
    cells that occur (see `CellCounter`), not with the lattice. `of`: frames with the grid and the Q of those
    to be counted. `previous_frame`: whether to count the co-located voxel of the previous frame, too.
    """

    def __init__(self, of: FieldSymbols | Frames, *, previous_frame: bool) -> None:
        self._bits = max(1, (of.alphabet - 1).bit_length())
        self._cells = CellCounter(9 if previous_frame else 8, self._bits)
        self._previous_frame, self._quantiser = previous_frame, of.quantiser
        self._before = 3 - scan_axis(
            of.grid
        )  # column of the one neighbour; 1 to 3 are those along z, y and x

    def add(self, frame: FieldSymbols, previous: FieldSymbols | None) -> None:
        """Count the voxels of a frame; space away from its bricks is not visited."""
        from touchfield.measure.kernels import field_rows

        grid, before = frame.grid, previous if self._previous_frame else None
        bricks = _reached_bricks(frame, before)
        old_bricks = bricks[:0] if before is None else before.bricks
        symbols, old_symbols = (
            np.array(frame.symbols),
            _NO_FRAME if before is None else np.array(before.symbols),
        )
        counted = 0
        for start in range(0, len(bricks), _BRICKS_AT_ONCE):
            part = bricks[start : start + _BRICKS_AT_ONCE]
            slots, old_slots = (
                neighbour_slots(part, b, grid.brick_shape, 14) for b in (frame.bricks, old_bricks)
            )
            extents = np.clip(np.asarray(grid.shape) - part.astype(np.int64) * BRICK, 0, BRICK)
            rows = np.empty((BRICK**3 * len(part), self._cells.word_count), np.uint64)
            packing = self._cells.columns, self._bits
            count = field_rows(slots, symbols, old_slots, old_symbols, extents, *packing, rows)
            self._cells.add(rows[:count])
            counted += count
        self._cells.zeros += frame.voxel_count - counted

    def symbol_counts(self) -> tuple[Int64s, int]:
        """Return the count of each symbol but 0, int64 [K], and the count of 0."""
        alone = self._cells.marginal((_SYMBOL,))
        counts = alone.counts()[: len(alone.counts()) - bool(alone.zeros)]
        return counts, alone.zeros

    def result(self, neighbourhood: str, *, previous_frame: bool = False) -> ContextEntropy:
        """Return H(S | c) of the counted voxels."""
        neighbours = NEIGHBOURHOODS[neighbourhood]
        columns = (self._before,) if neighbours == 1 else tuple(range(1, 1 + neighbours))
        columns += (_PREVIOUS_FRAME,) * previous_frame
        joint = self._cells.marginal((_SYMBOL, *columns))
        cells = joint.counts()
        contexts = joint.marginal(columns).counts()
        bits = max(0.0, entropy_bits(cells) - entropy_bits(contexts))  # negative only by rounding
        informed = joint.samples - joint.zeros
        notes = [f"{len(contexts)} contexts"]
        if informed < 10 * len(cells):
            notes.append(
                f"diluted: {informed} voxels not all 0 for {len(cells)} cells, fewer than ten each; too low"
            )
        conditions = [f"{neighbours} neighbour{'s' * (neighbours > 1)}"] * (neighbours > 0)
        conditions += ["previous frame"] * previous_frame
        name = f"H(S|{', '.join(conditions)})" if conditions else "H(S)"
        quantity = Quantity(
            name, bits, "bit/sample", self._quantiser, "voxel", "plug-in", joint.samples, len(cells), None,
            tuple(notes),
        )  # fmt: skip
        once = int((cells == 1).sum())
        return ContextEntropy(
            neighbourhood, previous_frame, quantity, len(contexts), len(cells), informed, once
        )


@dataclass(frozen=True)
class CodingLimits:
    """Entropy bounds on the rate of a coder of these frames.

    `voxels`: number of voxels in all frames; `supported` of them are not 0. `voxel_entropy` and
    `object_entropy`: H(S) over all and over the supported voxels (NaN if there is none), bit/sample.
    `contexts`: 1, 3 and 7 neighbours and, if there are several frames, 0, 1, 3 and 7 with the previous frame.
    The one neighbour lies along `scan_axis`: "z", or the last axis with more than one sample.
    """

    frame_count: int
    voxels: int
    supported: int
    voxel_entropy: Quantity
    object_entropy: Quantity
    contexts: tuple[ContextEntropy, ...]
    scan_axis: str = "z"

    def context(self, neighbourhood: str, *, previous_frame: bool = False) -> ContextEntropy:
        """One of `contexts`; KeyError if it is not among them."""
        for context in self.contexts:
            if (context.neighbourhood, context.previous_frame) == (neighbourhood, previous_frame):
                return context
        raise KeyError((neighbourhood, previous_frame))

    def summary(self) -> dict[str, Any]:
        """Plain numbers under stable keys: bits per voxel, supported voxel, and frame."""

        def plain(per_voxel: float) -> dict[str, float | None]:
            return {
                "bits_per_voxel": per_voxel,
                "bits_per_supported_voxel": per_voxel * self.voxels / self.supported
                if self.supported
                else None,
                "bits_per_frame": per_voxel * self.voxels / self.frame_count,
            }

        contexts = {
            c.per_voxel.name: {**plain(c.per_voxel.value), "contexts": c.contexts, "cells": c.cells,
                               "informed": c.informed, "once": c.once, "diluted": c.is_diluted}
            for c in self.contexts
        }  # fmt: skip
        return {
            "quantiser": self.voxel_entropy.quantiser,
            "frames": self.frame_count,
            "voxels": self.voxels,
            "supported_voxels": self.supported,
            "voxel_entropy": plain(self.voxel_entropy.value),
            "object_entropy_bits": self.object_entropy.value if self.supported else None,
            "scan_axis": self.scan_axis,
            "contexts": contexts,
        }


def coding_limits(frames: Fields) -> CodingLimits:
    """Return the coding limits of quantised frames of one grid and one quantiser.

    The frames are read once and in order. The raster's lines run along z, and so does the single neighbour.
    If z has a single sample, as in a flat array of actuators, they run along the last axis with more:
    `scan_axis`.

    InvalidArgument if there is no frame, frames differ in grid or Q, or the joint cells exceed the memory
    budget.
    """
    quantised, last = Frames(frames, "frames"), None
    contexts = ContextCounter(quantised, previous_frame=True)
    for frame in quantised:
        contexts.add(frame, last)
        last = frame
    support_counts, empty = contexts.symbol_counts()
    voxel_counts, quantiser = (
        np.append(support_counts, empty) if empty else support_counts,
        quantised.quantiser,
    )
    requested = [(name, False) for name in NEIGHBOURHOODS if name != "none"]
    if quantised.count > 1:
        requested += [(name, True) for name in NEIGHBOURHOODS]
    supported, unit = int(support_counts.sum()), "bit/sample"
    bits, notes = (entropy_bits(support_counts), ()) if supported else (math.nan, ("no voxel is supported",))
    return CodingLimits(
        quantised.count,
        supported + empty,
        supported,
        Quantity(
            "H(S)",
            entropy_bits(voxel_counts),
            unit,
            quantiser,
            "voxel",
            samples=supported + empty,
            symbols=len(voxel_counts),
        ),
        Quantity(
            "H(S | S != 0)",
            bits,
            unit,
            quantiser,
            "object",
            samples=supported,
            symbols=len(support_counts),
            notes=notes,
        ),
        tuple(contexts.result(name, previous_frame=before) for name, before in requested),
        "xyz"[scan_axis(quantised.grid)],
    )
