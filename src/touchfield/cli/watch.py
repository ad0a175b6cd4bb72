"""Command `watch`: touch from the picture, the sound and the depth of a movie."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from touchfield.cli.main import command
from touchfield.cli.output import Answer, check_results, progress


@command(
    "Make",
    "watch movie.mp4 -o both.mp4 --plot both.png",
    "watch movie.mp4 -o both.mkv --only sound --device tactile-vest-8x8",
    "watch movie.mp4 -o both.mp4 --depth depth.mkv",
)
def watch(
    movie: Annotated[Path, "A movie: .mp4, .m4v, .mov, .mkv, .webm, .ts or .avi."],
    out: Annotated[
        Path, typer.Option("-o", "--out", help="The movie with touch: .mp4, .m4v, .mov, .ts or .mkv.")
    ],
    device: Annotated[str, "An array of motors: a profile's name, or its TOML file."] = "tactsuit-x40",
    only: Annotated[str | None, "picture, sound or depth; default: all that there are."] = None,
    depth: Annotated[
        Path | None,
        "Depth of the movie: a video of 16-bit grey, or a folder of depth pictures; default: the movie's own "
        "track of depth, if it has one.",
    ] = None,
    plot: Annotated[Path | None, "PNG to draw: what was found and the drives over time."] = None,
) -> Answer:
    """Make touch from what catches the eye in MOVIE, what is heard, and what comes nearer."""
    from touchfield.tasks.watch import WatchSpec, watch as run

    check_results((movie, *([] if depth is None else [depth])), out, plot=plot)
    spec = WatchSpec(device, only, depth)
    with progress("watch") as report:
        done = run(movie, out, spec, plot=plot, report=report)
    notes = done.notes if plot is None else (*done.notes, f"the picture is {plot}")
    return Answer(done.summary(), str(out), notes)
