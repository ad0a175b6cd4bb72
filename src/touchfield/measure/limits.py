"""The limits of coding a medium, so that a codec can be placed against its own data (theory sections 4 and 5).

Beside each other stand, of the same symbols S = Q(F) over all voxels of all frames: H(S) of the voxel and of the
object; H(S | causal neighbours), with and without the previous frame. All are plug-in estimates of what an ideal
coder with that context would need, too low where contexts are diluted. What a real coder surely reaches is what one
did: the bytes of a file of coder `touch` in its exact mode.

Time: one pass over the frames, which may be made when asked for. Memory: two frames and the different joint cells
(`CellCounter`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from touchfield.measure.context import NEIGHBOURHOODS, ContextCounter, ContextEntropy, scan_order, scan_relabelled
from touchfield.measure.estimators import entropy_bits
from touchfield.measure.field_symbols import Fields, Frames
from touchfield.measure.quantity import Quantity

LINE_AXIS: Final = 2
"""Scan lines run along the fastest axis of the raster: z, or after `scan_relabelled` the one in its place."""


@dataclass(frozen=True)
class CodingLimits:
    """Rates that a coder of these frames can hope for.

    Of `voxels` in all frames `supported` are not 0. `voxel_entropy` and `object_entropy`: H(S) over all and over the
    supported voxels (NaN where there is none), bit/sample. `contexts`: 1, 3 and 7 neighbours; and with the previous
    frame, where there is one, 0, 1, 3 and 7. The one neighbour lies along `scan_axis`: "z", or the last axis that has
    more than one sample.
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
        for one in self.contexts:
            if (one.neighbourhood, one.previous_frame) == (neighbourhood, previous_frame):
                return one
        raise KeyError((neighbourhood, previous_frame))

    def summary(self) -> dict[str, Any]:
        """Plain numbers under stable keys: bits a voxel, bits a supported voxel, bits a frame."""

        def plain(per_voxel: float) -> dict[str, float | None]:
            return {
                "bits_per_voxel": per_voxel,
                "bits_per_supported_voxel": per_voxel * self.voxels / self.supported if self.supported else None,
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
    """The coding limits of quantised frames, of one grid and one Q, looked at once, in order.

    The raster's lines run along z, and the one neighbour lies there. Where z has a single sample, as on a flat array
    of actuators, they go along the last axis that has more, as in an array without z: `scan_order`.

    InvalidArgument if there is no frame, frames differ in grid or Q, or the joint cells outgrow the memory budget.
    """
    contexts, count, axis, last = None, 0, LINE_AXIS, None
    for given in Frames(frames, "frames"):
        frame = scan_relabelled(given)
        if contexts is None:
            axis = scan_order(given.grid)[LINE_AXIS]
            contexts = ContextCounter(frame.alphabet, frame.quantiser, previous_frame=True)
        contexts.add(frame, last)
        count, last = count + 1, frame
    assert contexts is not None and last is not None  # Frames refuses none
    held, empty = contexts.symbol_counts()
    every, quantiser = np.append(held, empty) if empty else held, last.quantiser
    asked = [(name, False) for name in NEIGHBOURHOODS if name != "none"]
    if count > 1:
        asked += [(name, True) for name in NEIGHBOURHOODS]
    supported, unit = int(held.sum()), "bit/sample"
    bits, notes = (entropy_bits(held), ()) if supported else (math.nan, ("no voxel is supported",))
    return CodingLimits(
        count,
        supported + empty,
        supported,
        Quantity(
            "H(S)", entropy_bits(every), unit, quantiser, "voxel", samples=supported + empty, symbols=len(every)
        ),
        Quantity("H(S | S != 0)", bits, unit, quantiser, "object", samples=supported, symbols=len(held), notes=notes),
        tuple(contexts.result(name, previous_frame=before) for name, before in asked),
        "xyz"[axis],
    )
