"""`BodyScene`: several moving bodies as one scene (the paper's Scene 1, section 5.1).

Each body has its own scene and a pose track.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from touchfield.arrays import Bools, Float64s
from touchfield.compute.threads import for_chunks
from touchfield.errors import InvalidArgument, require_positive
from touchfield.medium import ForceField, Grid
from touchfield.medium.budget import zero_forces
from touchfield.medium.field import brick_keys, bricks_of, field_without_empty_bricks
from touchfield.sources.camera import require_frame
from touchfield.sources.laws import ForceProfile
from touchfield.sources.mesh.mesh_scene import MeshScene
from touchfield.sources.physics.live_simulation import LiveSimulation
from touchfield.sources.scene import UP_Z_AXES, Body, MovingScene, Scene
from touchfield.sources.shapes.analytic_scene import AnalyticScene
from touchfield.sources.shapes.shapes import Plane
from touchfield.sources.thin_walls import MinThickness, ThinWall

_AT_REST = (0.0,) * 9
_MAX_MESH_NOTES = 4
_Part = tuple[ForceField, tuple[float, ...]]  # a body's field, and the motion of its surface


class BodyScene(MovingScene):
    """Moving bodies.

    Where they overlap, their forces are added (the device filter clips the sum to F_max).

    With `ForceProfile.surface_damping_n_s_per_m` b, b (v + omega x r) is added wherever a body has a force: b
    times its velocity there, with r relative to its origin.

    bodies : sequence of Body; One or more, with tracks of equal length.
    simulation : callable, optional; Makes the simulation that the tracks are the start of, with the poses of
        all bodies in their order; ``can_move``, bool [bodies], tells which of them may move in it.

    Raises `InvalidArgument` if there is no body, the tracks differ in length, a deforming body does not have
    a frame for each pose, or the rate is not positive.
    """

    is_of_bodies = True

    def __init__(
        self,
        bodies: Sequence[Body],
        rate_hz: float,
        axes: str = UP_Z_AXES,
        notes: tuple[str, ...] = (),
        simulation: Callable[[], LiveSimulation] | None = None,
        can_move: Sequence[bool] = (),
    ) -> None:
        if not bodies:
            raise InvalidArgument("bodies", "none", "at least one")
        require_positive(rate_hz=rate_hz)
        count = len(bodies[0].track)
        for body in bodies:
            if len(body.track) != count:
                found, expected = f"{len(body.track)} poses", f"{count}, as the first body has"
                raise InvalidArgument(f"body {body.name}", found, expected)
            if not body.is_rigid and body.scene.frame_count != count:
                raise InvalidArgument(
                    f"body {body.name}", f"{body.scene.frame_count} frames", f"1 or {count}"
                )
        self._bodies = tuple(bodies)
        self.frame_count, self.rate_hz = count, float(rate_hz)
        self.axes, self.notes = axes, notes
        self.simulation, self._can_move = simulation, tuple(can_move)
        self._is_static = tuple(body.is_rigid and body.track.is_constant for body in bodies)
        self._static_sum: tuple[Grid, ForceProfile, ForceField] | None = None
        self._latest: tuple[int, Grid, ForceProfile, ForceField] | None = None

    def bodies(self) -> tuple[Body, ...]:
        return self._bodies

    def freed(self) -> BodyScene:
        """Return this scene with bodies that may move otherwise than in their tracks (`Body.is_free`)."""
        other, can_move = copy.copy(self), self._can_move or (True,) * len(self._bodies)
        other._bodies = tuple(
            replace(body, is_free=is_free) for body, is_free in zip(self._bodies, can_move, strict=True)
        )
        return other

    def thickened(self, rule: MinThickness) -> tuple[Scene, tuple[ThinWall, ...]]:
        """See `Scene.thickened`: each body by itself."""
        bodies, thin = list[Body](), list[ThinWall]()
        for body in self._bodies:
            scene, walls = body.scene.thickened(rule.of_track(body.track))
            bodies.append(replace(body, scene=scene))
            thin += [wall._replace(name=body.name) for wall in walls]
        if not thin:
            return self, ()
        other = copy.copy(self)
        other._bodies, other._static_sum, other._latest = tuple(bodies), None, None
        return other, tuple(thin)

    def _box_m(self, start: int, stop: int) -> Float64s:
        """Return the box of all bodies.

        Planes count as their points, unless there are only planes.
        """
        planes = [_planes_of(body.scene) for body in self._bodies]
        lows, highs = [], []
        for body, is_static, points in zip(self._bodies, self._is_static, planes):
            box = body.scene.bounds_m()
            if points is not None and any(group is None for group in planes):
                box = np.stack([points.min(axis=0), points.max(axis=0)])
            frames = slice(start, start + 1 if is_static else stop)
            low, high = _moved_boxes(box, body.track.rotations(frames), body.track.positions(frames))
            lows.append(low.min(axis=0))
            highs.append(high.max(axis=0))
        return np.stack([np.min(lows, axis=0), np.max(highs, axis=0)])

    def field(self, frame: int, grid: Grid, profile: ForceProfile) -> ForceField:
        """Return the sum of the fields of all bodies at the points of `grid`.

        Each body is in its pose of the frame.

        The sum of the static bodies is cached for the latest grid and profile. A frame in which no body has
        moved since the one before is the same object.

        Raises `InvalidArgument` if there is no such frame, or a body cannot be moved to its pose
        (`Scene.moved`).
        """
        require_frame(frame, self.frame_count)
        latest, is_repeated = self._latest, self._is_repeated(frame)
        if is_repeated and latest is not None and latest[:3] == (frame - 1, grid, profile):
            field = latest[3]
        else:
            field = self._sum_of_bodies(frame, grid, profile)
        # a field may be large: it is kept only for a frame that needs it
        self._latest = (frame, grid, profile, field) if self._is_repeated(frame + 1) else None
        return field

    def _is_repeated(self, frame: int) -> bool:
        """Return True if no body has moved since the frame before, nor moves then."""
        if not 0 < frame < self.frame_count:
            return False
        near = slice(max(frame - 2, 0), frame + 1)  # between the poses from which both velocities are taken
        return not self._moves[near].any()

    @cached_property
    def _moves(self) -> Bools:
        """Whether any body moves from each frame to the next, bool [frame_count - 1]."""
        moves = np.zeros(self.frame_count - 1, np.bool_)
        for body, is_static in zip(self._bodies, self._is_static):
            if is_static:
                continue
            for poses in (body.track.positions_m, body.track.quaternions):
                moves |= (poses[1:] != poses[:-1]).any(axis=1)
            moves |= not body.is_rigid
        return moves

    def _sum_of_bodies(self, frame: int, grid: Grid, profile: ForceProfile) -> ForceField:
        static = np.flatnonzero(self._is_static).tolist()
        moving = np.flatnonzero(np.logical_not(self._is_static)).tolist()
        parts = list[_Part]()
        if static:
            if self._static_sum is None or self._static_sum[:2] != (grid, profile):
                self._static_sum = grid, profile, _sum(grid, self._parts(static, 0, grid, profile))
            parts = [(self._static_sum[2], _AT_REST)]
        return _sum(grid, [*parts, *self._parts(moving, frame, grid, profile)])

    def _parts(self, indices: Iterable[int], frame: int, grid: Grid, profile: ForceProfile) -> list[_Part]:
        parts = list[_Part]()
        for n in indices:
            body = self._bodies[n]
            rotation, shift, scene = body.track.rotation(frame), body.track.positions(frame), body.scene
            if not (np.array_equal(rotation, np.eye(3)) and not shift.any()):
                scene = scene.moved(rotation, shift)
            field = scene.field(0 if body.is_rigid else frame, grid, profile)
            motion, damping = _AT_REST, profile.surface_damping_n_s_per_m
            if damping and not self._is_static[n]:  # origin, b v and b omega
                (moved,) = body.track.surface_motions(self.rate_hz, damping, slice(frame, frame + 1))
                motion = tuple(np.concatenate([body.track.positions(frame), moved]).tolist())
            parts.append((field, motion))
        return parts


def notes_of_meshes(bodies: Sequence[Body]) -> tuple[str, ...]:
    """Return what was repaired in the meshes of bodies, and which are open, after the name of each."""
    notes = list[str]()
    for body in bodies:
        if isinstance(body.scene, MeshScene):
            lines = body.scene.notes[:-1] if body.scene.is_closed else body.scene.notes
            notes += [f"{body.name}: {line}" for line in lines]
    more = len(notes) - _MAX_MESH_NOTES
    return (*notes[:_MAX_MESH_NOTES], *([f"{more} more such notes on meshes."] if more > 0 else []))


def _sum(grid: Grid, parts: Sequence[_Part]) -> ForceField:
    """Return the sum of fields on a lattice."""
    from touchfield.sources.shapes.kernels import add_body

    if len(parts) == 1 and parts[0][1] == _AT_REST:
        return parts[0][0]
    keys_of_parts = [brick_keys(grid, field.bricks) for field, _ in parts]
    keys = np.unique(np.concatenate([np.zeros(0, np.int64), *keys_of_parts]))
    total, lattice = zero_forces(len(keys)), (*grid.origin_m, *grid.spacing_m)
    for (field, motion), part_keys in zip(parts, keys_of_parts):
        arguments = field.bricks, field.forces_n, np.searchsorted(keys, part_keys), lattice, motion, total
        for_chunks(add_body, len(part_keys), *arguments, chunk=32)
    return field_without_empty_bricks(grid, bricks_of(grid, keys), total)


def _moved_boxes(box_m: Float64s, turns: Float64s, shifts_m: Float64s) -> tuple[Float64s, Float64s]:
    """Return low and high corners, float64 [n, 3], of a box after rotations [n, 3, 3] and shifts [n, 3]."""
    middle, half = box_m.mean(axis=0), np.ptp(box_m, axis=0) / 2
    centre, reach = turns @ middle + shifts_m, np.abs(turns) @ half
    return centre - reach, centre + reach


def _planes_of(scene: Scene) -> Float64s | None:
    """Return a point of each plane, float64 [n, 3], if a scene consists of planes only; else None."""
    if not isinstance(scene, AnalyticScene) or not all(isinstance(shape, Plane) for shape in scene.shapes):
        return None
    return scene.placed(
        np.array([shape.point_m for shape in scene.shapes if isinstance(shape, Plane)], np.float64)
    )
