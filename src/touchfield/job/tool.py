"""The tool that a user names: point, sphere:RADIUS_M, or MESH.obj, with ,points=N behind the last two."""

from __future__ import annotations

from pathlib import Path

from touchfield.errors import InvalidArgument
from touchfield.render.tool import SPHERE_POINTS, Tool
from touchfield.sources.mesh import read_triangles

__all__ = ["tool_of"]

_FORMS = "point, sphere:RADIUS_M or MESH.obj, with ,points=N behind the last two"


def tool_of(words: str) -> Tool | None:
    """The tool that `words` name; None is a point.

    A mesh is in metres of the field, its origin is the device's point and its axes are the field's where the grip is
    not turned.

    Raises
    ------
    InvalidArgument
        If the words name none, or a number is out of range.
    SourceError
        If the mesh cannot be read.
    """
    name, comma, option = words.rpartition(",") if ",points=" in words else (words, "", "")
    points = SPHERE_POINTS
    if comma:
        try:
            points = int(option.removeprefix("points="))
        except ValueError:
            raise InvalidArgument("--tool", repr(words[:80]), _FORMS) from None
    kind, colon, rest = name.strip().partition(":")
    if kind == "point" and not colon and not comma:
        return None
    if kind == "sphere" and colon:
        try:
            radius_m = float(rest)
        except ValueError:
            raise InvalidArgument("--tool", repr(words[:80]), _FORMS) from None
        return Tool.sphere(radius_m, points)
    path = Path(name)
    if not path.is_file():
        raise InvalidArgument("--tool", repr(words[:80]), f"{_FORMS}; no such file is there")
    vertices, triangles, _ = read_triangles(path)
    return Tool.of_triangles(vertices, triangles, points, path.name)
