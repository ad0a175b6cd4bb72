"""Recorded contacts as a scene: where a probe was and what pushed it, from CSV or MCAP, as a field of forces.

Forces are those on the probe, in the axes and metres of the recording; between samples stands the curl-free field of
`touchfield.sources.curl_free`. It is told where it can be trusted: within `REACH` lengths of its kernel of a sample
that went into it. Farther off there is no force, and what the probe never met is not made up.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.errors import InvalidArgument, SourceError
from touchfield.medium import BRICK, ForceField, Grid
from touchfield.medium.trace import ContactTrace, has_forces, read_contacts
from touchfield.sources.curl_free import CurlFree, thinned_contacts
from touchfield.sources.registry import SourceKind
from touchfield.sources.scene import UP_Z_AXES, Scene, field_of_points

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.sources.options import SourceOptions
    from touchfield.sources.profile import ForceProfile

    Float64s = NDArray[np.float64]

__all__ = ["KIND", "REACH", "ContactScene"]

REACH: Final = 1.0
"""Lengths of the kernel: a sample so far off still tells 60 % of the potential."""

_LEAST: Final = 4
_FARTHEST_M: Final = 1e4
_STRONGEST_N: Final = 1e6
_SEVERE: Final = 0.5


class ContactScene(Scene):
    """Forces that were recorded, as a field that stands still.

    Parameters
    ----------
    where : str; Of the trace, for messages.

    Raises `SourceError` if there are too few places, all in one, or no force at all.
    """

    axes = UP_Z_AXES
    box_wording = "the trace"

    def __init__(self, trace: ContactTrace, where: str = "trace") -> None:
        with np.errstate(over="ignore"):
            extent = np.ptp(trace.positions_m, axis=0).max()
        if not (extent < _FARTHEST_M and np.abs(trace.forces_n).max() < _STRONGEST_N):
            found = f"{extent:g} m and {np.abs(trace.forces_n).max():g} N"
            raise SourceError(where, found, f"less than {_FARTHEST_M:g} m and {_STRONGEST_N:g} N", "Check the units.")
        if not extent > 0 or not trace.forces_n.any():
            found = "a probe that never moved" if not extent > 0 else "no force"
            raise SourceError(where, found, "forces at several places", "Record a contact.")
        points_m, forces_n, spacing_m = thinned_contacts(trace.positions_m, trace.forces_n)
        if len(points_m) < _LEAST:
            raise SourceError(where, f"{len(points_m)} places", f"at least {_LEAST}", "Record a longer contact.")
        self.interpolant = CurlFree.fitted(points_m, forces_n, spacing_m)
        self.reach_m = REACH * self.interpolant.length_m
        missed = self.interpolant.missed
        self.notes = (
            f"A field with no curl through {len(points_m)} means of {len(trace.positions_m)} samples: forces that "
            f"are left out are missed by {100 * missed:.3g} %; none are told beyond {1e3 * self.reach_m:.3g} mm of "
            "a sample; the force law is ignored.",
        )
        if missed > _SEVERE:
            self.notes += (
                "So much of these forces is no gradient: friction, inertia, or another contact each time. The "
                "field is a rough mean of them.",
            )

    def bounds_m(self) -> Float64s:
        """The box of the trace, float64 [2, 3]."""
        points = self.interpolant.points_m
        return np.stack([points.min(axis=0) - self.reach_m, points.max(axis=0) + self.reach_m])

    def field(self, frame: int, grid: Grid, profile: ForceProfile) -> ForceField:
        """See `Scene.field`; neither frame nor law matter."""
        from scipy.spatial import KDTree

        tree = KDTree(self.interpolant.points_m)
        shape = np.array(grid.brick_shape)
        bricks = np.stack(np.meshgrid(*[np.arange(n) for n in shape], indexing="ij"), axis=-1).reshape(-1, 3)
        half = float(np.linalg.norm((BRICK - 1) / 2 * np.asarray(grid.spacing_m)))
        centres = grid.to_m(bricks * BRICK + (BRICK - 1) / 2)
        bricks = bricks[tree.query(centres, distance_upper_bound=self.reach_m + half)[0] < np.inf]
        near = bricks.astype(np.int32)
        return field_of_points(grid, near, lambda points: self.interpolant.forces_n(points, self.reach_m))


def _recognise(path: Path) -> bool:
    if not path.is_file():
        return False
    return path.suffix.lower() == ".mcap" or (path.suffix.lower() in (".csv", ".tsv", ".txt") and has_forces(path))


def _open(path: Path, options: SourceOptions) -> Scene:
    reader: Callable[[Path], ContactTrace] = read_contacts
    if path.suffix.lower() == ".mcap":
        from touchfield.sources.mcap_trace import read_mcap as reader
    if options.frame == "camera":
        raise InvalidArgument("--frame", "camera", "world: a trace has no camera")
    return ContactScene(reader(path), str(path))


KIND = SourceKind(
    "contacts",
    "a recording of positions and forces: .csv with t_s,x_m,y_m,z_m,fx_n,fy_n,fz_n, or MCAP (extra: mcap)",
    _recognise,
    _open,
)
