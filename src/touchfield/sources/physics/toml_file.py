"""Scenes of rigid bodies that fall and collide, or that files pose, from a ``.toml`` file (paper section
5.1)::

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

    [floor]                          # without this table there is none
    height_m = 0.0
    touchable = true                 # false: bodies fall on it, but it is not felt

    [[body]]
    kind = "box"                     # box, sphere, capsule, cylinder, ellipsoid, superquadric, mesh
    half_extents_m = [0.03, 0.02, 0.01]
    name = "brick"                   # optional, as all below but position_m
    position_m = [0, 0, 0.2]
    rotation_deg = [0, 0, 0]         # about the fixed x, then y, then z axis
    velocity_m_s = [0, 0, 0]
    spin_deg_s = [0, 0, 0]           # about the axes of the scene
    density_kg_m3 = 1000             # or mass_kg
    fixed = false                    # true: it stays where it is

    [[body]]
    kind = "mesh"
    file = "hand.ply"                # and unit_m; or vertices_m and triangles, as lists of three numbers
    poses = "hand.csv"               # in place of position_m and what follows: see touchfield.medium.trace

The other keys of a body are those of its shape, as in `touchfield.sources.shapes.analytic_scene`; its middle
is the origin of the body's frame. Axes are x east, y north, z up. A body that a file poses pushes others and
is moved by none. Where nothing is simulated, no MuJoCo is needed, and the scene lasts as long as the pose
files.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from touchfield.errors import SourceError
from touchfield.files import require_beside
from touchfield.json_values import JsonValue
from touchfield.medium.pose_track import PoseTrack
from touchfield.medium.trace import Trace, read_trace
from touchfield.sources.mesh.mesh_scene import MeshScene
from touchfield.sources.options import SourceOptions
from touchfield.sources.physics.body_scene import BodyScene
from touchfield.sources.physics.simulation import (
    FRAME_RATE_HZ,
    SECONDS,
    frames_of,
    load_mujoco,
    model_of,
    simulated,
)
from touchfield.sources.poses import quaternion_of_turns, track_at_rate
from touchfield.sources.registry import SourceKind
from touchfield.sources.scene import UP_Z_AXES, Body
from touchfield.sources.shapes.analytic_scene import AnalyticScene, read_toml, shape_of_table, tables
from touchfield.sources.shapes.shapes import SHAPES, Plane, Triple

_FEWEST_STEPS: Final = 7
_KINDS: Final = (*(kind for kind in SHAPES if kind != "plane"), "mesh")
_PLACE: Final = ("position_m", "rotation_deg")
_MOTION: Final = ("velocity_m_s", "spin_deg_s", "density_kg_m3", "mass_kg")
_MESH: Final = ("file", "unit_m", "vertices_m", "triangles")
_OF_BODY: Final = ("name", "poses", "fixed", *_PLACE, *_MOTION)

# -- the keys: what each holds, and what must not stand beside it
_RANGES: Final = {
    **dict.fromkeys(("seconds", "rate_hz", "step_s", "contact_s"), (1e-9, 1e9)),
    **dict.fromkeys(("friction", "torsional_friction_m", "rolling_friction_m"), (0.0, 1e6)),
    "restitution": (0.0, 1.0),
    **dict.fromkeys(("density_kg_m3", "mass_kg", "unit_m"), (1e-12, 1e12)),
    "height_m": (-1e9, 1e9),
}
_TRIPLES: Final = ("gravity_m_s2", *_PLACE, "velocity_m_s", "spin_deg_s")
_ALONE: Final = {
    "poses": (*_PLACE, *_MOTION, "fixed"),
    "fixed": _MOTION,
    "mass_kg": ("density_kg_m3",),
    "file": ("vertices_m", "triangles"),
    "vertices_m": ("unit_m",),
}


def _value(one: JsonValue, key: str) -> Any:
    """The value of a key, checked."""
    if key in _RANGES:
        return one.number(*_RANGES[key])
    if key in _TRIPLES:
        if len(one.items()) != 3:
            raise one.refused("a list of three numbers")
        return tuple(_value(each, "height_m") for each in one.each())
    if key in ("vertices_m", "triangles"):
        return np.array([_value(row, "position_m") for row in one.each(least=1)], np.float64)
    if key in ("touchable", "fixed"):
        if not isinstance(one.value, bool):
            raise one.refused("true or false")
        return one.value
    return one.text()


def _values(table: JsonValue, keys: Iterable[str]) -> dict[str, Any]:
    """The values of those keys that are there."""
    return {key: _value(table.at(key), key) for key in keys if key in table.members()}


def _filled(kind: type[Any], table: JsonValue) -> Any:
    """The dataclass of that kind with the values of a table, which has no other keys."""
    names = tuple(f.name for f in fields(kind))
    table.only(names)
    return kind(**_values(table, names))


@dataclass(frozen=True)
class World:
    """The table ``[physics]``."""

    seconds: float | None = None  # none: 2 s, or what the pose files hold where nothing is simulated
    rate_hz: float = FRAME_RATE_HZ  # frames a second
    step_s: float = 0.001  # time step of the simulation
    gravity_m_s2: Triple = (0.0, 0.0, -9.81)
    friction: float = 0.6  # coefficient of sliding friction of every contact
    # torque for each newton of normal force, newton metres, against turning about the normal and rolling
    torsional_friction_m: float = 0.0
    rolling_friction_m: float = 0.0
    restitution: float = 0.3  # speed after a bounce over speed before it, 0 to 1; below 0.02 it is 0.02
    # how long a bounce lasts, at least 7 steps; None is 8. What arrives at v enters by about v contact_s / 3
    contact_s: float | None = None


@dataclass(frozen=True)
class Floor:
    """The table ``[floor]``: everything below a height; `touchable` says whether it is a part of the scene."""

    height_m: float = 0.0
    touchable: bool = True


@dataclass(frozen=True)
class RigidBody:
    """A table ``[[body]]``."""

    where: str  # file and number, for messages
    name: str
    scene: AnalyticScene | MeshScene  # in the body's frame: one shape, or one mesh
    # of the body's frame at the start; all turns are about the axes of the scene
    position_m: Triple = (0.0, 0.0, 0.0)
    rotation_deg: Triple = (0.0, 0.0, 0.0)
    velocity_m_s: Triple = (0.0, 0.0, 0.0)
    spin_deg_s: Triple = (0.0, 0.0, 0.0)
    density_kg_m3: float = 1000.0
    mass_kg: float | None = None  # in place of the density
    poses: Path | None = None  # file of the poses it takes in place of being simulated
    fixed: bool = False  # whether it stays where it is

    @property
    def is_simulated(self) -> bool:
        """True if it falls and collides."""
        return self.poses is None and not self.fixed


class PhysicsTable(NamedTuple):
    """A whole file."""

    world: World
    floor: Floor | None
    bodies: tuple[RigidBody, ...]


def read_physics(path: Path, *, anywhere: bool = False) -> PhysicsTable:
    """Read a physics scene; mesh files are read too, pose files are not.

    `anywhere` bool: whether it may name files outside its folder. Raises `SourceError` if a file cannot be
    read or lies elsewhere, or a key is unknown, missing or holds the wrong thing; it names file and key.
    """
    table = read_toml(path, "a TOML file with [[body]] tables")
    table.only(("physics", "floor", "body"))
    bodies = tuple(_body(path, entry, anywhere) for entry in tables(table, "body"))
    taken = {"floor": "the floor"}
    for body in bodies:
        if body.name in taken:
            found = f"{body.name!r}, as {taken[body.name]} is called"
            raise SourceError(f"{body.where}.name", found, "a name of its own")
        taken[body.name] = "another body"
    floor = _filled(Floor, table.at("floor")) if table.get("floor") else None
    world: World = _filled(World, table.at("physics", {}))
    if world.contact_s is None:
        world = replace(world, contact_s=8 * world.step_s)
    elif world.contact_s < _FEWEST_STEPS * world.step_s * (1 - 1e-9):
        expected = f"at least {_FEWEST_STEPS} steps of {world.step_s:g} s"
        raise table.at("physics").at("contact_s").refused(expected)
    return PhysicsTable(world, floor, bodies)


def _body(path: Path, entry: JsonValue, anywhere: bool) -> RigidBody:
    kind = entry.at("kind").text(_KINDS)
    own: tuple[str, ...] = _MESH
    if kind != "mesh":  # the frame of a shape is the body's
        own = tuple(f.name for f in fields(SHAPES[kind]) if f.name not in ("center_m", "rotation_deg"))  # type: ignore[arg-type]
    entry.only(("kind", *own, *_OF_BODY))
    if kind == "mesh":
        scene: AnalyticScene | MeshScene = _mesh(path, entry, anywhere)
    else:
        of_kind = {key: entry.value[key] for key in own if key in entry.value}
        shape = shape_of_table(replace(entry, value={"kind": kind, "center_m": [0, 0, 0], **of_kind}))
        scene = AnalyticScene((shape,), "union", UP_Z_AXES)
    values = {"name": entry.place, **_values(entry, _OF_BODY)}
    for name in _ALONE:
        for other in _ALONE[name] if {**entry.value, **values}.get(name) else ():
            if other in entry.value:
                raise entry.at(other).wrong(f"it beside {name}", "one of the two")
    if "poses" in values:
        values["poses"] = _beside(path, entry, "poses", anywhere)
    elif "position_m" not in values:
        raise entry.wrong("no 'position_m'", "where the body begins: position_m, or poses")
    return RigidBody(f"{entry.file}: {entry.place}", scene=scene, **values)


def _beside(path: Path, entry: JsonValue, key: str, anywhere: bool) -> Path:
    """The path of a file that a body names."""
    return require_beside(
        path.parent, entry.at(key).text(), f"{entry.file}: {entry.place}.{key}", anywhere=anywhere
    )


def _mesh(path: Path, entry: JsonValue, anywhere: bool) -> MeshScene:
    values = _values(entry, _MESH)
    if "file" in values:
        from touchfield.sources.mesh.mesh_files import read_triangles

        file = _beside(path, entry, "file", anywhere)
        if not file.exists():
            raise entry.at("file").wrong(f"nothing at {file}", "a mesh file", "Check the path.")
        vertices, triangles, notes = read_triangles(file)
        return MeshScene(vertices * values.get("unit_m", 1.0), triangles, name=str(file), notes=notes)
    for name in ("vertices_m", "triangles"):
        if name not in values:
            raise entry.wrong(f"no {name!r}", "a mesh: file, or vertices_m and triangles")
    corners, numbers = values["vertices_m"], values["triangles"]
    if not ((numbers % 1 == 0) & (numbers >= 0) & (numbers < len(corners))).all():
        raise entry.at("triangles").wrong(
            "a number of no vertex", f"whole numbers from 0 to {len(corners) - 1}"
        )
    return MeshScene(corners, numbers.astype(np.int32), name=f"{entry.file}: {entry.place}")


# -- the scene
# -------------------------------------------------------------------------------------------------
def open_physics(path: Path, options: SourceOptions) -> BodyScene:
    """Read a scene, simulate it, and give its bodies in motion; ``options`` gives other seconds or another
    rate.

    Raises `SourceError` if a file is at fault, or the simulation diverges; `MissingExtra` if there is
    something to simulate and MuJoCo is not installed; `InvalidArgument` if that is more poses than are kept.
    """
    table = read_physics(path, anywhere=options.allow_outside)
    rate = options.rate_hz or table.world.rate_hz
    poses = {body.name: read_trace(body.poses) for body in table.bodies if body.poses}
    frames = _frame_count(path, table, poses, options.seconds or table.world.seconds, rate)
    posed = {name: track_at_rate(trace, rate, frames) for name, trace in poses.items()}
    notes: tuple[str, ...] = ()
    if any(body.is_simulated for body in table.bodies):
        model, ids, warnings = model_of(load_mujoco(), table, posed, str(path))
        driven = {
            body_id: posed[body.name] for body, body_id in zip(table.bodies, ids, strict=True) if body.poses
        }
        tracks, notes = simulated(model, ids, frames, rate, str(path), driven)
        notes = (*warnings, *notes)
    else:
        for body in table.bodies:
            if not body.poses:
                turns = np.tile(quaternion_of_turns(body.rotation_deg), (frames, 1))
                posed[body.name] = replace(PoseTrack.still(frames, body.position_m), quaternions=turns)
        tracks = [posed[body.name] for body in table.bodies]
    bodies = [Body(one.name, one.scene, track) for one, track in zip(table.bodies, tracks, strict=True)]
    if table.floor and table.floor.touchable:
        plane = Plane((0.0, 0.0, table.floor.height_m), (0.0, 0.0, 1.0))
        bodies.append(Body("floor", AnalyticScene((plane,), "union", UP_Z_AXES), PoseTrack.still(frames)))
    return BodyScene(bodies, rate, UP_Z_AXES, (*_outside(poses, frames / rate, rate), *notes))


def _outside(poses: dict[str, Trace], seconds: float, rate_hz: float) -> tuple[str, ...]:
    """A note for each body whose poses go on after the end of the scene."""
    late = [name for name, trace in poses.items() if (float(trace.times_s[-1]) - seconds) * rate_hz > 1.0]
    return tuple(f"{name}: the poses after {seconds:.6g} s are left out (--seconds)." for name in late)


def _frame_count(
    path: Path, table: PhysicsTable, poses: dict[str, Trace], seconds: float | None, rate_hz: float
) -> int:
    if seconds is None and len(poses) and not any(body.is_simulated for body in table.bodies):
        last_s = max(float(trace.times_s[-1]) for trace in poses.values())
        # the frame at the last pose is one too
        seconds = (math.floor(max(last_s, 0.0) * rate_hz + 1e-6) + 1) / rate_hz
    return frames_of(str(path), SECONDS if seconds is None else seconds, rate_hz, len(table.bodies))


def _recognise(path: Path) -> bool:
    if path.suffix.lower() != ".toml" or not path.is_file():
        return False
    table = read_toml(path, "")  # where it cannot be read, the next kind that takes .toml will say why
    return "body" in table.members() or "physics" in table.members()


KIND = SourceKind(
    "physics",
    "rigid bodies that fall, collide or follow pose files, from a .toml file",
    _recognise,
    open_physics,
)
