"""Analytic scenes from a ``.toml`` file::

    axes = "x right, y up, z towards the viewer"   # optional
    rate_hz = 30.0                                 # optional
    combine = "sum"                                # or "union"; optional

    [[shape]]
    kind = "sphere"                                # plane, sphere, box, superquadric
    center_m = [0.0, 0.0, 0.0]
    radius_m = 0.05

The other keys of a shape are the parameters of its class in `touchfield.sources.shapes`.
"""

from __future__ import annotations

import dataclasses
import tomllib
from pathlib import Path
from typing import Any, Final

from touchfield.errors import InvalidArgument, SourceError
from touchfield.sources.analytic_scene import AnalyticScene
from touchfield.sources.options import SourceOptions
from touchfield.sources.registry import SourceKind
from touchfield.sources.scene import UP_Y_AXES, Scene
from touchfield.sources.shapes import Box, Plane, Shape, Sphere, Superquadric

__all__ = ["KIND", "SHAPES", "read_analytic"]

SHAPES: Final[dict[str, type[Shape]]] = {
    "plane": Plane,
    "sphere": Sphere,
    "box": Box,
    "superquadric": Superquadric,
}
"""The kinds of shape; a new one is a dataclass with a signed distance."""

_TOP: Final = ("axes", "rate_hz", "combine", "shape")


def read_analytic(path: Path, rate_hz: float | None = None) -> AnalyticScene:
    """Read a scene of shapes; `rate_hz` stands in where the file gives none.

    Raises
    ------
    SourceError
        If the file cannot be read, is no TOML, or a key is unknown, missing or holds the wrong thing.
    """
    try:
        table = tomllib.loads(path.read_text("utf-8"))
    except OSError as error:
        raise SourceError(str(path), f"that it cannot be read: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise SourceError(str(path), f"no TOML ({error})", "a TOML file with [[shape]] tables") from error
    _known(f"{path}", table, _TOP)
    entries = table.get("shape")
    if not isinstance(entries, list) or not entries or not all(isinstance(e, dict) for e in entries):
        raise SourceError(f"{path}: shape", "no list of tables", "at least one [[shape]] table")
    shapes = [_shape(f"{path}: shape {i + 1}", entry) for i, entry in enumerate(entries)]
    axes, combine = (_text(path, table, name, default) for name, default in (("axes", UP_Y_AXES), ("combine", "sum")))
    rate = _number(f"{path}: rate_hz", table["rate_hz"]) if "rate_hz" in table else rate_hz or 30.0
    try:
        return AnalyticScene(shapes, combine, axes, rate)
    except InvalidArgument as error:
        raise SourceError(f"{path}: {error.where}", error.found, error.expected) from error


def _known(where: str, table: dict[str, Any], names: tuple[str, ...]) -> None:
    for key in table:
        if key not in names:
            raise SourceError(f"{where}: {key}", "a key that is not known", f"one of {', '.join(names)}")


def _shape(where: str, entry: dict[str, Any]) -> Shape:
    kind = entry.get("kind")
    if not isinstance(kind, str) or kind not in SHAPES:
        raise SourceError(f"{where}: kind", repr(kind), f"one of {', '.join(SHAPES)}")
    made = SHAPES[kind]
    fields = dataclasses.fields(made)  # type: ignore[arg-type]
    _known(where, entry, ("kind", *(f.name for f in fields)))
    values = {}
    for f in fields:
        if f.name in entry:
            values[f.name] = _value(f"{where}: {f.name}", entry[f.name])
        elif f.default is dataclasses.MISSING:
            raise SourceError(f"{where}: {f.name}", "nothing", f"a value; a {kind} needs it")
    try:
        return made(**values)
    except InvalidArgument as error:
        raise SourceError(f"{where}: {error.where}", error.found, error.expected) from error
    except (TypeError, ValueError) as error:
        raise SourceError(where, "a number for a list, or a list for a number", f"the keys of a {kind}") from error


def _value(where: str, value: Any) -> float | tuple[float, ...]:
    if isinstance(value, list):
        return tuple(_number(where, item) for item in value)
    return _number(where, value)


def _number(where: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise SourceError(where, repr(value)[:60], "a number")
    try:
        return float(value)
    except OverflowError as error:
        raise SourceError(where, "a number beyond all bounds", "a number") from error


def _text(path: Path, table: dict[str, Any], name: str, default: str) -> str:
    value = table.get(name, default)
    if not isinstance(value, str):
        raise SourceError(f"{path}: {name}", repr(value)[:60], "a text")
    return value


def _recognise(path: Path) -> bool:
    return path.suffix.lower() == ".toml" and path.is_file()


def _open(path: Path, options: SourceOptions) -> Scene:
    return read_analytic(path, options.rate_hz)


KIND = SourceKind("analytic", "shapes with a formula, from a .toml file", _recognise, _open)
