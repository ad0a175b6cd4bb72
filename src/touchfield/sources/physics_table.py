"""The TOML file of a physics scene, checked; its keys are described in `touchfield.sources.physics`."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from touchfield.arrays import Float64s
from touchfield.errors import SourceError
from touchfield.files import require_beside
from touchfield.sources.analytic_scene import AnalyticScene, shape_of_table
from touchfield.sources.mesh_scene import MeshScene
from touchfield.sources.scene import UP_Z_AXES
from touchfield.sources.shapes import SHAPES, Triple
from touchfield.sources.simulation import FRAME_RATE_HZ
from touchfield.sources.toml_values import known, number, read_toml, tables, text

DENSITY_KG_M3: Final = 1000.0

_KINDS: Final = (*(kind for kind in SHAPES if kind != "plane"), "mesh")
_PLACE: Final = ("position_m", "rotation_deg")
_MOTION: Final = ("velocity_m_s", "spin_deg_s", "density_kg_m3", "mass_kg")
_MESH: Final = ("file", "unit_m", "vertices_m", "triangles")
_HELD: Final = ("center_m", "rotation_deg")  # of a shape: its frame is the body's
_FEWEST_STEPS: Final = 7


def _within(least: float, most: float) -> Callable[[str, Any], float]:
    """A reader of numbers in a range."""

    def read(where: str, value: Any) -> float:
        given = number(where, value)
        if not least <= given <= most:
            raise SourceError(where, f"{given:g}", f"a number from {least:g} to {most:g}")
        return given

    return read


_coordinate = _within(-1e9, 1e9)


def _triple(where: str, value: Any) -> Triple:
    if not isinstance(value, list) or len(value) != 3:
        raise SourceError(where, repr(value)[:60], "a list of three numbers")
    x, y, z = (_coordinate(where, item) for item in value)
    return x, y, z


def _rows(where: str, value: Any) -> Float64s:
    if not isinstance(value, list) or not value:
        raise SourceError(where, repr(value)[:60], "a list of lists of three numbers")
    return np.array([_triple(where, row) for row in value], np.float64)


def _flag(where: str, value: Any) -> bool:
    if not isinstance(value, bool):
        raise SourceError(where, repr(value)[:60], "true or false")
    return value


_READERS: Final[dict[str, Callable[[str, Any], Any]]] = {
    **dict.fromkeys(("seconds", "rate_hz", "step_s", "contact_s"), _within(1e-9, 1e9)),
    **dict.fromkeys(("friction", "torsional_friction_m", "rolling_friction_m"), _within(0.0, 1e6)),
    "restitution": _within(0.0, 1.0),
    **dict.fromkeys(("density_kg_m3", "mass_kg", "unit_m"), _within(1e-12, 1e12)),
    "height_m": _coordinate,
    **dict.fromkeys(("gravity_m_s2", *_PLACE, "velocity_m_s", "spin_deg_s"), _triple),
    **dict.fromkeys(("vertices_m", "triangles"), _rows),
    **dict.fromkeys(("touchable", "fixed"), _flag),
    **dict.fromkeys(("name", "poses", "file"), text),
}
_ALONE: Final = {
    "poses": (*_PLACE, *_MOTION, "fixed"),
    "fixed": _MOTION,
    "mass_kg": ("density_kg_m3",),
    "file": ("vertices_m", "triangles"),
    "vertices_m": ("unit_m",),
}
"""Keys of a body, and those that must not stand beside them."""


def _read(where: str, table: dict[str, Any], names: Iterable[str]) -> dict[str, Any]:
    """The values of those keys that are there."""
    return {name: _READERS[name](f"{where}: {name}", table[name]) for name in names if name in table}


def _filled(kind: type[Any], where: str, table: Any) -> Any:
    """The dataclass of that kind with the values of a table, which has no other keys."""
    if not isinstance(table, dict):
        raise SourceError(where, repr(table)[:60], "a table")
    names = tuple(f.name for f in fields(kind))
    known(where, table, names)
    return kind(**_read(where, table, names))


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
    density_kg_m3: float = DENSITY_KG_M3
    mass_kg: float | None = None  # in place of the density
    poses: Path | None = None  # file of the poses it takes in place of being simulated
    is_fixed: bool = False  # whether it stays where it is

    @property
    def is_simulated(self) -> bool:
        """True if it falls and collides."""
        return self.poses is None and not self.is_fixed


@dataclass(frozen=True)
class PhysicsTable:
    """A whole file."""

    world: World
    floor: Floor | None
    bodies: tuple[RigidBody, ...]


def read_physics(path: Path, *, anywhere: bool = False) -> PhysicsTable:
    """Read a physics scene; mesh files are read too, pose files are not.

    `anywhere` bool: whether it may name files outside its folder.

    Raises `SourceError` if a file cannot be read or lies elsewhere, or a key is unknown, missing or holds the wrong
    thing; it names file and key.
    """
    table = read_toml(path, "a TOML file with [[body]] tables")
    known(str(path), table, ("physics", "floor", "body"))
    entries = tables(str(path), table.get("body"), "body")
    bodies = tuple(_body(path, i, entry, anywhere) for i, entry in enumerate(entries, 1))
    taken = {"floor": "the floor"}
    for body in bodies:
        if body.name in taken:
            found = f"{body.name!r}, as {taken[body.name]} is called"
            raise SourceError(f"{body.where}: name", found, "a name of its own")
        taken[body.name] = "another body"
    floor = _filled(Floor, f"{path}: floor", table["floor"]) if "floor" in table else None
    return PhysicsTable(_world(f"{path}: physics", table.get("physics", {})), floor, bodies)


def _world(where: str, table: Any) -> World:
    world: World = _filled(World, where, table)
    if world.contact_s is None:
        return replace(world, contact_s=8 * world.step_s)
    if world.contact_s < _FEWEST_STEPS * world.step_s * (1 - 1e-9):
        found, expected = f"{world.contact_s:g}", f"at least {_FEWEST_STEPS} steps of {world.step_s:g} s"
        raise SourceError(f"{where}: contact_s", found, expected)
    return world


def _body(path: Path, count: int, entry: dict[str, Any], anywhere: bool) -> RigidBody:
    where = f"{path}: body {count}"
    kind = entry.get("kind")
    if not isinstance(kind, str) or kind not in _KINDS:
        raise SourceError(f"{where}: kind", repr(kind)[:60], f"one of {', '.join(_KINDS)}")
    own = _MESH if kind == "mesh" else tuple(f.name for f in fields(SHAPES[kind]) if f.name not in _HELD)  # type: ignore[arg-type]
    known(where, entry, ("kind", "name", "poses", "fixed", *own, *_PLACE, *_MOTION))
    of_kind = {key: entry[key] for key in own if key in entry}
    scene = _mesh(path, where, of_kind, anywhere) if kind == "mesh" else _shape(where, kind, of_kind)
    given = {"name": f"body {count}", **_read(where, entry, ("name", "poses", "fixed", *_PLACE, *_MOTION))}
    for name in _ALONE:
        for other in _ALONE[name] if {**entry, **given}.get(name) else ():
            if other in entry:
                raise SourceError(f"{where}: {other}", f"it beside {name}", "one of the two")
    if "poses" in given:
        given["poses"] = require_beside(path.parent, given["poses"], f"{where}: poses", anywhere=anywhere)
    elif "position_m" not in given:
        raise SourceError(f"{where}: position_m", "nothing", "where the body begins: position_m, or poses")
    return RigidBody(where, scene=scene, is_fixed=given.pop("fixed", False), **given)


def _shape(where: str, kind: str, of_kind: dict[str, Any]) -> AnalyticScene:
    shape = shape_of_table(where, {"kind": kind, "center_m": [0, 0, 0], **of_kind})
    return AnalyticScene((shape,), "union", UP_Z_AXES)


def _mesh(path: Path, where: str, of_kind: dict[str, Any], anywhere: bool) -> MeshScene:
    given = _read(where, of_kind, _MESH)
    if "file" in given:
        from touchfield.sources.mesh import read_triangles

        file = require_beside(path.parent, given["file"], f"{where}: file", anywhere=anywhere)
        if not file.exists():
            raise SourceError(f"{where}: file", f"nothing at {file}", "a mesh file", "Check the path.")
        vertices, triangles, notes = read_triangles(file)
        return MeshScene(vertices * given.get("unit_m", 1.0), triangles, name=str(file), notes=notes)
    for name in ("vertices_m", "triangles"):
        if name not in given:
            raise SourceError(f"{where}: {name}", "nothing", "a mesh: file, or vertices_m and triangles")
    corners, numbers = given["vertices_m"], given["triangles"]
    if not ((numbers % 1 == 0) & (numbers >= 0) & (numbers < len(corners))).all():
        expected = f"whole numbers from 0 to {len(corners) - 1}"
        raise SourceError(f"{where}: triangles", "a number of no vertex", expected)
    return MeshScene(corners, numbers.astype(np.int32), name=where)
