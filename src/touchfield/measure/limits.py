"""The limits of coding a medium, so that a codec can be placed against its own data (theory sections 4 and 5).

Beside each other stand, of the same symbols S = Q(F) over all voxels of all frames: H(S) of the voxel and of the
object; block entropies and rates of the scan lines; H(S | causal neighbours), with and without the previous frame;
and the prequential code length. All but the last are plug-in estimates of what an ideal coder with that context would
need, too low where contexts are diluted; the last is what a real one surely reaches. A codec that does better than
the last knows more of the medium than its neighbouring symbols.

Time: one pass over the frames, which may be a generator. Memory: two frames, the different joint cells
(`CellCounter`) and the tables of the code.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.measure.block_rate import BlockCounter, BlockRates, over_voxels
from touchfield.measure.causal import frames_of, scan_order, scan_relabelled
from touchfield.measure.context import NEIGHBOURHOODS, ContextCounter, ContextEntropy
from touchfield.measure.estimators import estimate_bits
from touchfield.measure.prequential import PrequentialCoder, PrequentialLength
from touchfield.measure.quantity import Quantity

if TYPE_CHECKING:
    from touchfield.measure.field_symbols import FieldSymbols

__all__ = ["CodingLimits", "coding_limits"]

LINE_AXIS: Final = 2
"""Scan lines run along the fastest axis of the raster: z, or after `scan_relabelled` the one in its place."""


@dataclass(frozen=True)
class CodingLimits:
    """What a coder of these frames can hope for, and what it surely reaches.

    Attributes
    ----------
    frame_count : int
    voxels : int
        Of all frames.
    supported : int
        Of these, not 0.
    voxel_entropy : Quantity
        H(S) over all voxels, bit/sample.
    object_entropy : Quantity
        H(S) over the supported voxels, bit/sample; NaN where there is none.
    scan_lines : BlockRates
        Of the lines along `scan_axis`.
    contexts : tuple of ContextEntropy
        1, 3 and 7 neighbours; and with the previous frame, where there is one, 0, 1, 3 and 7.
    prequential : PrequentialLength
    scan_axis : str
        The axis that the scan lines run along, and that the one neighbour lies along: "z", or the last that has more
        than one sample.
    """

    frame_count: int
    voxels: int
    supported: int
    voxel_entropy: Quantity
    object_entropy: Quantity
    scan_lines: BlockRates
    contexts: tuple[ContextEntropy, ...]
    prequential: PrequentialLength
    scan_axis: str = "z"

    def context(self, neighbourhood: str, *, previous_frame: bool = False) -> ContextEntropy:
        """One of `contexts`; KeyError if it is not among them."""
        for found in self.contexts:
            if (found.neighbourhood, found.previous_frame) == (neighbourhood, previous_frame):
                return found
        raise KeyError((neighbourhood, previous_frame))

    def summary(self) -> dict[str, Any]:
        """Plain numbers under stable keys: bits a voxel, bits a supported voxel, bits a frame."""
        per_frame = self.voxels / self.frame_count

        def plain(per_voxel: float) -> dict[str, float | None]:
            supported = per_voxel * self.voxels / self.supported if self.supported else None
            return {
                "bits_per_voxel": per_voxel,
                "bits_per_supported_voxel": supported,
                "bits_per_frame": per_voxel * per_frame,
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
            "scan_lines": {q.name: plain(q.value) for q in self.scan_lines.rates},
            "contexts": contexts,
            "prequential": {
                **plain(self.prequential.per_voxel.value),
                "total_bits": self.prequential.total_bits,
                "frame_bits": [f.total for f in self.prequential.frames],
            },
        }


def coding_limits(
    frames: FieldSymbols | Iterable[FieldSymbols], *, split: int | None = None, longest: int = 4
) -> CodingLimits:
    """The coding limits of quantised frames.

    Parameters
    ----------
    frames : FieldSymbols, or an iterable of them
        Of one grid and one Q; looked at once, in order.
    split : int, optional
        The number of directions in a symbol, for the prequential code; see `PrequentialCoder`.
    longest : int
        The longest block of the scan lines; shortened to the samples along them.

    Returns
    -------
    CodingLimits

    Raises
    ------
    InvalidArgument
        If there is no frame, frames differ in grid or Q, a number is out of range, or the joint cells outgrow the
        memory budget.

    Notes
    -----
    Scan lines run along z, and the one neighbour lies there. Where z has a single sample, as on a flat array of
    actuators, both go along the last axis that has more, and the raster is that of an array without z: `scan_order`.
    """
    tools, count, last = None, 0, None
    for given in frames_of(frames):
        frame = scan_relabelled(given)
        tools = tools or _Tools(frame, split, longest, scan_order(given.grid)[LINE_AXIS])
        tools.add(frame, last)
        count, last = count + 1, frame
    assert tools is not None and last is not None  # frames_of refuses none
    return tools.result(count, last.quantiser)


class _Tools:
    """The counters that each frame goes through."""

    def __init__(self, frame: FieldSymbols, split: int | None, longest: int, axis: int) -> None:
        self.axis = axis
        self.contexts = ContextCounter(frame.alphabet, previous_frame=True)
        self.blocks = BlockCounter(frame.alphabet, min(longest, frame.grid.shape[LINE_AXIS]))
        self.coder = PrequentialCoder(frame.alphabet, split)

    def add(self, frame: FieldSymbols, previous: FieldSymbols | None) -> None:
        self.contexts.add_field(frame, previous)
        self.blocks.add_field(frame, LINE_AXIS)
        self.coder.add_field(frame)

    def result(self, frame_count: int, quantiser: str) -> CodingLimits:
        held, empty = self.contexts.symbol_counts()
        supported = int(held.sum())
        voxel = _entropy("H(S)", np.append(held, empty) if empty else held, quantiser, "voxel")
        asked = [(name, False) for name in NEIGHBOURHOODS if name != "none"]
        if frame_count > 1:
            asked += [(name, True) for name in NEIGHBOURHOODS]
        found = (self.contexts.result(name, previous_frame=before) for name, before in asked)
        return CodingLimits(
            frame_count,
            supported + empty,
            supported,
            voxel,
            _entropy("H(S | S != 0)", held, quantiser, "object"),
            over_voxels(self.blocks.result(), quantiser),
            tuple(c.of(quantiser, "voxel") for c in found),
            self.coder.result(quantiser, "voxel"),
            "xyz"[self.axis],
        )


def _entropy(name: str, counts: Any, quantiser: str, weighting: str) -> Quantity:
    if not len(counts):
        return Quantity(name, float("nan"), "bit/sample", quantiser, weighting, notes=("no voxel is supported",))
    n = int(counts.sum())
    notes = () if n >= 10 * len(counts) else (f"{n} samples of {len(counts)} symbols, fewer than ten each; too low",)
    return Quantity(
        name, estimate_bits(counts), "bit/sample", quantiser, weighting, "plug-in", n, len(counts), None, notes
    )
