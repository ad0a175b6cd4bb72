"""The command that feels: play, the options of its renderer, and the tool in the hand."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Final

import typer

from touchfield.cli.main import Asked, Json, Stream, command
from touchfield.cli.options import asks, fields_of, numbers_of, rows, rows_of
from touchfield.cli.show import Answer, check_results, progress
from touchfield.errors import InvalidArgument
from touchfield.medium.deformation import read_deformation
from touchfield.render.material import read_materials
from touchfield.render.spec import RenderSpec
from touchfield.render.tool import SPHERE_POINTS, Tool
from touchfield.sources.mesh.mesh_files import read_triangles
from touchfield.tasks.play import PlaySpec

RENDER: Final = rows_of(RenderSpec, "Renderer") + rows(
    "Renderer",
    ("clutch-mm", str | None, None, "Point of the field at the device's origin, X,Y,Z in millimetres."),
    ("gravity-n", str | None, None, "A steady force for the weight of the handle, X,Y,Z in newtons."),
    ("no-blend", bool, False, "Play every frame as it was decoded, with the steps where a segment starts."),
    (
        "tool",
        str,
        "point",
        "In the hand: point, sphere:RADIUS_M, or MESH.obj in metres; ,points=N behind it.",
    ),
    (
        "materials",
        Path | None,
        None,
        "What surfaces are made of, JSON (touchfield texture); default: the stream's.",
    ),
    (
        "deformation",
        Path | None,
        None,
        "What bends the medium: tracks, or a body that yields (touchfield deform).",
    ),
)

_TRIPLE: Final = "three numbers, X,Y,Z"
_FORMS: Final = "point, sphere:RADIUS_M or MESH.obj, with ,points=N behind the last two"


@command(
    "Feel",
    "play room.touch --offline --plot forces.png",
    "play room.touch --device haply --friction 0.4",
    "play vest.touch --device bhaptics --loop",
)
@asks(rows_of(PlaySpec), RENDER)
def play(
    asked: Asked,
    stream: Stream,
    log: Annotated[Path | None, "CSV to write: every tick."] = None,
    plot: Annotated[Path | None, "PNG to draw: the hand, the field, the forces."] = None,
    check: Annotated[bool, "Play nothing; tell whether this machine can decode it in time."] = False,
    bridge: Annotated[bool, "Show the hand in a browser while it plays (extra broadcast)."] = False,
    as_json: Json = False,
) -> None:
    """Feel STREAM on a device, or on a simulated hand."""
    from touchfield.tasks.play import check_play
    from touchfield.tasks.play import play as run

    if check:
        verdict = check_play(stream, asked["speed"])
        Answer(verdict, stream).show(as_json)
        if not verdict["can_play"]:
            raise typer.Exit(1)
        return
    check_results((stream,), log, plot)
    is_logged = not (log is plot is None)
    beside = {"is_logged": is_logged, "is_drawn": plot is not None, "render": render_spec(asked)}
    spec = PlaySpec(**{**fields_of(PlaySpec, asked), **beside})
    with _bridge(stream, bridge) as watch, progress("play") as report:
        played = run(stream, spec, report, _say, watch)
    notes = played.notes
    if log is not None:
        played.write_log(log)
        notes = (*notes, f"the log is {log}")
    if plot is not None and played.error is None:
        played.draw(plot)
        notes = (*notes, f"the picture is {plot}")
    if played.is_starved:
        share = played.statistics["stalled_share"]
        notes = (
            *notes,
            f"{100 * share:.3g} % of the time there was nothing, as frames came too late: this has failed",
        )
    Answer(played.statistics, stream, notes).show(as_json)
    played.checked()
    if played.is_starved:
        raise typer.Exit(1)


@contextmanager
def _bridge(stream: str, is_shown: bool) -> Iterator[Callable[[Any], None]]:
    """A call that has a player shown in a browser, where that is wanted."""
    if not is_shown:
        yield lambda player: None
        return
    from touchfield.network.access import Access, Pages
    from touchfield.network.bridge import Bridge
    from touchfield.viewer.browser import empty_page, served_page

    if not Path(stream).is_file():
        raise InvalidArgument("--bridge", stream, "a .touch file on this machine")
    with Bridge(Path(stream), Access(port=0), Pages(served_page(), empty_page())) as server:
        _say(f"open {server.page} in a browser")
        yield server.follow


def _say(note: str) -> None:
    """Print a note at once, beside the result."""
    typer.echo(f"note: {note}", err=True)


def render_spec(asked: dict[str, Any]) -> RenderSpec:
    """The options as the renderer takes them."""
    values = {name: value for name, value in fields_of(RenderSpec, asked).items() if value is not None}
    values["tool"] = tool_of(asked["tool"])
    if asked["materials"] is not None:
        values["materials"] = read_materials(asked["materials"])
    if asked["deformation"] is not None:
        values["deformation"] = read_deformation(asked["deformation"])
    if asked["clutch_mm"] is not None:
        values["clutch_m"] = tuple(
            v / 1000 for v in numbers_of("--clutch-mm", asked["clutch_mm"], (3,), _TRIPLE)
        )
    if asked["gravity_n"] is not None:
        values["gravity_n"] = numbers_of("--gravity-n", asked["gravity_n"], (3,), _TRIPLE)
    return RenderSpec(**values, blend=not asked["no_blend"])


def tool_of(words: str) -> Tool | None:
    """The tool that `words` name; None is a point.

    A mesh is in metres of the field, its origin is the device's point and its axes are the field's where the
    grip is not turned.

    InvalidArgument if the words name none or a number is out of range, SourceError if the mesh cannot be
    read.
    """
    name, comma, option = words.rpartition(",") if ",points=" in words else (words, "", "")
    points = SPHERE_POINTS
    if comma:
        try:
            points = int(option.removeprefix("points="))
        except ValueError:
            raise InvalidArgument("--tool", repr(words[:80]), _FORMS) from None
    kind, colon, rest = name.strip().partition(":")
    if kind == "point" and not colon and not comma:
        return None
    if kind == "sphere" and colon:
        try:
            radius_m = float(rest)
        except ValueError:
            raise InvalidArgument("--tool", repr(words[:80]), _FORMS) from None
        return Tool.sphere(radius_m, points)
    path = Path(name)
    if not path.is_file():
        raise InvalidArgument("--tool", repr(words[:80]), f"{_FORMS}; no such file is there")
    vertices, triangles, _ = read_triangles(path)
    return Tool.of_triangles(vertices, triangles, points, path.name)
