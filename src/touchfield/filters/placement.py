"""Where the scene lies in the device's workspace, and the lattice there: the first step of the mapping M
(paper sections 3.1, 4.1, 5.1, 5.2).

x_hand = scale * (x_scene - offset), with one scale for all axes: honest, where the paper's mapping may stretch. The
workspace is centred on the origin of the hand's space. A device's box is given along x right, y up, z towards the
user; the scene's x, y, z lie along them.

The lattice is "2^n_w samples per dimension" over the nominal workspace, or the nominal lattice of its position
resolution, or the N x M actuators of an array on their pitch. An array is laid on the scene's x and y whatever the
axes mean, and the third axis is pooled.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, overload

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.medium import Grid

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike, NDArray

    from touchfield.devices import Device
    from touchfield.sources.analytic_scene import AnalyticScene
    from touchfield.sources.profile import ForceProfile

    Float64s = NDArray[np.float64]

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


_UNITS: Final = (("km", 1e3), ("m", 1.0), ("mm", 1e-3), ("um", 1e-6))


@dataclass(frozen=True)
class Placement:
    """The similarity from scene metres to hand metres.

    scale : float; hand metres for one scene metre, positive.
    offset_m : (float, float, float); the point of the scene that lies at the centre of the workspace, scene metres.
    Raises `InvalidArgument` if a number is out of range or not finite.
    """

    scale: float = 1.0
    offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        scale, offset = float(self.scale), tuple(float(x) for x in self.offset_m)
        if not (scale > 0 and math.isfinite(scale) and math.isfinite(1 / scale)):
            raise InvalidArgument("placement scale", repr(self.scale), "a positive number")
        if len(offset) != 3 or not all(map(math.isfinite, offset)):
            raise InvalidArgument("placement offset_m", repr(self.offset_m), "three finite coordinates in metres")
        object.__setattr__(self, "scale", scale)
        object.__setattr__(self, "offset_m", offset)

    @classmethod
    def fit(cls, scene_box_m: ArrayLike, workspace_m: ArrayLike, margin_m: float = 0.0) -> Placement:
        """The scene's box as large as the workspace allows, its aspect kept.

        scene_box_m : float [2, 3]; low and high corner; an axis without extent sets no limit.
        workspace_m : float [3]; extents in the scene's axes; ``inf`` sets no limit.
        margin_m : float; room to leave on every side for forces outside the surface, metres of the hand.
        """
        centre, extent = _centre_and_extent(scene_box_m)
        room = _workspace(workspace_m) - 2 * float(margin_m)
        if not (margin_m >= 0 and (room > 0).all()):
            raise InvalidArgument("margin_m", repr(margin_m), "from 0 to less than half the workspace")
        bounded = (extent > 0) & np.isfinite(room)
        if not bounded.any():
            raise InvalidArgument("workspace_m", "no limit along any extent of the scene", "finite metres")
        scale = float((room[bounded] / extent[bounded]).min())
        return cls(scale, _triple(centre))

    @classmethod
    def crop(cls, scene_box_m: ArrayLike) -> Placement:
        """Scale 1: the workspace is a window of its own size about the centre of the scene's box."""
        return cls.scaled(scene_box_m, 1.0)

    @classmethod
    def scaled(cls, scene_box_m: ArrayLike, factor: float) -> Placement:
        """A given scale about the centre of the scene's box."""
        centre, _ = _centre_and_extent(scene_box_m)
        return cls(factor, _triple(centre))

    @overload
    def to_hand(self, what: Grid) -> Grid: ...
    @overload
    def to_hand(self, what: ArrayLike) -> NDArray[np.float64]: ...
    def to_hand(self, what: Grid | ArrayLike) -> Grid | NDArray[np.float64]:
        """Points of the scene [..., 3], or a grid, metres, where the hand finds them, metres, float64 [..., 3]."""
        if isinstance(what, Grid):
            return what.moved(self.scale, -self.scale * np.asarray(self.offset_m))
        moved: NDArray[np.float64] = self.scale * (np.asarray(what, np.float64) - np.asarray(self.offset_m))
        return moved

    @overload
    def to_scene(self, what: Grid) -> Grid: ...
    @overload
    def to_scene(self, what: ArrayLike) -> NDArray[np.float64]: ...
    def to_scene(self, what: Grid | ArrayLike) -> Grid | NDArray[np.float64]:
        """Points of the hand's space [..., 3], or a grid, metres, in the scene, metres, float64 [..., 3]."""
        if isinstance(what, Grid):
            return what.moved(1 / self.scale, self.offset_m)
        moved: NDArray[np.float64] = np.asarray(what, np.float64) / self.scale + np.asarray(self.offset_m)
        return moved

    @property
    def wording(self) -> str:
        """The scale in words: 1 mm of the hand is 23.7 mm of the scene."""
        length_m = 1e-3 / self.scale
        unit, size_m = next((u for u in _UNITS if length_m >= u[1]), _UNITS[-1])
        return f"1 mm of the hand is {length_m / size_m:.4g} {unit} of the scene"

    def told(self) -> dict[str, list[float]]:
        """The mapping as files and summaries keep it: x_hand = mapping_scale * (x_scene - mapping_offset_m)."""
        return {"mapping_scale": [self.scale], "mapping_offset_m": list(self.offset_m)}


def _centre_and_extent(scene_box_m: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    box = np.asarray(scene_box_m, np.float64)
    expected = "finite low and high corners [2, 3] in metres, not all alike"
    if box.shape != (2, 3) or not np.isfinite(box).all():
        raise InvalidArgument("scene_box_m", f"{box.tolist()}", expected)
    extent = box[1] - box[0]
    if (extent < 0).any() or not extent.any() or not np.isfinite(extent).all():
        raise InvalidArgument("scene_box_m", f"{box.tolist()}", expected)
    return box[0] + extent / 2, extent


def _workspace(workspace_m: ArrayLike) -> NDArray[np.float64]:
    workspace = np.asarray(workspace_m, np.float64)
    if workspace.shape != (3,) or not (workspace > 0).all():
        raise InvalidArgument("workspace_m", f"{workspace.tolist()}", "three positive extents in metres")
    return workspace


def _triple(values: NDArray[np.float64]) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return (x, y, z)


def exact_forces(
    scene: AnalyticScene, placement: Placement, profile_hand: ForceProfile, force_max_n: float
) -> Callable[[Float64s], Float64s]:
    """The force of shapes with a formula at points of the hand, clipped to F_max.

    profile_hand : ForceProfile; the force law in hand metres.
    Returns callable: ``forces(points_m float64 [n, 3]) -> newtons float64 [n, 3]``.
    """
    law = profile_hand.rescaled(placement.scale)
    offset_m = np.asarray(placement.offset_m)

    def forces(points_m: Float64s) -> Float64s:
        found = scene.forces_n(points_m / placement.scale + offset_m, law)
        size = np.linalg.norm(found, axis=1, keepdims=True)
        clipped: Float64s = found * (force_max_n / np.maximum(size, force_max_n))
        return clipped

    return forces
