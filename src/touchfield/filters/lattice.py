"""The lattice that a device can show, in hand metres (paper sections 3.1, 5.1 and 5.2).

"2^n_w samples per dimension" over the nominal workspace, or the nominal lattice of its position resolution
(the Omni's 8e9 samples of table 1), or the N x M actuators of an array on their pitch.

An array is laid on the scene's x and y whatever the axes mean, and the third axis is pooled.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from touchfield.errors import InvalidArgument
from touchfield.medium import Grid

if TYPE_CHECKING:
    from touchfield.devices import Device

__all__ = ["NW_RANGE", "device_grid"]

NW_RANGE: Final = (3, 10)
"""Least and greatest n_w; the paper takes 5 to 7."""


def device_grid(device: Device, nw: int | None = None, depth_m: float | None = None) -> Grid:
    """The lattice of a device over its workspace, centred on the origin, hand metres.

    nw : int or None; 2^nw samples along each axis; None for the nominal lattice. An array has its own lattice: no
        effect.
    depth_m : float or None; of an array: how much of the hand's depth is pooled; None for the profile's.
    Raises `InvalidArgument` if `nw` is not within `NW_RANGE`.
    """
    extents = device.workspace_m
    if device.is_array:
        extents = extents if depth_m is None else (*extents[:2], depth_m)
        shape = device.lattice
    elif nw is None:
        shape = device.lattice
    elif isinstance(nw, int) and NW_RANGE[0] <= nw <= NW_RANGE[1]:
        shape = (2**nw, 2**nw, 2**nw)
    else:
        raise InvalidArgument(
            "nw", repr(nw), f"a whole number from {NW_RANGE[0]} to {NW_RANGE[1]}, or the nominal lattice"
        )
    low, high = [-e / 2 for e in extents], [e / 2 for e in extents]
    return Grid.over_box(low, high, shape)
