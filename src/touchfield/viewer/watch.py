"""Draws the touch of a movie over time: the drives of the picture, and the low frequencies, onsets and drives
of the sound."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from touchfield.arrays import Float32s, Float64s
from touchfield.viewer.page import titled_figure, write_png

if TYPE_CHECKING:
    from pathlib import Path

_LOW, _ONSET = "#0072b2", "#d55e00"
_MIN_DB = -60.0
_MAX_POINTS = 4000


@dataclass(frozen=True)
class Timeline:
    """The touch of one source over time.

    start_s, seconds : float
        When it starts after the first source of the movie, and its duration.
    drives : float32 [actuators, bins]
        0 to 1, row by row from the top left, over equal spans of time.
    levels : float32 [hops]
        Level of the low frequencies of a sound, full scale 1; empty for a picture.
    onsets_s : float64 [onsets]
        Seconds after the first source.
    """

    start_s: float
    seconds: float
    drives: Float32s
    levels: Float32s = field(default_factory=lambda: np.zeros(0, np.float32))
    onsets_s: Float64s = field(default_factory=lambda: np.zeros(0))


def draw_timeline(path: Path, timelines: Mapping[str, Timeline], title: str) -> None:
    """Draw the timelines by the names of their sources as a PNG.

    Raises `MissingExtra` if matplotlib is not installed.
    """
    heights = [ratio for name in timelines for ratio in ((1, 2) if name == "sound" else (2,))]
    figure = titled_figure("the picture of the timeline", title, 9.0, 1.1 + 0.9 * sum(heights))
    plots = iter(np.atleast_1d(figure.subplots(len(heights), 1, sharex=True, height_ratios=heights)))
    plot = None
    for name, timeline in timelines.items():
        if name == "sound":
            _draw_sound(next(plots), timeline)
        plot = next(plots)
        _draw_drives(plot, timeline, name)
    if plot is not None:
        plot.set_xlabel("time / s")
        plot.set_xlim(0, max(line.start_s + line.seconds for line in timelines.values()))
    write_png(figure, path)


def _draw_sound(plot: Any, timeline: Timeline) -> None:
    step = max(1, len(timeline.levels) // _MAX_POINTS)
    levels = np.pad(timeline.levels, (0, -len(timeline.levels) % step)).reshape(-1, step).max(axis=1)
    decibels = 20 * np.log10(np.maximum(levels, 10 ** (_MIN_DB / 20)))
    times_s = timeline.start_s + np.linspace(0, timeline.seconds, len(levels), endpoint=False)
    plot.fill_between(times_s, decibels, _MIN_DB, color=_LOW, lw=0, label="20 to 200 Hz")
    plot.plot(timeline.onsets_s, np.full(len(timeline.onsets_s), 3.0), "|", color=_ONSET, label="onsets")
    plot.set_ylim(_MIN_DB, 8)
    plot.set_ylabel("sound / dB")
    plot.legend(loc="lower right", fontsize=8, ncols=2)


def _draw_drives(plot: Any, timeline: Timeline, name: str) -> None:
    count = len(timeline.drives)
    extent = (timeline.start_s, timeline.start_s + timeline.seconds, count + 0.5, 0.5)
    plot.imshow(
        timeline.drives, aspect="auto", interpolation="nearest", cmap="magma", vmin=0, vmax=1, extent=extent
    )
    plot.set_ylabel(f"{name}: actuator")
