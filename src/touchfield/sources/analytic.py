"""Analytic scenes from a ``.toml`` file::

    axes = "x right, y up, z towards the viewer"   # optional
    rate_hz = 30.0                                 # optional
    combine = "sum"                                # or "union"; optional

    [[shape]]
    kind = "sphere"                                # plane, sphere, box, superquadric, capsule, cylinder, ellipsoid
    center_m = [0.0, 0.0, 0.0]
    radius_m = 0.05

The other keys of a shape are the parameters of its class in `touchfield.sources.shapes`.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any, Final

from touchfield.errors import InvalidArgument, SourceError
from touchfield.sources.analytic_scene import AnalyticScene
from touchfield.sources.options import SourceOptions
from touchfield.sources.registry import SourceKind
from touchfield.sources.scene import UP_Y_AXES, Scene
from touchfield.sources.shapes import Box, Capsule, Cylinder, Ellipsoid, Plane, Shape, Sphere, Superquadric
from touchfield.sources.toml_values import known, number, number_or_list, read_toml, tables, text

__all__ = ["KIND", "SHAPES", "read_analytic", "shape_of_table"]

SHAPES: Final[dict[str, type[Shape]]] = {
    "plane": Plane,
    "sphere": Sphere,
    "box": Box,
    "superquadric": Superquadric,
    "capsule": Capsule,
    "cylinder": Cylinder,
    "ellipsoid": Ellipsoid,
}
"""The kinds of shape; a new one is a dataclass with a signed distance."""

_TOP: Final = ("axes", "rate_hz", "combine", "shape")


def read_analytic(path: Path, rate_hz: float | None = None) -> AnalyticScene:
    """Read a scene of shapes; `rate_hz` stands in where the file gives none.

    Raises `SourceError` if the file cannot be read, is no TOML, or a key is unknown, missing or holds the wrong
    thing.
    """
    table = read_toml(path, "a TOML file with [[shape]] tables")
    known(f"{path}", table, _TOP)
    entries = tables(f"{path}", table.get("shape"), "shape")
    shapes = [shape_of_table(f"{path}: shape {i + 1}", entry) for i, entry in enumerate(entries)]
    axes, combine = (
        text(f"{path}: {name}", table.get(name, default))
        for name, default in (("axes", UP_Y_AXES), ("combine", "sum"))
    )
    rate = number(f"{path}: rate_hz", table["rate_hz"]) if "rate_hz" in table else rate_hz or 30.0
    try:
        return AnalyticScene(shapes, combine, axes, rate)
    except InvalidArgument as error:
        raise SourceError(f"{path}: {error.where}", error.found, error.expected) from error


def shape_of_table(where: str, entry: dict[str, Any]) -> Shape:
    """The shape that a table describes: its kind, and the parameters of that kind.

    Raises `SourceError` if the kind is unknown, or a parameter is unknown, missing or at fault; it names `where` and
    the key.
    """
    kind = entry.get("kind")
    if not isinstance(kind, str) or kind not in SHAPES:
        raise SourceError(f"{where}: kind", repr(kind), f"one of {', '.join(SHAPES)}")
    made = SHAPES[kind]
    fields = dataclasses.fields(made)  # type: ignore[arg-type]
    known(where, entry, ("kind", *(f.name for f in fields)))
    values = {}
    for f in fields:
        if f.name in entry:
            values[f.name] = number_or_list(f"{where}: {f.name}", entry[f.name])
        elif f.default is dataclasses.MISSING:
            raise SourceError(f"{where}: {f.name}", "nothing", f"a value; a {kind} needs it")
    try:
        return made(**values)
    except InvalidArgument as error:
        raise SourceError(f"{where}: {error.where}", error.found, error.expected) from error
    except (TypeError, ValueError) as error:
        raise SourceError(where, "a number for a list, or a list for a number", f"the keys of a {kind}") from error


def _recognise(path: Path) -> bool:
    return path.suffix.lower() == ".toml" and path.is_file()


def _open(path: Path, options: SourceOptions) -> Scene:
    return read_analytic(path, options.rate_hz)


KIND = SourceKind("analytic", "shapes with a formula, from a .toml file", _recognise, _open)
