"""Options of the device filter, and the lattice of samples that a device gets.

x_hand = scale * (x_scene - offset), with one scale for all axes, where the paper's mapping may stretch. The
workspace is centred on the origin of the hand's space: x to the right, y up, z towards the user; the scene's
x, y, z lie along them. The lattice has "2^n_w samples per dimension" over the nominal workspace, or is the
nominal lattice of its position resolution, or the N x M actuators of an array on their pitch, laid on the
scene's x and y.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from touchfield.errors import InvalidArgument, require_kinds
from touchfield.filters.resample import low_pass
from touchfield.medium import Grid
from touchfield.medium.grid import Placement

if TYPE_CHECKING:
    from touchfield.devices import Device
    from touchfield.sources.laws import ForceProfile

NW_RANGE: Final = (3, 10)
"""Smallest and largest n_w; the paper uses 5 to 7."""


def require_nw(nw: int | None) -> None:
    """Raise `InvalidArgument` unless n_w is within `NW_RANGE` or None (the nominal lattice)."""
    if nw is not None and not (isinstance(nw, int) and NW_RANGE[0] <= nw <= NW_RANGE[1]):
        expected = f"a whole number from {NW_RANGE[0]} to {NW_RANGE[1]}, or the nominal lattice"
        raise InvalidArgument("nw", repr(nw), expected)


def device_grid(device: Device, nw: int | None = None, depth_m: float | None = None) -> Grid:
    """Return the lattice of a device over its workspace, centred on the origin, hand metres.

    nw : int or None; 2^nw samples along each axis; None for the nominal lattice. Arrays ignore it.
    depth_m : float or None; of an array: the depth of the hand's space to pool; None for the profile's.
    Raises `InvalidArgument` if `nw` is not within `NW_RANGE`.
    """
    extents = device.workspace_m
    if device.is_array:
        extents = extents if depth_m is None else (*extents[:2], depth_m)
        shape = device.lattice
    else:
        require_nw(nw)
        shape = device.lattice if nw is None else (2**nw, 2**nw, 2**nw)
    low, high = [-e / 2 for e in extents], [e / 2 for e in extents]
    return Grid.over_box(low, high, shape)


POOLS: Final = ("auto", "max", "mean", "relief")


@dataclass(frozen=True)
class DeviceFilterSpec:
    """The options of the device filter."""

    oversample: int = 2  # scene samples per device sample along an axis, 1 to 8; for an array at least 8
    force_floor_share: float = 0.01  # forces below this fraction of F_max are dropped; 0 keeps all
    low_pass: str = "spline"  # a name of `touchfield.filters.LOW_PASSES`
    # of an array: "max" or "mean" of the forces along the depth, the "relief" as met from above, or
    # "auto": relief where the device shows heights, else max
    pool: str = "auto"
    cutoff: str = "nyquist"  # of an array of pitch d: 1/(2d), or "literal", 2/d as the paper prints

    def __post_init__(self) -> None:
        require_kinds(self, pool=POOLS, cutoff=("nyquist", "literal"))
        if not 1 <= self.oversample <= 8:
            raise InvalidArgument("oversample", repr(self.oversample), "a whole number from 1 to 8")
        if not 0 <= self.force_floor_share < 1:
            raise InvalidArgument(
                "force_floor_share", repr(self.force_floor_share), "a share from 0 to below 1"
            )
        low_pass(self.low_pass)


@dataclass(frozen=True)
class DeviceFilter:
    """The mapping M of a device: its lattice, the placement of the scene, and the force law.

    `grid` is the lattice in hand metres, one sample deep for an array; `profile` is the law in hand metres.
    """

    device: Device
    grid: Grid
    placement: Placement
    profile: ForceProfile
    spec: DeviceFilterSpec = field(default_factory=DeviceFilterSpec)
