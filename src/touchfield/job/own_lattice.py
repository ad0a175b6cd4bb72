"""The lattice of a stored field that is to be kept without loss: its own, as the device's would change its forces."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.filters.placement import Placement
from touchfield.medium import Grid, HapticMedium

if TYPE_CHECKING:
    from touchfield.devices import Device
    from touchfield.job.spec import EncodeSpec
    from touchfield.sources.scene import Scene

__all__ = ["own_lattice"]

_ROUNDING_M = 1e-9


def own_lattice(scene: Scene, chosen: Device, spec: EncodeSpec) -> tuple[Placement, Grid] | None:
    """Where a stored field lies in the workspace that keeps its samples: where it is, or moved to the middle.

    Parameters
    ----------
    scene : Scene
    chosen : Device
    spec : EncodeSpec
        A factor as its `mapping` makes the lattice larger or smaller by that, and its forces no other.

    Returns
    -------
    (Placement, Grid) or None
        The lattice in hand metres; None where nothing stored is to be kept without loss, or an array takes it.

    Raises
    ------
    InvalidArgument
        If the field is larger than the workspace.
    """
    stored = getattr(scene, "medium", None)
    if spec.coder != "touch" or spec.touch.mode != "lossless" or chosen.is_array:
        return None
    if not isinstance(stored, HapticMedium):
        return None
    half, box = np.asarray(chosen.workspace_m) / 2 + _ROUNDING_M, np.stack(stored.grid.box_m)
    factor = 1.0 if spec.mapping in ("fit", "crop") else float(spec.mapping)
    if factor == 1.0 and (np.abs(box) <= half).all():
        return Placement(), stored.grid
    if not (factor * np.ptp(box, axis=0) <= 2 * half).all():
        size, room = (" x ".join(f"{1e3 * side:.4g}" for side in s) for s in (factor * np.ptp(box, axis=0), 2 * half))
        raise InvalidArgument(
            "--lossless-quantised",
            f"a stored field of {size} mm in a workspace of {room} mm",
            "one that fits, as the samples of another lattice would be other forces",
            "Take a larger --device, a --mapping factor that makes it fit, or --mode mask.",
        )
    placement = Placement.scaled(box, factor)
    return placement, placement.to_hand(stored.grid)
