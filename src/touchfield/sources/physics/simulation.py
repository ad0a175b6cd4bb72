"""A rigid-body simulation with MuJoCo: the pose of every body at the frames of a scene (paper section 5.1,
Scene 1).

Frame i is the state at the time i / rate, so that frame 0 is the state it begins from and 2 s at 1 kHz are
2000 frames. The same model gives the same poses, bit for bit, on one machine.

Of a physics scene, a contact is a spring and a damper on the relative acceleration (MuJoCo's direct
``solref``) that push and never pull: it ends where their force is zero. With the damping ratio z, theta =
acos z and w the frequency of the spring alone, that is after T = 2 theta / (w sin theta), and the speed has
fallen by exp(-2 z theta / sin theta), the restitution (Schwager and Poschel, "Coefficient of restitution and
linear-dashpot model revisited", 2007); z and w are solved for. A mesh collides as its convex hull.
"""

from __future__ import annotations

import math
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.arrays import Float64s
from touchfield.errors import InvalidArgument, SourceError, import_extra
from touchfield.medium.pose_track import PoseTrack
from touchfield.sources.mesh.mesh_scene import MeshScene
from touchfield.sources.poses import quaternion_of_turns
from touchfield.sources.shapes.shapes import Superquadric, rotation_matrix

if TYPE_CHECKING:
    from touchfield.sources.physics.toml_file import PhysicsTable, RigidBody

FRAME_RATE_HZ: Final = 1000.0  # frames a second where none are asked for: the rate of haptic rendering
SECONDS: Final = 2.0  # of a simulation, where none are asked for
START: Final = "touchfield"  # name of the keyframe from which a simulation begins, where the model has it
_MAX_POSES: Final = 1 << 22  # bodies times frames; 28 doubles of 8 bytes and their copies are kept for each
_MAX_STEPS: Final = 20_000_000  # steps times bodies: up to half a minute of one core
_STEPS_S: Final = (1e-9, 1e9)

_HARD: Final = (0.99, 0.99, 0.001, 0.5, 2.0)
"""Impedance: nearly all of the acceleration at a contact is the spring's and damper's."""

_LEAST_RESTITUTION: Final = 0.02
_MOST_DAMPED: Final = 10.0  # a damping ratio beyond that of the least restitution
_POSED_KG_M3: Final = (
    1e8  # density of a body that a file poses: nothing that it meets within a frame moves it
)
_HULL_ROWS: Final = 16
_THINNEST: Final = 1e-5
"""Thickness of a mesh, as a share of its length, below which no hull is made of it that could be trusted."""

_OVERLAP_M: Final = 1e-4

_one_at_a_time = threading.Lock()


def load_mujoco() -> Any:
    """The module, imported when it is first needed; `MissingExtra` if it is not installed."""
    return import_extra("mujoco", "a simulation of rigid bodies", "mujoco", "physics")


@contextmanager
def _warnings_heard(where: str, found: str, expected: str) -> Iterator[list[str]]:
    """Warnings of MuJoCo, which otherwise go to the screen and into a file; `SourceError` for a model at
    fault.
    """
    mujoco, heard = load_mujoco(), list[str]()
    with _one_at_a_time:  # the handler is one for the whole process
        before = mujoco.get_mju_user_warning()
        mujoco.set_mju_user_warning(lambda said: heard.append(str(said)))
        try:
            with warnings.catch_warnings(
                record=True
            ) as records:  # the compiler of models warns as Python does
                warnings.simplefilter("always")
                yield heard
        except (ValueError, MemoryError, mujoco.FatalError, mujoco.UnexpectedError) as error:
            raise SourceError(where, f"{found} ({error})", expected) from error
        finally:
            mujoco.set_mju_user_warning(before)
            heard += [str(one.message) for one in records]


def compiled(make: Callable[[], Any], where: str, found: str, expected: str) -> tuple[Any, tuple[str, ...]]:
    """Result of `make`, and what MuJoCo warned of; `SourceError` in these words where it refuses."""
    with _warnings_heard(where, found, expected) as heard:
        result = make()
    return result, tuple(f"MuJoCo warns: {' '.join(said.split())[:200]}" for said in heard)


def frames_of(where: str, seconds: float, rate_hz: float, body_count: int = 1) -> int:
    """Frames of a duration, at least one; `InvalidArgument` for more poses of so many bodies than are kept."""
    frames = seconds * rate_hz
    if not frames * body_count <= _MAX_POSES:
        found = f"{seconds:g} s at {rate_hz:g} Hz for {body_count} bodies"
        mend = "Ask for fewer seconds or a lower rate; the times of poses begin at 0."
        raise InvalidArgument(where, found, f"at most {_MAX_POSES} poses", mend)
    return max(round(frames), 1)


def simulated(
    model: Any,
    body_ids: Sequence[int],
    frame_count: int,
    rate_hz: float,
    where: str,
    posed: Mapping[int, PoseTrack] | None = None,
) -> tuple[list[PoseTrack], tuple[str, ...]]:
    """Step a model and record its bodies.

    The model's time step must divide the time between frames; where it does not, the nearest that does is
    set, and a note says so. A keyframe of the name `START` is the state it begins from. Controls are 0.
    `where` is what to call the model in messages; `posed` are the poses, and so velocities, that bodies with
    a free joint are given.

    Gives a track for each of `body_ids`, scene from body frame, and notes.

    Raises `SourceError` if the simulation diverges, MuJoCo cannot go on, or the time step is none;
    `InvalidArgument` if it would take more than 20 million steps of a body.
    """
    mujoco = load_mujoco()
    if not _STEPS_S[0] <= model.opt.timestep <= _STEPS_S[1]:
        found, (least, most) = f"{model.opt.timestep:g} s", _STEPS_S
        raise SourceError(f"{where}: timestep", found, f"{least:g} to {most:g} s")
    steps, notes = _steps_a_frame(model, rate_hz)
    if steps * frame_count * len(body_ids) > _MAX_STEPS:
        found, mend = (
            f"{frame_count} frames of {steps} steps of {len(body_ids)} bodies",
            "Make the step longer.",
        )
        raise InvalidArgument(where, found, f"at most {_MAX_STEPS} steps of a body", f"Ask for less. {mend}")
    ids = np.asarray(body_ids, np.intp)
    positions, quaternions = np.empty((frame_count, len(ids), 3)), np.empty((frame_count, len(ids), 4))
    driven = [_driven(model, body, track, rate_hz) for body, track in (posed or {}).items()]
    with _warnings_heard(where, "a simulation that stops", "a model that MuJoCo can step") as heard:
        data = mujoco.MjData(model)
        key = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, START)
        if key >= 0:
            mujoco.mj_resetDataKeyframe(model, data, key)
        for frame in range(frame_count):
            for place, motion, poses, velocities in driven:
                data.qpos[place], data.qvel[motion] = poses[frame], velocities[frame]
            mujoco.mj_kinematics(model, data)
            positions[frame], quaternions[frame] = data.xpos[ids], data.xquat[ids]
            if frame + 1 < frame_count:
                mujoco.mj_step(model, data, steps)
            if heard:
                notes += _judged(mujoco, data, heard, f"{where}, {(frame + 1) / rate_hz:g} s")
    return [PoseTrack(quaternions[:, k], positions[:, k]) for k in range(len(ids))], notes


def _driven(
    model: Any, body: int, track: PoseTrack, rate_hz: float
) -> tuple[slice, slice, Float64s, Float64s]:
    """Where a body with a free joint has its pose and velocity in the state, and both of them frame by frame."""
    joint = int(model.body_jntadr[body])
    place, motion = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
    ahead = np.diff(track.positions_m, axis=0, append=track.positions_m[-1:]) * rate_hz
    own_spin = np.einsum("fji,fj->fi", track.rotations(), track.velocities(rate_hz)[1])  # in the body's frame
    poses, velocities = np.hstack([track.positions_m, track.quaternions]), np.hstack([ahead, own_spin])
    return slice(place, place + 7), slice(motion, motion + 6), poses, velocities


def _steps_a_frame(model: Any, rate_hz: float) -> tuple[int, tuple[str, ...]]:
    """Steps between two frames; sets the model's time step to what divides the time between them."""
    period, asked = 1.0 / rate_hz, float(model.opt.timestep)
    below = max(math.floor(period / asked), 1)
    steps = min((below, below + 1), key=lambda n: (abs(period / n - asked), n))
    model.opt.timestep = period / steps
    if abs(period / steps - asked) <= 1e-9 * asked:
        return steps, ()
    wording = (
        f"A time step of {asked:g} s does not divide a frame of {period:g} s; it is {period / steps:g} s."
    )
    return steps, (wording,)


def _judged(mujoco: Any, data: Any, heard: list[str], where: str) -> tuple[str, ...]:
    """Warnings as notes; `SourceError` where they say that the state is no longer a state."""
    said = " ".join(" ".join(heard).split())[:200]
    heard.clear()
    kinds = mujoco.mjtWarning
    for kind in (kinds.mjWARN_BADQPOS, kinds.mjWARN_BADQVEL, kinds.mjWARN_BADQACC):
        if data.warning[int(kind)].number:
            expected = "a stable simulation"
            raise SourceError(where, f"that it diverges ({said})", expected, "Make the time step shorter.")
    return (f"MuJoCo warns: {said}",)


# -- a physics scene as a model
# --------------------------------------------------------------------------------
def model_of(
    mujoco: Any, table: PhysicsTable, posed: Mapping[str, PoseTrack], where: str
) -> tuple[Any, list[int], tuple[str, ...]]:
    """The model, the ids of its bodies in the order of the table, and notes.

    `posed` mapping of str to PoseTrack: of the bodies that files pose, by name; `where` str: what to call the
    scene in messages.

    Raises `SourceError` if MuJoCo refuses it, as it does a mesh without volume.
    """
    spec = mujoco.MjSpec()
    world = table.world
    spec.option.timestep, spec.option.gravity = world.step_s, world.gravity_m_s2
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    ratio = _damping_ratio(max(world.restitution, _LEAST_RESTITUTION))
    frequency = 2 * _angle_over_sine(ratio) / (world.contact_s or 8 * world.step_s)
    condim = (
        1
        if world.friction == 0
        else 6
        if world.rolling_friction_m
        else 4
        if world.torsional_friction_m
        else 3
    )
    touch: dict[str, Any] = {
        "friction": [world.friction, world.torsional_friction_m, world.rolling_friction_m],
        "condim": condim,
        "solref": [-(frequency**2), -2 * ratio * frequency],
        "solimp": list(_HARD),
    }
    if table.floor:
        plane = mujoco.mjtGeom.mjGEOM_PLANE
        spec.worldbody.add_geom(
            type=plane, size=[0, 0, 1], pos=[0, 0, table.floor.height_m], contype=0, **touch
        )
    start: dict[str, list[float]] = {"qpos": [], "qvel": []}
    notes: tuple[str, ...] = ()
    for number, body in enumerate(table.bodies):
        position, turn = list(body.position_m), quaternion_of_turns(body.rotation_deg)
        is_posed = body.name in posed
        if is_posed:
            position, turn = list(posed[body.name].positions_m[0]), posed[body.name].quaternions[0]
        in_model = spec.worldbody.add_body(
            name=f"b{number}", pos=position, quat=turn, gravcomp=float(is_posed)
        )
        if not body.fixed:
            in_model.add_freejoint()
            start["qpos"] += [*position, *turn]
            spin = np.radians(body.spin_deg_s) @ rotation_matrix(body.rotation_deg)  # in the body's own frame
            start["qvel"] += [*body.velocity_m_s, *spin]
        matter = {"density": body.density_kg_m3} if body.mass_kg is None else {"mass": body.mass_kg}
        if is_posed:
            matter = {"density": _POSED_KG_M3}
        own = {
            **touch,
            **matter,
            "contype": int(body.is_simulated),
        }  # what is not simulated meets only what is
        notes += _add_geom(mujoco, spec, in_model, f"m{number}", body, own)
    spec.add_key(name=START, **start)

    def make() -> tuple[Any, tuple[float, int, int]]:
        model = spec.compile()
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, 0)
        mujoco.mj_forward(model, data)
        return model, min(
            ((float(one.dist), one.geom1, one.geom2) for one in data.contact), default=(0.0, 0, 0)
        )

    (model, (deepest_m, *geoms)), warned = compiled(
        make, where, "bodies that MuJoCo refuses", "bodies with a volume"
    )
    notes += warned
    kind = mujoco.mjtObj.mjOBJ_BODY
    ids = [mujoco.mj_name2id(model, kind, f"b{number}") for number in range(len(table.bodies))]
    if deepest_m < -_OVERLAP_M:  # of all contacts that throw bodies apart one is told
        name_of = {
            0: "the floor",
            **{body_id: body.name for body_id, body in zip(ids, table.bodies, strict=True)},
        }
        first, second = (name_of[int(model.geom_bodyid[geom])] for geom in geoms)
        notes += (f"{second} begins {-1e3 * deepest_m:.2g} mm within {first}: it is thrown out.",)
    return model, ids, notes


def _damping_ratio(restitution: float) -> float:
    """z with exp(-2 z theta / sin theta) = restitution, by bisection."""
    low, high = 0.0, _MOST_DAMPED
    for _ in range(60):
        ratio = (low + high) / 2
        if 2 * ratio * _angle_over_sine(ratio) < -math.log(restitution):
            low = ratio
        else:
            high = ratio
    return low


def _angle_over_sine(ratio: float) -> float:
    """theta / sin theta for theta = acos(ratio), which is imaginary beyond 1."""
    if abs(ratio - 1) < 1e-9:
        return 1.0
    if ratio < 1:
        return math.acos(ratio) / math.sqrt(1 - ratio * ratio)
    return math.acosh(ratio) / math.sqrt(ratio * ratio - 1)


def _add_geom(
    mujoco: Any, spec: Any, in_model: Any, mesh_name: str, body: RigidBody, properties: dict[str, Any]
) -> tuple[str, ...]:
    """Add what collides for the scene of a body."""
    from scipy.spatial import ConvexHull

    kinds, scene = mujoco.mjtGeom, body.scene
    mesh, volume = dict[str, Any](), 0.0
    if isinstance(scene, MeshScene):
        points, triangles = np.array(scene.surface.vertices_m), np.array(scene.surface.triangles)
        volume = scene.surface.volume_m3() if scene.is_closed else 0.0
        if volume < 0:
            triangles = np.ascontiguousarray(triangles[:, ::-1])
        inertia = mujoco.mjtMeshInertia
        how = inertia.mjMESH_INERTIA_EXACT if volume else inertia.mjMESH_INERTIA_CONVEX
        mesh = {"userface": triangles.reshape(-1), "inertia": how}
    else:
        (shape,) = scene.shapes
        if not isinstance(shape, Superquadric):
            size = getattr(shape, "half_extents_m", None)
            size = size or (shape.radius_m, getattr(shape, "half_length_m", 0.0), 0.0)  # type: ignore[attr-defined]
            kind = getattr(kinds, f"mjGEOM_{type(shape).__name__.upper()}")
            in_model.add_geom(type=kind, size=list(size), **properties)
            return ()
        points = _hull_points(shape)
    sizes = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if not sizes[-1] > _THINNEST * sizes[0]:
        found = f"a body {sizes[-1] / max(sizes[0], 1e-300):.1g} as thick as it is long"
        raise SourceError(f"{body.where}: size", found, f"{_THINNEST:g} or more")
    spec.add_mesh(name=mesh_name, uservert=points.reshape(-1), **mesh)
    in_model.add_geom(type=kinds.mjGEOM_MESH, meshname=mesh_name, **properties)
    hull = float(ConvexHull(points).volume)
    is_convex = not mesh or abs(hull - abs(volume)) <= 1e-6 * hull
    return () if is_convex else (f"{body.name} is not convex: it collides as its convex hull.",)


def _hull_points(shape: Superquadric) -> Float64s:
    """Points of a superquadric's surface by its angles, float64 [n, 3]; closest where it is most curved."""
    turns = np.arange(2 * _HULL_ROWS) * (math.pi / _HULL_ROWS)
    along, around = np.meshgrid(np.linspace(-math.pi / 2, math.pi / 2, _HULL_ROWS + 1), turns)
    e1, e2 = shape.exponents

    def power(value: Float64s, exponent: float) -> Float64s:
        return np.asarray(np.sign(value) * np.abs(np.where(np.abs(value) < 1e-12, 0.0, value)) ** exponent)

    ring = power(np.cos(along), e1)
    unit = ring * power(np.cos(around), e2), ring * power(np.sin(around), e2), power(np.sin(along), e1)
    return np.asarray(
        np.unique(np.stack(unit, axis=-1).reshape(-1, 3), axis=0) * np.asarray(shape.half_extents_m)
    )
