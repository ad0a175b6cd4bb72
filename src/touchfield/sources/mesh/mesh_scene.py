"""`MeshScene`: a triangle mesh as a scene (paper section 4). A sample's force follows from its signed
distance to the mesh.

The force is F = f(phi) n, with phi the signed distance to the mesh.

The paper's reference [21] gives no formula. Here phi is exact; for a closed mesh its sign is that of the
winding number (inside if that is not 0). Small holes are closed (`touchfield.sources.mesh.surface`). A mesh
that stays open is a shell. A one-sided shell has its wall behind the faces and the sign of the angle-weighted
pseudo-normal, and its force fades to 0 at the rim over the reach of the law. A two-sided shell is a wall of
thickness T around the mesh, phi = |d| - T/2. The wall of a nearly closed mesh stays within the volume that it
would enclose. If closed parts overlap, the distance is to the surface of their union: inside is where the
winding number is not 0, and a wall with inside on both of its sides exerts no force. Triangles that cross
others are cut there (`touchfield.sources.mesh.kernels.sign`); those that share a vertex do not cut each
other.
"""

from __future__ import annotations

import copy
import math
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from touchfield.arrays import Float64s, Int32s, Int64s
from touchfield.errors import InvalidArgument, require_one_of
from touchfield.medium import ForceField, Grid
from touchfield.medium.pose_track import checked_rotation
from touchfield.sources.laws import ForceProfile
from touchfield.sources.mesh.surface import RepairedSurface, Surface, close_holes, from_longest, unit
from touchfield.sources.mesh.thicken import Growth, grow, growth_of
from touchfield.sources.scene import UP_Y_AXES, Scene
from touchfield.sources.thin_walls import MinThickness, ThinWall

if TYPE_CHECKING:
    from touchfield.sources.mesh.kernels.field import Band


_UNSURE: Final = 2e-9
"""Distance, relative to the largest coordinate, below which directions suffer from rounding."""
_TOUCHING: Final = 1e-9  # of the extent: heights that count as 0
_PROBE: Final = 1e-7  # of the extent: distance from a triangle at which the two sides are tested
_LARGEST_IN_SPACINGS: Final = 1e12  # extent of mesh and grid; beyond it float64 cannot resolve samples


class MeshScene(Scene):
    """A static mesh.

    vertices_m : float array [n, 3] or RepairedSurface; Metres. Equal vertices must have been merged
        (`touchfield.sources.mesh.surface.merge_vertices`). A `RepairedSurface`, whose holes are already
        closed, needs no `triangles`.
    triangles : integer array [m, 3]; Vertex numbers, anticlockwise seen from outside.
    shell : str; Side of the wall of an open mesh: "one" sided, "two" sided, or "auto", which is one-sided if
        all triangles face consistently.
    holes : str; The rule by which holes are closed: "small", "close" or "leave"
        (`touchfield.sources.mesh.surface`).
    name : str; Its name in messages.
    notes : tuple of str; Notes of the reader; one on the kind of mesh follows them.

    Raises `SourceError` if there is no triangle, or a coordinate or vertex number is invalid;
    `InvalidArgument` if `shell` or `holes` is unknown.

    Attributes
    ----------
    is_one_sided : bool; Whether an open mesh is a one-sided shell.
    velocities_m_s : float64 [n, 3] or None; Velocities of the vertices, if the mesh is one instant of a
        motion. A profile with surface damping uses them.
    """

    axes = UP_Y_AXES
    unit = ("--unit-m", 0.001, 1000.0)

    def __init__(
        self,
        vertices_m: ArrayLike | RepairedSurface,
        triangles: ArrayLike = (),
        *,
        shell: str = "auto",
        holes: str = "small",
        name: str = "mesh",
        notes: tuple[str, ...] = (),
    ) -> None:
        repaired = vertices_m
        if not isinstance(repaired, RepairedSurface):
            repaired = close_holes(Surface(repaired, triangles, name), holes)
        require_one_of("shell", shell, ("auto", "one", "two"))
        self.name, self.surface = name, repaired.surface
        self._lids, self._rim_edges = repaired.lids, repaired.rim
        self.velocities_m_s: Float64s | None = None
        self.is_closed = self.surface.is_closed
        edges = self.surface.edges
        is_sheet = edges.unbalanced_count > 0
        self.is_one_sided = shell == "one" or (shell == "auto" and is_sheet and repaired.is_oriented)
        self._opening = "a sheet laid double"  # why the mesh is not closed
        if edges.boundary_count:
            self._opening = f"open with {edges.boundary_count} boundary edges"
        elif is_sheet:
            count = edges.unbalanced_count
            self._opening = (
                f"without a boundary but not closed, as at {count} edges triangles do not pair off"
            )
        reason = "as requested"
        if shell == "auto":
            reason = (
                "all triangles face consistently" if self.is_one_sided else "triangles face inconsistently"
            )
            reason = reason if is_sheet else "every triangle has a twin that faces the other way"
        kind = "one-sided shell, the wall behind its faces" if self.is_one_sided else "two-sided shell"
        wording = f"{self._opening}: taken as a {kind} ({reason})."
        wording = "closed: what they enclose is inside." if self.is_closed else wording
        self.notes = (*notes, *repaired.notes, f"{len(self.surface.triangles)} triangles, {wording}")

    def bounds_m(self) -> Float64s:
        return self.surface.bounds_m

    def thickened(self, rule: MinThickness) -> tuple[MeshScene, tuple[ThinWall, ...]]:
        """See `Scene.thickened`; open meshes are no solids."""
        growth = self.growth_of(rule)
        if growth is None:
            return self, ()
        wall = ThinWall(Path(self.name).name, growth.thickness_m, growth.thickened_m)
        return self.grown(growth.motions_m), (wall,)

    def growth_of(self, rule: MinThickness) -> Growth | None:
        """Return how far the triangles have to move outwards; None if the mesh is thick enough, or open."""
        if not self.is_closed:
            return None
        is_outer, union = None, self._union
        if union is not None:
            is_outer = np.zeros(len(self.surface.triangles), np.bool_)
            is_outer[union.uncut] = is_outer[union.parents] = True
        return growth_of(self.surface, self._normals[:, 0], rule, is_outer)

    def grown(self, motions_m: Float64s) -> MeshScene:
        """Return this mesh with triangles moved outwards along their normals, by motions float64 [m]."""
        other = copy.copy(self)
        other.surface = grow(self.surface, self._normals[:, 0], motions_m)
        for name in ("_active_table", "_union", "_rim_table", "_normals"):
            other.__dict__.pop(name, None)
        return other

    def moved(self, rotation: Float64s, shift_m: Float64s) -> MeshScene:
        """See `Scene.moved`; edges, closedness and normals are reused.

        Raises `InvalidArgument` if `rotation` is not a rotation; `SourceError` if a coordinate overflows.
        """
        matrix = checked_rotation(rotation)
        other = copy.copy(self)
        other.surface = self.surface.with_vertices(
            self.surface.vertices_m @ matrix.T + np.asarray(shift_m, np.float64)
        )
        for name in ("_active_table", "_union", "_rim_table"):
            other.__dict__.pop(name, None)
        if np.array_equal(other.surface.triangles, self.surface.triangles):
            other._normals = self._normals @ matrix.T
        else:  # among edges of equal length rounding has made another the longest
            other.__dict__.pop("_normals", None)
        if self.velocities_m_s is not None:
            other.velocities_m_s = self.velocities_m_s @ matrix.T
        return other

    def field(self, frame: int, grid: Grid, profile: ForceProfile) -> ForceField:
        """See `Scene.field`.

        Raises `InvalidArgument` if `frame` is not 0, the mesh is open and `profile` a solid's, or the grid is
        too fine for float64.
        """
        from touchfield.sources.mesh.kernels import field, sign

        if frame != 0:
            raise InvalidArgument(f"{self.name}, frame", str(frame), "0, the only one")
        band = self._band(profile)
        low, high = grid.box_m
        reach = float(np.abs([low, high, *self.surface.bounds_m]).max())
        if reach > _LARGEST_IN_SPACINGS * min(grid.spacing_m):
            found = f"{min(grid.spacing_m):g} m for a mesh and grid that reach to {reach:g} m"
            raise InvalidArgument("grid spacing_m", found, "a coarser grid, or both nearer to the origin")
        if max(band.inner_m, band.outer_m) < 0:
            return ForceField.empty(grid)
        events = np.zeros(0, np.int64)
        if band.sidedness in (field.CLOSED, field.LIDDED):
            faces = self.surface.triangles
            faces = np.concatenate([faces, self._lids]) if len(self._lids) else faces
            events = sign.crossings(self.surface.vertices_m, faces, grid)
        has_rim = band.sidedness in (field.ONE_SIDED, field.LIDDED) and len(self._rim_edges)
        rim = self._rim_table if has_rim else None
        motion = None
        if profile.surface_damping_n_s_per_m > 0 and self.velocities_m_s is not None:
            faces, vertices, union = self.surface.triangles, self.surface.vertices_m, self._union
            faces = faces if union is None else faces[np.concatenate([union.uncut, union.parents])]
            motion = field.Motion(faces, vertices, self.velocities_m_s, profile.surface_damping_n_s_per_m)
        surface = self._active_table, self._active_normals
        bricks, forces = field.mesh_forces(surface, events, grid, band, _UNSURE * reach, motion, rim)
        return ForceField(grid, bricks, forces)

    def prepare_field(self) -> None:
        """Compute what every field of this mesh needs, whatever its grid and its force law."""
        _ = self._active_table

    def _band(self, profile: ForceProfile) -> Band:
        from touchfield.sources.mesh.kernels.field import CLOSED, LIDDED, ONE_SIDED, TWO_SIDED, Band

        pieces = profile.table()
        low, high = profile.low_m, profile.high_m
        if not self.is_closed and math.isinf(low):
            found = f"a solid law for a mesh that is {self._opening}"
            mend = "Give --thickness-m or --holes close, or close the mesh."
            raise InvalidArgument(f"{self.name}, thickness_m", found, "the thickness of a shell", mend)
        # a sample on the surface may count as outside
        outer = high if high > 0 or (high == 0 and float(profile(0.0)) != 0) else -1.0
        if self.is_closed:
            deepest = float(np.ptp(self.surface.bounds_m, axis=0).min()) / 2
            return Band(CLOSED, min(-low, deepest * (1 + 1e-9)) if low < 0 else -1.0, outer, 0.0, pieces)
        if self.is_one_sided:
            reach = max(-low, high)
            return Band(LIDDED if len(self._lids) else ONE_SIDED, reach, reach, 0.0, pieces)
        half = max(-low, 0.0) / 2
        return Band(TWO_SIDED, high + half, high + half, half, pieces)

    # -- active surface: the triangles, or the outer surface of parts that overlap -------------------------
    @cached_property
    def _union(self) -> Union | None:
        return union_of(self.surface) if self.is_closed else None

    @cached_property
    def _active_table(self) -> Float64s:
        """The table of the triangles that exert forces."""
        from touchfield.sources.mesh.kernels.triangle import triangle_table

        table, union = triangle_table(self.surface.vertices_m, self.surface.triangles), self._union
        if union is None:
            return table
        corners = union.corners_m.reshape(-1, 3)
        pieces = triangle_table(corners, np.arange(len(corners), dtype=np.int32).reshape(-1, 3))
        return np.concatenate([table[union.uncut], pieces])

    def _active_normals(self) -> Float64s:
        """Return the pseudo-normals of the triangles that exert forces, float64 [m, 7, 3]."""
        union = self._union
        if union is None:
            return self._normals
        pieces = np.repeat(self._normals[union.parents, :1], 7, axis=1)
        return np.concatenate([self._normals[union.uncut], pieces])

    @cached_property
    def _rim_table(self) -> Float64s:
        from touchfield.sources.mesh.kernels.triangle import triangle_table

        return triangle_table(self.surface.vertices_m, self._rim_edges[:, [0, 1, 0]])

    @cached_property
    def _normals(self) -> Float64s:
        normals = self.surface.pseudo_normals()
        if self.is_closed and self.surface.volume_m3() < 0:
            normals *= -1.0
        return normals


# -- the outer surface of closed parts that overlap --------------------------------------------------------
class Union(NamedTuple):
    """The boundary of a union."""

    uncut: Int64s  # int64 [k]; triangles of the boundary that are not cut
    corners_m: Float64s  # float64 [p, 3, 3]; pieces of cut triangles, each starting with its longest edge
    parents: Int32s  # int32 [p]; the triangle of each piece


def union_of(surface: Surface) -> Union | None:
    """Compute the boundary of the union of a closed surface's parts.

    Returns None if that is the surface itself.
    """
    from touchfield.sources.mesh.kernels import sign as kernel

    faces = surface.triangles
    corners = surface.vertices_m[faces]
    extent = float(np.abs(surface.bounds_m).max()) + float(np.ptp(surface.bounds_m, axis=0).max())
    normals = unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    boxes = kernel.boxes_of(corners)
    bins = kernel.sorted_into_bins(boxes)
    pairs = kernel.crossing_pairs(bins, boxes, corners, normals, faces, _TOUCHING * extent)
    if not len(pairs) and not _parts_meet(surface, boxes):
        return None
    starts = (
        np.flatnonzero(np.append(True, pairs[1:, 0] != pairs[:-1, 0]))
        if len(pairs)
        else np.zeros(0, np.int64)
    )
    cut_corners, parents = kernel.cut(
        np.append(starts, len(pairs)), pairs, corners, normals, _TOUCHING * extent
    )
    is_cut = np.zeros(len(faces), bool)
    is_cut[parents] = True
    uncut = np.flatnonzero(~is_cut)
    pieces = np.concatenate([corners[uncut], cut_corners]), np.concatenate([uncut.astype(np.int32), parents])
    is_outer = kernel.bounds_union(*pieces, normals, bins, (surface.vertices_m, faces), _PROBE * extent)
    if is_outer.all():
        return None
    outer_uncut, is_outer_piece = uncut[is_outer[: len(uncut)]], is_outer[len(uncut) :]
    outer_pieces = cut_corners[is_outer_piece]
    return Union(
        outer_uncut,
        np.take_along_axis(outer_pieces, from_longest(outer_pieces)[:, :, None], axis=1),
        parents[is_outer_piece],
    )


def _parts_meet(surface: Surface, boxes: Float64s) -> bool:
    """Return True if the boxes of two connected parts overlap."""
    part_of = surface.part_of_vertex()[surface.triangles[:, 0]]
    order = np.argsort(part_of, kind="stable")
    first = np.flatnonzero(np.append(True, np.diff(part_of[order]) != 0))
    if len(first) == 1:
        return False
    low = np.minimum.reduceat(boxes[order, 0::2], first)
    high = np.maximum.reduceat(boxes[order, 1::2], first)
    order = np.argsort(low[:, 0])
    low, high = low[order], high[order]
    for i in range(len(low) - 1):
        until = np.searchsorted(low[:, 0], high[i, 0], side="right")
        if ((low[i + 1 : until] <= high[i]) & (high[i + 1 : until] >= low[i])).all(axis=1).any():
            return True
    return False
