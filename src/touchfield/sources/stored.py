"""Opens a stored force field, ``.npz`` or ``.zarr`` with the array ``forces_n``, or ``.vti``, as a scene.

The forces are used as stored: a force law does not apply, and the profile is ignored.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from touchfield.arrays import Float64s
from touchfield.errors import SourceError
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.medium.field import bricks_reached, field_of_points
from touchfield.medium.stores.npz import NpzArchive, read_npz
from touchfield.medium.stores.vti_reader import read_vti
from touchfield.medium.stores.zarr_store import read_zarr
from touchfield.sources.laws import ForceProfile
from touchfield.sources.options import SourceOptions
from touchfield.sources.registry import SourceKind
from touchfield.sources.scene import Scene


class StoredScene(Scene):
    """A medium as a scene: trilinear interpolation of its stored forces.

    ``to_the_bit()`` returns the same medium including bricks that hold only -0.0, which count as no force; by
    default `stored`.
    """

    has_law = False
    stored: HapticMedium

    def __init__(self, medium: HapticMedium, to_the_bit: Callable[[], HapticMedium] | None = None) -> None:
        self.stored = medium
        self.to_the_bit = to_the_bit or (lambda: medium)
        self.frame_count, self.rate_hz = medium.frame_count, medium.rate_hz
        self.axes = medium.axes
        self.finest_m = medium.grid.spacing_m
        self.notes = ("The stored forces are used as they are; the force law is ignored.",)

    def bounds_m(self) -> Float64s:
        """Return the box of the stored grid, metres, float64 [2, 3]."""
        return np.stack(self.stored.grid.box_m)

    def field(self, frame: int, grid: Grid, profile: ForceProfile) -> ForceField:
        """Return the stored forces at the points of `grid`.

        Returns the field itself if the grids are equal.
        """
        stored = self.stored[frame]
        if grid == stored.grid:
            return stored
        return field_of_points(grid, bricks_reached(stored, grid), stored.sample_n)


_VTK = (".vti", ".pvd")


def _recognise(path: Path) -> bool:
    if path.suffix.lower() == ".zarr":
        return path.is_dir()
    if path.suffix.lower() in _VTK:
        return path.is_file()
    return path.suffix.lower() == ".npz" and "forces_n" in NpzArchive(path).names


def _open(path: Path, options: SourceOptions) -> Scene:
    if path.suffix.lower() == ".npz":
        return StoredScene(read_npz(path), lambda: read_npz(path, to_the_bit=True))
    if path.suffix.lower() == ".zarr":
        return StoredScene(read_zarr(path))
    if path.suffix.lower() in _VTK:
        return StoredScene(read_vti(path), lambda: read_vti(path, to_the_bit=True))
    found = "a folder" if path.is_dir() else f"a file named {path.suffix or 'without suffix'}"
    mend = "Make it a medium: touchfield encode."
    raise SourceError(str(path), found, "a .touch file or a stored field, .npz, .zarr or .vti", mend)


KIND = SourceKind(
    "field", "a stored force field: .npz or .zarr with forces_n, .vti or .pvd", _recognise, _open
)
