"""H(S | causal neighbours) and H(S | causal neighbours, previous frame): the coding limit of theory section 5.

A coder that visits the voxels in raster order (x slowest, z fastest) knows, of each voxel, the neighbours with no
greater index along any axis. Neighbourhoods are nested corners of the 2^3 cube of such neighbours:

========== ========== ==========================================================
name       neighbours which
========== ========== ==========================================================
none       0          nothing: H(S)
previous   1          the one before in raster order, (0, 0, -1)
axes       3          one before along each axis
corner     7          all of {-1, 0}^3 but the voxel itself
========== ========== ==========================================================

and each may take in the co-located voxel of the previous frame. For arrays of fewer axes, the missing ones are empty;
a field of one sample along z is such an array (`scan_order`), and its "previous" lies along its last longer axis.
The estimate is H(S, c) - H(c) over one exact count, so that with the plug-in H(S | c) falls as c grows, whatever the
data. The same law makes it *too low*: contexts dilute, and a context seen once costs nothing. `ContextEntropy` says
how diluted it is; what a coder can surely reach is in `prequential`.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Int64s
from touchfield.errors import InvalidArgument
from touchfield.measure.causal import (
    CellCounter,
    array_frames,
    array_of,
    boxes_of,
    extents_of,
    frames_of,
    haloed,
    reached_bricks,
    scan_relabelled,
)
from touchfield.measure.estimators import estimate_bits
from touchfield.measure.quantity import FewSamplesWarning, Quantity
from touchfield.medium.field import slots_around

if TYPE_CHECKING:
    from touchfield.measure.field_symbols import FieldSymbols


NEIGHBOURHOODS: Final = {"none": 0, "previous": 1, "axes": 3, "corner": 7}
"""Names, and how many causal neighbours each takes."""

_SYMBOL, _PREVIOUS_FRAME = 0, 8  # columns of a row
_BRICKS_AT_ONCE = 1024
_VOXELS_AT_ONCE = 1 << 16
_NO_FRAME = np.zeros((0, 8, 8, 8), np.int32)


@dataclass(frozen=True)
class ContextEntropy:
    """H(S | c) and how far to trust it.

    `neighbourhood`: one of `NEIGHBOURHOODS`. `previous_frame`: whether c takes in the co-located voxel of the
    previous frame. `per_voxel`: bit/sample over all voxels. `per_supported`: the same bits over the voxels that are
    not 0; NaN where there is none. `contexts`: how many different c were seen. `cells`: how many different (S, c)
    were seen; K of the dilution. `informed`: voxels where S or any part of c is not 0: n of the dilution. The
    others are all one cell. `once`: cells that were seen only once.
    """

    neighbourhood: str
    previous_frame: bool
    per_voxel: Quantity
    per_supported: Quantity
    contexts: int
    cells: int
    informed: int
    once: int

    def of(self, quantiser: str, weighting: str) -> ContextEntropy:
        """The same with Q and mu, which only the caller knows."""
        return replace(
            self,
            per_voxel=self.per_voxel.of(quantiser=quantiser, weighting=weighting),
            per_supported=self.per_supported.of(quantiser=quantiser, weighting=weighting),
        )

    @property
    def is_diluted(self) -> bool:
        """Fewer than ten informed voxels to a cell: the plug-in is far below the truth."""
        return self.informed < 10 * self.cells

    def summary(self) -> dict[str, Any]:
        """Plain values under stable keys."""
        return {
            "neighbourhood": self.neighbourhood,
            "previous_frame": self.previous_frame,
            "per_voxel": self.per_voxel.summary(),
            "per_supported": self.per_supported.summary(),
            "contexts": self.contexts,
            "cells": self.cells,
            "informed": self.informed,
            "once": self.once,
            "diluted": self.is_diluted,
        }


class ContextCounter:
    """Counts voxels with the widest context, frame after frame; every narrower one is a marginal of that count.

    Memory beyond the frames grows with the different cells that are there (see `CellCounter`), never with the
    lattice or the array: bricks, and boxes of an array, are looked at some at a time.

    `alphabet`: symbols are below it. `previous_frame`: whether to count the co-located voxel of the previous frame,
    too.
    """

    def __init__(self, alphabet: int, *, previous_frame: bool) -> None:
        self._bits = max(1, (alphabet - 1).bit_length())
        self._cells = CellCounter(9 if previous_frame else 8, self._bits)
        self._previous_frame = previous_frame

    def add_field(self, frame: FieldSymbols, previous: FieldSymbols | None) -> None:
        """Count the voxels of a sparse frame; space away from its bricks in closed form."""
        from touchfield.measure.kernels.context import field_rows

        before = previous if self._previous_frame else None
        bricks = reached_bricks(frame.grid, frame, before)
        old_bricks = bricks[:0] if before is None else before.bricks
        symbols = (np.array(frame.symbols), _NO_FRAME if before is None else np.array(before.symbols))
        counted = 0
        for start in range(0, len(bricks), _BRICKS_AT_ONCE):
            part = bricks[start : start + _BRICKS_AT_ONCE]
            slots = (
                slots_around(part, frame.bricks, frame.grid.brick_shape),
                slots_around(part, old_bricks, frame.grid.brick_shape),
            )
            rows = field_rows(slots, symbols, extents_of(frame.grid, part), self._cells.columns, self._bits)
            self._cells.add(rows)
            counted += len(rows)
        self._cells.add_zeros(frame.voxel_count - counted)

    def add_array(self, frame: NDArray[Any], previous: NDArray[Any] | None) -> None:
        """Count the voxels of a dense frame, int [nx, ny, nz], box after box."""
        from touchfield.measure.kernels.context import REACH, block_rows

        for box in boxes_of(frame.shape, _VOXELS_AT_ONCE):
            now = haloed(frame, box, REACH, 0)
            old = np.zeros_like(now) if previous is None else haloed(previous, box, REACH, 0)
            nx, ny, nz = (n - REACH for n in now.shape)
            rows = block_rows(now, old, (nx, ny, nz), self._cells.columns, self._bits)
            self._cells.add(rows)
            self._cells.add_zeros(nx * ny * nz - len(rows))

    def symbol_counts(self) -> tuple[Int64s, int]:
        """How often each symbol but 0 was counted, int64 [K], and how often 0."""
        alone = self._cells.marginal((_SYMBOL,))
        held = alone.counts()[: len(alone.counts()) - bool(alone.zeros)]
        return held, alone.zeros

    def result(
        self, neighbourhood: str, *, previous_frame: bool = False, estimator: str = "plug-in"
    ) -> ContextEntropy:
        """H(S | c) of what was counted.

        InvalidArgument if the neighbourhood or the estimator is unknown, or the previous frame was not counted.
        """
        if neighbourhood not in NEIGHBOURHOODS:
            raise InvalidArgument("neighbourhood", repr(neighbourhood), f"one of {', '.join(NEIGHBOURHOODS)}")
        if previous_frame and not self._previous_frame:
            raise InvalidArgument("previous_frame", "True", "a medium with frames, as FieldSymbols or [t, x, y, z]")
        known = tuple(range(1, 1 + NEIGHBOURHOODS[neighbourhood])) + (_PREVIOUS_FRAME,) * previous_frame
        joint = self._cells.marginal((_SYMBOL, *known))
        cells = joint.counts()
        contexts = joint.marginal(known).counts()
        bits = estimate_bits(cells, estimator) - estimate_bits(contexts, estimator)
        informed = joint.samples - joint.zeros
        notes = [f"{len(contexts)} contexts"]
        if informed < 10 * len(cells):
            notes.append(f"diluted: {informed} voxels not all 0 for {len(cells)} cells, fewer than ten each; too low")
        if estimator == "plug-in":
            bits = max(0.0, bits)  # below only by rounding
        elif bits < 0:
            notes.append("negative by the correction of its bias")
        name = _name(NEIGHBOURHOODS[neighbourhood], previous_frame)
        quantity = Quantity(
            name, bits, "bit/sample", weighting="voxel", estimator=estimator,
            samples=joint.samples, symbols=len(cells), notes=tuple(notes),
        )  # fmt: skip
        supported = per_supported(quantity, joint.samples, int(self.symbol_counts()[0].sum()))
        once = int((cells == 1).sum())
        return ContextEntropy(
            neighbourhood, previous_frame, quantity, supported, len(contexts), len(cells), informed, once
        )


def _name(neighbours: int, previous_frame: bool) -> str:
    given = [f"{neighbours} neighbour{'s' * (neighbours > 1)}"] * (neighbours > 0)
    given += ["previous frame"] * previous_frame
    return f"H(S|{', '.join(given)})" if given else "H(S)"


def per_supported(quantity: Quantity, samples: int, supported: int) -> Quantity:
    """Bits a sample as bits a supported voxel; NaN with a note where no voxel is supported."""
    unit = "bit/supported voxel"
    if supported:
        return quantity.times(samples / supported, unit)
    return quantity.of(value=float("nan"), unit=unit, notes=(*quantity.notes, "no voxel is supported"))


def context_entropy(
    frames: Any, neighbourhood: str = "axes", *, previous_frame: bool = False, estimator: str = "plug-in"
) -> ContextEntropy:
    """H(S | c) of symbols, bits a voxel.

    InvalidArgument for values that are not symbols, an unknown name, or a previous frame of a single array.
    FewSamplesWarning if there are fewer than ten informed voxels to a cell.

    Parameters
    ----------
    frames : int array of 1 to 4 dimensions, FieldSymbols, or an iterable of FieldSymbols
        Symbols from 0 (no force) on; the first of four axes is time.
    neighbourhood : {"none", "previous", "axes", "corner"}
        0, 1, 3 or 7 causal neighbours (1, 2 and 3 of a picture, 1 of a sequence).
    previous_frame : bool
        Whether to condition on the co-located voxel of the previous frame; before the first there is only 0.
    estimator : str
        Of both entropies, one of `ESTIMATORS`.

    Examples
    --------
    >>> import numpy as np
    >>> context_entropy(np.arange(10_000) % 2, "previous").per_voxel.value < 0.002
    True
    """
    if neighbourhood not in NEIGHBOURHOODS:  # before the work, and not after it
        raise InvalidArgument("neighbourhood", repr(neighbourhood), f"one of {', '.join(NEIGHBOURHOODS)}")
    x = array_of("frames", frames)
    if x is not None:
        found = _counted_array(x, previous_frame).result(
            neighbourhood, previous_frame=previous_frame, estimator=estimator
        )
        found = found.of("as given", "samples")
    else:
        counter, quantiser = _counted_fields(frames, previous_frame)
        found = counter.result(neighbourhood, previous_frame=previous_frame, estimator=estimator)
        found = found.of(quantiser, "voxel")
    if found.is_diluted:
        warnings.warn(f"{found.per_voxel.name}: {found.per_voxel.notes[1]}", FewSamplesWarning, stacklevel=2)
    return found


def _counted_array(x: NDArray[Any], previous_frame: bool) -> ContextCounter:
    if previous_frame and x.ndim != 4:
        raise InvalidArgument("previous_frame", f"True with an array of shape {x.shape}", "four axes, time first")
    counter = ContextCounter(int(x.max()) + 1, previous_frame=previous_frame)
    before = None
    for frame in array_frames(x):
        counter.add_array(frame, before)
        before = frame
    return counter


def _counted_fields(frames: Any, previous_frame: bool) -> tuple[ContextCounter, str]:
    counter, before = None, None
    for frame in map(scan_relabelled, frames_of(frames)):
        counter = counter or ContextCounter(frame.alphabet, previous_frame=previous_frame)
        counter.add_field(frame, before)
        before = frame
    assert counter is not None and before is not None  # frames_of refuses none
    return counter, before.quantiser
