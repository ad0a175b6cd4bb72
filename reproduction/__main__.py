"""Runs `python -m reproduction` in a checkout: makes the paper's tables and figures again.

Every experiment that was asked for is tried. What cannot be made (a library that is not installed, a source
at fault) takes one line on standard error and on the page of all; the others are made all the same, and the
command ends with the exit code of the first that was not.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from reproduction.experiment import Experiment, Inputs, experiment, experiments
from reproduction.origin import origin
from reproduction.page import Made, command, plain, write_finding, write_page
from reproduction.scenes import user_inputs
from touchfield.cli.main import Json, run
from touchfield.cli.output import Answer, progress
from touchfield.errors import InvalidArgument, TouchfieldError

__all__ = ["app", "run_reproduction"]

ALL = "all"

app = typer.Typer(add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False)


@app.command()
def reproduce(
    names: Annotated[list[str], typer.Argument(help="Tables and figures, such as table3 fig9; or all.")],
    out: Annotated[Path, typer.Option(help="Folder for pages and pictures.")] = Path("reproduced"),
    depth: Annotated[
        list[Path] | None, typer.Option(help="A depth sequence of your own; may be repeated.")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Smaller sizes: a trial.")] = False,
    as_json: Json = False,
) -> None:
    """Make the paper's tables and figures again: printed, literal and corrected side by side."""
    run_reproduction(names, out, depth or [], quick, as_json)


def run_reproduction(
    names: Sequence[str], out: Path, depth: Sequence[Path], quick: bool, as_json: bool
) -> None:
    """Run experiments and write their pages into a folder.

    Raises
    ------
    InvalidArgument
        For an unknown name, or a folder that cannot be written or that holds what is read.
    TouchfieldError
        If a depth sequence cannot be read, or nothing at all could be made.
    typer.Exit
        With the exit code of the first experiment that could not be made, when all others are written.
    """
    is_all = ALL in names
    chosen = experiments() if is_all else tuple(dict.fromkeys(experiment(name) for name in names))
    _check_folders(out, depth)
    user_inputs(tuple(depth))  # a folder at fault is told before the work
    source = origin(depth)
    made = [_made(one, Inputs(out, tuple(depth), quick=quick), source) for one in chosen]
    failed = [one for one in made if one.error is not None]
    if len(failed) == len(made) and failed[0].error is not None:
        raise failed[0].error
    page = write_page(out, made, command([ALL], depth, quick), source) if is_all else None
    _say(made, out, page, as_json)
    for one in failed:
        if one.error is not None:
            sys.stderr.write(f"touchfield: {one.experiment.name} is not made: {one.error}\n")
    if failed and failed[0].error is not None:
        raise typer.Exit(failed[0].error.exit_code)


def _check_folders(out: Path, depth: Sequence[Path]) -> None:
    """The folder for the results is there, and none that is read."""
    for folder in depth:
        if out.resolve().is_relative_to(folder.resolve()):
            raise InvalidArgument(
                str(out), f"a folder of {folder}, which is read", "another folder for the results"
            )
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InvalidArgument(
            str(out), error.strerror or str(error), "a folder", "Name another one."
        ) from None


def _made(one: Experiment, inputs: Inputs, source: dict[str, Any]) -> Made:
    with progress(one.name, "step") as report:
        try:
            finding = one.run(replace(inputs, report=report))
        except TouchfieldError as error:
            return Made(one, error=error)
    # a page is the same whatever was asked for beside it
    made_by = command([one.name], inputs.depth, inputs.quick)
    write_finding(inputs.folder, one, finding, made_by, source)
    return Made(one, finding)


def _say(made: Sequence[Made], out: Path, page: Path | None, as_json: bool) -> None:
    written: dict[str, Any] = {}
    for one in made:
        if one.finding is None:
            continue
        if as_json:
            written[one.experiment.name] = plain(one.finding.data)
        else:
            written[one.experiment.name] = f"{one.experiment.name}.md"
    if page is not None:
        written["page"] = page.name
    Answer(written, f"reproduced in {out}").show(as_json)


if __name__ == "__main__":
    run(commands=app)
