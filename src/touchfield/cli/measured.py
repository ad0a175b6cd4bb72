"""How `touchfield measure` prints what it found: one line for each quantity, with its interval and its unit."""

from __future__ import annotations

from typing import TYPE_CHECKING

from touchfield.cli.show import show

if TYPE_CHECKING:
    from touchfield.job import Measurement
    from touchfield.measure.quantity import Quantity

__all__ = ["show_measurement"]

Row = tuple[str, str, str, str]
"""Name, value, interval, what it is."""


def show_measurement(found: Measurement, as_json: bool, notes: tuple[str, ...]) -> None:
    """Print a measurement as one JSON object, or as tables with their notes."""
    notes = (*found.notes, *notes)
    if as_json:
        show(found.summary(), "", True, notes)
        return
    from rich.console import Console

    console = Console()
    console.print(
        f"{found.name}: {found.frames} frame(s) of {found.voxels:,} voxels, {found.occupancy:.3%} with a force; "
        f"Q is {found.quantiser}, {found.alphabet:,} symbols",
        markup=False, highlight=False, style="bold", soft_wrap=True,
    )  # fmt: skip
    _table("information", [*_entropies(found), *(_row(q, "") for q in found.in_time.values())])
    if found.limits is not None:
        _table("coding limits: what a coder of this medium can hope for", _limits(found))
    if found.capacities:
        _table("capacity of devices (eq. 1 to 3)", _capacities(found))
    if found.passivity is not None:
        p = found.passivity
        _table("energy, middle frame", [
            ("relative curl", f"{p.relative_curl:.4g}", "", "0: no loop gains energy; 1: a pure rotation"),
            ("worst loop", f"{1e3 * p.worst_loop_j:.4g}", "", f"mJ gained in one round, of {p.loops} random loops"),
        ])  # fmt: skip
    every = [found.entropy, found.voxel, found.object, *found.in_time.values()]
    for note in dict.fromkeys((*notes, *(n for q in every for n in q.notes))):
        console.print(f"note: {note}", markup=False, highlight=False, soft_wrap=True)


def _row(quantity: Quantity, what: str) -> Row:
    i = quantity.interval
    spread = "" if i is None else f"{i.low:.5g} to {i.high:.5g}"
    return quantity.name, f"{quantity.value:.6g}", spread, f"{quantity.unit} {what}".strip()


def _entropies(found: Measurement) -> list[Row]:
    rows = [
        _row(found.voxel, "over all voxels"),
        _row(found.corrected, "over all voxels, Miller-Madow"),
        _row(found.object, "over the object"),
        _row(found.per_frame, ""),
    ]
    if found.entropy.weighting == "interaction":
        rows.insert(0, _row(found.entropy, "over the visits of the trace"))
    return rows


def _limits(found: Measurement) -> list[Row]:
    assert found.limits is not None
    each = found.voxels * found.frames / found.supported_voxels
    rows = [("H(S)", f"{found.voxel.value * each:.5g}", "", "bit/supported voxel, no neighbours")]
    for rate in found.limits.scan_lines.rates[1:]:
        rows.append((rate.name, f"{rate.value * each:.5g}", "", "block rate of the lines along z"))
    for c in found.limits.contexts:
        what = "too few samples for its contexts: not to be trusted" if c.is_diluted else f"{c.contexts:,} contexts"
        rows.append((c.per_voxel.name, f"{c.per_voxel.value * each:.5g}", "", what))
    reached = found.limits.prequential.per_supported
    rows.append(("prequential", f"{reached.value:.5g}", "", "a code that surely reaches it"))
    if found.file_bits is not None:
        rows.append(("this file", f"{found.file_bits / found.supported_voxels:.5g}", "", "everything counted"))
    return rows


def _capacities(found: Measurement) -> list[Row]:
    rows = []
    for name, c in found.capacities.items():
        rows.append(_row(c.capacity.of(name=name), f"of the {c.codomain_bits:,.0f} that it could be told"))
        rows.append(_row(c.wmr.of(name="  WMR"), "rendered"))
        rows.append(_row(c.hil.of(name="  HIL"), "lost"))
    return rows


def _table(title: str, rows: list[Row]) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(show_header=False, box=None, pad_edge=False, title=title, title_justify="left")
    table.add_column(no_wrap=True)
    table.add_column(justify="right", no_wrap=True)
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for row in rows:
        table.add_row(*row)
    Console().print(table)
