"""`Grid`: a regular lattice of sample points. `Placement`: how a scene is scaled and moved into the workspace
of a device.

A placement maps scene metres to hand metres.

The paper samples the workspace "with 2^n_w samples per dimension" (section 5.2). Sample (i, j, k) lies at
``origin_m + (i, j, k) * spacing_m`` and represents the cell of that size around it, so that the box of a grid
extends half a spacing beyond its first and last samples.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, overload

import numpy as np
from numpy.typing import ArrayLike

from touchfield.arrays import Float64s
from touchfield.errors import InvalidArgument

BRICK = 8
"""Samples along each edge of a brick (docs/decisions/0001)."""

ON_A_SAMPLE: Final = (
    1e-6  # of the spacing: a point this near to a sample lies on it, so whole steps are exact
)

CORNERS: Final = np.indices((2, 2, 2), np.int32).reshape(3, 8).T.copy()
"""The corners of a cube of edge 1, z fastest, int32 [8, 3]."""

LOCAL: Final = np.stack([*np.indices((BRICK,) * 3)], axis=-1)
"""Indices of the samples within a brick, int64 [8, 8, 8, 3]."""

MAX_SAMPLES_PER_AXIS = 1 << 20
MAX_M = 1e100  # of a spacing, its inverse and an origin: products of two are finite


@dataclass(frozen=True)
class Grid:
    """A regular lattice of sample points.

    shape : (int, int, int); samples along x, y, z; 1 to 2^20 each.
    spacing_m : (float, float, float); distance between neighbouring samples, metres, positive.
    origin_m : (float, float, float); position of sample (0, 0, 0), metres.
    Raises `InvalidArgument` if a number is out of range or not finite.
    """

    shape: tuple[int, int, int]
    spacing_m: tuple[float, float, float]
    origin_m: tuple[float, float, float]

    def __post_init__(self) -> None:
        try:
            shape = tuple(int(n) for n in self.shape)
            spacing = tuple(float(h) for h in self.spacing_m)
            origin = tuple(float(x) for x in self.origin_m)
        except (TypeError, ValueError, OverflowError):
            found = f"{self.shape!r}, {self.spacing_m!r}, {self.origin_m!r}"
            raise InvalidArgument("grid", found, "three numbers each: samples, spacing_m, origin_m") from None
        if (
            len(shape) != 3
            or any(not 1 <= n <= MAX_SAMPLES_PER_AXIS for n in shape)
            or shape != tuple(self.shape)
        ):
            raise InvalidArgument(
                "grid shape", repr(self.shape), f"three counts from 1 to {MAX_SAMPLES_PER_AXIS}"
            )
        if len(spacing) != 3 or any(not 1 / MAX_M <= h <= MAX_M for h in spacing):
            expected = f"three lengths from {1 / MAX_M:g} to {MAX_M:g} m"
            raise InvalidArgument("grid spacing_m", repr(self.spacing_m), expected)
        if len(origin) != 3 or not all(abs(x) <= MAX_M for x in origin):
            expected = f"three coordinates of at most {MAX_M:g} m"
            raise InvalidArgument("grid origin_m", repr(self.origin_m), expected)
        object.__setattr__(self, "shape", shape)
        object.__setattr__(self, "spacing_m", spacing)
        object.__setattr__(self, "origin_m", origin)

    @property
    def description(self) -> str:
        """Samples and spacing as short text."""
        shape = " x ".join(map(str, self.shape))
        return f"{shape} samples of {' x '.join(f'{1e3 * h:.4g}' for h in self.spacing_m)} mm"

    @classmethod
    def over_box(cls, low_m: ArrayLike, high_m: ArrayLike, shape: tuple[int, int, int]) -> Grid:
        """Return the grid whose cells fill the box from `low_m` to `high_m`, metres."""
        try:
            low, high, count = (np.asarray(v, float).reshape(3) for v in (low_m, high_m, shape))
        except (TypeError, ValueError):
            found = f"{low_m!r}, {high_m!r}, {shape!r}"
            raise InvalidArgument(
                "grid over a box", found, "three numbers each: low_m, high_m, shape"
            ) from None
        spacing = (high - low) / count
        origin = low + spacing / 2
        return cls(shape, tuple(spacing.tolist()), tuple(origin.tolist()))

    @property
    def voxel_count(self) -> int:
        """V, the number of samples (the paper's 2^n_w x 2^n_w x 2^n_w)."""
        return math.prod(self.shape)

    @property
    def brick_shape(self) -> tuple[int, int, int]:
        """Number of bricks along x, y, z; the last ones may extend beyond the grid."""
        nx, ny, nz = self.shape
        return (-(-nx // BRICK), -(-ny // BRICK), -(-nz // BRICK))

    @property
    def box_m(self) -> tuple[Float64s, Float64s]:
        """Low and high corner of the cells, metres, each float64 [3]."""
        spacing = np.asarray(self.spacing_m)
        low = np.asarray(self.origin_m) - spacing / 2
        return low, low + spacing * np.asarray(self.shape)

    def axis_m(self, axis: int) -> Float64s:
        """Return the positions of the samples along an axis, metres, float64 [n]."""
        indices = np.arange(self.shape[axis], dtype=np.float64)
        return np.asarray(self.origin_m[axis] + self.spacing_m[axis] * indices)

    @property
    def coordinates(self) -> dict[str, tuple[str, Float64s, dict[str, str]]]:
        """Coordinates of xarray: for each axis its name, positions in metres, and attributes."""
        return {name: (name, self.axis_m(axis), {"units": "m"}) for axis, name in enumerate("xyz")}

    def to_m(self, index: ArrayLike) -> Float64s:
        """Convert (fractional) indices [..., 3] to positions in metres, float64 [..., 3]."""
        return np.asarray(
            np.asarray(self.spacing_m) * np.asarray(index, np.float64) + np.asarray(self.origin_m)
        )

    def to_index(self, position_m: ArrayLike) -> Float64s:
        """Convert positions in metres [..., 3] to fractional indices, float64 [..., 3]."""
        offset = np.asarray(position_m, np.float64) - np.asarray(self.origin_m)
        return np.asarray(offset / np.asarray(self.spacing_m))

    def refined(self, factor: int) -> Grid:
        """Return the grid over the same box with `factor` times the samples per axis."""
        low, high = self.box_m
        nx, ny, nz = self.shape
        return Grid.over_box(low, high, (nx * factor, ny * factor, nz * factor))

    def padded(self, margins: tuple[int, int, int]) -> Grid:
        """Return the grid with `margins` additional samples at both ends of each axis."""
        x, y, z = (n + 2 * m for n, m in zip(self.shape, margins, strict=True))
        return Grid((x, y, z), self.spacing_m, tuple(self.to_m(np.negative(margins)).tolist()))

    def is_close(self, other: Grid) -> bool:
        """Return True if both grids have the same samples.

        Positions may differ by less than 1e-6 of the spacing of `other`.
        """
        corners_m = [
            np.stack([grid.origin_m, grid.to_m(np.subtract(grid.shape, 1))]) for grid in (self, other)
        ]
        return self.shape == other.shape and bool(
            (np.abs(corners_m[0] - corners_m[1]) < 1e-6 * np.array(other.spacing_m)).all()
        )

    def moved(self, scale: float, offset_m: ArrayLike) -> Grid:
        """Return the grid after the map x -> scale * x + offset."""
        origin = np.asarray(self.origin_m) * scale + np.asarray(offset_m, float)
        spacing = np.asarray(self.spacing_m) * scale
        return Grid(self.shape, tuple(spacing.tolist()), tuple(origin.tolist()))


_UNITS: Final = (("km", 1e3), ("m", 1.0), ("mm", 1e-3), ("um", 1e-6))


@dataclass(frozen=True)
class Placement:
    """The similarity from scene metres to hand metres.

    scale : float; hand metres for one scene metre, positive.
    offset_m : (float, float, float); the point of the scene that lies at the centre of the workspace, scene
        metres.
    Raises `InvalidArgument` if a number is out of range or not finite.
    """

    scale: float = 1.0
    offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        scale, offset = float(self.scale), tuple(float(x) for x in self.offset_m)
        if not 1 / MAX_M <= scale <= MAX_M:
            raise InvalidArgument("placement scale", repr(self.scale), f"{1 / MAX_M:g} to {MAX_M:g}")
        if len(offset) != 3 or not all(abs(x) <= MAX_M for x in offset):
            expected = f"three coordinates of at most {MAX_M:g} m"
            raise InvalidArgument("placement offset_m", repr(self.offset_m), expected)
        object.__setattr__(self, "scale", scale)
        object.__setattr__(self, "offset_m", offset)

    @classmethod
    def fit(cls, scene_box_m: ArrayLike, workspace_m: ArrayLike, margin_m: float = 0.0) -> Placement:
        """Scale the scene's box to the workspace, with its aspect ratio preserved.

        scene_box_m : float [2, 3]; low and high corner; an axis without extent sets no limit.
        workspace_m : float [3]; extents in the scene's axes; ``inf`` sets no limit.
        margin_m : float; margin on every side for forces outside the surface, metres of the hand.
        """
        centre, extent = _centre_and_extent(scene_box_m)
        workspace = np.asarray(workspace_m, np.float64)
        if workspace.shape != (3,) or not (workspace > 0).all():
            raise InvalidArgument("workspace_m", f"{workspace.tolist()}", "three positive extents in metres")
        available = workspace - 2 * float(margin_m)
        if not (margin_m >= 0 and (available > 0).all()):
            raise InvalidArgument("margin_m", repr(margin_m), "from 0 to less than half the workspace")
        bounded = (extent > 0) & np.isfinite(available)
        if not bounded.any():
            raise InvalidArgument("workspace_m", "no limit along any extent of the scene", "finite metres")
        with np.errstate(over="ignore"):  # an extent of almost 0 limits nothing
            scale = float((available[bounded] / extent[bounded]).min())
        return cls(scale, tuple(centre.tolist()))

    @classmethod
    def scaled(cls, scene_box_m: ArrayLike, factor: float) -> Placement:
        """Use a given scale about the centre of the scene's box; 1 keeps the scene's size."""
        centre, _ = _centre_and_extent(scene_box_m)
        return cls(factor, tuple(centre.tolist()))

    @overload
    def to_hand(self, value: Grid) -> Grid: ...
    @overload
    def to_hand(self, value: ArrayLike) -> Float64s: ...
    def to_hand(self, value: Grid | ArrayLike) -> Grid | Float64s:
        """Convert points [..., 3] or a grid from scene metres to hand metres."""
        if isinstance(value, Grid):
            return value.moved(self.scale, -self.scale * np.asarray(self.offset_m))
        return np.asarray(self.scale * (np.asarray(value, np.float64) - np.asarray(self.offset_m)))

    @overload
    def to_scene(self, value: Grid) -> Grid: ...
    @overload
    def to_scene(self, value: ArrayLike) -> Float64s: ...
    def to_scene(self, value: Grid | ArrayLike) -> Grid | Float64s:
        """Convert points [..., 3] or a grid from hand metres to scene metres."""
        if isinstance(value, Grid):
            return value.moved(1 / self.scale, self.offset_m)
        return np.asarray(np.asarray(value, np.float64) / self.scale + np.asarray(self.offset_m))

    @property
    def wording(self) -> str:
        """The scale in words: 1 mm of the hand is 23.7 mm of the scene."""
        length_m = 1e-3 / self.scale
        unit, size_m = next((u for u in _UNITS if length_m >= u[1]), _UNITS[-1])
        return f"1 mm of the hand is {length_m / size_m:.4g} {unit} of the scene"

    def to_dict(self) -> dict[str, list[float]]:
        """Return the placement by its names in files.

        x_hand = mapping_scale (x_scene - mapping_offset_m).
        """
        return {"mapping_scale": [self.scale], "mapping_offset_m": list(self.offset_m)}


def axis_description(axes: str, axis: int) -> list[str]:
    """Return the words that describe one axis of a medium.

    The result for axis 1 of "x right, y down" is ["y", "down"]; it is [] if the axis is not described.
    """
    parts = axes.lower().split(",")
    return parts[axis].split() if axis < len(parts) else []


def _centre_and_extent(scene_box_m: ArrayLike) -> tuple[Float64s, Float64s]:
    box = np.asarray(scene_box_m, np.float64)
    extent = box[1] - box[0] if box.shape == (2, 3) and np.isfinite(box).all() else np.zeros(3)
    if (extent < 0).any() or not extent.any() or not np.isfinite(extent).all():
        expected = "finite low and high corners [2, 3] in metres, not all alike"
        raise InvalidArgument("scene_box_m", f"{box.tolist()}", expected)
    return box[0] + extent / 2, extent
