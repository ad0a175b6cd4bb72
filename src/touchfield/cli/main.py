"""The `touchfield` command: encode, field, filter, measure, plan, info, decode, compare, devices, sources, warmup,
demo, reproduce; those of the receiver (play, export, import, doctor) are in `receiver`, those of stored media in
`editing` and `library`.

Exit code 0 if all went well, 2 for a usage error, 1 for data at fault; an error is one line on stderr.
"""

from __future__ import annotations

import os
import signal
import sys
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from touchfield._version import __version__
from touchfield.cli import editing, library, receiver  # noqa: F401  their commands register themselves
from touchfield.cli.app import FieldFile, Json, Source, Stream, app
from touchfield.cli.motion import show_motion
from touchfield.cli.options import (
    ALLOW_OUTSIDE,
    BESIDE,
    CODER,
    SCENE,
    TARGET,
    asks,
    encode_spec,
    filter_rows,
    target_of,
)
from touchfield.cli.show import check_picture, is_same_file, keep_source, progress, show, show_rows
from touchfield.errors import InvalidArgument, MissingExtra, TouchfieldError
from touchfield.measure.estimators import ESTIMATORS

__all__ = ["app", "run"]

# typer carries a click of its own in some versions and imports it in others; its errors' base is found either way
USAGE_ERROR: Any = next(c for c in typer.BadParameter.__mro__ if c.__name__ == "ClickException")

LATER = {"touch": ("passes", "columns")}
"""Of a coder, what is compiled last, and longest, before a first field is coded."""

TYPER_INTERRUPTED = 130
"""What typer makes of Ctrl-C."""


@app.callback(invoke_without_command=True)
def root(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Show the version and exit.")] = False,
) -> None:
    """Touch as a medium: a scene becomes a force field, a stream, and a field again."""
    if version:
        typer.echo(f"touchfield {__version__}")
    elif context.invoked_subcommand is None:
        typer.echo(context.get_help())


@app.command()
@asks(SCENE, BESIDE, CODER, TARGET)
def encode(
    source: Source,
    out: Annotated[Path, typer.Argument(help="The .touch file to write.")],
    as_json: Json = False,
    with_report: Annotated[
        bool,
        typer.Option("--report", help="Also measure what a hand feels of the coding that moves, or holds still."),
    ] = False,
    *,
    asked: dict[str, Any],
) -> None:
    """Turn SOURCE into a .touch file."""
    from touchfield import job

    keep_source(source, out)
    spec, target = encode_spec(asked), target_of(asked)
    with progress("encode", later=LATER.get(spec.coder, ())) as report:
        if target is None:
            done = job.encode(source, out, spec, report)
        else:
            done = job.encode_to_target(source, out, spec, target, report)
    shown = done.summary()
    if with_report:
        with progress("report") as report:
            shown |= job.hand_motion(done.prepared, out, report=report).summary()
    show_motion(shown, str(out), as_json, done.notes)


@app.command()
@asks(SCENE)
def field(
    source: Source,
    out: Annotated[Path | None, typer.Argument(help="FIELD.npz, or FIELD.vti for ParaView.")] = None,
    preview: Annotated[Path | None, typer.Option(help="PNG to draw: where the scene lies in the workspace.")] = None,
    as_json: Json = False,
    *,
    asked: dict[str, Any],
) -> None:
    """Write the device-filtered force field before coding, what `encode` starts from; or draw it, with --preview."""
    from touchfield import job

    if out is None and preview is None:
        raise InvalidArgument("touchfield field", "no result to make", "FIELD.npz, FIELD.vti or --preview PNG")
    check_picture(source, preview)
    if out is not None:
        keep_source(source, out)
    shown: dict[str, Any] = {}
    with progress("field") as report:
        prepared = job.prepare(source, encode_spec(asked))
        if preview is not None:
            job.draw_preview(prepared, preview)
            shown["preview"] = str(preview)
        if out is not None:
            shown["file"] = str(job.write_field(out, prepared.medium, report, prepared.placement))
    show({**shown, **prepared.summary()}, str(out or preview), as_json, (*prepared.notes, *prepared.learnt))


@app.command(name="filter")
@asks(filter_rows(), BESIDE, SCENE, CODER)
def filter_(
    source: Source,
    out: Annotated[Path, typer.Argument(help="OUT.touch, or the filtered field: FIELD.npz, FIELD.vti.")],
    as_json: Json = False,
    with_report: Annotated[
        bool, typer.Option("--report", help="Also measure what each filter does: bits, energy, what a hand feels.")
    ] = False,
    quantiser: Annotated[str, typer.Option(help="Q of the report's entropies.")] = "weber:0.1",
    plot: Annotated[Path | None, typer.Option(help="PNG to draw: the middle frame before and after.")] = None,
    *,
    asked: dict[str, Any],
) -> None:
    """Filter SOURCE, a scene or a .touch file, in the order of the options, and write OUT."""
    from touchfield import job
    from touchfield.codec.paper.field_quantiser import FieldQuantiserSpec

    spec, parsed = encode_spec(asked), FieldQuantiserSpec.parse(quantiser)
    beside = {row[0]: getattr(spec, row[0].replace("-", "_")) for row in BESIDE}
    if not spec.filters and all(words is None for words in beside.values()):
        names = ", ".join(f"--{row[0]}" for row in (*filter_rows(), *BESIDE))
        raise InvalidArgument("touchfield filter", "no filter", f"at least one of {names}")
    if out.suffix not in (".touch", ".npz", ".vti"):
        raise InvalidArgument(str(out), f"the ending {out.suffix!r}", "OUT.touch, or FIELD.npz or FIELD.vti")
    for name, words in beside.items():
        if words is not None and out.suffix != ".touch":
            mend = "A field file has no place for it."
            raise InvalidArgument(f"--{name}", f"it with {out.suffix}", "OUT.touch", mend)
    keep_source(source, out)
    check_picture(source, plot)
    measured = None
    if with_report:  # first: what it cannot be made of must not leave a file behind
        with progress("report") as report:
            measured = job.filter_report(source, spec, parsed, report).summary()
    with progress("filter", later=LATER.get(spec.coder, ()) if out.suffix == ".touch" else ()) as report:
        if out.suffix == ".touch":
            done = job.encode(source, out, spec, report)
            shown, notes = done.summary(), done.notes
        else:
            prepared = job.prepare(source, spec)
            shown, notes = prepared.summary(), prepared.notes
            out = job.write_field(out, prepared.medium, report, prepared.placement)
    if plot is not None:
        job.draw_filtered(source, spec, plot)
        notes = (*notes, f"the picture is {plot}")
    shown["filters"] = "; ".join(f"{step.name} {step.words}" for step in spec.chain) or "none"
    if as_json:
        show({**shown, "report": measured} if measured else shown, str(out), True, notes)
        return
    show(shown, str(out), False, notes)
    if measured:
        show_rows(measured["stages"], f"before and after each filter (Q {measured['quantiser']})")


@app.command()
@asks(tuple(row for row in SCENE if row[0] != "device"))
def measure(
    medium: Annotated[str, typer.Argument(help="A .touch file, or any SOURCE.", metavar="MEDIUM")],
    device: Annotated[
        list[str] | None, typer.Option(help="Device whose capacity, WMR and HIL are wanted; may be repeated.")
    ] = None,
    quantiser: Annotated[
        str | None,
        typer.Option(
            help="Q: weber:K, uniform:NEWTONS or lloyd-max:BITS, each with /DIRECTIONS; components:NEWTONS."
        ),
    ] = None,
    over: Annotated[
        str, typer.Option(help="mu: voxel, object, or interaction:TRACE.csv (t_s,x_m,y_m,z_m).")
    ] = "voxel",
    estimator: Annotated[str, typer.Option(help=f"Estimator of entropy: {', '.join(ESTIMATORS)}.")] = "plug-in",
    reference: Annotated[
        str, typer.Option(help="Device in whose workspace a SOURCE is sampled as W.")
    ] = "phantom-omni",
    no_limits: Annotated[bool, typer.Option("--no-limits", help="Leave out the coding limits.")] = False,
    plot: Annotated[Path | None, typer.Option(help="PNG to draw.")] = None,
    as_json: Json = False,
    *,
    asked: dict[str, Any],
) -> None:
    """Measure a medium in bits: entropies, coding limits, capacity of devices, energy."""
    from touchfield import job
    from touchfield.cli.measured import show_measurement

    encode = encode_spec({**asked, "device": reference})
    spec = job.MeasureSpec(quantiser, over, estimator, tuple(device or ()), not no_limits, encode)
    check_picture(medium, plot)
    with progress("measure", "step") as report:
        found = job.measure_medium(medium, spec, report)
    if plot is not None:
        found.draw(plot)
    show_measurement(found, as_json, (f"the picture is {plot}",) if plot else ())


@app.command()
@asks(SCENE)
def plan(
    source: Source,
    budget: Annotated[str, typer.Option(help="Bit rate to keep to: 64kbit/s; or bit/s, Mbit/s, B/s, kB/s.")],
    k: Annotated[list[float] | None, typer.Option(help="Weber fraction to try; may be repeated.")] = None,
    effort: Annotated[str, typer.Option(help="fast, default or max.")] = "fast",
    out: Annotated[Path | None, typer.Option(help="PNG to draw: the frontier and the choice.")] = None,
    as_json: Json = False,
    *,
    asked: dict[str, Any],
) -> None:
    """Find the lattice and the settings that spend a bit rate best; --nw is the finest of three lattices."""
    from touchfield import job
    from touchfield.cli.plan import show_plan

    rate, search, spec = job.parse_rate(budget), job.PlanGrid(), encode_spec(asked)
    if spec.nw is None:
        raise InvalidArgument("--nominal", "it with plan", "--nw, the finest lattice to try")
    search = replace(search, nw=tuple(range(max(3, spec.nw - 2), spec.nw + 1)), k=tuple(k or search.k))
    check_picture(source, out)
    with progress("plan", "setting") as report:
        found = job.plan(source, rate, replace(spec, touch=replace(spec.touch, effort=effort)), search, report)
    if out is not None:
        found.draw(out)
    show_plan(found, as_json, (f"the picture is {out}",) if out else ())


@app.command()
def decode(stream: Stream, out: FieldFile, as_json: Json = False) -> None:
    """Turn a .touch file back into a force field."""
    from touchfield import job

    keep_source(stream, out)
    with job.open_stream(stream) as opened, progress("decode") as report:
        written = job.write_field(out, opened.medium, report, opened.placement)
        shown = {"file": str(written), "frames": len(opened.medium), "grid_shape": list(opened.medium.grid.shape)}
    show(shown, str(written), as_json)


@app.command()
def info(stream: Stream, as_json: Json = False) -> None:
    """Say what a .touch file holds."""
    from touchfield import job
    from touchfield.cli.listing import stream_for_people

    with job.open_stream(stream) as opened:
        shown = opened.summary()
    show(shown if as_json else stream_for_people(shown), str(stream), as_json)


@app.command()
def compare(
    source: Source,
    stream: Stream,
    as_json: Json = False,
    picture: Annotated[Path | None, typer.Option(help="PNG to write; default: beside the stream.")] = None,
    no_picture: Annotated[bool, typer.Option("--no-picture", help="Write no picture.")] = False,
    frame: Annotated[int | None, typer.Option(help="Frame to draw; default: the middle one.")] = None,
    k: Annotated[float | None, typer.Option(help="Weber fraction of the mask; default: the stream's.")] = None,
    f0_n: Annotated[float | None, typer.Option(help="F_0 of the mask, newtons.")] = None,
    allow_outside: Annotated[bool, typer.Option("--allow-outside", help=ALLOW_OUTSIDE)] = False,
) -> None:
    """Measure a stream against its source, and draw both."""
    from touchfield import job

    target = picture or stream.with_suffix(".png")
    if picture is None and is_same_file(source, target):
        target = stream.with_suffix(".compare.png")
    keep_source(source, target)
    keep_source(stream, target)
    with progress("compare") as report:
        compared = job.compare(
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
    show_motion(compared.summary(), f"{stream} against {source}", as_json, notes)


@app.command()
def devices(as_json: Json = False, verbose: Annotated[bool, typer.Option(help="With all sources.")] = False) -> None:
    """List the device profiles, with their sources."""
    from touchfield.cli.listing import list_devices

    list_devices(as_json, verbose)


@app.command()
def sources(as_json: Json = False) -> None:
    """List the kinds of source."""
    from touchfield.sources.registry import kinds

    show(
        {kind.name: kind.summary for kind in kinds()},
        "kinds of source (--as takes a name, or a word that one description alone has)",
        as_json,
    )


@app.command()
def warmup() -> None:
    """Compile all kernels now, so that the first real job does not wait for it."""
    from touchfield import job

    with progress("compile", "step", later=("passes", "measures", "filters")) as report:
        job.warm_up(report)


@app.command()
def demo(
    folder: Annotated[Path, typer.Argument(help="Folder for the results.")] = Path("demo"),
    as_json: Json = False,
) -> None:
    """Run the main job on real scenes that come with the libraries: no download, no device."""
    from touchfield.cli.demo import run_demo

    run_demo(folder, as_json)


@app.command()
def reproduce(
    names: Annotated[list[str], typer.Argument(help="Tables and figures, such as table3 fig9; or all.")],
    out: Annotated[Path, typer.Option(help="Folder for pages and pictures.")] = Path("reproduction"),
    depth: Annotated[list[Path] | None, typer.Option(help="A depth sequence of your own; may be repeated.")] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Smaller sizes: a trial.")] = False,
    as_json: Json = False,
) -> None:
    """Make the paper's tables and figures again: printed, literal and corrected side by side."""
    from touchfield.cli.reproduce import run_reproduce

    run_reproduce(names, out, depth or [], quick, as_json)


def run(arguments: list[str] | None = None) -> None:
    """The console entry point."""
    # a request to end (a job scheduler, `timeout`) cleans up as Ctrl-C does
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    sys.exit(_exit_code(arguments))


def _exit_code(arguments: list[str] | None) -> int:
    try:
        result = app(args=arguments, standalone_mode=False)
        if result == TYPER_INTERRUPTED:
            raise KeyboardInterrupt
        return result if isinstance(result, int) else 0
    except TouchfieldError as error:
        return _say(str(error), error.exit_code)
    except (KeyboardInterrupt, typer.Abort):
        return _say("interrupted; nothing was written under the final name", 1)
    except USAGE_ERROR as error:
        return _say(f"{error.format_message()} (touchfield --help tells more)", 2)
    except MemoryError:
        return _say("out of memory: a smaller --nw, fewer --frames or a thinner --thickness-m take less", 1)
    except BrokenPipeError:
        return 1
    except OSError as error:
        name = error.filename or "file system"
        return _say(f"{name}: {error.strerror or error}. Check the path, the permissions and the free space", 1)
    except Exception as error:
        if os.environ.get("TOUCHFIELD_TRACEBACK"):
            raise
        text = f"a fault of touchfield itself ({type(error).__name__}: {error})"
        return _say(f"{text}. Run again with TOUCHFIELD_TRACEBACK=1 and report what it prints", 1)


def _say(text: str, code: int) -> int:
    sys.stderr.write(f"touchfield: {' '.join(text.split())}\n")
    return code
