"""Commands that compare many media (paper section 4): `index` and `search` for a folder, `similar` and
`correlate` for two; and `points`, which finds a few samples that determine a field (section 6.2)."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from touchfield.cli.main import Options, Stream, command
from touchfield.cli.options import (
    CODER,
    SCENE,
    Workers,
    coder_spec,
    encode_spec,
    numbers_of,
    refuse_unused,
    values_of,
    with_options,
)
from touchfield.cli.output import Answer, check_results, echo, progress, show_notes
from touchfield.compute.executors import executor_of
from touchfield.errors import InvalidArgument

Folder = Annotated[Path, typer.Argument(help="A folder of .touch files, with the folders in it.")]
IndexFile = Annotated[
    Path | None,
    typer.Option("--index", help="File of the index; default: FOLDER.index.npz next to the folder."),
]

_MAX_REPORTED = 20


@command("Study", "index recordings")
def index(folder: Folder, index_file: IndexFile = None, workers: Workers = None) -> Answer:
    """Describe every .touch file of FOLDER for `search`; only what changed is read again."""
    from touchfield.tasks.library import index_folder

    if index_file is not None and index_file.suffix == ".touch":
        raise InvalidArgument("--index", str(index_file), "a name that ends in .npz")
    with progress("index") as report, executor_of(workers) as executor:
        done = index_folder(folder, index_file, report, executor)
    faults = done.faults
    fault_notes = [f"left out: {name}: {fault}" for name, fault in list(faults.items())[:_MAX_REPORTED]]
    more = (
        (f"{len(faults) - _MAX_REPORTED} more are left out; --json tells them all",)
        if len(faults) > _MAX_REPORTED
        else ()
    )
    print_text = Answer(done.summary(), str(done.path), (*done.notes, *fault_notes, *more)).show
    return Answer({**done.summary(), "faults": faults}, str(folder), done.notes, print_text=print_text)


@command("Study", "search recordings like.touch")
def search(
    folder: Folder,
    like: Annotated[Path, "A .touch file, in FOLDER or not."],
    count: Annotated[int, "How many are wanted."] = 10,
    any_pose: Annotated[bool, "Leave out what turns with a body."] = False,
    weight: Annotated[
        list[str] | None, "PART=NUMBER, such as amplitude=2 or change=0; may be repeated."
    ] = None,
    index_file: IndexFile = None,
) -> Answer:
    """List the media of FOLDER that are most like LIKE, the nearest first; index it before."""
    from touchfield.measure.retrieval import ANY_POSE
    from touchfield.tasks.library import search as run

    weights = dict(ANY_POSE) if any_pose else {}
    for text in weight or ():
        name, _, number = text.partition("=")
        try:
            weights[name] = float(number)
        except ValueError:
            raise InvalidArgument("--weight", repr(text), "PART=NUMBER, such as amplitude=2") from None
    try:
        result = run(folder, like, count, weights, index_file)
    except InvalidArgument as error:  # of a part: the command line names the option
        if not error.where.startswith("weight"):
            raise
        found = error.found if error.where == "weights" else f"{error.where} {error.found}"
        raise InvalidArgument("--weight", found, error.expected, error.hint) from error
    figures = result.summary()

    def print_text() -> None:
        echo(f"like {like}, of {figures['media']} media ({figures['query_ms']:.1f} ms)")
        for match in figures["matches"]:
            echo("{rank:4d}  {distance:.4f}  {name}".format(**match))
        show_notes(result.notes)

    return Answer(figures, str(like), result.notes, print_text=print_text)


@command("Study", "similar one.touch other.touch")
@with_options(SCENE)
def similar(
    options: Options,
    first: Annotated[str, "A .touch file, or any SOURCE."],
    second: Annotated[str, "Another; it is brought onto the lattice of the first."],
    quantiser: Annotated[str, "Q, the same for both; coarse, lest a coder's error counts."] = (
        "weber:0.25/ico1"
    ),
    over: Annotated[str, "mu of NMI and VI: voxel, or object (where one has a force)."] = "object",
    looks: Annotated[int, "Frames that are compared, evenly spaced."] = 8,
) -> Answer:
    """Tell how alike two media are: voxel by voxel, as histograms, to a compressor, and, in any pose, as
    `search` ranks them.
    """
    from touchfield.tasks.library import similar as run

    with progress("similar") as report:
        done = run(
            first, second, encode_spec(options), quantiser=quantiser, over=over, frames=looks, report=report
        )
    figures = done.summary()
    names = {
        "normalised": "NMI",
        "variation": "VI / bit",
        "jensen_shannon": "sqrt(JSD)",
        "compression": "NCD",
    }
    short = {names.get(k, k): v["value"] if k in names and v else v for k, v in figures.items()}
    title = f"{first} and {second}"
    return Answer(figures, title, done.notes, print_text=Answer(short, title, done.notes).show)


@command("Study", "correlate video.mp4 room.touch")
def correlate(
    video: Annotated[Path, "A video, a GIF, a picture, or a folder of pictures."],
    stream: Stream,
    looks: Annotated[int, "Times that are looked at, evenly spaced."] = 4,
    reading: Annotated[str, "|F| along the sight: peak (how hard it can push) or first."] = "peak",
    intrinsics: Annotated[
        str | None, "fx,fy,cx,cy of the camera, pixels; default: seen from the front."
    ] = None,
    source_rate_hz: Annotated[float | None, "Pictures a second, where the video does not say."] = None,
) -> Answer:
    """Tell how much pictures tell of their scene's touch: I(luma; |F|) in bits a pixel, and, unless they are
    too smooth, whether by chance.
    """
    from touchfield.tasks.library import correlate as run

    camera = None if intrinsics is None else numbers_of("--intrinsics", intrinsics, (4,), "fx,fy,cx,cy")
    with progress("correlate") as report:
        done = run(
            video, stream, frames=looks, reading=reading, intrinsics=camera, source_rate_hz=source_rate_hz,
            report=report,
        )  # fmt: skip
    title = f"I(luma; |F|) of {video} and {stream}, bits a pixel"
    return Answer(done.summary(), title, done.notes, {"looks": ""})


@command("Study", "points 15 fox.touch rebuilt.touch --plot points.png", "points 5 recorded.csv --next")
@with_options(CODER)
def points(
    options: Options,
    count: Annotated[int, "How many points."],
    source: Annotated[
        str, typer.Argument(help="A .touch file, a stored field, or a recording of contacts.", metavar="IN")
    ],
    out: Annotated[
        Path | None, typer.Argument(help="The medium rebuilt (.touch, .npz, .vti), or the points (.csv).")
    ] = None,
    modes: Annotated[int | None, "Modes of a medium that moves; default: COUNT."] = None,
    is_next: Annotated[
        bool, typer.Option("--next", help="Where to record next, and how little is known there.")
    ] = (False),
    measured: Annotated[Path | None, "With --next: a recording of what was measured of IN."] = None,
    plot: Annotated[
        Path | None, "PNG to draw: the points, the field, the rebuilt field and its error."
    ] = None,
) -> Answer:
    """Find a few points of IN from which to rebuild the rest, with its error, or where to measure next."""
    from touchfield.tasks.reduction import fewest_points, next_points

    check_results((source,), out, plot=plot)
    if is_next and (out is not None or modes is not None):
        raise InvalidArgument("--next", "OUT or --modes with it", "neither: nothing is rebuilt yet")
    if measured is not None and not is_next:
        raise InvalidArgument("--measured", "no --next", "both, or neither")
    if is_next:
        refuse_unused(values_of(options, CODER), "with --next: nothing is rebuilt yet")
        done = next_points(source, count, measured)
    else:
        with progress("points") as report:
            done = fewest_points(source, count, out, modes, coder_spec(options), report)
    picture = () if plot is None else (f"the picture is {plot}",)
    if plot is not None:
        done.draw(plot)
    title, notes = f"{count} points of {source}", (*done.notes, *picture)
    return Answer(done.summary(), title, notes, {"next": "places, the first one first"})
