"""Commands that distribute touch: `serve` (a folder of ``.touch`` files over HTTP), `live` (a source as it is
made), `mux` and `demux` (touch as a track of a movie)."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from touchfield.cli.main import Options, Stream, command
from touchfield.cli.options import SCENE, address_rows, encode_spec, first_given, values_of, with_options
from touchfield.cli.output import Answer, echo, progress

if TYPE_CHECKING:
    from touchfield.network.access import Access
    from touchfield.network.live import LiveSegment, LiveSender
    from touchfield.network.udp import Layer, UdpSender

    Add = Callable[[LiveSegment], bytes]

_LIVE_ADDRESS: Final = address_rows(8076, "receive")
_LIVE: Final = (
    "As of `encode`; or camera:N (a depth camera, by OpenCV), watch:FOLDER (pictures that are put there), "
    "- (PNG pictures on standard input)."
)


@command("Broadcast", "serve streams", "serve streams --host 0.0.0.0 --token a-long-word")
@with_options(address_rows(8075, "read"))
def serve(
    options: Options,
    folder: Annotated[Path, "Folder of .touch files, with pages and videos."],
) -> None:
    """Serve a folder of streams: anyone plays them by their address, and fetches only what is felt."""
    from touchfield.network.access import Pages
    from touchfield.network.server import serve as run
    from touchfield.viewer.browser import empty_page, served_page

    run(folder, _access(options), echo, Pages(served_page(), empty_page()))


def _access(options: dict[str, Any]) -> Access:
    from touchfield.network.access import Access

    return Access(
        options["host"], options["port"], options["token"], options["open"], tuple(options["cors"] or ())
    )


@command(
    "Broadcast", "live sample:falling-4 --rate-hz 20", "live watch:pictures --world causal --depth-scale 1000"
)
@with_options(_LIVE_ADDRESS, SCENE)
def live(
    options: Options,
    source: Annotated[str, typer.Argument(help=_LIVE)],
    out: Annotated[
        str | None,
        typer.Argument(help="-: to standard output, for `touchfield play -` behind a pipe; no server."),
    ] = None,
    segment_s: Annotated[float, "Seconds of a segment, which is the delay."] = 0.25,
    loop: Annotated[bool, "Begin again at the end."] = False,
    udp: Annotated[
        str | None, "HOST:PORT that gets datagrams with parity, too; with --token, authenticated ones."
    ] = None,
    coarse: Annotated[
        bool, "Also send a coarse layer, at /coarse/live and at the next port of --udp."
    ] = False,
    on_air_s: Annotated[float | None, "How long; default: to the end."] = None,
) -> Answer | None:
    """Send SOURCE live: coded as its frames come, for any number of receivers (touchfield play ws://...)."""
    from touchfield.errors import InvalidArgument
    from touchfield.network.access import Pages, require_free
    from touchfield.network.live import END, write_message
    from touchfield.network.live_server import LiveServer
    from touchfield.network.udp import require_receiver
    from touchfield.tasks.live import LiveSpec, broadcast, coarse_layer, open_sender
    from touchfield.viewer.browser import empty_page, served_page

    def print_note(note: str) -> None:
        echo(f"note: {note}", to_stderr=True)

    if out not in (None, "-"):
        raise InvalidArgument("OUT", repr(out), "- or nothing", "Receivers come by ws://, http:// or --udp.")
    if out == "-":
        _require_no_server(options, coarse=coarse, udp=udp)
    if udp is not None:
        require_receiver(udp, "--udp", is_layered=coarse)
    spec = LiveSpec(segment_s, loop, on_air_s)
    access = None if out == "-" else _access(options)
    if access is not None:
        require_free(access)
    prepared, sender = open_sender(source, encode_spec(options))
    if access is None:
        pipe = sys.stdout.buffer
        write_message(pipe, sender.opening)
        sent = broadcast(prepared, lambda segment: write_message(pipe, sender.add(segment)), spec, print_note)
        write_message(pipe, END)
        print_note(_counts(sent.summary()))
        bound = sent.error_bound(prepared)
        if bound["error_bound"]:
            print_note(
                f"error bound: {bound['error_bound']}; largest error {sent.worst_mask_ratio:.3f} of it"
            )
        if "error_bound_note" in bound:
            print_note(f"error bound: {bound['error_bound_note']}")
        return None
    layer = coarse_layer(source, prepared) if coarse else None
    under = layer[1] if layer else None
    pages = Pages(served_page(), empty_page())
    with LiveServer(sender, access, pages, under) as server, ExitStack() as stack:
        query = "?token=..." if options["token"] else ""

        def print_addresses() -> None:
            echo(
                f"ws://{server.address}/live{query}  http://{server.address}/live.json{query}", to_stderr=True
            )
            echo(f"in a browser: http://{server.address}/view{query}", to_stderr=True)
            if udp is not None:
                echo(f"datagrams: udp://{udp.removeprefix('udp://')}{query}", to_stderr=True)
            if layer:
                echo(f"coarse layer: ws://{server.address}/coarse/live{query}", to_stderr=True)

        def sending(add: Add, sender: LiveSender, kind: Layer) -> Add:
            if udp is None:
                return add
            return _sending(add, stack.enter_context(_udp_sender(sender, udp, kind, options["token"])))

        send = sending(server.add, sender, "fine" if layer else "alone")
        also = None
        if layer:
            also = layer[0], sending(partial(server.add, is_coarse=True), layer[1], "coarse")
        try:
            sent = broadcast(prepared, send, spec, print_note, coarse=also, on_start=print_addresses)
        finally:
            server.end()
    counts = {**sent.summary(), **sent.error_bound(prepared)}
    sums = {
        **counts,
        "max_receivers": server.max_receivers,
        "receiver_skipped_segments": server.skipped,
        "dropped_receivers": server.dropped,
    }
    return Answer(sums, source, prepared.notes)


def _require_no_server(options: dict[str, Any], *, coarse: bool, udp: str | None) -> None:
    """InvalidArgument for an option of the server, which a pipe has not."""
    from touchfield.errors import InvalidArgument

    values = values_of(options, _LIVE_ADDRESS) | {"coarse": (coarse, False), "udp": (udp, None)}
    if (name := first_given(values)) is not None:
        hint = "Leave out the -, or the option."
        raise InvalidArgument(f"--{name}", "a pipe beside it", "a server, which OUT - does without", hint)


def _counts(summary: dict[str, Any]) -> str:
    return ", ".join(f"{value:,} {name}" for name, value in summary.items() if isinstance(value, int))


def _udp_sender(sender: LiveSender, address: str, layer: Layer, token: str | None) -> UdpSender:
    from touchfield.network.udp import UdpSender

    return UdpSender(sender, address, layer, token)


def _sending(add: Add, link: UdpSender) -> Add:
    """Return a function that adds a segment, and sends it by datagrams."""

    def send(segment: LiveSegment) -> bytes:
        message = add(segment)
        link.add(message)
        return message

    return send


@command(
    "Broadcast",
    "mux movie.mp4 room.touch with-touch.mp4",
    "mux movie.mp4 room.touch with-touch.ts --at-s 12.5",
    "mux movie.mp4 room.touch with-touch.mp4 --sidecar",
)
def mux(
    movie: Annotated[Path, "A movie; its tracks are copied as they are."],
    stream: Stream,
    out: Annotated[Path, "The movie with touch: .mp4, .mov, .ts or .mkv; or .mpd, a DASH manifest."],
    at_s: Annotated[float, "Second of the movie at which the touch begins."] = 0.0,
    sidecar: Annotated[bool, "Write OUT.touch too, for programs that drop the track."] = False,
) -> Answer:
    """Put STREAM beside sound and picture, as a timed track that other players pass over."""
    from touchfield.network.mux import mux as run

    with progress("mux") as report:
        done = run(movie, stream, out, at_s, report, sidecar)
    return Answer(done.summary(), str(out), done.notes)


@command("Broadcast", "demux with-touch.mp4 room.touch", "demux watched.mp4 sound.touch --track sound")
def demux(
    movie: Annotated[Path, "A movie that `mux` made, also if other programs copied it; or .m3u8."],
    out: Annotated[Path, "The .touch file to write."],
    track: Annotated[
        str | None, "Of several: a tag, such as sound or picture, or a number; default: the first."
    ] = None,
) -> Answer:
    """Take the touch out of a movie: the file that was put in, byte for byte."""
    from touchfield.network.demux import demux as run

    done = run(movie, out, track)
    return Answer(done.summary(), str(out), done.notes)
