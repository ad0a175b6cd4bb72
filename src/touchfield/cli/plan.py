"""How `touchfield plan` prints what it found: the frontier as a table, the choice, and what to type."""

from __future__ import annotations

from touchfield.cli.show import literal_console, show, show_notes
from touchfield.job.plan_choice import Plan, PlanTrial

__all__ = ["show_plan"]

_HEADINGS = ("", "nw", "coder", "k or step", "bit/s", "NMSE dB", "mask kept")


def show_plan(found: Plan, as_json: bool, notes: tuple[str, ...] = ()) -> None:
    """Print a plan as one JSON object, or as a table with its notes."""
    if as_json:
        show(found.summary(), "", True, notes)
        return
    from rich.table import Table

    console = literal_console()
    title = f"{found.source}: {found.frames_tried} frames under {len(found.trials)} settings; the frontier"
    console.print(title, style="bold", soft_wrap=True)
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for i, heading in enumerate(_HEADINGS):
        table.add_column(heading, justify="left" if i in (0, 2) else "right")
    for trial in found.front:
        table.add_row("->" if trial is found.chosen else "", *_cells(trial))
    console.print(table)
    best_paper = [t for t in found.trials if t.spec.coder == "paper" and t.bits_per_s <= found.budget_bits_per_s]
    said = [f"mask kept: share of the voxels within max({found.f0_n:g} N, {found.k:g} |F|) on the finest lattice"]
    if found.multiplier is not None:
        said.append(f"lambda is {found.multiplier:.4g} bit/s for a unit of NMSE at the choice")
    if best_paper:
        paper = min(best_paper, key=lambda t: t.nmse)
        said.append(f"coder paper within the budget: {paper.options}: {' '.join(_cells(paper)[-2:])}")
    else:
        said.append("coder paper: nothing within the budget")
    said.append(f"touchfield encode {found.source} OUT.touch {found.chosen.options}")
    show_notes((*said, *notes))


def _cells(trial: PlanTrial) -> tuple[str, ...]:
    told = trial.summary()
    control = f"{told['step_n']:g} N" if told["step_n"] is not None else f"{told['k']:g}"
    nmse = "exact" if told["nmse_db"] is None else f"{told['nmse_db']:.2f}"
    kept = f"{100 * trial.mask_kept:.2f} %"
    kind = f"paper {told['directions']}" if told["directions"] else trial.kind
    return (str(told["nw"] or "-"), kind, control, f"{trial.bits_per_s:,.0f}", nmse, kept)
