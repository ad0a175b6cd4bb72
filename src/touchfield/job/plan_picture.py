"""The picture of a plan: NMSE over bit rate, one colour for each coder and mode, one shape for each lattice."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final

from touchfield.viewer.page import titled_figure, write_png

if TYPE_CHECKING:
    from pathlib import Path

    from touchfield.job.plan_choice import Plan, PlanTrial

__all__ = ["draw_plan"]

_COLOURS: Final = {
    "touch mask": "#0072b2",
    "touch mask-direction": "#009e73",
    "touch nmse": "#e69f00",
    "paper": "0.45",
}
_SHAPES: Final = "os^Dv<>p"
_SIZE_INCH: Final = (9.5, 5.6)


def draw_plan(path: Path, plan: Plan) -> None:
    """Write the picture as PNG.

    Raises
    ------
    MissingExtra
        If matplotlib is not installed.
    """
    chosen = plan.chosen
    title = f"{plan.source}: {chosen.options} for {_rate(plan.budget_bits_per_s)}"
    figure = titled_figure("the picture of a plan", title, *_SIZE_INCH)
    panel = figure.subplots()
    nws = sorted({t.spec.nw or 0 for t in plan.trials})
    drawn = [t for t in plan.trials if t.nmse > 0]
    for trial in drawn:
        _point(panel, trial, nws)
    front = [t for t in plan.front if t.nmse > 0]
    panel.plot([t.bits_per_s for t in front], [_db(t) for t in front], color="black", lw=1, zorder=1)
    panel.axvline(plan.budget_bits_per_s, color="0.3", lw=1, ls="--", zorder=0)
    if chosen.nmse > 0:
        panel.plot(chosen.bits_per_s, _db(chosen), "o", ms=15, mfc="none", mec="black", mew=1.6)
        said = (
            f"{chosen.kind}, {chosen.options}\n{_rate(chosen.bits_per_s)}, {100 * chosen.mask_kept:.1f} % in the mask"
        )
        panel.annotate(said, (chosen.bits_per_s, _db(chosen)), (12, 12), textcoords="offset points", fontsize=8,
                       parse_math=False)  # fmt: skip
    panel.set_xscale("log")
    panel.set_xlabel("bit/s (dashed: the budget; line: the frontier; ring: the choice)", fontsize=8)
    panel.set_ylabel("NMSE, dB, against the finest lattice", fontsize=8)
    panel.tick_params(labelsize=8)
    panel.grid(color="0.92")
    for side in ("top", "right"):
        panel.spines[side].set_visible(False)
    _key(panel, drawn, nws)
    write_png(figure, path)


def _point(panel: Any, trial: PlanTrial, nws: list[int]) -> None:
    shape = _SHAPES[nws.index(trial.spec.nw or 0) % len(_SHAPES)]
    panel.plot(trial.bits_per_s, _db(trial), shape, ms=6, color=_COLOURS[trial.kind], zorder=2)


def _key(panel: Any, drawn: list[PlanTrial], nws: list[int]) -> None:
    """Which colour and which shape is what."""
    for kind in dict.fromkeys(t.kind for t in drawn):
        panel.plot([], [], "o", ms=6, color=_COLOURS[kind], label=kind)
    for i, nw in enumerate(nws):
        panel.plot([], [], _SHAPES[i % len(_SHAPES)], ms=6, color="0.2", mfc="none", label=f"nw {nw}")
    panel.legend(fontsize=8, frameon=False)


def _db(trial: PlanTrial) -> float:
    return 10 * math.log10(trial.nmse)


def _rate(bits_per_s: float) -> str:
    for unit, size in (("Mbit/s", 1e6), ("kbit/s", 1e3)):
        if bits_per_s >= size:
            return f"{bits_per_s / size:.4g} {unit}"
    return f"{bits_per_s:.4g} bit/s"
