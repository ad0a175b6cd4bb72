"""Commands that look and study: info, view and compare, measure."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any
from urllib.parse import urlsplit

import typer

from touchfield.cli.app import Json, Source, Stream, command
from touchfield.cli.options import ALLOW_OUTSIDE, SCENE, asks, encode_spec
from touchfield.cli.show import check_picture, is_same_file, keep_source, progress, show, show_motion
from touchfield.container.remote import is_remote
from touchfield.errors import InvalidArgument, MissingExtra
from touchfield.measure.estimators import ESTIMATORS
from touchfield.viewer.page import is_our_picture

__all__: list[str] = []


@command("Look", "view room.touch", "view room.touch --against scan.ply --out room.html --no-open")
def view(
    stream: Stream,
    against: Annotated[
        str | None, typer.Option(help="SOURCE of the file: tell NMSE, entropy, vibration, too.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="HTML file to write; default: a temporary one.")] = None,
    no_open: Annotated[bool, typer.Option("--no-open", help="Open no browser.")] = False,
    as_json: Json = False,
) -> None:
    """Open STREAM in the browser: seen, played, probed and heard, without any network."""
    from touchfield.job.view import view as run

    check_picture(stream, out)
    with progress("view") as report:
        page = run(stream, against, report)
    path = page.save(out) if out else None
    if not no_open:
        path = page.open(path)
    if path is None:
        raise InvalidArgument("--no-open", "no --out", "an HTML file to write", "Name one: --out page.html.")
    show({"page": str(path), "page_bytes": path.stat().st_size, **page.figures}, str(stream), as_json)


@command("Look", "compare scan.ply scan.touch", "compare scan.ply scan.touch --no-picture --json")
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

    target = picture or _free_name(source, stream)
    keep_source(source, target)
    keep_source(stream, target)
    if not no_picture and target.exists() and not is_our_picture(target):
        mend = "Name another --picture, or take --no-picture."
        raise InvalidArgument(f"{target} is there, and touchfield did not draw it: it is left as it is", mend=mend)
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


def _free_name(source: str, stream: str) -> Path:
    """STREAM.png, or STREAM.compare.png where that is the source or was not drawn here; here for an address."""
    own = Path(urlsplit(stream).path).name if is_remote(stream) else stream
    usual = Path(own).with_suffix(".png")
    is_free = not usual.exists() or (is_our_picture(usual) and not is_same_file(source, usual))
    return usual if is_free else usual.with_suffix(".compare.png")


@command("Study", "measure room.touch", "measure scan.ply --device phantom-omni --device tshirt-32x32")
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
    density: Annotated[
        float | None,
        typer.Option(
            help="Samples of W per axis for one of a point device; the paper's has 5. [default: data sheet]"
        ),
    ] = None,
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
    spec = job.MeasureSpec(quantiser, over, estimator, tuple(device or ()), not no_limits, encode, density)
    check_picture(medium, plot)
    with progress("measure", "step") as report:
        measurement = job.measure_medium(medium, spec, report)
    if plot is not None:
        measurement.draw(plot)
    show_measurement(measurement, as_json, (f"the picture is {plot}",) if plot else ())
