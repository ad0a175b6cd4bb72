"""The command of paper section 6.1: reduce."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from touchfield.cli.app import Json, command
from touchfield.cli.editing import Medium, coder_spec
from touchfield.cli.options import CODER, asks
from touchfield.cli.show import check_picture, progress, show

__all__: list[str] = []


@command(
    "Study",
    "reduce fox.touch",
    "reduce ground.touch --cull shell.touch --mode lossless --plot reduced.png",
    "reduce fox.touch few-modes.touch --rank 20 --trace log.csv",
)
@asks(CODER)
def reduce(
    medium: Medium,
    out: Annotated[Path | None, typer.Argument(help="OUT.touch of the modes that are kept; none without it.")] = None,
    modes: Annotated[str, typer.Option(help="global: of whole frames; bricks: of bricks of 8^3 samples.")] = "global",
    rank: Annotated[int | None, typer.Option(help="Modes to keep; default: as many as --nmse-db needs.")] = None,
    nmse_db: Annotated[float, typer.Option(help="Error that modes are counted for.")] = -30.0,
    cull: Annotated[Path | None, typer.Option(help="OUT.touch without what the hand can never feel.")] = None,
    push_n: Annotated[float | None, typer.Option(help="Of the hand, at most; default: the device's.")] = None,
    mass_kg: Annotated[float | None, typer.Option(help="Of hand and device; default: 50 g and its own.")] = None,
    speed_m_s: Annotated[float | None, typer.Option(help="Of the hand, at most; default: 0.2.")] = None,
    device: Annotated[str | None, typer.Option(help="Device in the hand; default: that of MEDIUM.")] = None,
    trace: Annotated[Path | None, typer.Option(help="Where a hand was: t_s,x_m,y_m,z_m, as a play's --log.")] = None,
    plot: Annotated[Path | None, typer.Option(help="PNG to draw: the spectrum, and a section.")] = None,
    as_json: Json = False,
    *,
    asked: dict[str, Any],
) -> None:
    """Tell in how few numbers MEDIUM varies, how many bits a degree of freedom has, and what no hand can feel."""
    from touchfield.job.reduction import ReductionSpec, reduce_medium

    for picture in (plot, out, cull):
        check_picture(medium, picture)
    spec = ReductionSpec(modes, rank, nmse_db, device, push_n, mass_kg, speed_m_s, trace)
    with progress("reduce") as report:
        done = reduce_medium(medium, out, cull, spec, coder_spec(asked), report)
    if plot is not None:
        from touchfield.viewer.reduction import draw_reduction

        draw_reduction(plot, done.values, done.field, done.felt, done.shown["hand"])
    told = dict(done.shown)
    held_out = {} if as_json else told.pop("held_out", {})
    show({**told, **{f"held_out_{name}": value for name, value in held_out.items()}}, medium, as_json, done.notes)
