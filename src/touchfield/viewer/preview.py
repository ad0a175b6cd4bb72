"""The picture of a field in its workspace: what a hand would find where, with the side at which the viewer sits.

Each panel shows the greatest force along the line of sight, over all frames given; the box is the workspace.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.viewer.page import titled_figure, write_png

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from touchfield.medium import ForceField, Grid

__all__ = ["PreviewSpec", "draw_shadows"]

_PANELS: Final = (("from the viewer", 0, 1), ("from the side", 2, 1), ("from above", 0, 2))
"""Each view, its axis across and its axis upwards."""

_ROOM: Final = 0.12  # around the workspace, of its largest side


@dataclass(frozen=True)
class PreviewSpec:
    """Words around the panels.

    Attributes
    ----------
    title, caption : str
    axes : str
        The medium's wording of its axes.
    """

    title: str
    caption: str
    axes: str

    @property
    def is_low_nearer(self) -> bool:
        """The viewer sits at low z, as z points away; else at high z."""
        return any(word in self.axes.lower() for word in ("z forward", "z away"))


def draw_shadows(path: Path, fields: Sequence[ForceField], spec: PreviewSpec) -> None:
    """Write a PNG of fields on one grid: three projections with the box of the grid, in millimetres.

    Raises
    ------
    MissingExtra
        If matplotlib is not installed.
    """
    grid = fields[0].grid
    low_mm, high_mm = (1e3 * corner for corner in grid.box_m)
    sides = high_mm - low_mm
    room = _ROOM * float(sides.max())
    widths = [float(sides[across] + 2 * room) for _, across, _ in _PANELS]
    heights = [float(sides[up] + 2 * room) for _, _, up in _PANELS]
    height_inch = 1.6 + 13.0 * max(heights) / sum(widths)
    figure = titled_figure("the preview of a field", f"{spec.title} (dashed)\n{spec.caption}", 15.0, height_inch)
    panels = figure.subplots(1, 3, gridspec_kw={"width_ratios": widths})
    top_n = max(max(float(f.support().amplitudes_n.max(initial=0.0)) for f in fields), 1e-6)
    for panel, (name, across, up) in zip(panels, _PANELS, strict=True):
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
        _turn(panel, spec, across, up)
    figure.colorbar(image, ax=list(panels), shrink=0.8, pad=0.01).set_label(
        "greatest |F| along the sight / N", fontsize=9
    )
    write_png(figure, path)


def _shadow(fields: Sequence[ForceField], grid: Grid, across: int, up: int) -> NDArray[np.float64]:
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


def _turn(panel: Any, spec: PreviewSpec, across: int, up: int) -> None:
    """As the viewer sees it: up is up, and in the other panels the viewer sits at the left, or below."""
    if up == 1 and "y down" in spec.axes:
        panel.invert_yaxis()
    style = {"xycoords": "axes fraction", "fontsize": 9, "color": "#d55e00", "fontweight": "bold"}
    if across == 2:
        if not spec.is_low_nearer:
            panel.invert_xaxis()
        panel.annotate(
            "viewer \N{DOWNWARDS ARROW}", (0.01, 0.5), rotation=90, va="center", ha="left", **style
        )  # turned, too
    elif up == 2:
        if not spec.is_low_nearer:
            panel.invert_yaxis()
        panel.annotate("viewer \N{UPWARDS ARROW}", (0.5, 0.01), va="bottom", ha="center", **style)
