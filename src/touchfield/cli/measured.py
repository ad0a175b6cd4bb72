"""How `touchfield measure` prints what it found: one line for each quantity, with its interval and its unit."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

from touchfield.cli.show import literal_console, show, show_notes

if TYPE_CHECKING:
    from touchfield.job import Measurement
    from touchfield.measure.capacity import Capacity
    from touchfield.measure.passivity import Passivity
    from touchfield.measure.quantity import Quantity

__all__ = ["show_measurement"]

Row = tuple[str, str, str, str]
"""Name, value, interval, what it is."""

_DILUTED = "too few samples for its {}: not to be trusted"
_WARNINGS = ("bias", "few", "too low", "overshoots", "negative", "diluted", "not to be trusted")
"""What a note says that tells how far a number may be trusted; such notes come first."""


def show_measurement(found: Measurement, as_json: bool, notes: tuple[str, ...]) -> None:
    """Print a measurement as one JSON object, or as tables with their notes."""
    if as_json:
        show(found.summary(), "", True, (*found.notes, *notes))
        return
    literal_console().print(
        f"{found.name}: {found.frames} frame(s) of {found.voxels:,} voxels, {found.occupancy:.3%} with a force; "
        f"Q is {found.quantiser}, {found.alphabet:,} symbols",
        style="bold", soft_wrap=True,
    )  # fmt: skip
    _table("information", [*_entropies(found), *(_row(q, "") for q in found.in_time.values())])
    if found.limits is not None:
        _table("coding limits: what a coder of this medium can hope for", _limits(found))
    if found.capacities:
        _table("capacity of devices (eq. 1 to 3)", _capacities(found))
    if found.passivity is not None:
        _table("energy, frame with the largest support", _energy(found.passivity))
    interval = found.entropy.interval
    if interval is not None:
        literal_console().print(f"intervals ({interval.level:.0%}) speak of {interval.population}", soft_wrap=True)
    show_notes(_notes(found, notes))


def _notes(found: Measurement, notes: tuple[str, ...]) -> list[str]:
    """Each note once, after the quantities that it is about: warnings, other notes, those of the scene."""
    about: dict[str, list[str]] = {}
    for name, note in _notes_of_quantities(found):
        names = about.setdefault(note, [])
        if name not in names:
            names.append(name)
    # what a device's capacity says is among the notes of the measurement too, as "DEVICE: NOTE"
    every = [f"{', '.join(names)}: {note}" for note, names in about.items()]
    every = list(dict.fromkeys((*every, *found.notes, *notes)))
    return sorted(every, key=lambda note: not any(word in note for word in _WARNINGS) or note in notes)


def _notes_of_quantities(found: Measurement) -> Iterator[tuple[str, str]]:
    """Pairs of a quantity's name and a note that it carries."""
    named = [
        (
            f"{found.entropy.name} over the visits",
            found.entropy if found.entropy.weighting == "interaction" else None,
        ),
        (f"{found.voxel.name} over all voxels", found.voxel),
        (f"{found.corrected.name} over all voxels, Miller-Madow", found.corrected),
        (f"{found.object.name} over the object", found.object),
        *((q.name, q) for q in found.in_time.values()),
    ]
    if found.limits is not None:
        named += [(rate.name, rate) for rate in found.limits.scan_lines.rates[1:]]
        named += [(c.per_voxel.name, c.per_voxel) for c in found.limits.contexts]
        named.append(("prequential", found.limits.prequential.per_supported))
    for device, c in found.capacities.items():
        named += [(f"{device}, {c.rendered.name}", c.rendered), (device, c.wmr)]
    for name, quantity in named:
        for note in quantity.notes if quantity is not None else ():
            if not note.endswith(" contexts"):  # the table counts them
                yield name, note
    for note in found.passivity.notes if found.passivity is not None else ():
        yield "energy", note


def _row(quantity: Quantity, what: str) -> Row:
    i = quantity.interval
    spread = "" if i is None else f"{_number(i.low, 5)} to {_number(i.high, 5)}"
    return quantity.name, _number(quantity.value, 6), spread, f"{quantity.unit} {what}".strip()


def _number(value: float, digits: int) -> str:
    """Without the sign of -0; "none" for NaN, whose reason is a note."""
    return "none" if math.isnan(value) else f"{value + 0.0:.{digits}g}"


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
    rows = [("H(S)", _number(found.voxel.value * each, 5), "", "bit/supported voxel, no neighbours")]
    for rate in found.limits.scan_lines.rates[1:]:
        what = _DILUTED.format("blocks") if rate.notes else f"block rate of the lines along {found.limits.scan_axis}"
        rows.append((rate.name, _number(rate.value * each, 5), "", what))
    for c in found.limits.contexts:
        what = _DILUTED.format("contexts") if c.is_diluted else f"{c.contexts:,} contexts"
        rows.append((c.per_voxel.name, _number(c.per_voxel.value * each, 5), "", what))
    reached = found.limits.prequential.per_supported
    rows.append(
        (
            "prequential",
            _number(reached.value, 5),
            "",
            "of the symbols alone" if found.quantiser == "distinct" else "a code that surely reaches it",
        )
    )
    if found.file_bits is not None:
        rows.append(("this file", _number(found.file_bits / found.supported_voxels, 5), "", "everything counted"))
    return rows


def _capacities(found: Measurement) -> list[Row]:
    rows = []
    for name, c in found.capacities.items():
        rows.append(_row(_shown(c, c.capacity, name), f"of the {c.codomain_bits:,.0f} that it could be told"))
        rows.append(_row(_shown(c, c.wmr, "  WMR"), "rendered"))
        rows.append(_row(_shown(c, c.hil, "  HIL"), "lost"))
    return rows


def _shown(of: Capacity, quantity: Quantity, name: str) -> Quantity:
    """Without an interval where that of H(M(W)) is unknown: it would speak of H(W) alone, and be too narrow."""
    unknown = of.reading == "realised" and of.rendered.interval is None
    return quantity.of(name=name, interval=None if unknown else quantity.interval)


def _energy(p: Passivity) -> list[Row]:
    """Where nothing could be seen, the reason stands in place of what the number means."""
    why = "; ".join(p.notes) or "not defined here"
    curl, loop = p.relative_curl, 1e3 * p.worst_loop_j
    meaning = "0: no loop gains energy; 1: a pure rotation"
    gained = f"mJ gained in one round, of {p.loops} random loops"
    return [
        ("relative curl", _number(curl, 4), "", why if math.isnan(curl) else meaning),
        ("worst loop", _number(loop, 4), "", why if math.isnan(loop) else gained),
    ]


def _table(title: str, rows: list[Row]) -> None:
    from rich.table import Table

    table = Table(show_header=False, box=None, pad_edge=False, title=title, title_justify="left")
    table.add_column(no_wrap=True, overflow="fold")
    table.add_column(justify="right", no_wrap=True, overflow="fold")
    table.add_column(no_wrap=True, overflow="fold")
    table.add_column(overflow="fold")
    for row in rows:
        table.add_row(*row)
    literal_console().print(table)
