"""Draws a run of the guidance: what each direction showed over time, the ground ahead, and the warnings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from touchfield.arrays import Float64s, Int64s
from touchfield.viewer.page import titled_figure, write_png

if TYPE_CHECKING:
    from pathlib import Path

_UNKNOWN, _NEAR, _FAR_NEAR, _WARNING = "#bbbbbb", "#b2182b", "#fddbc7", "#d55e00"
_STEP, _DROP = "#0072b2", "#000000"


class GuidanceRows(NamedTuple):
    """Rows of a run: times in seconds [n]; states (0 unknown, 1 free, 2 near) and distances in metres [n, 8];
    distances of the next step and drop [n, 2]; and whether the warning was shown [n]."""

    times_s: Float64s
    states: Int64s
    distances_m: Float64s
    ahead_m: Float64s
    is_warning: Float64s


def draw_guidance(path: Path, rows: GuidanceRows, names: Sequence[str], warn_m: float, title: str) -> None:
    """Draw the rows as a PNG: a line for each direction, the distances of steps and drops, and the warnings.

    Surfaces are red, darker the nearer; unknown directions are grey. Raises `MissingExtra` if matplotlib is
    not installed.
    """
    figure = titled_figure("the picture of the guidance", title, 9.0, 5.2)
    from matplotlib.colors import LinearSegmentedColormap, to_rgb

    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    colours = LinearSegmentedColormap.from_list("near", [_NEAR, _FAR_NEAR])
    image = np.ones((8, len(rows.times_s), 3))
    image[rows.states.T == 0] = to_rgb(_UNKNOWN)
    is_near = rows.states.T == 2
    image[is_near] = colours(np.clip(rows.distances_m.T[is_near] / warn_m, 0, 1))[:, :3]
    image[:, rows.is_warning > 0] = to_rgb(_WARNING)
    start_s, end_s = float(rows.times_s[0]), float(rows.times_s[-1]) + 1e-3
    top.imshow(image, aspect="auto", interpolation="nearest", extent=(start_s, end_s, 7.5, -0.5))
    top.set_yticks(range(8), names)
    top.set_ylabel("direction")
    for column, colour, label in ((0, _STEP, "step up"), (1, _DROP, "drop")):
        bottom.plot(rows.times_s, rows.ahead_m[:, column], ".", ms=3, color=colour, label=label)
    bottom.set_ylim(0, 3)
    bottom.set_ylabel("ahead / m")
    bottom.set_xlabel("time / s")
    bottom.legend(loc="upper right", fontsize=8)
    for label, colour in (
        ("nearer than " + f"{warn_m:g} m", _NEAR),
        ("unknown", _UNKNOWN),
        ("warning", _WARNING),
    ):
        top.plot([], [], "s", color=colour, label=label)
    top.legend(loc="upper left", fontsize=8)
    write_png(figure, path)
