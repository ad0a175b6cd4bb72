"""How `touchfield plan` prints a plan: the frontier as a table, the choice, and what to type."""

from __future__ import annotations

from touchfield.cli.show import literal_console, show, show_notes
from touchfield.job import Plan, Trial

__all__ = ["show_plan"]


def show_plan(plan: Plan, as_json: bool, notes: tuple[str, ...] = ()) -> None:
    """Print a plan as one JSON object, or as a table with its notes."""
    if as_json:
        show(plan.summary(), "", True, (*plan.notes, *notes))
        return
    from rich.table import Table

    console = literal_console()
    title = f"{plan.source}: {plan.frames_tried} frames under {len(plan.trials)} settings; the frontier"
    console.print(title, style="bold", soft_wrap=True)
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for i, heading in enumerate(("", "nw", "coder", "k or step", plan.unit, "NMSE dB", "mask kept")):
        table.add_column(heading, justify="left" if i in (0, 2) else "right")
    for trial in plan.front():
        table.add_row("->" if trial is plan.chosen else "", *_cells(plan, trial))
    console.print(table)
    papers = [t for t in plan.trials if t.spec.coder == "paper" and plan.is_within(t)]
    said = [
        *plan.notes,
        f"mask kept: share of the voxels within max({plan.f0_n:g} N, {plan.k:g} |F|) on the finest lattice",
    ]
    if plan.multiplier is not None:
        said.append(f"lambda is {plan.multiplier:.4g} {plan.unit} for a unit of NMSE at the choice")
    if papers:
        paper = min(papers, key=lambda t: t.nmse)
        said.append(f"coder paper within the budget: {paper.options}: {' '.join(_cells(plan, paper)[-2:])}")
    else:
        said.append("coder paper: nothing within the budget")
    said.append(f"touchfield encode {plan.source} OUT.touch {plan.chosen.options}")
    show_notes((*said, *notes))


def _cells(plan: Plan, trial: Trial) -> tuple[str, ...]:
    told = trial.summary()
    control = f"{told['step_n']:g} N" if told["step_n"] is not None else f"{told['k']:g}"
    nmse = "exact" if told["nmse_db"] is None else f"{told['nmse_db']:.2f}"
    kept = f"{100 * trial.mask_kept:.2f} %"
    kind = f"paper {told['directions']}" if told["directions"] else trial.kind
    return (str(told["nw"] or "-"), kind, control, f"{plan.cost(trial):,.0f}", nmse, kept)
