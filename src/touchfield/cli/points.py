"""The command of the fewest points (paper section 6.2): points."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from touchfield.cli.app import Json, command
from touchfield.cli.options import CODER, asks, coder_spec
from touchfield.cli.show import check_picture, is_same_file, progress, show, show_rows
from touchfield.errors import InvalidArgument


@command("Study", "points 15 fox.touch rebuilt.touch --plot points.png", "points 5 felt.csv --next")
@asks(CODER)
def points(
    count: Annotated[int, typer.Argument(help="How many points.")],
    source: Annotated[
        str, typer.Argument(help="A .touch file, a stored field, or a recording of contacts.", metavar="IN")
    ],
    out: Annotated[
        Path | None, typer.Argument(help="The medium rebuilt (.touch, .npz, .vti), or the points (.csv).")
    ] = None,
    modes: Annotated[int | None, typer.Option(help="Modes of a medium that moves; default: COUNT.")] = None,
    is_next: Annotated[bool, typer.Option("--next", help="Where to record next, and how little is known there.")] = (
        False
    ),
    measured: Annotated[
        Path | None, typer.Option(help="With --next: a recording of what was measured of IN.")
    ] = None,
    plot: Annotated[Path | None, typer.Option(help="PNG to draw.")] = None,
    as_json: Json = False,
    *,
    asked: dict[str, Any],
) -> None:
    """Find the fewest points of IN that tell the rest, or where to measure next."""
    from touchfield.job.reduction import fewest_points, next_points
    from touchfield.job.spec import EncodeSpec

    check_picture(source, plot)
    if out is not None and is_same_file(source, out):
        raise InvalidArgument(str(out), "the file that is read", "another name")
    if is_next and (out is not None or modes is not None):
        raise InvalidArgument("--next", "OUT or --modes beside it", "neither: nothing is rebuilt yet")
    if measured is not None and not is_next:
        raise InvalidArgument("--measured", "no --next", "both, or neither")
    spec = coder_spec(asked)
    if is_next:
        done = next_points(source, count, measured)
    else:
        with progress("points") as report:
            done = fewest_points(source, count, out, modes, spec, report)
    if plot is not None:
        done.draw(plot, (spec.k, spec.f0_n or EncodeSpec().f0_n or 0.0))
    rows = done.shown.get("next", ())
    if as_json or not rows:
        show(done.summary(), f"{count} points of {source}", as_json, done.notes)
        return
    show({key: value for key, value in done.summary().items() if key != "next"}, f"where next: {source}", False)
    show_rows(rows, "places, the first one first")
