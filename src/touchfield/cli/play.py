"""Command `play`: plays a ``.touch`` file on a haptic device or a simulated hand. Defines its options, and
the tool that touches in place of a point."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Final

import typer

from touchfield.cli.main import Json, Options, Stream, command
from touchfield.cli.options import (
    fields_of,
    numbers_of,
    refuse_unused,
    rows,
    rows_of,
    values_of,
    with_options,
)
from touchfield.cli.output import Answer, check_results, echo, progress
from touchfield.container.remote import is_live, is_remote
from touchfield.errors import InvalidArgument
from touchfield.medium.deformation import read_deformation
from touchfield.render.material import read_materials
from touchfield.render.spec import RenderSpec
from touchfield.render.tool import SPHERE_POINTS, Tool
from touchfield.sources.mesh.mesh_files import read_triangles
from touchfield.tasks.play import PlaySpec
from touchfield.tasks.play_mcap import require_log

RENDER: Final = rows_of(RenderSpec, "Renderer") + rows(
    "Renderer",
    ("clutch-mm", str | None, None, "Point of the field at the device's origin, X,Y,Z in millimetres."),
    ("gravity-n", str | None, None, "A steady force for the weight of the handle, X,Y,Z in newtons."),
    (
        "no-blend",
        bool,
        False,
        "Play every frame as decoded, with the steps where a segment or a loop starts and after a seek.",
    ),
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
@with_options(rows_of(PlaySpec), RENDER)
def play(
    options: Options,
    stream: Stream,
    log: Annotated[Path | None, "Every tick, to write: .csv; or .mcap, for Foxglove (extra: mcap)."] = None,
    plot: Annotated[Path | None, "PNG to draw: the hand, the field, the forces."] = None,
    check: Annotated[bool, "Play nothing; tell whether this machine can decode it in time."] = False,
    bridge: Annotated[bool, "Show the hand in a browser while it plays."] = False,
    as_json: Json = False,
) -> None:
    """Feel STREAM on a device, or on a simulated hand."""
    from touchfield.tasks.play import check_play, play as run

    if check:
        own = {"log": (log, None), "plot": (plot, None), "bridge": (bridge, False)}
        unused = values_of(options, rows_of(PlaySpec), RENDER) | own
        del unused["speed"]
        refuse_unused(unused, "with --check, which plays nothing")
        verdict = check_play(stream, options["speed"])
        Answer(verdict, stream).show(as_json)
        if not verdict["can_play"]:
            raise typer.Exit(1)
        return
    _refuse_unused_by_device(options, bridge)
    check_results((stream,), log, plot=plot)
    if log is not None:
        require_log(log)  # before the playback, not after
    is_logged = not (log is plot is None)
    derived = {"is_logged": is_logged, "is_drawn": plot is not None, "render": render_spec(options)}
    spec = PlaySpec(**{**fields_of(PlaySpec, options), **derived})
    with _bridge(stream, bridge) as watch, progress("play") as report:
        played = run(stream, spec, report, _print_note, watch)
    notes = played.notes
    if log is not None:
        notes = (*notes, *played.write_log(log), f"the log is {log}")
    if plot is not None and played.error is None:
        played.draw(plot)
        notes = (*notes, f"the picture is {plot}")
    if played.is_starved:
        notes = (*notes, _starved_note(stream, played.statistics["stalled_share"]))
    Answer(played.statistics, stream, notes).show(as_json)
    played.checked()
    if played.is_starved:
        raise typer.Exit(1)


def _refuse_unused_by_device(options: Options, has_bridge: bool) -> None:
    """InvalidArgument for an option of point devices with an array, or the other way round."""
    from touchfield.devices.drivers.registry import is_array_device

    if not is_array_device(options["device"]):
        panel = values_of(options, rows_of(PlaySpec, None, "panel"))
        refuse_unused(panel, f"with --device {options['device']}, which is no array")
        return
    unused = values_of(options, RENDER) | {"bridge": (has_bridge, False)}
    del unused["no-blend"]
    refuse_unused(unused, f"with --device {options['device']}, an array of actuators")


def _starved_note(stream: str, fraction: float) -> str:
    """What a playback lacked, why, and what helps."""
    lack = f"{100 * fraction:.3g} % of the time there was no force, as frames came too late: this has failed"
    if is_live(stream):
        causes = "the sender or this machine is too slow, or the network delays or loses segments"
        return f"{lack}. Either {causes}: send with a lower --rate-hz or a smaller --nw (touchfield live)"
    causes = "this machine decodes too slowly, or other programs use it"
    if is_remote(stream):
        return f"{lack}. Either {causes}, or the network is too slow: download the file, or lower --speed"
    command = shlex.join(["touchfield", "play", stream, "--check"])
    return f"{lack}. Either {causes}: {command} tells; a lower --speed helps"


@contextmanager
def _bridge(stream: str, is_enabled: bool) -> Iterator[Callable[[Any], None]]:
    """Yield a function that shows a player in a browser, or does nothing if that is not enabled."""
    if not is_enabled:
        yield lambda player: None
        return
    from touchfield.network.access import Access, Pages
    from touchfield.network.bridge import Bridge
    from touchfield.viewer.browser import empty_page, served_page

    if not Path(stream).is_file():
        raise InvalidArgument("--bridge", stream, "a .touch file on this machine")
    with Bridge(Path(stream), Access(port=0), Pages(served_page(), empty_page())) as server:
        _print_note(f"open {server.page} in a browser")
        yield server.follow


def _print_note(note: str) -> None:
    """Print a note to stderr immediately."""
    echo(f"note: {note}", to_stderr=True)


def render_spec(options: dict[str, Any]) -> RenderSpec:
    """Return the spec of the renderer from the options."""
    values = {name: value for name, value in fields_of(RenderSpec, options).items() if value is not None}
    values["tool"] = tool_of(options["tool"])
    if options["materials"] is not None:
        values["materials"] = read_materials(options["materials"])
    if options["deformation"] is not None:
        values["deformation"] = read_deformation(options["deformation"])
    if options["clutch_mm"] is not None:
        values["clutch_m"] = tuple(
            v / 1000 for v in numbers_of("--clutch-mm", options["clutch_mm"], (3,), _TRIPLE)
        )
    if options["gravity_n"] is not None:
        values["gravity_n"] = numbers_of("--gravity-n", options["gravity_n"], (3,), _TRIPLE)
    return RenderSpec(**values, blend=not options["no_blend"])


def tool_of(text: str) -> Tool | None:
    """Return the tool that a text names; None for a point.

    A mesh is in metres of the field. Its origin is the device's point, and its axes are those of the field
    while the grip is not rotated.

    Raises InvalidArgument if the text is invalid or a number is out of range, SourceError if the mesh cannot
    be read.
    """
    name, comma, option = text.rpartition(",") if ",points=" in text else (text, "", "")
    points = SPHERE_POINTS
    if comma:
        try:
            points = int(option.removeprefix("points="))
        except ValueError:
            raise InvalidArgument("--tool", repr(text[:80]), _FORMS) from None
    kind, colon, rest = name.strip().partition(":")
    if kind == "point" and not colon and not comma:
        return None
    if kind == "sphere" and colon:
        try:
            radius_m = float(rest)
        except ValueError:
            raise InvalidArgument("--tool", repr(text[:80]), _FORMS) from None
        return Tool.sphere(radius_m, points)
    path = Path(name)
    if not path.is_file():
        raise InvalidArgument("--tool", repr(text[:80]), f"{_FORMS}; no such file is there")
    vertices, triangles, _ = read_triangles(path)
    return Tool.of_triangles(vertices, triangles, points, path.name)
