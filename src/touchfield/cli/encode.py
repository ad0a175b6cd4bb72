"""Commands that write ``.touch`` files and other formats: `encode`, `filter`, `field`, `plan`, `export` and
`import`."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from touchfield import pipeline, tasks
from touchfield.cli.main import Options, Source, Stream, command
from touchfield.cli.options import (
    ALLOW_EMPTY,
    CODER,
    FORCE_ROWS,
    SCENE,
    TARGET,
    DeviceCompute,
    Workers,
    encode_spec,
    filter_rows,
    target_of,
    with_options,
)
from touchfield.cli.output import (
    HAND_TABLES,
    Answer,
    check_results,
    literal_console,
    progress,
    show_notes,
    show_table,
)
from touchfield.compute.cuda import computing
from touchfield.compute.executors import executor_of
from touchfield.container.remote import is_remote
from touchfield.errors import InvalidArgument, require_ending
from touchfield.files import refuse_overwriting
from touchfield.pipeline.empty_result import felt_medium
from touchfield.tasks.plan import Plan, Trial


@command(
    "Make",
    "encode scan.ply scan.touch",
    "encode depth-folder room.touch --frames 0:90 --k 0.2",
    "encode sample:terrain small.touch --target-bytes 60000",
    "encode scan.ply scan.touch --report --plot scan.png",
)
@with_options(SCENE, ALLOW_EMPTY, FORCE_ROWS, CODER, TARGET)
def encode(
    options: Options,
    source: Source,
    to: Annotated[
        str,
        typer.Argument(
            metavar="OUT", help="The .touch file, or OUT.zarr, tiles of a huge lattice; also s3://..."
        ),
    ],
    with_report: Annotated[
        bool,
        typer.Option(
            "--report", help="Also measure the file against SOURCE: error, bits, what a hand feels."
        ),
    ] = False,
    plot: Annotated[Path | None, "PNG to draw: SOURCE, the file and the error, the middle frame."] = None,
    workers: Workers = None,
    device_compute: DeviceCompute = "cpu",
) -> Answer:
    """Turn SOURCE into a .touch file."""
    out, is_measured = Path(to), with_report or plot is not None
    check_results((source,), None if is_remote(to) else out, plot=plot)
    require_ending(to, "OUT.touch", "OUT.zarr", hint="For a field take: touchfield field.")
    spec, target = encode_spec(options), target_of(options)
    if is_remote(to) and (target is not None or is_measured):
        raise InvalidArgument("--report, --plot and targets work with a path, not with an address")
    if target is not None and workers is not None:
        raise InvalidArgument(
            f"--workers works without {target.option}: one encoding after another finds a target"
        )
    if target is not None and out.suffix == ".zarr":
        raise InvalidArgument(f"{target.option} works with OUT.touch, not with .zarr")
    if is_measured and out.suffix == ".zarr":
        raise InvalidArgument("--report and --plot work with OUT.touch, not with .zarr")
    later = ("fusion",) if Path(source).is_dir() else ()  # a folder is a depth sequence, most often
    with (
        computing(device_compute),
        progress("encode", later=later) as report,
        executor_of(workers) as executor,
    ):
        if out.suffix == ".zarr":
            tiled = pipeline.encode_tiles(source, to, spec, report, executor)
            return Answer(tiled.summary(), to, tiled.notes)
        if target is None:
            done = pipeline.encode(source, to, spec, report, executor=executor)
        else:
            done = pipeline.encode_to_target(source, out, spec, target, report)
        if not is_measured:
            return Answer(done.summary(), to, done.notes)
    with computing(device_compute), progress("report") as report:
        compared = pipeline.compare_prepared(done.prepared, out, report=report)
    if plot is not None:
        compared.draw(plot)
    return _with_comparison(to, done, compared, plot)


def _with_comparison(
    to: str, done: pipeline.Encoded, compared: pipeline.Comparison, plot: Path | None
) -> Answer:
    """Return the answer of an encoding with the figures of its comparison, and the name of its picture."""
    encoding, comparison = done.summary(), compared.summary()
    picture = () if plot is None else (f"the picture is {plot}",)
    new_figures = {name: value for name, value in comparison.items() if name not in encoding}
    notes = tuple(dict.fromkeys((*done.notes, *compared.notes, *picture)))
    return Answer({**encoding, **new_figures}, to, notes, HAND_TABLES)


@command("Make", "filter room.touch soft.touch --gaussian sigma=2mm --report --plot soft.png", name="filter")
@with_options(filter_rows(), FORCE_ROWS, SCENE, ALLOW_EMPTY, CODER)
def filter_(
    options: Options,
    source: Source,
    out: Annotated[Path, "OUT.touch, or the filtered field: FIELD.npz, FIELD.vti."],
    with_report: Annotated[
        bool,
        typer.Option("--report", help="Also measure what each filter does: bits, energy, what a hand feels."),
    ] = False,
    plot: Annotated[Path | None, "PNG to draw: the middle frame before and after the filters."] = None,
    workers: Workers = None,
) -> Answer:
    """Filter SOURCE, a scene or a .touch file, in the order of the options, and write OUT."""
    spec = encode_spec(options)
    force_options = {row.name: getattr(spec, row.key) for row in FORCE_ROWS}
    if not spec.filters and all(value is None for value in force_options.values()):
        names = ", ".join(f"--{row.name}" for row in (*filter_rows(), *FORCE_ROWS))
        raise InvalidArgument(f"touchfield filter has no filter to apply: name at least one of {names}")
    require_ending(out, "OUT.touch", "FIELD.npz", "FIELD.vti")
    is_stream = out.suffix == ".touch"
    stray = [name for name, value in {**force_options, "workers": workers}.items() if value is not None]
    if stray and not is_stream:
        raise InvalidArgument(f"--{stray[0]} works with OUT.touch, not with {out.suffix}, a field file")
    check_results((source,), out, plot=plot)
    measured = None
    if with_report:  # first: what it cannot be made of must not leave a file behind
        with progress("report") as report:
            measured = pipeline.filter_report(source, spec, report).summary()
    with progress("filter") as report:
        if is_stream:
            with executor_of(workers) as executor:
                done = pipeline.encode(source, out, spec, report, executor=executor)
            summary, notes = done.summary(), done.notes
        else:
            prepared = pipeline.prepare(source, spec)
            summary, notes = prepared.summary(), prepared.notes
            out = pipeline.write_field(out, felt_medium(prepared), report, prepared.placement)
    if plot is not None:
        pipeline.draw_filtered(source, spec, plot)
        notes = (*notes, f"the picture is {plot}")
    summary["filters"] = "; ".join(f"{step.name} {step.text}" for step in spec.chain) or "none"
    if not measured:
        return Answer(summary, str(out), notes)

    def print_text() -> None:
        title = f"before and after each filter (Q {measured['quantiser']})"
        Answer({**summary, "stages": measured["stages"]}, str(out), notes, {"stages": title}).show()

    return Answer({**summary, "report": measured}, str(out), notes, print_text=print_text)


@command("Make", "field scan.ply --preview look.png", "field scan.ply field.npz --nw 6")
@with_options(SCENE, ALLOW_EMPTY)
def field(
    options: Options,
    source: Source,
    out: Annotated[Path | None, typer.Argument(help="FIELD.npz, or FIELD.vti for ParaView.")] = None,
    preview: Annotated[Path | None, "PNG to draw: where the scene lies in the workspace."] = None,
    device_compute: DeviceCompute = "cpu",
) -> Answer:
    """Write the device-filtered force field before coding, what `encode` starts from; or draw it, with
    --preview.
    """
    if out is None and preview is None:
        raise InvalidArgument(
            "touchfield field makes FIELD.npz or FIELD.vti, or draws --preview PNG: name one"
        )
    check_results((source,), out, plot=preview)
    summary: dict[str, Any] = {}
    with computing(device_compute), progress("field") as report:
        prepared = pipeline.prepare(source, encode_spec(options))
        if preview is not None:
            tasks.view.draw_preview(prepared, preview)
            summary["preview"] = str(preview)
        if out is not None:
            summary["file"] = str(
                pipeline.write_field(out, felt_medium(prepared), report, prepared.placement)
            )
    return Answer({**summary, **prepared.summary()}, str(out or preview), (*prepared.notes, *prepared.learnt))


@command("Make", "plan depth-folder --budget 64kbit/s --plot plan.png", "plan scan.ply --budget 60kB")
@with_options(SCENE)
def plan(
    options: Options,
    source: Source,
    budget: Annotated[
        str,
        typer.Option(help="What to keep to: a rate such as 64kbit/s, or bytes of the file, such as 60kB."),
    ],
    k: Annotated[list[float] | None, "Weber fraction to try; may be repeated."] = None,
    effort: Annotated[str, "fast or default, as of encode."] = "fast",
    plot: Annotated[Path | None, "PNG to draw: the frontier and the choice."] = None,
    workers: Workers = None,
) -> Answer:
    """Find the lattice and the settings that spend a budget best; --nw is the finest of three lattices."""
    amount, search, spec = tasks.plan.parse_budget(budget), tasks.plan.PlanGrid(), encode_spec(options)
    if spec.nw is None:
        raise InvalidArgument("--nominal does not go with plan: name --nw, the finest lattice to try")
    search = replace(search, nw=tuple(range(max(3, spec.nw - 2), spec.nw + 1)), k=tuple(k or search.k))
    check_results((source,), plot=plot)
    spec = replace(spec, touch=replace(spec.touch, effort=effort))
    with progress("plan") as report, executor_of(workers) as executor:
        result = tasks.plan.plan(source, amount, spec, search, report, executor)
    if plot is not None:
        result.draw(plot)
    arguments, notes = _encode_arguments(result, options), (f"the picture is {plot}",) if plot else ()
    values = {**result.summary(), "encode_options": shlex.join(arguments)}
    return Answer(
        values, "", (*result.notes, *notes), print_text=lambda: _show_plan(result, arguments, notes)
    )


def _encode_arguments(plan: Plan, options: dict[str, Any]) -> list[str]:
    """Return the options with which `encode` repeats the choice: its settings and those of the scene."""
    arguments = [*plan.choice.options.split(), "--representation", "voxel"]
    if plan.choice.spec.coder == "touch":
        arguments += ["--effort", plan.choice.spec.touch.effort]
    for row in SCENE:
        value = options[row.key]
        if value != row.default and row.name not in ("nw", "representation"):
            arguments += [f"--{row.name}"] if value is True else [f"--{row.name}", str(value)]
    return arguments


def _show_plan(plan: Plan, arguments: list[str], notes: tuple[str, ...]) -> None:
    """Print a plan as a table with its notes."""
    frames = f"{plan.frames_tried} frame{'s' * (plan.frames_tried > 1)}"
    title = f"{plan.source}: {frames} under {len(plan.trials)} settings; the frontier"
    literal_console().print(title, style="bold", soft_wrap=True)
    rows = [("->" if trial is plan.choice else "", *_cells(plan, trial)) for trial in plan.front()]
    headings = ("", "nw", "coder", "k or step", plan.unit, "NMSE dB", "within mask")
    show_table(rows, headings, right=(1, 3, 4, 5, 6))
    lines = [
        *plan.notes,
        f"within mask: voxels within max({plan.f0_n:g} N, {plan.k:g} |F|) on the finest lattice",
    ]
    if plan.multiplier is not None:
        lines.append(f"lambda is {plan.multiplier:.4g} {plan.unit} for a unit of NMSE at the choice")
    lines.append(shlex.join(["touchfield", "encode", plan.source, "OUT.touch", *arguments]))
    show_notes((*lines, *notes))


def _cells(plan: Plan, trial: Trial) -> tuple[str, ...]:
    figures = trial.summary()
    control = f"{figures['step_n']:g} N" if figures["step_n"] is not None else f"{figures['k']:g}"
    nmse = "exact" if figures["nmse_db"] is None else f"{figures['nmse_db']:.2f}"
    within_bound = f"{100 * trial.mask_fraction:.2f} %"
    kind = f"paper {figures['directions']}" if figures["directions"] else trial.kind
    return (str(figures["nw"] or "-"), kind, control, f"{plan.cost(trial):,.0f}", nmse, within_bound)


@command(
    "Make",
    "export vest.touch vest.tact",
    "export room.touch force.wav --trajectory hand.csv",
    "export room.touch page.html --source room.ply",
)
def export(
    stream: Stream,
    out: Annotated[
        Path, "OUT.hjif (ISO/IEC 23090-31), .tact (bHaptics), .wav, .haptic (Meta), .ahap or .html."
    ],
    device: Annotated[
        str | None, "Profile: the array whose drives are written; default: the stream's."
    ] = None,
    trajectory: Annotated[Path | None, "Where the probe goes: CSV of t_s,x_m,y_m,z_m."] = None,
    panel: Annotated[str, "Of an array with two panels: front or back."] = "front",
    full_scale_n: Annotated[float, "A force as .hjif: newtons written as 1, for readers that clip."] = 1.0,
    source: Annotated[str | None, "SOURCE of the file: the page shows it, and the difference, too."] = None,
) -> Answer:
    """Write STREAM in another format: drives of an array, the force along --trajectory, or a page for any
    browser.
    """
    from touchfield.tasks.exchange import export as run

    check_results((stream, trajectory, source), out)
    with progress("export") as report:
        done = run(stream, out, device, trajectory, panel, report, full_scale_n, source)
    return Answer(done.summary(), str(out), done.notes)


@command("Make", "import effect.hjif effect.touch", name="import")
def import_(
    effect: Annotated[
        Path, "EFFECT.hjif, its binary form .hmpg, .ahap (Apple), .haptic (Meta) or .tact (bHaptics)."
    ],
    out: Annotated[Path, "The .touch file to write."],
    rate_hz: Annotated[float, "Frames a second of the medium."] = 100.0,
    force_max_n: Annotated[float | None, "Force of a full drive; default: the file's, or 3.3."] = None,
) -> Answer:
    """Turn an effect into a .touch file: a symbolic medium for an array of actuators."""
    from touchfield.tasks.exchange import import_effect

    refuse_overwriting(out, effect)
    with progress("import") as report:
        done = import_effect(effect, out, None, rate_hz, force_max_n, report)
    return Answer(done.summary(), str(out), done.notes)
