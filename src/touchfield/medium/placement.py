"""The place of a scene in a workspace: the similarity from scene metres to hand metres."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, overload

import numpy as np
from numpy.typing import ArrayLike

from touchfield.arrays import Float64s
from touchfield.errors import InvalidArgument
from touchfield.medium.grid import Grid

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
        return cls(scale, tuple(centre.tolist()))

    @classmethod
    def crop(cls, scene_box_m: ArrayLike) -> Placement:
        """Scale 1: the workspace is a window of its own size about the centre of the scene's box."""
        return cls.scaled(scene_box_m, 1.0)

    @classmethod
    def scaled(cls, scene_box_m: ArrayLike, factor: float) -> Placement:
        """A given scale about the centre of the scene's box."""
        centre, _ = _centre_and_extent(scene_box_m)
        return cls(factor, tuple(centre.tolist()))

    @overload
    def to_hand(self, what: Grid) -> Grid: ...
    @overload
    def to_hand(self, what: ArrayLike) -> Float64s: ...
    def to_hand(self, what: Grid | ArrayLike) -> Grid | Float64s:
        """Points of the scene [..., 3], or a grid, metres, where the hand finds them, metres, float64 [..., 3]."""
        if isinstance(what, Grid):
            return what.moved(self.scale, -self.scale * np.asarray(self.offset_m))
        return np.asarray(self.scale * (np.asarray(what, np.float64) - np.asarray(self.offset_m)))

    @overload
    def to_scene(self, what: Grid) -> Grid: ...
    @overload
    def to_scene(self, what: ArrayLike) -> Float64s: ...
    def to_scene(self, what: Grid | ArrayLike) -> Grid | Float64s:
        """Points of the hand's space [..., 3], or a grid, metres, in the scene, metres, float64 [..., 3]."""
        if isinstance(what, Grid):
            return what.moved(1 / self.scale, self.offset_m)
        return np.asarray(np.asarray(what, np.float64) / self.scale + np.asarray(self.offset_m))

    @property
    def wording(self) -> str:
        """The scale in words: 1 mm of the hand is 23.7 mm of the scene."""
        length_m = 1e-3 / self.scale
        unit, size_m = next((u for u in _UNITS if length_m >= u[1]), _UNITS[-1])
        return f"1 mm of the hand is {length_m / size_m:.4g} {unit} of the scene"

    def told(self) -> dict[str, list[float]]:
        """The mapping as files and summaries keep it: x_hand = mapping_scale * (x_scene - mapping_offset_m)."""
        return {"mapping_scale": [self.scale], "mapping_offset_m": list(self.offset_m)}


def _centre_and_extent(scene_box_m: ArrayLike) -> tuple[Float64s, Float64s]:
    box = np.asarray(scene_box_m, np.float64)
    extent = box[1] - box[0] if box.shape == (2, 3) and np.isfinite(box).all() else np.zeros(3)
    if (extent < 0).any() or not extent.any() or not np.isfinite(extent).all():
        expected = "finite low and high corners [2, 3] in metres, not all alike"
        raise InvalidArgument("scene_box_m", f"{box.tolist()}", expected)
    return box[0] + extent / 2, extent


def _workspace(workspace_m: ArrayLike) -> Float64s:
    workspace = np.asarray(workspace_m, np.float64)
    if workspace.shape != (3,) or not (workspace > 0).all():
        raise InvalidArgument("workspace_m", f"{workspace.tolist()}", "three positive extents in metres")
    return workspace
