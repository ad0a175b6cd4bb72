"""Commands `view` (opens a file in the browser), `compare` (a file with its source) and `measure` (a medium
in bits), and the printing of a measurement."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from touchfield import pipeline, tasks
from touchfield.cli.main import Options, Source, Stream, command
from touchfield.cli.options import SCENE, encode_spec, fields_of, refuse_unused, rows_of, with_options
from touchfield.cli.output import (
    HAND_TABLES,
    Answer,
    check_results,
    literal_console,
    progress,
    show_notes,
    show_table,
)
from touchfield.container.remote import is_remote
from touchfield.errors import InvalidArgument, MissingExtra, require_ending
from touchfield.files import is_same_file, url_path
from touchfield.tasks.measure import Measurement, MeasureSpec
from touchfield.viewer.page import is_our_picture

if TYPE_CHECKING:
    from touchfield.measure.passivity import Passivity
    from touchfield.measure.quantity import Quantity


@command(
    "Look",
    "view room.touch",
    "view room.touch --source scan.ply --out room.html --no-open",
    "view both.mp4 --out both.html",
    "view town.touch --out town.html",
    "view room.touch --rerun --out room.rrd --log felt.csv",
)
def view(
    stream: Stream,
    source: Annotated[
        str | None, "SOURCE of the file: shown too, and the difference; NMSE, vibration."
    ] = None,
    device: Annotated[
        list[str] | None, "Tell its capacity, WMR and HIL, and the entropy; may be repeated."
    ] = None,
    out: Annotated[Path | None, "HTML file to write; default: a temporary one. --rerun: OUT.rrd."] = None,
    no_open: Annotated[bool, "Open no browser."] = False,
    page: Annotated[
        str,
        "field; map, to find places; or timeline, to edit a movie's touch. auto: what the file has.",
    ] = "auto",
    rerun: Annotated[
        bool, "Show it in Rerun instead, or write --out OUT.rrd and open nothing (extra: rerun)."
    ] = False,
    log: Annotated[Path | None, "--rerun: log of play, CSV or MCAP, whose hand and force are shown."] = None,
) -> Answer:
    """Open STREAM in the browser: seen, played, probed and heard, without any network."""
    from touchfield.tasks.view import view as run

    if rerun:
        unused = {
            "source": (source, None),
            "device": (device, None),
            "no-open": (no_open, False),
            "page": (page, "auto"),
        }
        refuse_unused(unused, "with --rerun")
        return _view_in_rerun(stream, out, log)
    refuse_unused({"log": (log, None)}, "without --rerun")
    check_results((stream, source), out)
    with progress("view") as report:
        shown = run(stream, source, report, tuple(device or ()), page)
    path = shown.save(out) if out else None
    if not no_open:
        path = shown.open(path)
    if path is None:
        raise InvalidArgument("--no-open", "no --out", "an HTML file to write", "Name one: --out page.html.")
    return Answer({"page": str(path), "page_bytes": path.stat().st_size, **shown.figures}, str(stream))


def _view_in_rerun(stream: str, out: Path | None, log: Path | None) -> Answer:
    """Show a stream in Rerun, or write its file."""
    from touchfield.tasks.rerun_scene import view_in_rerun

    check_results((stream, log), out)
    if out is not None:
        require_ending(out, "OUT.rrd")
    with progress("view") as report:
        scene = view_in_rerun(stream, out, log, report)
    values = scene.summary if out is None else {"file": str(out), **scene.summary}
    return Answer(values, stream, scene.notes)


@command("Look", "compare scan.ply scan.touch", "compare scan.ply scan.touch --no-picture --json")
def compare(
    source: Source,
    stream: Stream,
    picture: Annotated[Path | None, "PNG to write; default: next to the stream."] = None,
    no_picture: Annotated[bool, "Write no picture."] = False,
    frame: Annotated[int | None, "Frame to draw; default: the middle one."] = None,
    k: Annotated[float | None, "Weber fraction of the mask; default: the stream's."] = None,
    f0_n: Annotated[float | None, "F_0 of the mask, newtons."] = None,
    allow_outside: Annotated[bool, "Models and scene files may name files outside their own folder."] = False,
) -> Answer:
    """Measure a stream against its source, and draw both."""
    if no_picture:
        refuse_unused({"picture": (picture, None), "frame": (frame, None)}, "with --no-picture")
    target = picture or _free_name(source, stream)
    if picture is None or no_picture:  # a picture that was not asked for may be left out
        check_results((source, stream), target)
    else:
        check_results((source, stream), plot=picture)
    if not no_picture and target.exists() and not is_our_picture(target):
        hint = "Name another --picture, or take --no-picture."
        raise InvalidArgument(
            f"{target} is there, and touchfield did not draw it: it is left as it is", hint=hint
        )
    with progress("compare") as report:
        compared = pipeline.compare(
            source, stream, k=k, f0_n=f0_n, frame=frame, allow_outside=allow_outside, report=report
        )
    notes = compared.notes
    if not no_picture:
        try:
            compared.draw(target)
            notes = (*notes, f"the picture is {target}")
        except MissingExtra as missing:
            if picture is not None:
                raise
            notes = (*notes, f"no picture: {missing}")
    return Answer(compared.summary(), f"{stream} against {source}", notes, HAND_TABLES)


def _free_name(source: str, stream: str) -> Path:
    """Return STREAM.png, or STREAM.compare.png if that is the source or another program's picture.

    For an address the name is in the current folder.
    """
    name = Path(url_path(stream)).name if is_remote(stream) else stream
    usual = Path(name).with_suffix(".png")
    is_free = not usual.exists() or (is_our_picture(usual) and not is_same_file(source, usual))
    return usual if is_free else usual.with_suffix(".compare.png")


@command("Study", "measure room.touch", "measure scan.ply --device phantom-omni --density 5")
@with_options(rows_of(MeasureSpec), tuple(row for row in SCENE if row.name != "device"))
def measure(
    options: Options,
    medium: Annotated[str, typer.Argument(help="A .touch file, or any SOURCE.", metavar="MEDIUM")],
    device: Annotated[
        list[str] | None, "Device whose capacity, WMR and HIL are wanted; may be repeated."
    ] = None,
    reference: Annotated[str, "Device in whose workspace a SOURCE is sampled as W."] = "phantom-omni",
    no_limits: Annotated[bool, "Leave out the coding limits."] = False,
    plot: Annotated[Path | None, "PNG to draw."] = None,
) -> Answer:
    """Measure a medium in bits: entropies, coding limits, capacity of devices, energy."""
    encode = encode_spec({**options, "device": reference})
    if not device:
        refuse_unused({"density": (options["density"], None)}, "without --device")
    measure_fields = fields_of(MeasureSpec, options)
    spec = MeasureSpec(**measure_fields, devices=tuple(device or ()), limits=not no_limits, encode=encode)
    check_results((medium,), plot=plot)
    with progress("measure") as report:
        measurement = tasks.measure.measure_medium(medium, spec, report)
    if plot is not None:
        measurement.draw(plot)
    notes = (f"the picture is {plot}",) if plot else ()
    all_notes = (*measurement.notes, *notes)
    return Answer(
        measurement.summary(), "", all_notes, print_text=lambda: show_measurement(measurement, notes)
    )


# -- a measurement in lines: each quantity with its interval and its unit ----------------------------------

Row = tuple[str, str, str, str]
"""Name, value, interval, what it is."""

_DILUTED = "too few samples for its contexts: not to be trusted"
_WARNINGS = ("bias", "few", "too low", "overshoots", "negative", "diluted", "not to be trusted")
"""Words of notes on the reliability of a number; such notes come first."""


def show_measurement(m: Measurement, notes: tuple[str, ...]) -> None:
    """Print a measurement as tables with their notes."""
    literal_console().print(
        f"{m.name}: {m.frames} frame(s) of {m.voxels:,} voxels, {m.occupancy:.3%} with a force; "
        f"Q is {m.quantiser}, {m.alphabet:,} symbols",
        style="bold", soft_wrap=True,
    )  # fmt: skip
    tables = {
        "information": [_row(q, meaning) for q, meaning in _information(m)],
        "coding limits: what a coder of this medium can hope for": _limits(m),
        "capacity of devices (eq. 1 to 3)": _capacities(m),
        "energy, frame with the largest support": [] if m.passivity is None else _energy(m.passivity),
    }
    for title, rows in tables.items():
        if rows:
            show_table(rows, title=title, right=(1,), unbroken=3)
    interval = m.entropy.interval
    if interval is not None:
        literal_console().print(
            f"intervals ({interval.level:.0%}) speak of {interval.population}", soft_wrap=True
        )
    dependence = m.entropy.dependence
    if dependence is not None:
        literal_console().print(
            f"samples of {m.entropy.name} are dependent over {dependence.correlation_length:.3g} samples: "
            f"{dependence.blocks} blocks count as {dependence.effective_blocks:.3g} independent ones",
            soft_wrap=True,
        )
    show_notes(_notes(m, notes))


def _notes(m: Measurement, notes: tuple[str, ...]) -> list[str]:
    """Return each note once, prefixed by the quantities it concerns; warnings come first."""
    named = [(f"{q.name} {meaning}".strip(), q) for q, meaning in _information(m) if q is not m.per_frame]
    if m.limits is not None:
        named += [(c.per_voxel.name, c.per_voxel) for c in m.limits.contexts]
    for device, c in m.capacities.items():
        named += [(f"{device}, {c.rendered.name}", c.rendered), (device, c.wmr)]
    about: dict[str, dict[str, None]] = {}
    for name, quantity in named:
        for note in quantity.notes:
            if not note.endswith(" contexts"):  # the table counts them
                about.setdefault(note, {})[name] = None
    for note in m.passivity.notes if m.passivity is not None else ():
        about.setdefault(note, {})["energy"] = None
    # what a device's capacity says is among the notes of the measurement too, as "DEVICE: NOTE"
    all_notes = [f"{', '.join(names)}: {note}" for note, names in about.items()]
    all_notes = list(dict.fromkeys((*all_notes, *m.notes, *notes)))
    return sorted(all_notes, key=lambda note: not any(word in note for word in _WARNINGS) or note in notes)


def _row(quantity: Quantity, meaning: str) -> Row:
    i = quantity.interval
    spread = "" if i is None else f"{_number(i.low, 5)} to {_number(i.high, 5)}"
    return quantity.name, _number(quantity.value, 6), spread, f"{quantity.unit} {meaning}".strip()


def _number(value: float, digits: int) -> str:
    """Format a number without the sign of -0; "none" for NaN, which a note explains."""
    return "none" if math.isnan(value) else f"{value + 0.0:.{digits}g}"


def _information(m: Measurement) -> list[tuple[Quantity, str]]:
    """Return the entropies to be printed, each with its meaning: H(S) by weighting, H(W), in time."""
    visits = [(m.entropy, "over the visits of the trace")] if m.entropy.weighting == "interaction" else []
    if m.contacts:
        *each, shared = m.contacts.values()
        visits = [(m.entropy, "over the visits of all contacts together"), *((q, "of one") for q in each)]
        visits.append((shared, "received more than once"))
    everywhere = [(m.voxel, "over all voxels"), (m.corrected, "over all voxels, Miller-Madow")]
    others = [(quantity, "") for quantity in (m.per_frame, *m.in_time.values())]
    return [*visits, *everywhere, (m.object, "over the object"), *others]


def _limits(m: Measurement) -> list[Row]:
    if m.limits is None:
        return []
    per_supported = m.voxels * m.frames / m.supported_voxels
    rows = [("H(S)", _number(m.voxel.value * per_supported, 5), "", "bit/supported voxel, no neighbours")]
    for c in m.limits.contexts:
        meaning = _DILUTED if c.is_diluted else f"{c.contexts:,} contexts"
        rows.append((c.per_voxel.name, _number(c.per_voxel.value * per_supported, 5), "", meaning))
    if m.file_bits is not None:
        rows.append(("this file", _number(m.file_bits / m.supported_voxels, 5), "", "everything counted"))
    return rows


def _capacities(m: Measurement) -> list[Row]:
    rows = []
    for name, c in m.capacities.items():
        # no interval where that of H(M(W)) is unknown: it would speak of H(W) alone, and be too narrow
        unknown = c.rendered.interval is None
        available = f"of the {c.codomain_bits:,.0f} that the stimulus could carry"
        for quantity, label, meaning in (
            (c.capacity, name, available),
            (c.wmr, "  WMR", "rendered"),
            (c.hil, "  HIL", "lost"),
        ):
            rows.append(
                _row(quantity.of(name=label, interval=None if unknown else quantity.interval), meaning)
            )
    return rows


def _energy(p: Passivity) -> list[Row]:
    """Return the rows of the energy measures; for an undefined number the reason replaces its meaning."""
    reason = "; ".join(p.notes) or "not defined here"
    curl, square = p.relative_curl, 1e3 * p.worst_square_j
    meaning = "0: no loop gains energy; 1: a pure rotation"
    gained = f"mJ gained in one round, of {p.squares:,} squares of the lattice"
    return [
        ("relative curl", _number(curl, 4), "", reason if math.isnan(curl) else meaning),
        ("worst square", _number(square, 4), "", reason if math.isnan(square) else gained),
    ]
