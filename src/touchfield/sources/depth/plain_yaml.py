"""Reads the part of YAML in which camera parameters are written (ROS, OpenCV, Kalibr, ORB-SLAM).

That part is: nested mappings by indentation, numbers and words, lists in brackets (over several lines) or by
dashes, comments, OpenCV's head ``%YAML:1.0`` and tags such as ``!!opencv-matrix``, which other readers
refuse.
"""

from __future__ import annotations

import re
from typing import Any

from touchfield.errors import SourceError

_ENTRY = re.compile(r"( *)(- +)?([A-Za-z_][\w. -]*?)\s*:(?:\s+(.*))?")
_ITEM = re.compile(r" *- +(.*)")


def parse_yaml(text: str, where: str) -> dict[str, Any]:
    """Return the contents of a YAML file of camera parameters: dicts, lists, floats, ints and words.

    Lines of other forms are ignored. Raises `SourceError` if a list has no end.
    """
    root: dict[str, Any] = {}
    parents: list[tuple[int, dict[str, Any]]] = [(-1, root)]
    latest: tuple[dict[str, Any], str] = root, ""
    lines = iter(line.split(" #")[0].rstrip() for line in text.expandtabs(4).splitlines())
    for line in lines:
        if line.lstrip().startswith(("#", "%", "---", "...")):
            continue
        item, entry = _ITEM.fullmatch(line), _ENTRY.fullmatch(line)
        if item and not (entry and entry[4]):
            holder, key = latest
            if not isinstance(holder.get(key), list):
                holder[key] = []
            holder[key].append(_value(item[1], lines, where))
        elif entry:
            indent = len(entry[1])
            while parents[-1][0] >= indent:
                parents.pop()
            holder, key = parents[-1][1], entry[3]
            value = re.sub(r"^!!?[\w/.:-]+\s*", "", entry[4] or "")
            holder[key] = _value(value, lines, where) if value else {}
            if not value:
                parents.append((indent, holder[key]))
            latest = holder, key
    return root


def _value(text: str, lines: Any, where: str) -> Any:
    """Return the value of a text: a list in brackets, which may take further lines, a number or a word."""
    if not text.startswith("["):
        return _scalar(text)
    while text.count("[") > text.count("]"):
        line = next(lines, None)
        if line is None:
            raise SourceError(where, "a list without its end", "numbers in brackets", "Copy the file again.")
        text += " " + line.strip()
    rows = re.findall(r"\[([^\[\]]*)\]", text)
    values = [[_scalar(token) for token in row.split(",") if token.strip()] for row in rows]
    return values[0] if len(values) == 1 else values


def _scalar(text: str) -> Any:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text.strip().strip("'\"")
