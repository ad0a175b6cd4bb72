"""Patterns of bHaptics vests: the ``.tact`` project (JSON), in dot mode.

No specification is published. The shape rests on what the maker's open SDKs parse (project with layout and tracks, a
track's effects, their modes by position, dot mode with its feedback) and on projects of its designer that others have
published: times in milliseconds from the beginning of the effect, intensities 0 to 1, `VestFront` and `VestBack` with
four columns and five rows each, index = 4 * row + column from the top left, `Tactot` the type of the layout.

A project is written as one effect on one track: its feedback is a list of spans, each with the dots that are on.

A vest with fewer rows is written to all 20 dots, as the adapter of bHaptics drives it: of four rows the lowest is the
fourth and the fifth, of two the upper is the first two and the lower the other three.

**Resolution.** Intensities are whole hundredths. A span is at least `LEAST_SPAN_MS` long, the designer's interval; of
the frames that fall into one span each dot takes its greatest drive, so that no tap is lost. Times are whole
milliseconds. Frequencies have no place: a vest shakes at its own.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.adapters.json_values import JsonValue, read_json
from touchfield.errors import InvalidArgument
from touchfield.medium.atomic import atomic_path

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.adapters.symbolic import ArrayEffect

__all__ = ["COLUMNS", "LEAST_SPAN_MS", "ROWS", "TactSpan", "fits_vest", "read_tact", "write_tact"]

COLUMNS: Final = 4
ROWS: Final = 5
LEAST_SPAN_MS: Final = 20
_POSITIONS: Final = {"front": "VestFront", "back": "VestBack"}
_ROWS_OF: Final = {5: (0, 1, 2, 3, 4), 4: (0, 1, 2, 3, 3), 2: (0, 0, 1, 1, 1)}
"""Rows of the vest -> the one that each row of dots shows."""

_STEPS: Final = 100
_MAX_BYTES: Final = 1 << 25
_MAX_MS: Final = 1 << 31


@dataclass(frozen=True)
class TactSpan:
    """Dots that are on for a while.

    Attributes
    ----------
    position : str
        "VestFront" or "VestBack".
    start_ms, end_ms : int
        From the beginning of the pattern.
    intensities : float32 [5, 4]
        0 to 1; row 0 is the top one.
    """

    position: str
    start_ms: int
    end_ms: int
    intensities: NDArray[np.float32]


def fits_vest(lattice: tuple[int, int, int]) -> bool:
    """Whether an array of these columns and rows is one that a vest's dots can show."""
    columns, rows, depth = lattice
    return columns == COLUMNS and rows in _ROWS_OF and depth == 1


def write_tact(path: str | Path, effect: ArrayEffect, *, panel: str = "front", name: str = "") -> None:
    """Write the drives of a vest as ``.tact``.

    Parameters
    ----------
    path : Path
    effect : ArrayEffect
        Of four columns and five, four or two rows.
    panel : str
        "front" or "back".
    name : str
        Of the pattern; by default that of the file.

    Raises
    ------
    InvalidArgument
        If the array is another, or there is no such panel.
    SourceError
        If the system refuses to write.
    """
    columns, rows, _ = effect.lattice
    if not fits_vest(effect.lattice):
        found, expected = f"{columns} columns, {rows} rows", f"{COLUMNS} columns, and 5, 4 or 2 rows"
        raise InvalidArgument("array", found, expected, "Take --device tactsuit-x40.")
    if panel not in _POSITIONS:
        raise InvalidArgument("panel", repr(panel), " or ".join(_POSITIONS))
    spans = list(_spans(effect))
    length_ms = max(1, round(1000 * len(effect) / effect.rate_hz))
    modes = {position: _dot_mode(spans if panel == side else [], length_ms) for side, position in _POSITIONS.items()}
    called = name or Path(path).stem
    layout = [
        {"index": COLUMNS * row + column, "x": round(column / (COLUMNS - 1), 3), "y": round(row / (ROWS - 1), 3)}
        for row in range(ROWS)
        for column in range(COLUMNS)
    ]
    track = {
        "enable": True,
        "effects": [{"name": called, "startTime": 0, "offsetTime": length_ms, "modes": modes}],
    }
    project = {
        "name": called,
        "id": called,
        "description": "",
        "createdAt": 0,
        "updatedAt": 0,
        "mediaFileDuration": math.ceil(length_ms / 1000),
        "layout": {"name": "Tactot", "type": "Tactot", "layouts": dict.fromkeys(_POSITIONS.values(), layout)},
        "tracks": [track],
    }
    document = {
        "project": project,
        "durationMillis": length_ms,
        "intervalMillis": LEAST_SPAN_MS,
        "size": COLUMNS * ROWS,
    }
    with atomic_path(Path(path)) as temporary:
        temporary.write_text(json.dumps(document) + "\n", encoding="utf-8")


def read_tact(path: str | Path) -> tuple[TactSpan, ...]:
    """The dots of a ``.tact`` file, by their beginning; what is in path mode is not read.

    Parameters
    ----------
    path : Path

    Raises
    ------
    SourceError
        If the file cannot be read, is longer than 32 MiB, is no JSON, or is of another shape.
    """
    root = read_json(path, _MAX_BYTES, "a .tact file")
    spans: list[TactSpan] = []
    for track in root.at("project").at("tracks").each():
        for effect in track.at("effects").each():
            begin = effect.at("startTime").whole(0, _MAX_MS)
            modes = effect.at("modes")
            for position in _POSITIONS.values():
                mode = modes.get(position)
                if mode is not None and mode.at("mode").text(("DOT_MODE", "PATH_MODE")) == "DOT_MODE":
                    feedback = mode.at("dotMode").at("feedback").each()
                    spans += [_span(one, position, begin) for one in feedback]
    return tuple(
        sorted((one for one in spans if one.intensities.any()), key=lambda one: (one.start_ms, one.position))
    )


def _span(one: JsonValue, position: str, begin: int) -> TactSpan:
    start = one.at("startTime").whole(0, _MAX_MS)
    end = one.at("endTime").whole(start, _MAX_MS)
    intensities = np.zeros(COLUMNS * ROWS, np.float32)
    for point in one.at("pointList").each():
        intensities[point.at("index").whole(0, COLUMNS * ROWS - 1)] = point.at("intensity").number(0, 1)
    return TactSpan(position, begin + start, begin + end, intensities.reshape(ROWS, COLUMNS))


def _spans(effect: ArrayEffect) -> Iterator[tuple[int, int, NDArray[np.int64]]]:
    """Spans of equal hundredths, int64 [5, 4], from and to a time, milliseconds; without those of silence."""
    frame_ms = 1000 / effect.rate_hz
    each = max(1, math.ceil(LEAST_SPAN_MS / frame_ms - 1e-9))
    firsts = np.arange(0, len(effect), each)
    steps = np.round(np.maximum.reduceat(effect.drives, firsts, axis=0) * _STEPS).astype(np.int64)
    steps = steps[:, _ROWS_OF[effect.drives.shape[1]]]
    times = np.round(np.append(firsts, len(effect)) * frame_ms).astype(np.int64).tolist()
    changes = np.flatnonzero((steps[1:] != steps[:-1]).any(axis=(1, 2))) + 1
    for first, stop in zip([0, *changes.tolist()], [*changes.tolist(), len(steps)]):
        if steps[first].any():
            yield times[first], max(times[stop], times[first] + 1), steps[first]


def _dot_mode(spans: list[tuple[int, int, NDArray[np.int64]]], length_ms: int) -> dict[str, Any]:
    feedback = [
        {
            "startTime": start,
            "endTime": end,
            "playbackType": "NONE",
            "pointList": [
                {"index": COLUMNS * int(row) + int(column), "intensity": int(steps[row, column]) / _STEPS}
                for row, column in np.argwhere(steps)
            ],
        }
        for start, end, steps in spans
    ]
    silence = {"startTime": 0, "endTime": length_ms, "playbackType": "NONE", "pointList": []}
    path = {"movingPattern": "CONST_SPEED", "playbackType": "NONE", "visible": True, "pointList": []}
    return {
        "mode": "DOT_MODE",
        "dotMode": {"dotConnected": False, "feedback": feedback or [silence]},
        "pathMode": {"feedback": [path]},
    }
