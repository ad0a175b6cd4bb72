"""Reads text files of points (.xyz, .pts, .txt as --as cloud): a line of numbers each, x y z first.

Columns after the third have no name. Three that look like unit vectors are normals; others (colour,
intensity) are not used. A first line with one number, as in PTS, is the number of points.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from touchfield.sources.clouds.cloud import Cloud, are_unit, require_points
from touchfield.sources.clouds.ply_points import lines_of

_MAX_LINE: Final = 4096
_MAX_COLUMNS: Final = 32
_MIN_LINE_BYTES: Final = 6  # "0 0 0\n"


def read_text(path: Path) -> Cloud:
    """Read the lines; ValueError if they are not numbers."""
    require_points(str(path), path.stat().st_size // _MIN_LINE_BYTES)
    skipped, delimiter = _layout(path)
    values = lines_of(path, comments=("#", "//"), delimiter=delimiter, skiprows=skipped)
    if values.shape[1] < 3:
        raise ValueError(f"lines of {values.shape[1]} numbers")
    points = np.ascontiguousarray(values[:, :3])
    for first in range(3, values.shape[1] - 2):
        normals = values[:, first : first + 3]
        if are_unit(normals):
            cloud, used = Cloud(points, np.asarray(normals, np.float32)), first
            break
    else:
        cloud, used = Cloud(points), values.shape[1]
    others = [i + 1 for i in range(3, values.shape[1]) if not used <= i < used + 3]
    notes = [f"Columns that are not used: {', '.join(map(str, others))}."] if others else []
    notes += [f"Columns {used + 1} to {used + 3} are unit vectors, read as normals."] * (
        len(cloud.normals) > 0
    )
    return cloud.noted(*notes)


def _layout(path: Path) -> tuple[int, str | None]:
    """Return the number of lines before the points, and the character between numbers, None for spaces."""
    skipped = 0
    with path.open("rb") as file:
        while line := file.readline(_MAX_LINE):
            text = line.decode("latin-1").split("#")[0].split("//")[0].strip()
            delimiter = next((c for c in ",;" if c in text), None)
            words = text.split(delimiter)
            if len(words) > _MAX_COLUMNS:
                raise ValueError(f"a line of {len(words)} columns")
            if len(words) >= 3 and all(map(_is_number, words)):
                return skipped, delimiter
            is_count = len(words) == 1 and _is_number(words[0])
            is_heading = not any(map(_is_number, words))
            if not is_count and not is_heading:
                raise ValueError(f"the line {text[:60]!r}")
            skipped += 1
            if skipped > 32:
                break
    raise ValueError("no line with three numbers among the first")


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
