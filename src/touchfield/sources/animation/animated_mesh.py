"""Animated glTF as a scene: skins, morph targets and moving nodes, evaluated at the rate of the medium.

Frame i shows the time i / rate_hz, for all such times before the end of the animation; the end is not shown,
so that an animation made to be repeated does not show its first frame twice. Which triangles there are and
which vertices are one is found once (`touchfield.sources.mesh.surface.welded_in_motion`); a frame is the same
surface with other vertices.

Source of the evaluation: Khronos, glTF 2.0 specification (2021); of the force on a moving surface: paper
section 3.2.

As objects, its bodies are the connected parts whose vertices move as one rigid body. What moves a part (a
node, a joint that carries all of it, several that move alike) does not matter: its motion is fitted from its
vertices, frame by frame, and it is rigid where no vertex is farther from the fit than 1e-5 of the part's
extent. Parts that move alike are one. Source of the fit: W. Kabsch, A solution for the best rotation to
relate two sets of vectors, Acta Cryst. A32, 1976.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from touchfield.arrays import Bools, Float64s, Int32s, Int64s
from touchfield.errors import InvalidArgument, SourceError, require_positive
from touchfield.medium import ForceField, Grid, PoseTrack
from touchfield.medium.pose_track import checked_rotation, quaternions_of
from touchfield.sources.camera import require_frame
from touchfield.sources.gltf.document import contents
from touchfield.sources.gltf.model import Model, Poses
from touchfield.sources.laws import ForceProfile
from touchfield.sources.mesh.mesh_scene import MeshScene, union_of
from touchfield.sources.mesh.surface import Mended, Surface, mended, welded_in_motion
from touchfield.sources.options import SourceOptions
from touchfield.sources.registry import SourceKind
from touchfield.sources.scene import UP_Y_AXES, Body, MovingScene, size_note

_RATE_HZ: Final = 60.0
_MOST_FRAMES: Final = 100_000
_BLOCK: Final = 64
_NODE_POSES: Final = 1 << 17  # node matrices of a block of times: about 50 MB with all that makes them
_LOOKS: Final = 16  # times at which vertices must be together to be one
_OVERLAP_LOOKS: Final = 5  # times at which bodies must not overlap
_LARGEST: Final = 1e15
_RIGID: Final = 1e-5


class AnimatedMeshScene(MovingScene):
    """A glTF model with one of its animations.

    animation : str or None; Its name or its number; None for the first.
    rate_hz : float; Frames a second.
    unit_m : float or None; Metres of one unit of the coordinates; None for 1, as glTF has it.
    shell, holes : str; Of an open mesh, as `MeshScene` takes them; holes are closed as they are at rest.

    Raises `SourceError` if the file or what it holds is at fault; `InvalidArgument` if there is no such
    animation, or it has too many frames.
    """

    axes = UP_Y_AXES
    unit = MeshScene.unit

    def __init__(
        self,
        path: Path,
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
        self._placed: tuple[Float64s, Float64s] | None = None
        self._block = lru_cache(maxsize=2)(self._poses)  # a frame may lie at the edge of its block
        self._latest: tuple[int, MeshScene] | None = None
        with np.errstate(all="ignore"):
            model = Model(path)
            number = _numbered(str(path), model.animation_names, animation)
            self._animation = model.animation(number)
            self.duration_s = self._animation.duration_s
            self._steps_in_block = max(1, min(_BLOCK, _NODE_POSES // max(model.node_count, 1)))
            # a duration in float32 may lie a little behind its frame
            count = self.duration_s * self.rate_hz * (1 - 1e-6)
            if count > _MOST_FRAMES:
                found = f"{self.rate_hz:g} for an animation of {self.duration_s:g} s"
                raise InvalidArgument(f"{self.name}, rate_hz", found, f"at most {_MOST_FRAMES} frames")
            self.frame_count = max(1, math.ceil(count))
            self._model = model
            looks = np.unique(np.linspace(0, self.frame_count - 1, _LOOKS).astype(int)).tolist()
            rest = self._in_metres(model.at_rest(), "at rest")
            self._kept = np.arange(len(rest))  # vertices of the model that are not one with another
            poses = np.stack([rest, *map(self.vertices_m, looks)])
            self._kept, triangles = welded_in_motion(poses, model.triangles)
            self._whole = mended(Surface(rest[self._kept], triangles, self.name), holes)
        scene = self._standing(self._whole)
        self.is_closed = scene.is_closed
        size = size_note(np.ptp(self.vertices_m(0), axis=0), unit_m, " in the first frame")
        names = model.animation_names
        others = ", ".join(_named(names, i) for i in range(len(names)) if i != number)
        text = f"Animation {_named(names, number)}: {self.duration_s:.4g} s, {self.frame_count} frame"
        text += "s" * (self.frame_count > 1) + (f"; there are also {others}." if others else ".")
        self.notes = (size, text, *model.notes, *scene.notes)

    # -- the surface
    # -----------------------------------------------------------------------------------------------
    def vertices_m(self, frame: int) -> Float64s:
        """The vertices of a frame in metres, float64 [n, 3].

        Raises `InvalidArgument` if there is no such frame; `SourceError` if a coordinate is not finite there.
        """
        require_frame(frame, self.frame_count, self.name)
        return self._at_step(2 * frame)

    def velocities_m_s(self, frame: int) -> Float64s:
        """The velocities of the vertices of a frame in metres a second, float64 [n, 3].

        Central differences of the animation over one frame, half of it before and half after; at both ends of
        the animation over what there is of it.

        Raises `InvalidArgument` if there is no such frame; `SourceError` if a coordinate is not finite there.
        """
        require_frame(frame, self.frame_count, self.name)
        step = 2 * frame
        before, after = self._time_s(step - 1), self._time_s(step + 1)
        if after <= before:
            return np.zeros_like(self._whole.surface.vertices_m)
        return np.asarray((self._at_step(step + 1) - self._at_step(step - 1)) / (after - before))

    def surface(self, frame: int) -> Surface:
        """The surface of a frame: the triangles are the same in all, but each begins with its longest edge."""
        return self._scene(frame).surface

    def _box_m(self, start: int, stop: int) -> Float64s:
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        used = np.unique(self._whole.surface.triangles)
        for frame in range(start, stop):
            vertices = self.vertices_m(frame)[used]
            low, high = np.minimum(low, vertices.min(axis=0)), np.maximum(high, vertices.max(axis=0))
        return np.stack([low, high])

    def _time_s(self, step: int) -> float:
        """The time of a step, half a frame; what is outside the animation is its end."""
        return min(max(step / (2 * self.rate_hz), 0.0), self.duration_s)

    def _poses(self, block: int) -> Poses:
        first = block * self._steps_in_block - 1
        times = np.array([self._time_s(first + i) for i in range(self._steps_in_block)])
        return self._model.poses(self._animation, times)

    def _at_step(self, step: int) -> Float64s:
        block, place = divmod(step + 1, self._steps_in_block)  # step -1 is the first: before frame 0
        with np.errstate(all="ignore"):
            vertices = self._model.vertices(self._block(block), place)[self._kept]
        return self._in_metres(vertices, f"at {self._time_s(step):.4g} s")

    def _in_metres(self, vertices: Float64s, when: str) -> Float64s:
        with np.errstate(all="ignore"):
            vertices = vertices * self._unit_m
            if self._placed is not None:
                vertices = vertices @ self._placed[0].T + self._placed[1]
            is_finite = bool((np.abs(vertices) < _LARGEST).all())
        if not is_finite:
            found = f"a coordinate that is NaN or infinite {when}"
            raise SourceError(self.name, found, "finite metres", "Export the animation again.")
        return vertices

    # -- the field
    # -------------------------------------------------------------------------------------------------
    def _scene(self, frame: int) -> MeshScene:
        latest = self._latest
        if latest is None or latest[0] != frame:
            surface = self._whole.surface.with_vertices(self.vertices_m(frame))
            self._latest = latest = frame, self._standing(replace(self._whole, surface=surface, notes=()))
        return latest[1]

    def _standing(self, whole: Mended) -> MeshScene:
        return MeshScene(whole, shell=self.shell, name=self.name)

    def field(self, frame: int, grid: Grid, profile: ForceProfile) -> ForceField:
        """See `Scene.field`; with the damping of a moving surface where `profile` asks for it.

        Raises `InvalidArgument` if there is no such frame, or as `MeshScene.field`; `SourceError` if a
        coordinate is not finite there.
        """
        scene = self._scene(frame)
        if profile.surface_damping_n_s_per_m > 0 and scene.velocities_m_s is None:
            scene.velocities_m_s = self.velocities_m_s(frame)
        return scene.field(0, grid, profile)

    # -- bodies
    # ----------------------------------------------------------------------------------------------------
    @cached_property
    def _parts(self) -> tuple[list[RigidPart], Bools]:
        return rigid_parts(self._whole.surface, self.vertices_m, self.frame_count)

    @cached_property
    def is_of_bodies(self) -> bool:
        """True if all of it is rigid bodies that do not overlap where one looks, so that objects lose
        nothing.
        """
        if self._parts[1].any():
            return False
        looks = np.unique(np.linspace(0, self.frame_count - 1, _OVERLAP_LOOKS).astype(int)).tolist()
        return all(union_of(self.surface(frame)) is None for frame in looks)

    def bodies(self) -> tuple[Body, ...]:
        """See `Scene.bodies`: the rigid parts in motion, and what deforms, if anything does."""
        parts, deforms = self._parts
        if not parts:
            return super().bodies()
        start = self.vertices_m(0)
        bodies = [
            Body(f"part {n}", self._standing(self._cut(each.has_vertex, start - each.origin_m)), each.track)
            for n, each in enumerate(parts, 1)
        ]
        if deforms.any():
            rest = self._copy()
            rest._kept, rest._whole = self._kept[deforms], self._cut(deforms, start)
            bodies.append(Body("what deforms", rest, PoseTrack.still(self.frame_count)))
        return tuple(bodies)

    def _copy(self) -> AnimatedMeshScene:
        """This scene without what is kept of where its vertices are."""
        other = copy.copy(self)
        other._latest = other._box = None
        other.__dict__.pop("_parts", None)
        return other

    def _cut(self, has_vertex: Bools, vertices_m: Float64s) -> Mended:
        """The surface of some vertices only."""
        number, whole = (np.cumsum(has_vertex) - 1).astype(np.int32), self._whole
        faces, lids, rim = (
            number[each[has_vertex[each[:, 0]]]] for each in (whole.surface.triangles, whole.lids, whole.rim)
        )
        surface = Surface(vertices_m[has_vertex], faces, self.name)
        return replace(whole, surface=surface, lids=lids, rim=rim, notes=())

    def moved(self, rotation: Float64s, shift_m: Float64s) -> AnimatedMeshScene:
        """See `Scene.moved`; `InvalidArgument` if `rotation` is not a rotation."""
        other, more = self._copy(), checked_rotation(rotation)
        turn, shift = self._placed or (np.eye(3), np.zeros(3))
        other._placed = more @ turn, more @ shift + np.asarray(shift_m, np.float64)
        return other


class RigidPart(NamedTuple):
    """Connected parts that move alike."""

    has_vertex: Bools  # bool [n]; which vertices are its own
    origin_m: (
        Float64s  # float64 [3]; where the origin of its own frame lies in frame 0, in which it is not turned
    )
    track: PoseTrack  # scene from its own frame


def rigid_parts(
    surface: Surface, vertices_m: Callable[[int], Float64s], frame_count: int
) -> tuple[list[RigidPart], Bools]:
    """The rigid parts of a surface in motion, and which vertices deform, bool [n].

    The triangles of `surface` tell what is connected; `vertices_m` gives the vertices of a frame, float64 [n,
    3].
    """
    part_of = surface.part_of_vertex()
    used = np.unique(surface.triangles)
    order = used[np.argsort(part_of[used], kind="stable")]
    looks = np.unique(np.linspace(0, frame_count - 1, _LOOKS).astype(int)).tolist()
    start = vertices_m(0)
    order, _ = _fitted(order, part_of, start, vertices_m, looks)  # what deforms mostly shows soon
    order, poses = _fitted(order, part_of, start, vertices_m, range(frame_count))
    deforms = np.zeros(len(part_of), bool)
    deforms[used] = True
    deforms[order] = False
    if not len(order):
        return [], deforms
    # in groups that move alike
    scale = np.ones((3, 4))
    scale[:, 3] = 1 / max(float(np.abs(start[order]).max()), 1e-300)
    rounded = np.round(poses[:, looks] * scale / (10 * _RIGID)).reshape(len(poses), -1)
    _, first, group = np.unique(rounded, axis=0, return_index=True, return_inverse=True)
    names, parts = np.unique(part_of[order]), []
    for number in np.argsort(first):
        rotations, shifts = poses[first[number], :, :, :3], poses[first[number], :, :, 3]
        has_vertex = np.isin(part_of, names[group.reshape(-1) == number]) & ~deforms
        has_vertex[np.setdiff1d(np.arange(len(part_of)), used)] = False
        origin, extent = start[has_vertex].mean(axis=0), np.ptp(start[has_vertex], axis=0).max()
        places = rotations @ origin + shifts
        moved = np.abs(rotations - np.eye(3)).max() * extent + np.abs(places - origin).max(initial=0.0)
        track = PoseTrack.still(frame_count, origin)
        if moved > _RIGID * extent:
            track = PoseTrack(quaternions_of(rotations), places)
        parts.append(RigidPart(has_vertex, origin, track))
    return parts, deforms


def _fitted(
    order: Int64s,
    part_of: Int32s,
    start: Float64s,
    vertices_m: Callable[[int], Float64s],
    frames: list[int] | range,
) -> tuple[Int64s, Float64s]:
    """The vertices of those parts that are rigid in these frames, and x -> R x + t of each, [parts, frames,
    3, 4].
    """
    names = part_of[order]
    first = np.flatnonzero(np.append(True, names[1:] != names[:-1]))[: len(names)]
    count = np.diff(np.append(first, len(names)))[:, None]
    if not len(order):
        return order, np.zeros((0, len(frames), 3, 4))
    number = np.repeat(np.arange(len(first)), count[:, 0])
    before = start[order]
    centre = np.add.reduceat(before, first) / count
    off = before - centre[number]
    extent = np.maximum.reduceat(np.linalg.norm(off, axis=1), first)
    is_rigid = np.ones(len(first), bool)
    poses = np.zeros((len(first), len(frames), 3, 4))
    for at, frame in enumerate(frames):
        after = vertices_m(frame)[order]
        there = np.add.reduceat(after, first) / count
        gone = after - there[number]
        together = np.add.reduceat(gone[:, :, None] * off[:, None, :], first)
        u, _, v = np.linalg.svd(together)
        u[:, :, 2] *= np.linalg.det(u @ v)[:, None]
        turn = u @ v
        error = np.linalg.norm(np.einsum("nij,nj->ni", turn[number], off) - gone, axis=1)
        is_rigid &= np.maximum.reduceat(error, first) <= _RIGID * extent
        poses[:, at, :, :3] = turn
        poses[:, at, :, 3] = there - np.einsum("pij,pj->pi", turn, centre)
    return order[is_rigid[number]], poses[is_rigid]


# -- names and files
# -----------------------------------------------------------------------------------------------
def _numbered(name: str, names: list[str], asked: str | None) -> int:
    """The number of the animation that was asked for, by name or number."""
    if not names:
        raise SourceError(
            name, "no animation", "one animation at least", "Open it as a mesh that stands still."
        )
    known = {str(number): number for number in range(len(names))}
    known |= {each: number for number, each in reversed([*enumerate(names)])}
    if asked is not None and asked not in known:
        there = ", ".join(_shown(each) for each in names[:20]) + (", ..." if len(names) > 20 else "")
        raise InvalidArgument(f"{name}, animation", _shown(asked), there)
    return 0 if asked is None else known[asked]


def _named(names: list[str], number: int) -> str:
    """A name as a message shows it, with its number where others have it too."""
    name = _shown(names[number])
    return name if names.count(names[number]) == 1 else f"{name} (number {number})"


def _shown(name: str) -> str:
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
        return True  # this reader knows what is wrong with it
    return bool(members.get("animations") and isinstance(members["animations"], list))


KIND = SourceKind("animated-mesh", "an animated model: GLB or glTF with an animation", _recognise, _open)
