"""The picture of a field in its workspace: what a hand would find where, with the side at which the viewer sits.

Each panel shows the greatest force along the line of sight, over all frames given; the box is the workspace.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.arrays import Float64s
from touchfield.viewer.page import titled_figure, write_png

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure

    from touchfield.medium import ForceField, Grid


_PANELS: Final = (
    ("from the viewer", (1, 0, 0), (0, 1, 0)),
    ("from the side", (0, 0, -1), (0, 1, 0)),
    ("from above", (1, 0, 0), (0, 0, -1)),
)
"""Each view, and what lies across and upwards in it: x right, y up, z towards the viewer."""

_ROOM: Final = 0.12  # around the workspace, of its largest side


@dataclass(frozen=True)
class PreviewSpec:
    """Words around the panels.

    Attributes
    ----------
    title, caption : str
    turn : float [3, 3]
        Signed permutation from x right, y up, z towards the viewer to the axes of the fields.
    """

    title: str
    caption: str
    turn: Float64s


def draw_shadows(path: Path, fields: Sequence[ForceField], spec: PreviewSpec) -> None:
    """Write `shadows` as a PNG."""
    write_png(shadows(fields, spec), path)


def shadows(fields: Sequence[ForceField], spec: PreviewSpec) -> Figure:
    """A figure of fields on one grid: three projections with the box of the grid, in millimetres.

    Raises MissingExtra if matplotlib is not installed.
    """
    grid = fields[0].grid
    low_mm, high_mm = (1e3 * corner for corner in grid.box_m)
    sides = high_mm - low_mm
    room = _ROOM * float(sides.max())
    panels_of = [(name, *_seen(spec, across), *_seen(spec, up)) for name, across, up in _PANELS]
    widths = [float(sides[across] + 2 * room) for _, across, _, _, _ in panels_of]
    heights = [float(sides[up] + 2 * room) for *_, up, _ in panels_of]
    height_inch = 1.6 + 13.0 * max(heights) / sum(widths)
    figure = titled_figure("the preview of a field", f"{spec.title} (dashed)\n{spec.caption}", 15.0, height_inch)
    panels = figure.subplots(1, 3, gridspec_kw={"width_ratios": widths})
    top_n = max(max(float(f.support().amplitudes_n.max(initial=0.0)) for f in fields), 1e-6)
    for panel, (name, across, is_left, up, is_down) in zip(panels, panels_of, strict=True):
        shadow = _shadow(fields, grid, across, up)
        image = panel.imshow(
            np.where(shadow > 0, shadow, np.nan).T, origin="lower", interpolation="nearest", aspect="equal",
            extent=(low_mm[across], high_mm[across], low_mm[up], high_mm[up]), cmap="viridis_r", vmin=0, vmax=top_n,
        )  # fmt: skip
        _draw_box(panel, (low_mm[across], low_mm[up]), (sides[across], sides[up]))
        panel.set_xlim(low_mm[across] - room, high_mm[across] + room)
        panel.set_ylim(low_mm[up] - room, high_mm[up] + room)
        panel.set_title(name, fontsize=10)
        panel.set_xlabel(f"{'xyz'[across]} / mm", fontsize=9)
        panel.set_ylabel(f"{'xyz'[up]} / mm", fontsize=9)
        panel.tick_params(labelsize=8)
        if is_left:
            panel.invert_xaxis()
        if is_down:
            panel.invert_yaxis()
    style = {"xycoords": "axes fraction", "fontsize": 9, "color": "#d55e00", "fontweight": "bold"}
    panels[1].annotate("viewer \N{DOWNWARDS ARROW}", (0.01, 0.5), rotation=90, va="center", ha="left", **style)
    panels[2].annotate("viewer \N{UPWARDS ARROW}", (0.5, 0.01), va="bottom", ha="center", **style)
    figure.colorbar(image, ax=list(panels), shrink=0.8, pad=0.01).set_label(
        "greatest |F| along the sight / N", fontsize=9
    )
    return figure


def _seen(spec: PreviewSpec, way: tuple[int, int, int]) -> tuple[int, bool]:
    """Axis of the fields that lies along a way of the viewer's, and whether it points against it."""
    along = spec.turn @ np.array(way, np.float64)
    axis = int(np.argmax(np.abs(along)))
    return axis, bool(along[axis] < 0)


def _shadow(fields: Sequence[ForceField], grid: Grid, across: int, up: int) -> Float64s:
    """The greatest force along the third axis, newtons, float64 [shape[across], shape[up]]."""
    shadow = np.zeros((grid.shape[across], grid.shape[up]))
    for field in fields:
        support = field.support()
        places = support.positions[:, across], support.positions[:, up]
        np.maximum.at(shadow, places, support.amplitudes_n)
    return shadow


def _draw_box(panel: Any, corner: tuple[float, float], size: tuple[float, float]) -> None:
    from matplotlib.patches import Rectangle

    panel.add_patch(Rectangle(corner, *size, fill=False, edgecolor="0.2", linewidth=1.2, linestyle="--"))
