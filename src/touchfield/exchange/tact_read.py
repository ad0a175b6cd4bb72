"""Reads ``.tact``, the projects of bHaptics' designer, as the drives of an array of actuators.

No specification is published. The keys are those that the vendor's open SDKs parse (``ProjectModel.h`` of
``bhaptics/haptic-library``), and the numbers may be strings, as its designer writes them. A file is a
project, or an object with a member "project".

**Tracks** contain effects, which last `offsetTime` from their `startTime` on, in milliseconds. A track with
``"enable": false`` is left out. Where effects overlap, their intensities add up to at most 1, as in the
vendor's open player (``bhaptics/tac-cpp``).

**Dot mode.** A span drives its dots from `startTime` to `endTime`, in milliseconds of the effect. "FADE_IN"
rises linearly from 0 over the span, "FADE_OUT" falls to 0, "FADE_IN_OUT" rises until the middle and falls
from there. If dots are connected, each dot changes linearly from its intensity in a span to that in the next
one; projects that contain the vendor's own rendering agree with that to a hundredth.

**Path mode.** A point moves linearly from one entry to the next, at their times; a single point stays for the
whole effect. It is shared among the four dots around it by bilinear weights. How the vendor's player shares
it is not published.

**Positions** become panels side by side: those that are driven, ordered as `POSITIONS` and then as they
appear. The front or back of a vest alone has four columns and five rows. Other positions have the columns and
rows of their layout. The format has no frequencies. A span between two frames is placed at the nearest one.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np

from touchfield.arrays import Float64s, Int64s
from touchfield.devices.drivers.bhaptics import COLUMNS, POSITIONS
from touchfield.errors import InvalidArgument
from touchfield.exchange.effect_files import ROWS
from touchfield.exchange.symbolic import (
    DEFAULT_RATE_HZ,
    MAX_SECONDS,
    MAX_VALUES,
    ArrayEffect,
    ImportedEffect,
    check_rate,
    checked_frames,
)
from touchfield.exchange.unused_keys import UnusedKeys
from touchfield.json_values import JsonValue, read_json

_MAX_BYTES: Final = 1 << 24
_MAX_WORK: Final = 1 << 27
"""Limit of intensities that are computed: frames of all spans times the dots of their panels."""
_MAX_DOTS: Final = 256
_MAX_MS: Final = 1000 * MAX_SECONDS
_SLACK_MS: Final = 0.5
"""Times are whole milliseconds: a frame may be half of one early."""
_FADES: Final = ("NONE", "FADE_IN", "FADE_OUT", "FADE_IN_OUT")
_PROJECT_KEYS: Final = (
    "tracks", "layout", "id", "name", "description", "createdAt", "updatedAt", "updateTime", "creationTime",
    "mediaFileDuration", "mediaFileUrl", "thumbnailUrl", "hapticEffectSize", "parentId", "column", "row",
    "peaks",
)  # fmt: skip
_FILE_KEYS: Final = ("project", "name", "durationMillis", "intervalMillis", "size", "feedback")


@dataclass(frozen=True)
class _Panel:
    """The dots of one position, by index: columns and rows from the top left."""

    columns: int
    rows: int
    cells: tuple[int, ...]  # row * columns + column of each index


@dataclass(frozen=True)
class _Span:
    """Dots whose intensities are linear from `start_ms` to `end_ms`, and faded over that time.

    `first` and `last` map the cell of a dot to its intensity at the two ends.
    """

    start_ms: float
    end_ms: float
    fade: str
    first: dict[int, float]
    last: dict[int, float]

    @property
    def is_driven(self) -> bool:
        return any(self.first.values()) or any(self.last.values())

    def intensities(self, times_ms: Float64s, panel: _Panel) -> Float64s:
        """Return float64 [n, rows, columns] at times of the span, before it is faded."""
        length_ms = max(self.end_ms - self.start_ms, 1e-9)
        fraction = np.clip((times_ms - self.start_ms) / length_ms, 0, 1)
        images = np.zeros((len(times_ms), panel.rows, panel.columns))
        for cell in self.first.keys() | self.last.keys():
            row, column = divmod(cell, panel.columns)
            start, end = self.first.get(cell, 0.0), self.last.get(cell, 0.0)
            images[:, row, column] = start + (end - start) * fraction
        return images


@dataclass(frozen=True)
class _Path:
    """A point that moves over the dots; it is faded from `start_ms` to `end_ms`."""

    start_ms: float
    end_ms: float
    fade: str
    points: Float64s  # [n, 4]: milliseconds, x and y from the top left, intensity; the last three 0 to 1

    @property
    def is_driven(self) -> bool:
        return bool(self.points[:, 3].any())

    def intensities(self, times_ms: Float64s, panel: _Panel) -> Float64s:
        """Return float64 [n, rows, columns] at times of the path, before it is faded."""
        at_ms, *values = self.points.T
        x, y, intensity = (np.interp(times_ms, at_ms, value) for value in values)
        images, frames = np.zeros((len(times_ms), panel.rows, panel.columns)), np.arange(len(times_ms))
        for column, across in _neighbours(x, panel.columns):
            for row, down in _neighbours(y, panel.rows):
                images[frames, row, column] += intensity * across * down
        if len(at_ms) > 1:  # a point that moves is gone after its last time
            images[times_ms > at_ms[-1] + _SLACK_MS] = 0
        return images


def _neighbours(fraction: Float64s, count: int) -> tuple[tuple[Int64s, Float64s], tuple[Int64s, Float64s]]:
    """Return the two dots around each place along an axis of `count` dots, and their weights."""
    low = np.clip(np.floor(fraction * (count - 1)), 0, max(count - 2, 0)).astype(np.int64)
    weight = fraction * (count - 1) - low
    return (low, 1 - weight), (np.minimum(low + 1, count - 1), weight)


_Driven = _Span | _Path


@dataclass
class _Reader:
    unused: UnusedKeys = field(default_factory=UnusedKeys)
    panels: dict[str, _Panel] = field(default_factory=dict)
    spans: dict[str, list[_Driven]] = field(default_factory=dict)
    end_ms: float = 0.0
    disabled: int = 0
    has_paths: bool = False


def read_tact(path: str | Path, rate_hz: float = DEFAULT_RATE_HZ) -> ImportedEffect:
    """Read a ``.tact`` file as drives of an array, sampled at `rate_hz`.

    Raises SourceError if the file cannot be read, is longer than 16 MiB, is not JSON, or has a value of the
    wrong type or out of range; and if no dot is driven, or it is longer than an hour. Raises InvalidArgument
    if the rate is out of range, or there would be too many drives.
    """
    check_rate(rate_hz)
    root, reader = read_json(path, _MAX_BYTES, "a .tact file"), _Reader()
    project = root.get("project")
    if project is None:
        project = root
    else:
        reader.unused.check(root, *_FILE_KEYS)
    reader.unused.check(project, *_PROJECT_KEYS)
    layouts = _layouts(project)
    for track in project.at("tracks").elements():
        _read_track(track, layouts, reader)
    driven = [name for name, spans in reader.spans.items() if any(span.is_driven for span in spans)]
    if not driven:
        raise project.at("tracks").wrong("no dot that is driven", "a pattern that drives a dot")
    driven.sort(key=lambda name: POSITIONS.index(name) if name in POSITIONS else len(POSITIONS))
    effect = _sample(root, [(reader.panels[name], reader.spans[name]) for name in driven], reader, rate_hz)
    device_name = "tactsuit-x40" if len(driven) == 1 and driven[0] in POSITIONS else ""
    return ImportedEffect(effect, device_name, notes=_notes(driven, reader))


def _notes(driven: list[str], reader: _Reader) -> tuple[str, ...]:
    notes: tuple[str, ...] = ()
    if len(driven) > 1 or driven[0] not in POSITIONS[:1]:
        places = " (side by side)" if len(driven) > 1 else ""
        notes += (f"Positions: {', '.join(name[:20] for name in driven)}{places}.",)
    if reader.has_paths:
        notes += (
            "A point of a path is shared among the dots around it by distance: how the vendor's player "
            "shares it is not published.",
        )
    if reader.disabled:
        notes += (f"Left out: {reader.disabled} tracks that are not enabled.",)
    return (*notes, *reader.unused.notes())


# -- the document ------------------------------------------------------------------------------------------


def _number(value: JsonValue, low: float, high: float) -> float:
    """Return a number from `low` to `high`, also one that is written as a string."""
    text = value.value
    if isinstance(text, str):
        try:
            number = float(text)
        except ValueError:
            raise value.refused(f"a number from {low:g} to {high:g}") from None
        value = JsonValue(number if math.isfinite(number) else None, value.file, value.location)
    return value.number(low, high)


def _layouts(project: JsonValue) -> dict[str, JsonValue]:
    layout = project.get("layout")
    if layout is None or layout.value is None:
        return {}
    layouts = layout.at("layouts", {})
    return {name: layouts.at(name) for name in layouts.members()}


def _panel(name: str, layouts: dict[str, JsonValue], where: JsonValue) -> _Panel:
    """Return the columns and rows of a position; a row if its layout is no lattice."""
    if name in POSITIONS:
        return _Panel(COLUMNS, ROWS, tuple(range(COLUMNS * ROWS)))
    if name not in layouts:
        raise where.wrong(f"position {name[:40]!r}", "one with a layout in the project", "Export it again.")
    layout = layouts[name]
    dots = {}
    for entry in layout.elements(1):
        index = entry.at("index").bounded_integer(0, _MAX_DOTS - 1)
        dots[index] = tuple(round(_number(entry.at(axis), -1e6, 1e6), 3) for axis in "xy")
    if sorted(dots) != list(range(len(dots))):
        raise layout.wrong(f"indices {sorted(dots)[:8]}", "indices from 0 without a gap")
    across, down = (sorted({dot[axis] for dot in dots.values()}) for axis in (0, 1))
    cells = tuple(down.index(dots[n][1]) * len(across) + across.index(dots[n][0]) for n in range(len(dots)))
    if len(across) * len(down) == len(dots) == len(set(cells)):
        return _Panel(len(across), len(down), cells)
    return _Panel(len(dots), 1, tuple(range(len(dots))))


def _read_track(track: JsonValue, layouts: dict[str, JsonValue], reader: _Reader) -> None:
    reader.unused.check(track, "enable", "effects", "id", "projectId", "name")
    if track.at("enable", True).value is False:
        reader.disabled += 1
        return
    for effect in track.at("effects", []).elements():
        reader.unused.check(effect, "id", "name", "startTime", "offsetTime", "modes", "priority", "trackId")
        start_ms = _number(effect.at("startTime", 0), 0, _MAX_MS)
        length_ms = _number(effect.at("offsetTime", 0), 0, _MAX_MS)
        reader.end_ms = max(reader.end_ms, start_ms + length_ms)
        modes = effect.at("modes")
        for name in modes.members():
            mode = modes.at(name)
            spans = list(_spans(mode, name, layouts, start_ms, length_ms, reader))
            reader.spans.setdefault(name, []).extend(spans)
            reader.end_ms = max([reader.end_ms, *(span.end_ms for span in spans)])
    if reader.end_ms > _MAX_MS:
        raise track.wrong(f"a pattern of {reader.end_ms / 1000:g} s", f"at most {MAX_SECONDS:g} s")


def _spans(
    mode: JsonValue,
    name: str,
    layouts: dict[str, JsonValue],
    start_ms: float,
    length_ms: float,
    reader: _Reader,
) -> Iterator[_Driven]:
    """Yield the spans of one position of an effect."""
    reader.unused.check(mode, "mode", "dotMode", "pathMode", "texture")
    if mode.at("texture", None).value:
        reader.unused.add(mode.at("texture").location)
    kind = mode.at("mode", "DOT_MODE").text(("DOT_MODE", "PATH_MODE"))
    part = mode.at("dotMode" if kind == "DOT_MODE" else "pathMode", {})
    lists = [entry for entry in part.at("feedback", []).elements() if entry.at("pointList", []).items()]
    if not lists:
        return
    if name not in reader.panels:
        reader.panels[name] = _panel(name, layouts, mode)
    panel = reader.panels[name]
    if kind == "PATH_MODE":
        reader.unused.check(part, "feedback")
        reader.has_paths = True
        for entry in lists:
            yield _path(entry, start_ms, length_ms, reader.unused)
        return
    reader.unused.check(part, "feedback", "dotConnected")
    dots = [_dot_span(entry, panel, start_ms, reader.unused) for entry in part.at("feedback").elements()]
    is_connected = part.at("dotConnected", False).value is True
    for span, following in zip(dots, [*dots[1:], None]):
        if is_connected and following is not None:
            yield replace(span, last=following.first)
        elif not is_connected or span.end_ms > span.start_ms:
            yield span


def _dot_span(entry: JsonValue, panel: _Panel, effect_ms: float, unused: UnusedKeys) -> _Span:
    unused.check(entry, "startTime", "endTime", "playbackType", "pointList")
    start_ms = effect_ms + _number(entry.at("startTime", 0), 0, _MAX_MS)
    end_ms = effect_ms + _number(entry.at("endTime"), 0, _MAX_MS)
    if end_ms < start_ms:
        raise entry.at("endTime").wrong(f"{end_ms - effect_ms:g} ms", "a time after startTime")
    fade = entry.at("playbackType", "NONE").text(_FADES)
    values: dict[int, float] = {}
    for point in entry.at("pointList", []).elements():
        unused.check(point, "index", "intensity")
        index = _number(point.at("index"), 0, len(panel.cells) - 1)
        if not index.is_integer():
            raise point.at("index").refused("the number of a dot")
        cell = panel.cells[int(index)]
        values[cell] = min(1.0, values.get(cell, 0.0) + _number(point.at("intensity"), 0, 1))
    return _Span(start_ms, end_ms, fade, values, values)


def _path(entry: JsonValue, effect_ms: float, length_ms: float, unused: UnusedKeys) -> _Path:
    unused.check(entry, "movingPattern", "playbackType", "pointList", "visible")
    fade = entry.at("playbackType", "NONE").text(_FADES)
    points: list[tuple[float, ...]] = []
    for point in entry.at("pointList").elements():
        unused.check(point, "x", "y", "intensity", "time")
        time_ms = effect_ms + _number(point.at("time", 0), 0, _MAX_MS)
        if points and time_ms < points[-1][0]:
            raise point.at("time").wrong(f"{time_ms - effect_ms:g} ms", "points in the order of time")
        points.append((time_ms, *(_number(point.at(name), 0, 1) for name in ("x", "y", "intensity"))))
    end_ms = max(effect_ms + length_ms, points[-1][0])
    return _Path(points[0][0] if len(points) > 1 else effect_ms, end_ms, fade, np.array(points))


# -- the drives --------------------------------------------------------------------------------------------


def _sample(
    root: JsonValue, panels: list[tuple[_Panel, list[_Driven]]], reader: _Reader, rate_hz: float
) -> ArrayEffect:
    frame_ms = 1000 / rate_hz
    rows, columns = max(panel.rows for panel, _ in panels), sum(panel.columns for panel, _ in panels)
    frames = max(1, math.ceil((reader.end_ms - _SLACK_MS) / frame_ms - 1e-9))
    checked_frames(root.file, frames, rows * columns, MAX_VALUES)
    work = sum(
        (2 + (span.end_ms - span.start_ms) / frame_ms) * panel.rows * panel.columns
        for panel, spans in panels
        for span in spans
    )
    if work > _MAX_WORK:
        raise InvalidArgument(
            root.file, f"{work:.3g} intensities of spans", f"at most {_MAX_WORK}", "Take a lower rate."
        )
    total = np.zeros((frames, rows, columns))
    left = 0
    for panel, spans in panels:
        for span in spans:
            _add_span(total[:, : panel.rows, left : left + panel.columns], panel, span, frame_ms)
        left += panel.columns
    return ArrayEffect(float(rate_hz), np.minimum(total, 1).astype(np.float32))


def _add_span(total: Float64s, panel: _Panel, span: _Driven, frame_ms: float) -> None:
    """Add a span to the drives of its panel, float64 [frames, rows, columns]."""
    first = max(0, math.ceil((span.start_ms - _SLACK_MS) / frame_ms - 1e-9))
    stop = min(len(total), math.ceil((span.end_ms - _SLACK_MS) / frame_ms - 1e-9))
    times_ms: Float64s = np.arange(first, stop, dtype=np.float64) * frame_ms
    if stop <= first:  # between two frames
        times_ms = np.array([(span.start_ms + span.end_ms) / 2])
        first = min(round(times_ms[0] / frame_ms), len(total) - 1)
        stop = first + 1
    length_ms = max(span.end_ms - span.start_ms, 1e-9)
    phase = np.clip((times_ms - span.start_ms) / length_ms, 0, 1)
    envelope = {
        "NONE": np.ones(len(phase)),
        "FADE_IN": phase,
        "FADE_OUT": 1 - phase,
        "FADE_IN_OUT": 1 - np.abs(2 * phase - 1),
    }[span.fade]
    total[first:stop] += envelope[:, None, None] * span.intensities(times_ms, panel)
