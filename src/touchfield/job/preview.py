"""Pictures of the job: where a scene lies in the workspace, before anything is coded; and a plan."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.render.axes import BOX_AXES, axes_matrix
from touchfield.viewer.page import titled_figure, write_png
from touchfield.viewer.preview import PreviewSpec, draw_shadows, shadows

if TYPE_CHECKING:
    from touchfield.job.plan import Plan, Trial
    from touchfield.job.prepare import Prepared
    from touchfield.medium import HapticMedium

__all__ = ["draw_medium", "draw_plan", "draw_preview"]

_FRAMES: Final = 3
"""Frames that are looked at: the first, the middle one and the last."""

_COLOURS: Final = {
    "touch mask": "#0072b2",
    "touch mask-direction": "#009e73",
    "touch nmse": "#e69f00",
    "paper": "0.45",
}
_SHAPES: Final = "os^Dv<>p"
_SIZE_INCH: Final = (9.5, 5.6)


def draw_preview(prepared: Prepared, path: str | Path) -> None:
    """Write a PNG of the forces in the workspace, seen from the viewer, from the side and from above.

    Raises
    ------
    MissingExtra
        If matplotlib is not installed.
    """
    medium, placement = prepared.medium, prepared.placement
    frames = np.unique(np.linspace(0, len(medium) - 1, _FRAMES).astype(int)).tolist()
    told = ", ".join(str(i) for i in frames)
    which = f"frame{'s' if len(frames) > 1 else ''} {told} of {len(medium)}"
    x, y, z = placement.offset_m
    up = "lattice" if prepared.device.is_array else "auto"  # as `play` lays it
    turn = axes_matrix(BOX_AXES, medium.axes, up)
    if (turn != axes_matrix(BOX_AXES, medium.axes)).any():
        which += f", {'xyz'[int(np.argmax(np.abs(turn[:, 1])))]} up for the hand"
    caption = f"{placement.wording}; the middle is the scene's ({x:.4g}, {y:.4g}, {z:.4g}) m; {medium.axes}"
    draw_shadows(
        Path(path),
        [medium[i] for i in frames],
        PreviewSpec(f"{which}, in the workspace of {prepared.device.name}", caption, turn),
    )


def draw_plan(path: Path, plan: Plan) -> None:
    """Write the picture of a plan as PNG: NMSE over the cost, a colour for each coder and mode, a shape a lattice.

    Raises
    ------
    MissingExtra
        If matplotlib is not installed.
    """
    from touchfield.job.plan import amount

    chosen = plan.chosen
    title = f"{plan.source}: {chosen.options} for {amount(plan.budget, plan.unit)}"
    figure = titled_figure("the picture of a plan", title, *_SIZE_INCH)
    panel = figure.subplots()
    nws = sorted({t.spec.nw or 0 for t in plan.trials})
    drawn = [t for t in plan.trials if t.nmse > 0]
    for trial in drawn:
        shape = _SHAPES[nws.index(trial.spec.nw or 0) % len(_SHAPES)]
        panel.plot(plan.cost(trial), _db(trial), shape, ms=6, color=_COLOURS[trial.kind], zorder=2)
    front = [t for t in plan.front() if t.nmse > 0]
    panel.plot([plan.cost(t) for t in front], [_db(t) for t in front], color="black", lw=1, zorder=1)
    panel.axvline(plan.budget, color="0.3", lw=1, ls="--", zorder=0)
    if chosen.nmse > 0:
        at = plan.cost(chosen), _db(chosen)
        panel.plot(*at, "o", ms=15, mfc="none", mec="black", mew=1.6)
        cost = f"{amount(at[0], plan.unit)}, {100 * chosen.mask_kept:.1f} % in the mask"
        panel.annotate(f"{chosen.kind}, {chosen.options}\n{cost}", at, (12, 12), textcoords="offset points",
                       fontsize=8, parse_math=False)  # fmt: skip
    panel.set_xscale("log")
    panel.set_xlabel(f"{plan.unit} (dashed: the budget; line: the frontier; ring: the choice)", fontsize=8)
    panel.set_ylabel("NMSE, dB, against the finest lattice", fontsize=8)
    panel.tick_params(labelsize=8)
    panel.grid(color="0.92")
    for side in ("top", "right"):
        panel.spines[side].set_visible(False)
    for kind in dict.fromkeys(t.kind for t in drawn):
        panel.plot([], [], "o", ms=6, color=_COLOURS[kind], label=kind)
    for i, nw in enumerate(nws):
        panel.plot([], [], _SHAPES[i % len(_SHAPES)], ms=6, color="0.2", mfc="none", label=f"nw {nw}")
    panel.legend(fontsize=8, frameon=False)
    write_png(figure, path)


def _db(trial: Trial) -> float:
    return 10 * math.log10(trial.nmse)


def draw_medium(medium: HapticMedium, path: str | Path | None = None) -> Any:
    """The forces of a medium as a matplotlib figure, as `draw_preview` shows them; a PNG, too, where `path` is given.

    Raises
    ------
    MissingExtra
        If matplotlib is not installed.
    """
    frames = np.unique(np.linspace(0, len(medium) - 1, _FRAMES).astype(int)).tolist()
    title = f"frame{'s' * (len(frames) > 1)} {', '.join(map(str, frames))} of {len(medium)}, on the medium's lattice"
    spec = PreviewSpec(title, f"{medium.grid.words}; {medium.axes}", axes_matrix(BOX_AXES, medium.axes, "auto"))
    figure = shadows([medium[i] for i in frames], spec)
    if path is not None:
        write_png(figure, Path(path))
    return figure
