"""Opens an animated glTF model as a scene: computes its moving surface (skins, morph targets, moving nodes)
at the frames of the medium.

Models are evaluated at the rate of the medium.

While the field of a frame is computed, a thread makes the surface of the next one.

Frame i shows the time i / rate_hz, for all such times before the end of the animation; the end itself is
excluded, so that a looping animation does not show its first frame twice. Triangles and welded vertices are
determined once (`touchfield.sources.mesh.surface.weld_in_motion`); a frame is the same surface with other
vertices.

Source of the evaluation: Khronos, glTF 2.0 specification (2021); of the force on a moving surface: paper
section 3.2.
"""

from __future__ import annotations

import copy
import math
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from functools import cache, cached_property, lru_cache
from pathlib import Path
from typing import Final

import numpy as np

from touchfield.arrays import Bools, Float64s, Int32s
from touchfield.compute.threads import worker_count
from touchfield.errors import InvalidArgument, SourceError, require_positive
from touchfield.medium import ForceField, Grid, PoseTrack
from touchfield.medium.pose_track import checked_rotation
from touchfield.sources.animation.rigid_parts import (
    RigidPart,
    outer_area_m2,
    rigid_parts,
    separate_parts,
)
from touchfield.sources.camera import require_frame
from touchfield.sources.gltf.document import contents
from touchfield.sources.gltf.model import Model, Poses
from touchfield.sources.laws import ForceProfile
from touchfield.sources.mesh.mesh_scene import MeshScene
from touchfield.sources.mesh.surface import RepairedSurface, Surface, close_holes, weld_in_motion
from touchfield.sources.options import SourceOptions
from touchfield.sources.registry import SourceKind
from touchfield.sources.scene import UP_Y_AXES, Body, MovingScene, size_note
from touchfield.sources.thin_walls import MinThickness, ThinWall

_RATE_HZ: Final = 60.0
_MAX_FRAMES: Final = 100_000
_BLOCK: Final = 64
_NODE_POSES: Final = 1 << 17  # node matrices of a block of times: about 50 MB with intermediate arrays
_SAMPLE_TIMES: Final = 16  # number of times at which vertices must coincide to be welded
_OVERLAP_TIMES: Final = 5  # number of times at which the overlap of bodies is measured
_LARGEST: Final = 1e15
_MAX_LOOKAHEAD_TRIANGLES: Final = 1 << 20  # the next surface of as many takes 0.4 GB
_MAX_HIDDEN: Final = 0.45
"""Largest fraction of the surface of bodies that may lie inside other bodies.

A robot whose links overlap at their joints stays below it (0.30 in `bench/bench_rig.py`). Two bodies at
nearly one place, whose forces would add everywhere, have 0.5.
"""


class AnimatedMeshScene(MovingScene):
    """A glTF model with one of its animations.

    animation : str or None; Its name or number; None for the first.
    rate_hz : float; Frames a second.
    unit_m : float or None; Metres of one unit of the coordinates; None for 1, as in glTF.
    shell, holes : str; As for `MeshScene`; holes are closed in the rest pose.

    Raises `SourceError` if the file or its content is invalid; `InvalidArgument` if there is no such
    animation, or it has too many frames.
    """

    axes = UP_Y_AXES
    unit = MeshScene.unit

    def __init__(
        self,
        path: str | Path,
        animation: str | None = None,
        *,
        rate_hz: float = _RATE_HZ,
        unit_m: float | None = None,
        shell: str = "auto",
        holes: str = "small",
    ) -> None:
        require_positive(rate_hz=rate_hz)
        self.name, self.rate_hz, self.shell = str(path), float(rate_hz), shell
        self._unit_m = 1.0 if unit_m is None else unit_m
        self._motion: tuple[Float64s, Float64s] | None = None
        self._block = lru_cache(maxsize=2)(self._poses)  # a frame may lie at the edge of its block
        self._latest: tuple[int, MeshScene] | None = None
        self._upcoming: tuple[int, Future[MeshScene]] | None = None  # the frame after it
        self._field_frame = -1  # the latest whose field was requested
        self._motions_m: Float64s | None = None  # of the triangles, outwards, of `thickened`
        self._min_thickness: MinThickness | None = None
        with np.errstate(all="ignore"):
            model = Model(Path(path))
            number = _animation_number(str(path), model.animation_names, animation)
            self._animation = model.animation(number)
            self.duration_s = self._animation.duration_s
            self._steps_in_block = max(1, min(_BLOCK, _NODE_POSES // max(model.node_count, 1)))
            # a duration in float32 may exceed that of its frames slightly
            count = self.duration_s * self.rate_hz * (1 - 1e-6)
            if count > _MAX_FRAMES:
                found = f"{self.rate_hz:g} for an animation of {self.duration_s:g} s"
                raise InvalidArgument(f"{self.name}, rate_hz", found, f"at most {_MAX_FRAMES} frames")
            self.frame_count = max(1, math.ceil(count))
            self._model = model
            sample_frames = np.unique(
                np.linspace(0, self.frame_count - 1, _SAMPLE_TIMES).astype(int)
            ).tolist()
            rest = self._in_metres(model.at_rest(), "at rest")
            self._vertex_ids = np.arange(len(rest))  # vertices of the model that remain after welding
            poses = np.stack([rest, *map(self.vertices_m, sample_frames)])
            self._vertex_ids, triangles = separate_parts(*weld_in_motion(poses, model.triangles))
            self._repaired = close_holes(Surface(rest[self._vertex_ids], triangles, self.name), holes)
        scene = self._static_scene(self._repaired)
        self.is_closed = scene.is_closed
        size = size_note(np.ptp(self.vertices_m(0), axis=0), unit_m, " in the first frame")
        names = model.animation_names
        others = ", ".join(_label(names, i) for i in range(len(names)) if i != number)
        text = f"Animation {_label(names, number)}: {self.duration_s:.4g} s, {self.frame_count} frame"
        text += "s" * (self.frame_count > 1) + (f"; there are also {others}." if others else ".")
        self.notes = (size, text, *model.notes, *scene.notes)

    # -- the surface ---------------------------------------------------------------------------------------
    def vertices_m(self, frame: int) -> Float64s:
        """Return the vertices of a frame in metres, float64 [n, 3].

        Raises `InvalidArgument` if there is no such frame; `SourceError` if a coordinate is not finite there.
        """
        require_frame(frame, self.frame_count, self.name)
        return self._at_step(2 * frame)

    def velocities_m_s(self, frame: int) -> Float64s:
        """Return the velocities of the vertices of a frame in metres a second, float64 [n, 3].

        Central differences of the animation over one frame, half of it before and half after, truncated at
        both ends of the animation.

        Raises `InvalidArgument` if there is no such frame; `SourceError` if a coordinate is not finite there.
        """
        require_frame(frame, self.frame_count, self.name)
        step = 2 * frame
        before, after = self._time_s(step - 1), self._time_s(step + 1)
        if after <= before:
            return np.zeros_like(self._repaired.surface.vertices_m)
        return np.asarray((self._at_step(step + 1) - self._at_step(step - 1)) / (after - before))

    def surface(self, frame: int) -> Surface:
        """Return the surface of a frame.

        It has the same triangles in every frame, each starting with its longest edge.
        """
        return self._scene(frame).surface

    def _box_m(self, start: int, stop: int) -> Float64s:
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        used = np.unique(self._repaired.surface.triangles)
        for frame in range(start, stop):
            vertices = self.vertices_m(frame)[used]
            low, high = np.minimum(low, vertices.min(axis=0)), np.maximum(high, vertices.max(axis=0))
        return np.stack([low, high])

    def _time_s(self, step: int) -> float:
        """Return the time of a step (half a frame), clipped to the animation."""
        return min(max(step / (2 * self.rate_hz), 0.0), self.duration_s)

    def _poses(self, block: int) -> Poses:
        first = block * self._steps_in_block - 1
        times = np.array([self._time_s(first + i) for i in range(self._steps_in_block)])
        return self._model.poses(self._animation, times)

    def _at_step(self, step: int) -> Float64s:
        block, index = divmod(step + 1, self._steps_in_block)  # step -1 is the first: before frame 0
        with np.errstate(all="ignore"):
            vertices = self._model.vertices(self._block(block), index)[self._vertex_ids]
        return self._in_metres(vertices, f"at {self._time_s(step):.4g} s")

    def _in_metres(self, vertices: Float64s, when: str) -> Float64s:
        with np.errstate(all="ignore"):
            vertices = vertices * self._unit_m
            if self._motion is not None:
                vertices = vertices @ self._motion[0].T + self._motion[1]
            is_finite = bool((np.abs(vertices) < _LARGEST).all())
        if not is_finite:
            found = f"a coordinate that is NaN or infinite {when}"
            raise SourceError(self.name, found, "finite metres", "Export the animation again.")
        return vertices

    # -- the field -----------------------------------------------------------------------------------------
    def _scene(self, frame: int) -> MeshScene:
        latest = self._latest
        if latest is None or latest[0] != frame:
            upcoming = self._upcoming
            if upcoming is not None and upcoming[0] == frame:
                scene = upcoming[1].result()
            else:
                scene = self._make_scene(frame)
            self._latest = latest = frame, scene
            self._upcoming = None
        return latest[1]

    def _make_scene(self, frame: int) -> MeshScene:
        scene = self._static_scene(self._at_frame(frame))
        return scene if self._motions_m is None else scene.grown(self._motions_m)

    def _look_ahead(self, frame: int) -> None:
        """Let a thread make the surface of the next frame, if frames are requested one after the other.

        Much of that runs on one core, and the field of this frame leaves the others some time.
        """
        is_next, self._field_frame = frame == self._field_frame + 1, frame
        is_small = len(self._repaired.surface.triangles) <= _MAX_LOOKAHEAD_TRIANGLES
        if not (is_next and is_small and frame + 1 < self.frame_count and worker_count() > 1):
            return

        def make() -> MeshScene:
            scene = self._make_scene(frame + 1)
            scene.prepare_field()
            return scene

        self._upcoming = frame + 1, _lookahead_pool().submit(make)

    def _at_frame(self, frame: int) -> RepairedSurface:
        """Return the surface of a frame; parts that an animated scale has mirrored are turned over."""
        repaired, vertices, lids = self._repaired, self.vertices_m(frame), self._repaired.lids
        is_turned, is_triangle_turned = self._turned_vertices(frame), None
        if is_turned is not None:
            is_triangle_turned = is_turned[repaired.surface.triangles[:, 0]]
            lids = np.where(is_turned[lids[:, :1]], lids[:, ::-1], lids)
        surface = repaired.surface.with_vertices(vertices, is_triangle_turned)
        return replace(repaired, surface=surface, lids=lids, notes=())

    @cached_property
    def _part_of(self) -> Int32s:
        return self._repaired.surface.part_of_vertex()

    def _turned_vertices(self, frame: int) -> Bools | None:
        """Return the vertices of parts that face the other way than at rest, bool [n]; None without any.

        A connected part turns as most of its vertices do.
        """
        if not self._animation.has_scale:
            return None
        block, index = divmod(2 * frame + 1, self._steps_in_block)
        is_turned = self._model.turned_vertices(self._block(block), index)
        if is_turned is None:
            return None
        part_of = self._part_of
        votes = np.bincount(part_of, np.where(is_turned[self._vertex_ids], 1.0, -1.0))
        return np.asarray((votes > 0)[part_of])

    def _static_scene(self, repaired: RepairedSurface) -> MeshScene:
        return MeshScene(repaired, shell=self.shell, name=self.name)

    def thickened(self, rule: MinThickness) -> tuple[AnimatedMeshScene, tuple[ThinWall, ...]]:
        """See `Scene.thickened`; the thickness is that of the first frame, so that no wall pulsates."""
        if rule.is_of_objects:
            other = self._copy()
            other._min_thickness = rule
            walls = other._bodies_and_walls()[1]
            return (other, walls) if walls else (self, ())
        growth = self._scene(0).growth_of(replace(rule, spacing_m=rule.turned_m))
        if growth is None:
            return self, ()
        other = self._copy()
        other._motions_m = growth.motions_m
        return other, (ThinWall(Path(self.name).name, growth.thickness_m, growth.thickened_m),)

    def field(self, frame: int, grid: Grid, profile: ForceProfile) -> ForceField:
        """See `Scene.field`; with the damping of a moving surface if `profile` has any.

        Raises `InvalidArgument` if there is no such frame, or as `MeshScene.field`; `SourceError` if a
        coordinate is not finite there.
        """
        scene = self._scene(frame)
        if self._upcoming is None:
            self._look_ahead(frame)
        if profile.surface_damping_n_s_per_m > 0 and scene.velocities_m_s is None:
            scene.velocities_m_s = self.velocities_m_s(frame)
        return scene.field(0, grid, profile)

    # -- bodies --------------------------------------------------------------------------------------------
    @cached_property
    def _parts(self) -> tuple[list[RigidPart], Bools]:
        surface = self._repaired.surface
        changes = np.zeros(len(surface.vertices_m), bool)
        if self._animation.has_scale:
            start = self._turned_vertices(0)
            for frame in range(1, self.frame_count):
                now = self._turned_vertices(frame)
                if now is not None or start is not None:
                    changes |= (False if now is None else now) != (False if start is None else start)
        return rigid_parts(surface, self.vertices_m, self.frame_count, changes)

    @cached_property
    def is_of_bodies(self) -> bool:
        """True if the model consists of rigid bodies that overlap little, as the links of a robot.

        At most 45 % of the surface may lie inside other bodies, and nothing if the surface is open.
        """
        if self._parts[1].any():
            return False
        return self._hidden_fraction <= (_MAX_HIDDEN if self.is_closed else 0.0)

    @cached_property
    def _hidden_fraction(self) -> float:
        """The largest fraction of the bodies' surfaces inside other bodies, at some times; in millionths.

        A body that consists of overlapping parts has the surface of their union, so only overlaps of
        different bodies count.
        """
        sample_frames = np.unique(np.linspace(0, self.frame_count - 1, _OVERLAP_TIMES).astype(int)).tolist()
        start, at_start = self.vertices_m(0), self._at_frame(0)
        bodies = (self._cut(part.has_vertex, start, at_start).surface for part in self._parts[0])
        of_bodies_m2 = sum(outer_area_m2(body) for body in bodies)
        of_union_m2 = min(outer_area_m2(self.surface(frame)) for frame in sample_frames)
        return max(0.0, round(1 - of_union_m2 / of_bodies_m2, 6)) if of_bodies_m2 else 0.0

    @property
    def overlap_note(self) -> str:
        """A note on rigid bodies that overlap, and on the representation that follows; "" if none do."""
        if self._parts[1].any() or not self._hidden_fraction:
            return ""
        percent = f"{100 * self._hidden_fraction:.2g} %"
        note = f"Rigid parts overlap: up to {percent} of the surface is inside others"
        if self.is_of_bodies:
            return f"{note}, where the forces of objects add (--representation voxel takes the union)"
        limit = f"{100 * _MAX_HIDDEN:.2g} % is the most for objects" if self.is_closed else "and it is open"
        return f"{note}, {limit}: voxels of the union (--representation object takes the sum)"

    def bodies(self) -> tuple[Body, ...]:
        """See `Scene.bodies`: the moving rigid parts, and the deforming rest, if any."""
        return self._bodies_and_walls()[0]

    def _bodies_and_walls(self) -> tuple[tuple[Body, ...], tuple[ThinWall, ...]]:
        """Return the bodies, thickened if that is requested, and the walls that were too thin."""
        (parts, deforms), rule = self._parts, self._min_thickness
        start, at_start = self.vertices_m(0), self._at_frame(0)
        bodies, walls = list[Body](), list[ThinWall]()
        for n, part in enumerate(parts, 1):
            name = f"part {n}"
            scene = self._static_scene(self._cut(part.has_vertex, start - part.origin_m, at_start))
            if rule is not None:
                scene, thin = scene.thickened(rule.of_track(part.track))
                walls += [wall._replace(name=name) for wall in thin]
            bodies.append(Body(name, scene, part.track))
        if deforms.any() or not parts:
            rest, name = self._copy(), "what deforms" if parts else "scene"
            rest._min_thickness = None
            if parts:
                rest._vertex_ids = self._vertex_ids[deforms]
                rest._repaired = self._cut(deforms, start, self._repaired)
                rest._forget_parts()
            if rule is not None:
                rest, thin = rest.thickened(replace(rule, is_of_objects=False, turned_m=rule.whole_m))
                walls += [wall._replace(name=name) for wall in thin]
            bodies.append(Body(name, rest, PoseTrack.constant(self.frame_count)))
        return tuple(bodies), tuple(walls)

    def _copy(self) -> AnimatedMeshScene:
        """Return this scene without its cached positions."""
        other = copy.copy(self)
        other._latest = other._upcoming = other._box = None
        return other

    def _forget_parts(self) -> None:
        """Drop what follows from the vertices and their motion, after a change of either."""
        for name in ("_parts", "_part_of", "_hidden_fraction", "is_of_bodies"):
            self.__dict__.pop(name, None)

    def _cut(self, has_vertex: Bools, vertices_m: Float64s, repaired: RepairedSurface) -> RepairedSurface:
        """Return the surface of some of the vertices, with the triangles of `repaired`."""
        number = (np.cumsum(has_vertex) - 1).astype(np.int32)
        faces, lids, rim = (
            number[indices[has_vertex[indices[:, 0]]]]
            for indices in (repaired.surface.triangles, repaired.lids, repaired.rim)
        )
        surface = Surface(vertices_m[has_vertex], faces, self.name)
        return replace(repaired, surface=surface, lids=lids, rim=rim, notes=())

    def moved(self, rotation: Float64s, shift_m: Float64s) -> AnimatedMeshScene:
        """See `Scene.moved`; `InvalidArgument` if `rotation` is not a rotation."""
        other, matrix = self._copy(), checked_rotation(rotation)
        turn, shift = self._motion or (np.eye(3), np.zeros(3))
        other._motion = matrix @ turn, matrix @ shift + np.asarray(shift_m, np.float64)
        other._forget_parts()
        return other


@cache
def _lookahead_pool() -> ThreadPoolExecutor:
    """The thread that makes the surface of the next frame."""
    return ThreadPoolExecutor(1, thread_name_prefix="touchfield-animation")


# -- names and files ---------------------------------------------------------------------------------------
def _animation_number(name: str, names: list[str], requested: str | None) -> int:
    """Return the number of the requested animation, given by name or number."""
    if not names:
        raise SourceError(name, "no animation", "one animation at least", "Open it as a static mesh.")
    numbers = {str(number): number for number in range(len(names))}
    numbers |= {label: number for number, label in reversed([*enumerate(names)])}
    if requested is not None and requested not in numbers:
        listed = ", ".join(_shorten(label) for label in names[:20]) + (", ..." if len(names) > 20 else "")
        raise InvalidArgument(f"{name}, animation", _shorten(requested), listed)
    return 0 if requested is None else numbers[requested]


def _label(names: list[str], number: int) -> str:
    """Return a name for a message, with its number if it is not unique."""
    name = _shorten(names[number])
    return name if names.count(names[number]) == 1 else f"{name} (number {number})"


def _shorten(name: str) -> str:
    return repr(name if len(name) <= 40 else name[:40] + "...")


def _open(path: Path, options: SourceOptions) -> AnimatedMeshScene:
    rate_hz, mesh = options.rate_hz or _RATE_HZ, {"shell": options.shell, "holes": options.holes}
    return AnimatedMeshScene(path, options.animation, rate_hz=rate_hz, unit_m=options.unit_m, **mesh)


def _recognise(path: Path) -> bool:
    if path.suffix.lower() not in (".glb", ".gltf") or not path.is_file():
        return False
    try:
        members, _ = contents(path, with_binary=False)
    except SourceError:
        return True  # opening it then reports what is wrong
    return bool(members.get("animations") and isinstance(members["animations"], list))


KIND = SourceKind("animated-mesh", "an animated model: GLB or glTF with an animation", _recognise, _open)
