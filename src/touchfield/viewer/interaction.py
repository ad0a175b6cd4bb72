"""Draws a recorded interaction: where the hand was, and the forces of field and device over time.

Curves over time are on the left, paths on the right; the background is tinted during contact.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Float64s
from touchfield.viewer.page import titled_figure, write_png
from touchfield.viewer.picture import shadow_n

if TYPE_CHECKING:
    from pathlib import Path

    from touchfield.medium import ForceField


_HUES: Final = ("#0072b2", "#d55e00", "#009e73")
_PUT, _FIELD, _FRICTION, _CONTACT = "0.1", "#0072b2", "#d55e00", "#f0e442"


@dataclass(frozen=True)
class InteractionView:
    """Content of `draw_interaction`.

    `rows` are those of the log of a playback: positions of the hand, force of the field there and friction
    are in the field's axes, described by `axes`; the force sent to the device is in the device's axes. The
    support of `background` is drawn behind the path.
    """

    title: str
    caption: str
    axes: str
    rows: NDArray[Any]
    peak_n: float
    continuous_n: float | None = None
    background: ForceField | None = None


def draw_interaction(path: Path, view: InteractionView) -> None:
    """Write the picture as PNG; `MissingExtra` if matplotlib is not installed."""
    figure = titled_figure("the picture of an interaction", f"{view.title}\n{view.caption}", 14.0, 9.0)
    gridspec = figure.add_gridspec(3, 2, width_ratios=(3, 2))
    hand, force, parts = (figure.add_subplot(gridspec[row, 0]) for row in range(3))
    rows, times_s = view.rows, view.rows["time_s"]
    has_contact = rows["field_force_n"].any(axis=1)
    _draw_axes(hand, times_s, 1e3 * rows["position_m"], "xyz", "hand, mm", title=view.axes, title_fontsize=7)
    _draw_force(force, view)
    _draw_axes(parts, times_s, rows["force_n"], ("Fx", "Fy", "Fz"), "put out, N\n(device's axes)")
    for axis in (hand, force, parts):
        full_height = axis.get_xaxis_transform()  # as high as the panel
        axis.fill_between(
            times_s, 0, 1, where=has_contact, transform=full_height, color=_CONTACT, alpha=0.22, lw=0
        )
        if len(times_s):
            axis.set_xlim(times_s[0], max(times_s[-1], times_s[0] + 1e-3))
    parts.set_xlabel("time, s")
    right = gridspec[:, 1].subgridspec(2, 1)
    _draw_path(figure, figure.add_subplot(right[0]), view, 0, 1)
    _draw_path(figure, figure.add_subplot(right[1]), view, 0, 2)
    write_png(figure, path)


def _draw_axes(
    axis: Any, times_s: Float64s, rows: Float64s, names: Sequence[str], label: str, **legend: Any
) -> None:
    for name, hue, line in zip(names, _HUES, rows.T):
        axis.plot(times_s, line, color=hue, lw=1.2, label=name)
    axis.set_ylabel(label)
    _draw_legend(axis, **legend)


def _draw_legend(axis: Any, **options: Any) -> None:
    """Draw the legend above the lines, which use the lower part of the panel."""
    low, high = axis.get_ylim()
    axis.set_ylim(low, high + 0.3 * (high - low))
    axis.legend(loc="upper right", ncols=3, fontsize=8, **options)


def _draw_force(axis: Any, view: InteractionView) -> None:
    rows = view.rows
    lines = (("field_force_n", _FIELD, "of the field"), ("friction_n", _FRICTION, "friction"),
             ("force_n", _PUT, "put out"))  # fmt: skip
    for name, colour, label in lines:
        axis.plot(rows["time_s"], np.linalg.norm(rows[name], axis=1), color=colour, lw=1.2, label=label)
    top = float(np.linalg.norm(rows["force_n"], axis=1).max(initial=0.0))
    for limit, word in ((view.peak_n, "peak"), (view.continuous_n, "continuous")):
        if limit is not None and limit <= 2 * max(top, 1e-9):
            axis.axhline(limit, color="0.5", lw=0.8, ls="--")
            axis.annotate(
                f"{word} {limit:g} N",
                (0.005, limit),
                xycoords=("axes fraction", "data"),
                fontsize=7,
                va="bottom",
                color="0.35",
            )
    axis.set_ylabel("|F|, N")
    axis.set_ylim(bottom=0)
    _draw_legend(axis)


def _draw_path(figure: Any, axis: Any, view: InteractionView, horizontal: int, vertical: int) -> None:
    """Draw the path along the third axis, coloured by the device's |F|, over the shadow of the field.

    The panel is cropped to the path and the samples with forces.
    """
    field, axes = view.background, [horizontal, vertical]
    size, positions_mm = np.linalg.norm(view.rows["force_n"], axis=1), 1e3 * view.rows["position_m"]
    seen_mm = [positions_mm[:, axes]]
    if field is not None and len(field.bricks):
        low, high = 1e3 * np.stack(field.grid.box_m)
        shadow = shadow_n([field], horizontal, vertical)
        axis.imshow(
            shadow.T, origin="lower", cmap="Greys", alpha=0.6,
            vmin=0, vmax=2 * max(float(shadow.max()), 1e-9),
            extent=(low[horizontal], high[horizontal], low[vertical], high[vertical]), aspect="equal",
        )  # fmt: skip
        seen_mm.append(1e3 * field.grid.to_m(field.positions())[:, axes])
    else:
        axis.set_aspect("equal", adjustable="datalim")
    order = np.argsort(size, kind="stable")
    drawn = axis.scatter(
        positions_mm[order, horizontal], positions_mm[order, vertical],
        c=size[order], s=5, cmap="viridis", vmin=0, vmax=max(float(size.max(initial=0.0)), 1e-9),
    )  # fmt: skip
    figure.colorbar(drawn, ax=axis, label="|F| put out, N", shrink=0.85)
    _crop(axis, np.concatenate(seen_mm))
    names, axis_words = "xyz", view.axes.split(",")
    if vertical < len(axis_words) and "down" in axis_words[vertical].split():
        axis.invert_yaxis()  # as the viewer sees it
    axis.set_xlabel(f"{names[horizontal]}, mm")
    axis.set_ylabel(f"{names[vertical]}, mm")


def _crop(axis: Any, points_mm: Float64s) -> None:
    """Limit a panel to points [n, 2], with a margin of a twentieth of their larger side."""
    points_mm = points_mm[np.isfinite(points_mm).all(axis=1)]
    if not len(points_mm):
        return
    low, high = points_mm.min(axis=0), points_mm.max(axis=0)
    margin = max(0.05 * float((high - low).max()), 1.0)
    axis.set_xlim(low[0] - margin, high[0] + margin)
    axis.set_ylim(low[1] - margin, high[1] + margin)
