"""Reads scenes of rigid bodies, simulated or with given poses, from a ``.toml`` file (paper section 5.1)::

    [physics]                        # optional, as all its keys; the values here are the defaults
    seconds = 2.0
    rate_hz = 1000.0                 # frames a second; frame i is the state at i / rate_hz
    step_s = 0.001                   # of the simulation
    gravity_m_s2 = [0, 0, -9.81]
    friction = 0.6
    torsional_friction_m = 0.0
    rolling_friction_m = 0.0
    restitution = 0.3                # speed after a bounce over speed before it
    contact_s = 0.008                # length of a bounce, 7 steps or more

    [floor]                          # no floor without this table
    height_m = 0.0
    touchable = true                 # false: bodies fall on it, but it exerts no force on the hand

    [[body]]
    kind = "box"                     # box, sphere, capsule, cylinder, ellipsoid, superquadric, mesh
    half_extents_m = [0.03, 0.02, 0.01]
    name = "brick"                   # optional, as all below but position_m
    position_m = [0, 0, 0.2]
    rotation_deg = [0, 0, 0]         # about the fixed x, then y, then z axis
    velocity_m_s = [0, 0, 0]
    spin_deg_s = [0, 0, 0]           # about the axes of the scene
    density_kg_m3 = 1000             # or mass_kg
    fixed = false                    # true: it does not move

    [[body]]
    kind = "mesh"
    file = "hand.ply"                # and unit_m; or vertices_m and triangles, as lists of three numbers
    poses = "hand.csv"               # instead of position_m and later keys: see touchfield.medium.trace

The other keys of a body are those of its shape, as in `touchfield.sources.shapes.analytic_scene`; its centre
is the origin of the body's frame. Axes are x east, y north, z up. A body posed by a file pushes others and is
not moved by them. If nothing is simulated, MuJoCo is not needed, and the scene lasts as long as the pose
files.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from touchfield.errors import SourceError
from touchfield.files import require_in_folder
from touchfield.json_values import JsonValue
from touchfield.medium.pose_track import PoseTrack
from touchfield.medium.trace import Trace, read_trace
from touchfield.sources.mesh.mesh_scene import MeshScene
from touchfield.sources.options import SourceOptions
from touchfield.sources.physics.body_scene import BodyScene, notes_of_meshes
from touchfield.sources.physics.live_simulation import LiveSimulation
from touchfield.sources.physics.simulation import (
    FRAME_RATE_HZ,
    SECONDS,
    frames_of,
    load_mujoco,
    model_of,
    simulate,
)
from touchfield.sources.poses import quaternion_of_euler, track_at_rate
from touchfield.sources.registry import SourceKind
from touchfield.sources.scene import UP_Z_AXES, Body, size_note
from touchfield.sources.shapes.analytic_scene import AnalyticScene, read_toml, shape_of_table, tables
from touchfield.sources.shapes.shapes import SHAPES, Plane, Triple

_MIN_CONTACT_STEPS: Final = 7
_KINDS: Final = (*(kind for kind in SHAPES if kind != "plane"), "mesh")
_POSE_KEYS: Final = ("position_m", "rotation_deg")
_MOTION_KEYS: Final = ("velocity_m_s", "spin_deg_s", "density_kg_m3", "mass_kg")
_MESH_KEYS: Final = ("file", "unit_m", "vertices_m", "triangles")
_BODY_KEYS: Final = ("name", "poses", "fixed", *_POSE_KEYS, *_MOTION_KEYS)

# -- the keys: ranges, and combinations that are not allowed -----------------------------------------------
_RANGES: Final = {
    **dict.fromkeys(("seconds", "rate_hz", "step_s", "contact_s"), (1e-9, 1e9)),
    **dict.fromkeys(("friction", "torsional_friction_m", "rolling_friction_m"), (0.0, 1e6)),
    "restitution": (0.0, 1.0),
    **dict.fromkeys(("density_kg_m3", "mass_kg", "unit_m"), (1e-12, 1e12)),
    "height_m": (-1e9, 1e9),
}
_TRIPLES: Final = ("gravity_m_s2", *_POSE_KEYS, "velocity_m_s", "spin_deg_s")
_EXCLUSIVE: Final = {
    "poses": (*_POSE_KEYS, *_MOTION_KEYS, "fixed"),
    "fixed": _MOTION_KEYS,
    "mass_kg": ("density_kg_m3",),
    "file": ("vertices_m", "triangles"),
    "vertices_m": ("unit_m",),
}


def _value(value: JsonValue, key: str) -> Any:
    """Return the checked value of a key."""
    if key in _RANGES:
        return value.number(*_RANGES[key])
    if key in _TRIPLES:
        if len(value.items()) != 3:
            raise value.refused("a list of three numbers")
        return tuple(_value(entry, "height_m") for entry in value.elements())
    if key in ("vertices_m", "triangles"):
        return np.array([_value(row, "position_m") for row in value.elements(min_count=1)], np.float64)
    if key in ("touchable", "fixed"):
        if not isinstance(value.value, bool):
            raise value.refused("true or false")
        return value.value
    return value.text()


def _values(table: JsonValue, keys: Iterable[str]) -> dict[str, Any]:
    """Return the values of the keys that are present."""
    return {key: _value(table.at(key), key) for key in keys if key in table.members()}


def _from_table(kind: type[Any], table: JsonValue) -> Any:
    """Return a dataclass with the values of a table, which must have no other keys."""
    names = tuple(f.name for f in fields(kind))
    table.only(names)
    return kind(**_values(table, names))


@dataclass(frozen=True)
class World:
    """The table ``[physics]``."""

    seconds: float | None = None  # None: 2 s, or the duration of the pose files if nothing is simulated
    rate_hz: float = FRAME_RATE_HZ  # frames a second
    step_s: float = 0.001  # time step of the simulation
    gravity_m_s2: Triple = (0.0, 0.0, -9.81)
    friction: float = 0.6  # coefficient of sliding friction of every contact
    # torque for each newton of normal force, newton metres, against spinning about the normal and rolling
    torsional_friction_m: float = 0.0
    rolling_friction_m: float = 0.0
    restitution: float = 0.3  # speed after a bounce over speed before it, 0 to 1; below 0.02 it is 0.02
    # duration of a bounce, at least 7 steps; None is 8. A body of speed v penetrates about v contact_s / 3
    contact_s: float | None = None


@dataclass(frozen=True)
class Floor:
    """The table ``[floor]``: the half-space below a height.

    It is part of the scene if `touchable`.
    """

    height_m: float = 0.0
    touchable: bool = True


@dataclass(frozen=True)
class RigidBody:
    """A table ``[[body]]``."""

    where: str  # file and number, for messages
    name: str
    scene: AnalyticScene | MeshScene  # in the body's frame: one shape, or one mesh
    # initial state of the body's frame; rotations are about the axes of the scene
    position_m: Triple = (0.0, 0.0, 0.0)
    rotation_deg: Triple = (0.0, 0.0, 0.0)
    velocity_m_s: Triple = (0.0, 0.0, 0.0)
    spin_deg_s: Triple = (0.0, 0.0, 0.0)
    density_kg_m3: float = 1000.0
    mass_kg: float | None = None  # instead of the density
    poses: Path | None = None  # file of prescribed poses, instead of simulation
    fixed: bool = False  # True if it does not move

    @property
    def is_simulated(self) -> bool:
        """True if it is simulated: neither posed by a file nor fixed."""
        return self.poses is None and not self.fixed


class PhysicsTable(NamedTuple):
    """The tables of a file."""

    world: World
    floor: Floor | None
    bodies: tuple[RigidBody, ...]


def read_physics(path: Path, *, anywhere: bool = False) -> PhysicsTable:
    """Read a physics scene with its mesh files, but not its pose files.

    `anywhere` bool: whether it may name files outside its folder. Raises `SourceError`, which names file and
    key, if a file cannot be read or lies elsewhere, or a key is unknown, missing or invalid.
    """
    table = read_toml(path, "a TOML file with [[body]] tables")
    table.only(("physics", "floor", "body"))
    bodies = tuple(_body(path, entry, anywhere) for entry in tables(table, "body"))
    used_names = {"floor": "the floor"}
    for body in bodies:
        if body.name in used_names:
            found = f"{body.name!r}, as {used_names[body.name]} is called"
            raise SourceError(f"{body.where}.name", found, "a name of its own")
        used_names[body.name] = "another body"
    floor = _from_table(Floor, table.at("floor")) if table.get("floor") else None
    world: World = _from_table(World, table.at("physics", {}))
    if world.contact_s is None:
        world = replace(world, contact_s=8 * world.step_s)
    elif world.contact_s < _MIN_CONTACT_STEPS * world.step_s * (1 - 1e-9):
        expected = f"at least {_MIN_CONTACT_STEPS} steps of {world.step_s:g} s"
        raise table.at("physics").at("contact_s").refused(expected)
    return PhysicsTable(world, floor, bodies)


def _body(path: Path, entry: JsonValue, anywhere: bool) -> RigidBody:
    kind = entry.at("kind").text(_KINDS)
    shape_keys: tuple[str, ...] = _MESH_KEYS
    if kind != "mesh":  # the frame of a shape is that of the body
        shape_keys = tuple(f.name for f in fields(SHAPES[kind]) if f.name not in ("center_m", "rotation_deg"))  # type: ignore[arg-type]
    entry.only(("kind", *shape_keys, *_BODY_KEYS))
    if kind == "mesh":
        scene: AnalyticScene | MeshScene = _mesh(path, entry, anywhere)
    else:
        shape_values = {key: entry.value[key] for key in shape_keys if key in entry.value}
        shape = shape_of_table(replace(entry, value={"kind": kind, "center_m": [0, 0, 0], **shape_values}))
        scene = AnalyticScene((shape,), "union", UP_Z_AXES)
    values = {"name": entry.location, **_values(entry, _BODY_KEYS)}
    for name in _EXCLUSIVE:
        for other in _EXCLUSIVE[name] if {**entry.value, **values}.get(name) else ():
            if other in entry.value:
                raise entry.at(other).wrong(f"it together with {name}", "one of the two")
    if "poses" in values:
        values["poses"] = _named_file(path, entry, "poses", anywhere)
    elif "position_m" not in values:
        raise entry.wrong("no 'position_m'", "an initial position: position_m, or poses")
    return RigidBody(f"{entry.file}: {entry.location}", scene=scene, **values)


def _named_file(path: Path, entry: JsonValue, key: str, anywhere: bool) -> Path:
    """Return the path of a file that a body names."""
    return require_in_folder(
        path.parent, entry.at(key).text(), f"{entry.file}: {entry.location}.{key}", anywhere=anywhere
    )


def _mesh(path: Path, entry: JsonValue, anywhere: bool) -> MeshScene:
    values = _values(entry, _MESH_KEYS)
    if "file" in values:
        from touchfield.sources.mesh.mesh_files import read_mesh

        file = _named_file(path, entry, "file", anywhere)
        if not os.path.exists(file):
            raise entry.at("file").wrong(f"nothing at {file}", "a mesh file", "Check the path.")
        mesh = read_mesh(file)
        unit_m = values.get("unit_m") or mesh.unit_m
        vertices_m, notes = mesh.vertices * (unit_m or 1.0), mesh.notes
        if unit_m is None:
            notes = (size_note(np.ptp(vertices_m, axis=0), None, option="unit_m"), *notes)
        return MeshScene(vertices_m, mesh.triangles, name=str(file), notes=notes)
    for name in ("vertices_m", "triangles"):
        if name not in values:
            raise entry.wrong(f"no {name!r}", "a mesh: file, or vertices_m and triangles")
    corners, numbers = values["vertices_m"], values["triangles"]
    if not ((numbers % 1 == 0) & (numbers >= 0) & (numbers < len(corners))).all():
        raise entry.at("triangles").wrong(
            "a number of no vertex", f"whole numbers from 0 to {len(corners) - 1}"
        )
    return MeshScene(corners, numbers.astype(np.int32), name=f"{entry.file}: {entry.location}")


# -- the scene ---------------------------------------------------------------------------------------------
def open_physics(path: Path, options: SourceOptions) -> BodyScene:
    """Read and simulate a scene; ``options`` may override its duration and rate.

    Raises `SourceError` if a file is invalid, or the simulation diverges; `MissingExtra` if there is
    something to simulate and MuJoCo is not installed; `InvalidArgument` for too many poses.
    """
    table = read_physics(path, anywhere=options.allow_outside)
    rate = options.rate_hz or table.world.rate_hz
    poses = {body.name: read_trace(body.poses) for body in table.bodies if body.poses}
    frames = _frame_count(path, table, poses, options.seconds or table.world.seconds, rate)
    posed = {name: track_at_rate(trace, rate, frames) for name, trace in poses.items()}
    notes: tuple[str, ...] = ()
    simulation: Callable[[], LiveSimulation] | None = None
    if any(body.is_simulated for body in table.bodies):
        model, ids, warnings = model_of(load_mujoco(), table, posed, str(path))
        driven = {
            body_id: posed[body.name] for body, body_id in zip(table.bodies, ids, strict=True) if body.poses
        }
        tracks, notes = simulate(model, ids, frames, rate, str(path), driven, can_rest=True)
        if not driven:
            floor_ids = [0] * bool(table.floor and table.floor.touchable)
            simulation = partial(LiveSimulation, model, [*ids, *floor_ids], rate, str(path), can_rest=True)
        notes = (*warnings, *notes)
    else:
        for body in table.bodies:
            if not body.poses:
                turns = np.tile(quaternion_of_euler(body.rotation_deg), (frames, 1))
                posed[body.name] = replace(PoseTrack.constant(frames, body.position_m), quaternions=turns)
        tracks = [posed[body.name] for body in table.bodies]
    bodies = [Body(body.name, body.scene, track) for body, track in zip(table.bodies, tracks, strict=True)]
    if table.floor and table.floor.touchable:
        plane = Plane((0.0, 0.0, table.floor.height_m), (0.0, 0.0, 1.0))
        bodies.append(Body("floor", AnalyticScene((plane,), "union", UP_Z_AXES), PoseTrack.constant(frames)))
    notes = (*notes_of_meshes(bodies), *_late_pose_notes(poses, frames / rate, rate), *notes)
    can_move = [not body.fixed for body in table.bodies] + [False] * (len(bodies) - len(table.bodies))
    return BodyScene(bodies, rate, UP_Z_AXES, notes, simulation, can_move)


def _late_pose_notes(poses: dict[str, Trace], seconds: float, rate_hz: float) -> tuple[str, ...]:
    """Return a note for each body whose poses extend beyond the end of the scene."""
    late = [name for name, trace in poses.items() if (float(trace.times_s[-1]) - seconds) * rate_hz > 1.0]
    return tuple(f"{name}: the poses after {seconds:.6g} s are left out (--seconds)." for name in late)


def _frame_count(
    path: Path, table: PhysicsTable, poses: dict[str, Trace], seconds: float | None, rate_hz: float
) -> int:
    if seconds is None and len(poses) and not any(body.is_simulated for body in table.bodies):
        last_s = max(float(trace.times_s[-1]) for trace in poses.values())
        # includes the frame at the last pose
        seconds = (math.floor(max(last_s, 0.0) * rate_hz + 1e-6) + 1) / rate_hz
    return frames_of(str(path), SECONDS if seconds is None else seconds, rate_hz, len(table.bodies))


def _recognise(path: Path) -> bool:
    if path.suffix.lower() != ".toml" or not path.is_file():
        return False
    table = read_toml(path, "")  # if it cannot be read, the next kind that reads .toml reports why
    return "body" in table.members() or "physics" in table.members()


KIND = SourceKind(
    "physics",
    "rigid bodies that fall, collide or follow pose files, from a .toml file",
    _recognise,
    open_physics,
)
