"""The least thickness of a wall that a lattice of samples can show from both sides, and reports on thinner
walls (decision 25).

The forces of the two sides of a wall point opposite ways. Between two samples they are interpolated, and the
low-pass of the device filter mixes them, so that a hand passes through a wall with too few samples in it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from touchfield.arrays import Float64s
from touchfield.medium import PoseTrack

Triple = tuple[float, float, float]

MIN_SAMPLES: Final = 2.25
"""Least thickness of a wall, in samples along its normal, besides the depth of its two surfaces."""
SURFACE_N: Final = 0.05
"""Largest force at which the proxy finds a surface, newtons (``TOUCH_WALL_MAX_LEVEL_N``)."""


class ThinWall(NamedTuple):
    """A wall that is too thin for the lattice: its object, its thickness, and that of the thickened wall."""

    name: str
    thickness_m: float
    thickened_m: float


@dataclass(frozen=True)
class MinThickness:
    """The least thickness that holds, by the direction of a wall's normal. All lengths are scene metres.

    spacing_m : spacing of the samples along x, y and z.
    shifted_m : the same for a body that moves without rotation.
    turned_m : the same for a body that rotates.
    surfaces_m : depth below both surfaces at which the proxy finds them, together.
    rotation : float64 [3, 3] or None; rotation of the object into the axes of the lattice.
    is_of_objects : bool; whether a moving body has a lattice of its own.
    """

    spacing_m: Triple
    shifted_m: Triple
    turned_m: Triple
    surfaces_m: float
    rotation: Float64s | None = None
    is_of_objects: bool = False

    @property
    def whole_m(self) -> Triple:
        """Spacing of the samples of a shape that deforms in its place: that of the coarsest axis."""
        return (max(self.spacing_m),) * 3

    def along(self, normals: Float64s) -> Float64s:
        """Return the least thickness along unit normals [..., 3] of the object, metres, float64 [...]."""
        on_lattice = normals if self.rotation is None else normals @ self.rotation.T
        samples_m = np.sqrt(((on_lattice * np.asarray(self.spacing_m)) ** 2).sum(axis=-1))
        return np.asarray(MIN_SAMPLES * samples_m + self.surfaces_m)

    def rotated(self, rotation: Float64s) -> MinThickness:
        """Return the rule for an object that a rotation float64 [3, 3] brings into the axes of this one."""
        return replace(self, rotation=rotation if self.rotation is None else self.rotation @ rotation)

    def of_track(self, track: PoseTrack) -> MinThickness:
        """Return the rule for the shape of a body that follows a track."""
        if track.is_constant:
            return self.rotated(track.rotation(0))
        never_turns = bool((track.quaternions == [1.0, 0.0, 0.0, 0.0]).all())
        return replace(self, spacing_m=self.shifted_m if never_turns else self.turned_m)
