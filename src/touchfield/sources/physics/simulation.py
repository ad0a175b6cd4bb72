"""Simulates rigid bodies with MuJoCo and records the pose of each in every frame (the paper's Scene 1,
section 5.1).

Frame i is the state at the time i / rate, so that frame 0 is the initial state and 2 s at 1 kHz are 2000
frames. On one machine the same model gives bit-identical poses.

In a physics scene, a contact is a spring and a damper on the relative acceleration (MuJoCo's direct
``solref``). They push and never pull: the contact ends when their force is zero. With the damping ratio z,
theta = acos z, and the frequency w of the undamped spring, it ends after T = 2 theta / (w sin theta), and the
speed has decreased by the factor exp(-2 z theta / sin theta), which is the restitution (Schwager and Poschel,
"Coefficient of restitution and linear-dashpot model revisited", 2007). z and w are solved from T and the
restitution. A mesh collides as its convex hull.
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
from touchfield.medium.budget import require_memory
from touchfield.medium.pose_track import MAX_POSES, PoseTrack
from touchfield.sources.mesh.mesh_scene import MeshScene
from touchfield.sources.physics.rest import RestWatch
from touchfield.sources.poses import quaternion_of_euler
from touchfield.sources.shapes.shapes import Superquadric, rotation_matrix

if TYPE_CHECKING:
    from touchfield.sources.physics.toml_file import PhysicsTable, RigidBody

FRAME_RATE_HZ: Final = 1000.0  # default frames a second: the rate of haptic rendering
SECONDS: Final = 2.0  # default duration of a simulation
START: Final = "touchfield"  # name of the keyframe from which a simulation starts, else the first
_BYTES_PER_POSE: Final = 7 * 8  # float64; the poses in hand metres share them
_BLOCK_FRAMES: Final = 1024  # frames that are recorded before they are added to the tracks
_MAX_STEPS: Final = 20_000_000  # steps times bodies: up to half a minute of one core
_STEPS_S: Final = (1e-9, 1e9)

_HARD: Final = (0.99, 0.99, 0.001, 0.5, 2.0)
"""Impedance: spring and damper determine nearly all of the acceleration at a contact."""

_MIN_RESTITUTION: Final = 0.02
_MAX_DAMPING_RATIO: Final = 10.0  # a damping ratio above that of the smallest restitution
_POSED_KG_M3: Final = 1e8
"""Density of a body posed by a file, so high that no contact moves it within a frame."""
_HULL_ROWS: Final = 16
_THINNEST: Final = 1e-5
"""Thickness of a mesh, relative to its length, below which its hull would be unreliable."""

_OVERLAP_M: Final = 1e-4

_warning_lock = threading.Lock()


def load_mujoco() -> Any:
    """Import `mujoco` on first use; `MissingExtra` if it is not installed."""
    return import_extra("mujoco", "a simulation of rigid bodies", "mujoco", "physics")


@contextmanager
def collect_warnings(where: str, found: str, expected: str) -> Iterator[list[str]]:
    """Collect MuJoCo's warnings, which otherwise go to the screen and into a file.

    Errors of MuJoCo become a `SourceError` with `found` and `expected`.
    """
    mujoco = load_mujoco()
    messages = list[str]()
    with _warning_lock:  # there is one handler for the whole process
        previous = mujoco.get_mju_user_warning()
        mujoco.set_mju_user_warning(lambda text: messages.append(str(text)))
        try:
            with warnings.catch_warnings(record=True) as records:  # the model compiler uses Python's warnings
                warnings.simplefilter("always")
                yield messages
        except (ValueError, MemoryError, mujoco.FatalError, mujoco.UnexpectedError) as error:
            raise SourceError(where, f"{found} ({error})", expected) from error
        finally:
            mujoco.set_mju_user_warning(previous)
            messages += [str(record.message) for record in records]


def compile_model(
    make: Callable[[], Any], where: str, found: str, expected: str
) -> tuple[Any, tuple[str, ...]]:
    """Return the result of `make`, and MuJoCo's warnings.

    Raises `SourceError` with these texts if it fails.
    """
    with collect_warnings(where, found, expected) as messages:
        result = make()
    return result, tuple(f"MuJoCo warns: {' '.join(message.split())[:200]}" for message in messages)


def frames_of(where: str, seconds: float, rate_hz: float, body_count: int = 1) -> int:
    """Return the number of frames of a duration, at least one.

    Raises `InvalidArgument` if a file cannot have so many poses, or they would take more than
    `memory_budget_bytes`.
    """
    frames = max(round(seconds * rate_hz), 1)
    contents = f"poses, {seconds:g} s at {rate_hz:g} Hz for {body_count} bodies"
    hint = "Ask for fewer seconds or a lower rate; the times of poses begin at 0."
    if frames * body_count > MAX_POSES:
        raise InvalidArgument(where, f"{frames * body_count} {contents}", f"at most {MAX_POSES}", hint)
    hint = f"{hint} Or set TOUCHFIELD_MEMORY_GIB."
    require_memory(where, contents, frames * body_count * _BYTES_PER_POSE, hint)
    return frames


def simulate(
    model: Any,
    body_ids: Sequence[int],
    frame_count: int,
    rate_hz: float,
    where: str,
    posed: Mapping[int, PoseTrack] | None = None,
    can_rest: bool = False,
) -> tuple[list[PoseTrack], tuple[str, ...]]:
    """Step a model and record the poses of its bodies.

    The time step of the model must divide the time between frames; otherwise the nearest one that does is
    set, with a note. The simulation starts from the keyframe named `START`, else from the first, with a
    note, else from the initial state. Controls are those of the keyframe, else 0, and do not change. `where`
    names the model in messages; `posed` are prescribed poses, and so velocities, of bodies with a free joint.
    With `can_rest` bodies that have come to rest keep their poses (`rest`); not if any body is posed, which
    could carry them.

    Returns a track, scene from body frame, for each of `body_ids`, and notes.

    Raises `SourceError` if the simulation diverges, MuJoCo fails, or the time step is invalid;
    `InvalidArgument` if it would take more than 20 million body steps.
    """
    mujoco = load_mujoco()
    if not _STEPS_S[0] <= model.opt.timestep <= _STEPS_S[1]:
        found, (shortest, longest) = f"{model.opt.timestep:g} s", _STEPS_S
        raise SourceError(f"{where}: timestep", found, f"{shortest:g} to {longest:g} s")
    steps, notes = steps_per_frame(model, rate_hz)
    if steps * frame_count * len(body_ids) > _MAX_STEPS:
        found = f"{frame_count} frames of {steps} steps of {len(body_ids)} bodies"
        mend = "Ask for less. Make the step longer."
        raise InvalidArgument(where, found, f"at most {_MAX_STEPS} steps of a body", mend)
    ids = np.asarray(body_ids, np.intp)
    recorder = _PoseRecorder(frame_count, len(ids))
    driven = [_driven_state(model, body, track, rate_hz) for body, track in (posed or {}).items()]
    rest = RestWatch(mujoco, model, rate_hz) if can_rest and not driven else None
    with collect_warnings(where, "a simulation that stops", "a model that MuJoCo can step") as messages:
        data = mujoco.MjData(model)
        notes += start_state(mujoco, model, data)
        for frame in range(frame_count):
            for position, motion, poses, velocities in driven:
                data.qpos[position], data.qvel[motion] = poses[frame], velocities[frame]
            mujoco.mj_kinematics(model, data)
            recorder.add(data.xquat[ids], data.xpos[ids])
            if frame + 1 < frame_count:
                mujoco.mj_step(model, data, steps)
                if rest is not None:
                    rest.update(data)
            if messages:
                notes += check_state(mujoco, data, messages, f"{where}, {(frame + 1) / rate_hz:g} s")
            if rest is not None and rest.is_over(data):
                mujoco.mj_kinematics(model, data)
                recorder.add_rest(data.xquat[ids], data.xpos[ids])
                break
    return recorder.tracks(), notes


class _PoseRecorder:
    """Collects the poses of all bodies frame by frame, into one array for each body.

    Poses arrive for all bodies of a frame and are needed for all frames of a body. They are moved in blocks,
    so that each pose is in memory once.
    """

    def __init__(self, frame_count: int, body_count: int) -> None:
        self._poses = [np.empty((frame_count, 7)) for _ in range(body_count)]
        self._block = np.empty((min(_BLOCK_FRAMES, frame_count), body_count, 7))
        self._stored, self._pending = 0, 0

    def add(self, quaternions: Float64s, positions_m: Float64s) -> None:
        """Add a frame: the quaternions [bodies, 4] and the positions [bodies, 3]."""
        row = self._block[self._pending]
        row[:, :4], row[:, 4:] = quaternions, positions_m
        self._pending += 1
        if self._pending == len(self._block):
            self._store_block()

    def _store_block(self) -> None:
        stop = self._stored + self._pending
        for k, poses in enumerate(self._poses):
            poses[self._stored : stop] = self._block[: self._pending, k]
        self._stored, self._pending = stop, 0

    def add_rest(self, quaternions: Float64s, positions_m: Float64s) -> None:
        """Add all frames that are left, of bodies that no longer move."""
        self._store_block()
        for poses, quaternion, position_m in zip(self._poses, quaternions, positions_m, strict=True):
            poses[self._stored :, :4], poses[self._stored :, 4:] = quaternion, position_m
        self._stored = len(self._poses[0]) if self._poses else self._stored

    def tracks(self) -> list[PoseTrack]:
        """Return the track of each body, and forget the poses."""
        self._store_block()
        tracks = list[PoseTrack]()
        while self._poses:  # each is freed when its track has a copy
            poses = self._poses.pop()
            tracks.append(PoseTrack(poses[:, :4], poses[:, 4:]))
        return tracks[::-1]


def start_state(mujoco: Any, model: Any, data: Any) -> tuple[str, ...]:
    """Set the state to a keyframe, if the model has any; returns a note on the choice."""
    if not model.nkey:
        return ()
    named = int(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, START))
    mujoco.mj_resetDataKeyframe(model, data, max(named, 0))
    if named >= 0:
        return ()
    name = repr(model.key(0).name[:40]) if model.key(0).name else "0"
    others = f" of {model.nkey} (one named {START!r} would be used instead)" if model.nkey > 1 else ""
    return (f"The simulation starts from the keyframe {name}{others}.",)


def _driven_state(
    model: Any, body: int, track: PoseTrack, rate_hz: float
) -> tuple[slice, slice, Float64s, Float64s]:
    """Return the slices of pose and velocity of a free body in the state, and their values in each frame."""
    joint = int(model.body_jntadr[body])
    position, motion = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
    velocity = np.diff(track.positions_m, axis=0, append=track.positions_m[-1:]) * rate_hz
    spin = np.einsum(
        "fji,fj->fi", track.rotations(), track.velocities(rate_hz)[1]
    )  # in the frame of the body
    poses, velocities = np.hstack([track.positions_m, track.quaternions]), np.hstack([velocity, spin])
    return slice(position, position + 7), slice(motion, motion + 6), poses, velocities


def steps_per_frame(model: Any, rate_hz: float) -> tuple[int, tuple[str, ...]]:
    """Return the steps between two frames.

    Sets the model's time step to a divisor of that time.
    """
    period_s, step_s = 1.0 / rate_hz, float(model.opt.timestep)
    floor = max(math.floor(period_s / step_s), 1)
    steps = min((floor, floor + 1), key=lambda n: (abs(period_s / n - step_s), n))
    model.opt.timestep = period_s / steps
    if abs(period_s / steps - step_s) <= 1e-9 * step_s:
        return steps, ()
    wording = (
        f"A time step of {step_s:g} s does not divide a frame of {period_s:g} s; it is {period_s / steps:g} "
        "s."
    )
    return steps, (wording,)


def check_state(mujoco: Any, data: Any, messages: list[str], where: str) -> tuple[str, ...]:
    """Return warnings as notes; `SourceError` if they report an invalid state."""
    text = " ".join(" ".join(messages).split())[:200]
    messages.clear()
    kinds = mujoco.mjtWarning
    for kind in (kinds.mjWARN_BADQPOS, kinds.mjWARN_BADQVEL, kinds.mjWARN_BADQACC):
        if data.warning[int(kind)].number:
            expected = "a stable simulation"
            raise SourceError(where, f"that it diverges ({text})", expected, "Make the time step shorter.")
    return (f"MuJoCo warns: {text}",)


# -- a physics scene as a model ----------------------------------------------------------------------------
def model_of(
    mujoco: Any, table: PhysicsTable, posed: Mapping[str, PoseTrack], where: str
) -> tuple[Any, list[int], tuple[str, ...]]:
    """Return the model of a table, the ids of its bodies, and notes.

    The ids are in the order of the table.

    `posed` mapping of str to PoseTrack: tracks of the bodies posed by files, by name; `where` str: name of
    the scene in messages.

    Raises `SourceError` if MuJoCo rejects the model, such as a mesh without volume.
    """
    spec = mujoco.MjSpec()
    world = table.world
    spec.option.timestep, spec.option.gravity = world.step_s, world.gravity_m_s2
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    ratio = _damping_ratio(max(world.restitution, _MIN_RESTITUTION))
    frequency = 2 * _angle_over_sine(ratio) / (world.contact_s or 8 * world.step_s)
    condim = 3
    if world.friction == 0:
        condim = 1
    elif world.rolling_friction_m:
        condim = 6
    elif world.torsional_friction_m:
        condim = 4
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
        position, turn = list(body.position_m), quaternion_of_euler(body.rotation_deg)
        is_posed = body.name in posed
        if is_posed:
            position, turn = list(posed[body.name].positions_m[0]), posed[body.name].quaternions[0]
        in_model = spec.worldbody.add_body(
            name=f"b{number}", pos=position, quat=turn, gravcomp=float(is_posed)
        )
        if not body.fixed:
            in_model.add_freejoint()
            start["qpos"] += [*position, *turn]
            spin = np.radians(body.spin_deg_s) @ rotation_matrix(
                body.rotation_deg
            )  # in the frame of the body
            start["qvel"] += [*body.velocity_m_s, *spin]
        mass = {"density": body.density_kg_m3} if body.mass_kg is None else {"mass": body.mass_kg}
        if is_posed:
            mass = {"density": _POSED_KG_M3}
        # bodies that are not simulated collide only with those that are
        properties = {**touch, **mass, "contype": int(body.is_simulated)}
        notes += _add_geom(mujoco, spec, in_model, f"m{number}", body, properties)
    spec.add_key(name=START, **start)

    def make() -> tuple[Any, tuple[float, int, int]]:
        model = spec.compile()
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, 0)
        mujoco.mj_forward(model, data)
        contacts = ((float(contact.dist), contact.geom1, contact.geom2) for contact in data.contact)
        return model, min(contacts, default=(0.0, 0, 0))

    (model, (deepest_m, *geoms)), warnings = compile_model(
        make, where, "bodies that MuJoCo refuses", "bodies with a volume"
    )
    notes += warnings
    kind = mujoco.mjtObj.mjOBJ_BODY
    ids = [mujoco.mj_name2id(model, kind, f"b{number}") for number in range(len(table.bodies))]
    if deepest_m < -_OVERLAP_M:  # report only the deepest of these overlaps
        name_of = {
            0: "the floor",
            **{body_id: body.name for body_id, body in zip(ids, table.bodies, strict=True)},
        }
        first, second = (name_of[int(model.geom_bodyid[geom])] for geom in geoms)
        notes += (f"{second} begins {-1e3 * deepest_m:.2g} mm within {first}: they will be pushed apart.",)
    return model, ids, notes


def _damping_ratio(restitution: float) -> float:
    """Solve exp(-2 z theta / sin theta) = restitution for z by bisection."""
    low, high = 0.0, _MAX_DAMPING_RATIO
    for _ in range(60):
        ratio = (low + high) / 2
        if 2 * ratio * _angle_over_sine(ratio) < -math.log(restitution):
            low = ratio
        else:
            high = ratio
    return low


def _angle_over_sine(ratio: float) -> float:
    """Return theta / sin theta for theta = acos(ratio), which is imaginary above 1."""
    if abs(ratio - 1) < 1e-9:
        return 1.0
    if ratio < 1:
        return math.acos(ratio) / math.sqrt(1 - ratio * ratio)
    return math.acosh(ratio) / math.sqrt(ratio * ratio - 1)


def _add_geom(
    mujoco: Any, spec: Any, in_model: Any, mesh_name: str, body: RigidBody, properties: dict[str, Any]
) -> tuple[str, ...]:
    """Add the collision geom of a body; return notes."""
    from scipy.spatial import ConvexHull

    kinds, scene = mujoco.mjtGeom, body.scene
    mesh, volume = dict[str, Any](), 0.0
    if isinstance(scene, MeshScene):
        points, triangles = np.array(scene.surface.vertices_m), np.array(scene.surface.triangles)
        volume = scene.surface.volume_m3() if scene.is_closed else 0.0
        if volume < 0:
            triangles = np.ascontiguousarray(triangles[:, ::-1])
        inertia = mujoco.mjtMeshInertia
        inertia_kind = inertia.mjMESH_INERTIA_EXACT if volume else inertia.mjMESH_INERTIA_CONVEX
        mesh = {"userface": triangles.reshape(-1), "inertia": inertia_kind}
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
    """Sample a superquadric's surface by its angles, float64 [n, 3], densest where curvature is largest."""
    turns = np.arange(2 * _HULL_ROWS) * (math.pi / _HULL_ROWS)
    latitude, longitude = np.meshgrid(np.linspace(-math.pi / 2, math.pi / 2, _HULL_ROWS + 1), turns)
    e1, e2 = shape.exponents

    def power(value: Float64s, exponent: float) -> Float64s:
        return np.asarray(np.sign(value) * np.abs(np.where(np.abs(value) < 1e-12, 0.0, value)) ** exponent)

    ring = power(np.cos(latitude), e1)
    unit = (
        ring * power(np.cos(longitude), e2),
        ring * power(np.sin(longitude), e2),
        power(np.sin(latitude), e1),
    )
    return np.asarray(
        np.unique(np.stack(unit, axis=-1).reshape(-1, 3), axis=0) * np.asarray(shape.half_extents_m)
    )
