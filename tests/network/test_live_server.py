"""Live streams on the air: a sender in time, a server and receivers on loopback,
and what a bad network does.
"""

from __future__ import annotations

import asyncio
import io
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from itertools import count
from pathlib import Path
from urllib.request import urlopen

import numpy as np
import pytest

from live_makers import GRID, HEAD, field, medium, segment, sender_of
from touchfield.cli.main import _exit_code
from touchfield.codec.touch.body import BodyReader
from touchfield.container import TouchReader
from touchfield.errors import FormatError, InvalidArgument, SourceError, reason
from touchfield.medium import ForceField, HapticMedium
from touchfield.network import live_client
from touchfield.network.access import Access, guarded, run, web
from touchfield.network.live import (  # fmt: skip
    ENDLESS,
    LiveReceiver,
    LiveSegment,
    LiveSender,
    Lost,
    Refused,
    file_of,
)
from touchfield.network.live_client import _manifest, open_live
from touchfield.network.live_server import LiveServer
from touchfield.pipeline import encode
from touchfield.pipeline.decoding import open_stream
from touchfield.pipeline.spec import EncodeSpec
from touchfield.render.player import Player
from touchfield.sources.stored import StoredScene
from touchfield.tasks.live import LiveSpec, Sent, _Layer, broadcast, open_sender
from touchfield.tasks.play import PlaySpec, play


def test_frames_go_on_the_air_in_time() -> None:
    prepared, sender = open_sender(medium(), EncodeSpec())
    now = [0.0]
    took: list[tuple[float, LiveSegment]] = []

    def send(one: LiveSegment) -> bytes:
        took.append((now[0], one))
        return sender.add(one)

    def pause(seconds: float) -> None:
        if len(took) < 6:
            time.sleep(0.01)  # the coder's thread
        now[0] += seconds

    sent = broadcast(
        prepared, send, LiveSpec(0.1, loop=True, seconds=3.0), clock_s=lambda: now[0], pause=pause
    )
    assert sent.frames + sent.left_out == 150 and sent.segments == len(took) >= 3
    assert all(one.first_frame % 5 == 0 for _, one in took)
    assert all(at - one.stop / 50 >= -1e-9 for at, one in took)  # nothing before its time


def test_segments_of_a_world_that_stands_begin_with_the_same_forces() -> None:
    rng = np.random.default_rng(1)
    world = field(5).to_dense() * rng.uniform(0.2, 1, (16, 16, 16, 1)).astype(np.float32)
    near = [world * (1 + rng.normal(0, 3e-4, world.shape).astype(np.float32)) for _ in range(6)]
    made = [ForceField.from_dense(GRID, dense) for dense in (*near, 0.5 * world)]
    prepared, _ = open_sender(HapticMedium.from_frames(made, 50.0, HEAD.axes), EncodeSpec())
    now, bodies = [0.0], list[bytes]()

    def pause(seconds: float) -> None:
        for _ in range(1000):  # for the coder's thread, of which nothing is to be left out
            if len(bodies) >= int(now[0] * 50 + 0.5) // 2:
                break
            time.sleep(0.005)
        now[0] += seconds

    def send(one: LiveSegment) -> None:
        bodies.append(one.body)

    broadcast(prepared, send, LiveSpec(0.04), clock_s=lambda: now[0], pause=pause)
    readers = [BodyReader(body, prepared.medium.grid, exact=False) for body in bodies]
    firsts = [reader.records(count)[0].payload for reader, count in zip(readers, (2, 2, 2, 1), strict=True)]
    assert firsts[0] == firsts[1] == firsts[2] != firsts[3]


def test_an_interrupt_ends_a_broadcast_in_order() -> None:
    prepared, sender = open_sender(medium(), EncodeSpec())
    now, notes = [0.0], list[str]()

    def pause(seconds: float) -> None:
        now[0] += seconds
        if now[0] > 0.5:
            raise KeyboardInterrupt

    sent = broadcast(prepared, sender.add, LiveSpec(0.1, loop=True), notes.append, lambda: now[0], pause)
    assert 0 < sent.frames <= 25 and sent.frames + sent.left_out >= 24 and notes[-1].startswith("interrupted")


def test_who_makes_frames_too_slowly_is_told_at_once() -> None:
    notes, now = list[str](), [0.0]

    def slow(index: int) -> ForceField:
        now[0] += 0.1
        return field(index)

    slow_medium = HapticMedium(grid=GRID, rate_hz=50.0, axes=HEAD.axes, frame_count=50, make_frame=slow)
    prepared, sender = open_sender(slow_medium, EncodeSpec())
    spec = LiveSpec(0.1, loop=True, seconds=1.9)
    sent = broadcast(
        prepared, sender.add, spec, notes.append, lambda: now[0], on_start=lambda: notes.append("ready")
    )
    assert sent.frames + sent.left_out == 95 and sent.left_out > 50
    assert "makes some 10 frames a second, and the medium has 50" in notes[0] and notes[1] == "ready"


def test_a_broadcast_has_one_frame_at_least_and_so_has_a_segment() -> None:
    prepared, sender = open_sender(replace(medium(), rate_hz=20.0), EncodeSpec())
    looks = iter(range(10_000))
    spec = LiveSpec(0.01, seconds=0.01)
    sent = broadcast(
        prepared, sender.add, spec, clock_s=lambda: 1e-6 * next(looks), pause=lambda seconds: None
    )
    assert (sent.frames, sent.segments, sent.left_out) == (1, 1, 0)


def test_frames_that_are_left_out_are_told_each_time_that_they_are_twice_as_many() -> None:
    sent, notes = Sent(), list[str]()
    for _ in range(9):
        sent.skip(1, "slow", notes.append)
    assert [note.split()[1] for note in notes] == ["1", "2", "4", "8"] and sent.left_out == 9


@pytest.mark.parametrize("wrong", [{"segment_s": 0.0}, {"segment_s": 11.0}, {"seconds": 0.0}])
def test_times_that_cannot_be(wrong: dict[str, float]) -> None:
    with pytest.raises(InvalidArgument):
        LiveSpec(**wrong)  # type: ignore[arg-type]


pytest.importorskip("aiohttp", reason="live streams need the extra broadcast")


@contextmanager
def on_air(
    access: Access = Access(port=0), is_over: Callable[[], bool] = lambda: False
) -> Iterator[LiveServer]:
    """A server that sends a segment of five frames every tenth of a second."""
    done, sender = threading.Event(), sender_of(0)[0]
    bodies = [segment(5 * i) for i in range(12)]

    def run(server: LiveServer) -> None:
        for i in count():
            server.add(replace(bodies[i % 12], first_frame=5 * i))
            if done.wait(0.1):
                return
            if is_over():
                break
        server.end()

    with LiveServer(sender, access) as server:
        thread = threading.Thread(target=run, args=(server,), daemon=True)
        thread.start()
        yield server
        done.set()
        thread.join()


@pytest.mark.parametrize(
    ("numbers", "said"),
    [(["1e999"], "that is none"), ([3, 3], "ascend"), ([4, 3], "ascend"), ([-1, 0], "ascend")],
)
def test_a_manifest_whose_numbers_have_no_end_or_do_not_ascend_is_told(
    numbers: list[object], said: str
) -> None:
    segments = ", ".join(f'{{"number": {n}}}' for n in numbers)
    with pytest.raises(SourceError, match=said):
        _manifest(f'{{"is_ended": false, "segments": [{segments}]}}'.encode(), "live.json")


@pytest.mark.parametrize("form", ["ws://{}/live", "http://{}/live.json"])
def test_receivers_get_the_frames_that_are_sent(form: str) -> None:
    with on_air() as server, open_stream(form.format(server.address)) as live:
        assert live.is_live and live.reader.head.frame_count == ENDLESS
        for i in range(12):
            got, number = live.medium[i], live.medium.make_frame.stream_frame(i)  # type: ignore[attr-defined]
            np.testing.assert_allclose(got.to_dense(), field(number % 60).to_dense(), atol=0.2)
        frames = live.medium.make_frame
        assert frames.lost == frames.refused == 0  # type: ignore[attr-defined]


def test_what_is_live_is_played_until_its_end() -> None:
    notes, players = list[str](), list[Player]()

    def is_felt() -> bool:  # however long the start takes
        return any(player.statistics().get("frames_used", 0) > 20 for player in players)

    with on_air(is_over=is_felt) as server:
        played = play(
            f"ws://{server.address}/live",
            PlaySpec("sim", seconds=60.0),
            on_note=notes.append,
            on_player=players.append,
        )
    assert played.error is None and "the sender has ended the stream" in played.notes
    assert played.statistics["frames_used"] > 20 and played.statistics["last_force_n"] == 0


def test_what_is_live_is_shown_on_an_array_until_its_end() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as array:
        array.bind(("127.0.0.1", 0))
        heard: list[int] = []
        listens = threading.Thread(target=lambda: heard.append(len(array.recv(1 << 14))), daemon=True)
        listens.start()
        with on_air(is_over=lambda: bool(heard)) as server:
            device = f"osc:127.0.0.1:{array.getsockname()[1]}"
            played = play(f"ws://{server.address}/live", PlaySpec(device, seconds=60.0))
    assert "the sender has ended the stream" in played.notes and played.statistics["sent"] > 0


def test_connections_that_say_nothing_are_left(monkeypatch: pytest.MonkeyPatch) -> None:
    """A hundred connections where sixty fit: the others are closed, and soon the sixty, and a receiver hears
    all.
    """
    monkeypatch.setattr("touchfield.network.access._max_connections", lambda: 60)
    monkeypatch.setattr("touchfield.network.access._PATIENCE_S", 0.5)

    def is_closed(link: socket.socket) -> bool:
        link.settimeout(5)
        try:
            return link.recv(1) == b""
        except ConnectionError:
            return True

    with on_air() as server:
        host, port = server.address.split(":")
        silent = [socket.create_connection((host, int(port))) for _ in range(100)]
        assert all(map(is_closed, silent))
        with open_stream(f"ws://{server.address}/live") as live:
            time.sleep(0.7)  # who has asked stays, however long it says nothing
            assert [live.medium[i].support_count > 0 for i in range(20)] == [True] * 20
        for link in silent:
            link.close()


def asking(address: str, path: str, *headers: str) -> socket.socket:
    """A connection with a request on it."""
    host, port = address.split(":")
    link = socket.create_connection((host, int(port)), timeout=5)
    link.sendall("\r\n".join([f"GET {path} HTTP/1.1", f"Host: {address}", *headers, "", ""]).encode())
    return link


def status_of(address: str, path: str) -> int:
    """The status of the answer to a request."""
    with asking(address, path) as link:
        return int(link.recv(1 << 12).split()[1])


UPGRADE = (
    "Connection: Upgrade", "Upgrade: websocket", "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
    "Sec-WebSocket-Version: 13",
)  # fmt: skip


def test_no_more_are_served_than_can_be(monkeypatch: pytest.MonkeyPatch) -> None:
    """A connection too many is closed at once; an answer too many is refused, and none once others have
    ended.
    """
    monkeypatch.setattr("touchfield.network.access._max_connections", lambda: 3)
    monkeypatch.setattr("touchfield.network.access._MAX_BUSY", 1)
    monkeypatch.setattr("touchfield.network.access._ENDING_S", 0.01)
    with LiveServer(sender_of(1)[0], Access(port=0)) as server, ExitStack() as others:
        for _ in range(2):
            assert [status_of(server.address, "/live.json") for _ in range(3)] == [200] * 3
            with asking(server.address, "/live", *UPGRADE) as hand:
                assert hand.recv(12) == b"HTTP/1.1 101"
                assert status_of(server.address, "/live.json") == 503
            while server.receivers:
                time.sleep(0.01)
        host, port = server.address.split(":")
        for _ in range(3):
            others.enter_context(socket.create_connection((host, int(port))))
        with socket.create_connection((host, int(port)), timeout=5) as link, suppress(ConnectionError):
            assert link.recv(1) == b""


@pytest.mark.parametrize(
    ("method", "path", "status"),
    [("GET", "/none", 404), ("GET", "/moved", 302), ("GET", "/fault", 500), ("GET", "/gone", 0),
     ("GET", "/absent", 404), ("POST", "/none", 405)],
)  # fmt: skip
def test_an_answer_that_fails_gives_its_place_back(
    method: str, path: str, status: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With room for one answer at once: an error of each kind, and next to it an answer."""
    monkeypatch.setattr("touchfield.network.access._MAX_BUSY", 1)
    application = guarded(Access(port=0))

    async def answer(request: web.Request) -> web.Response:
        if request.path == "/":
            return web.Response(text="here")
        if request.path == "/gone":
            assert request.transport is not None
            request.transport.abort()
            raise ConnectionResetError
        raise {"/none": web.HTTPNotFound(), "/moved": web.HTTPFound("/")}.get(request.path, ValueError())

    for one in ("/", "/none", "/moved", "/fault", "/gone"):
        application.router.add_get(one, answer)

    async def status_after(address: str, method: str, path: str) -> int:
        host, port = address.split(":")
        reader, writer = await asyncio.open_connection(host, int(port))
        writer.write(f"{method} {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n".encode())
        try:
            words = (await reader.read()).split()
        except ConnectionError:
            words = []
        writer.close()
        return int(words[1]) if words else 0

    async def statuses() -> list[int]:
        is_over, address = asyncio.Event(), asyncio.get_running_loop().create_future()
        server = asyncio.ensure_future(run(application, Access(port=0), address.set_result, is_over))
        where = await address
        found = [await status_after(where, *asked) for asked in ((method, path), ("GET", "/"), ("GET", "/"))]
        is_over.set()
        await server
        return found

    assert asyncio.run(statuses()) == [status, 200, 200]


def test_an_address_that_is_taken_is_told() -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port, told = other.getsockname()[1], list[str]()

        def enter() -> None:
            try:
                LiveServer(sender_of(0)[0], Access(port=port)).__enter__()
            except InvalidArgument as error:
                told.append(str(error))

        thread = threading.Thread(target=enter, daemon=True)
        thread.start()
        thread.join(10)
    assert told and f"127.0.0.1:{port}" in told[0] and "--port" in told[0]
    with pytest.raises(InvalidArgument, match=r"a\.\.b:0: .*--host"):
        LiveServer(sender_of(0)[0], Access("a..b", port=0, is_open=True)).__enter__()


def test_many_receivers_and_bad_ones_beside_them() -> None:
    """Ten that read, one that never does, one that talks, and one that sends garbage:
    the ten miss nothing.
    """
    with on_air() as server:
        host, port = server.address.split(":")
        mute = asking(server.address, "/live", *UPGRADE)
        garbage = socket.create_connection((host, int(port)))
        garbage.sendall(b"\x16\x03\x01" + bytes(range(256)) * 8)
        idle = [socket.create_connection((host, int(port))) for _ in range(50)]

        async def receive() -> list[list[int]]:
            import aiohttp

            async with aiohttp.ClientSession() as session:

                async def one(says: str) -> list[int]:
                    receiver, seen = LiveReceiver(), list[int]()
                    async with session.ws_connect(f"ws://{server.address}/live") as link:
                        if says:
                            await link.send_str(says)
                        async for message in link:
                            for event in receiver.receive(message.data):
                                assert not isinstance(event, Lost | Refused)
                                seen += [event.first_frame] if isinstance(event, LiveSegment) else []
                            if len(seen) == 8:
                                break
                    return seen

                return await asyncio.gather(*(one("") for _ in range(10)), one("hello"))

        *heard, talker = asyncio.run(receive())
        assert all(len(seen) == 8 and np.diff(seen).tolist() == [5] * 7 for seen in heard)
        assert len(talker) < 8  # who speaks is left
        with open_stream(f"ws://{server.address}/live"):
            assert server.max_receivers >= 11  # at once, however few there are now
        for link in (mute, garbage, *idle):
            link.close()


def test_who_asks_for_a_segment_and_does_not_read_it_is_left(
    left: threading.Event, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("touchfield.network.live_server._PATIENCE_S", 0.3)
    sender = sender_of(0)[0]
    with LiveServer(sender, Access(port=0)) as server:
        server.add(LiveSegment(0, 5, bytes(1 << 25)))
        with asking(server.address, "/live/0") as link:
            assert left.wait(30)
            received = 0
            with suppress(ConnectionError):
                while part := link.recv(1 << 20):
                    received += len(part)
        assert received < 1 << 25 and server.dropped == 0
        with asking(server.address, "/live", *UPGRADE):
            ends = time.monotonic() + 30
            while not server.dropped and time.monotonic() < ends:
                time.sleep(0.01)
        assert server.dropped == 1, "of receivers alone it is told"


def test_who_may_not_receive() -> None:
    access = Access(port=0, token="a long word")
    with on_air(access) as server:
        wrong = open_live(f"ws://{server.address}/live?token=not%20that")
        with pytest.raises(SourceError, match="found 401 ") as told, wrong:
            pass
        assert "that" not in str(told.value).replace("and that it is on", "")
        for form in ("ws://{}/live", "http://{}/live.json"):
            with open_live(f"{form.format(server.address)}?token=a%20long%20word") as live:
                assert live.medium[0].support_count
    with on_air() as server:

        async def from_page(origin: str) -> int:
            import aiohttp

            async with aiohttp.ClientSession() as session:
                with suppress(aiohttp.WSServerHandshakeError):
                    async with session.ws_connect(f"ws://{server.address}/live", headers={"Origin": origin}):
                        return 101
                return 403

        assert asyncio.run(from_page("https://evil.example")) == 403
        assert asyncio.run(from_page(f"http://{server.address}")) == 101


def test_addresses_are_told_once_the_code_is_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    encode(StoredScene(medium()), tmp_path / "some.touch", EncodeSpec(nw=4))
    warm = _Layer.warm

    def told(lane: _Layer, frame: ForceField) -> float:
        print("compiling", file=sys.stderr)
        return warm(lane, frame)

    monkeypatch.setattr(_Layer, "warm", told)
    assert _exit_code(["live", str(tmp_path / "some.touch"), "--port", "0", "--on-air-s", "0.1"]) == 0
    said = capsys.readouterr().err
    assert 0 <= said.rindex("compiling") < said.index("ws://")


def test_a_first_segment_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_client, "_ANSWER_S", 1.0)
    monkeypatch.setattr(live_client, "REPORT_AFTER_S", 0.1)
    sender, notes = sender_of(0)[0], list[str]()
    with LiveServer(sender, Access(port=0)) as server:
        threading.Timer(1.25, lambda: server.add(segment(0))).start()
        with open_live(f"ws://{server.address}/live", notes.append) as live:
            assert live.medium[0].support_count
    assert "its sender may be starting" in notes[0]


def test_another_programme_with_another_head_is_to_be_opened_anew() -> None:
    client, other = live_client._Client("ws://127.0.0.1:1/live", lambda note: None), LiveSender()
    other.open(replace(HEAD, rate_hz=25.0))
    client._take(sender_of(0)[0].opening)
    with pytest.raises(
        SourceError, match=r"another programme; expected the one that was opened\. Open it again"
    ):
        client._take(other.opening)
    client._loop.close()


def test_what_is_not_there_is_told() -> None:
    with pytest.raises(InvalidArgument, match="address of datagrams: found 'here'"), open_live("udp://here"):
        pass
    with pytest.raises(SourceError, match="Check the address"), open_live("ws://127.0.0.1:1/live"):
        pass
    with (
        on_air() as server,
        pytest.raises(SourceError, match="404"),
        open_live(f"http://{server.address}/other/live.json"),
    ):
        pass


def proxied(address: str, hurt: list[int]) -> tuple[str, threading.Event]:
    """A relay in front of a server; connections are cut after so many bytes, the last one never."""
    listener = socket.create_server(("127.0.0.1", 0))
    listener.settimeout(0.05)
    host, port = address.split(":")
    done = threading.Event()

    def relay(link: socket.socket, most: int) -> None:
        with link, socket.create_connection((host, int(port))) as server:

            def up() -> None:
                with suppress(OSError):
                    while data := link.recv(65536):
                        server.sendall(data.replace(listener_name, address.encode()))

            threading.Thread(target=up, daemon=True).start()
            passed = 0
            with suppress(OSError):
                while not done.is_set() and (data := server.recv(4096)):
                    link.sendall(data)
                    passed += len(data)
                    if passed > most:
                        link.shutdown(socket.SHUT_RDWR)
                        return

    def run() -> None:
        limits = list(hurt)
        while not done.is_set():
            try:
                link, _ = listener.accept()
            except TimeoutError:
                continue
            most = limits.pop(0) if limits else 1 << 40
            threading.Thread(target=relay, args=(link, most), daemon=True).start()

    name = f"127.0.0.1:{listener.getsockname()[1]}"
    listener_name = name.encode()
    threading.Thread(target=run, daemon=True).start()
    return name, done


def test_a_connection_that_is_cut_is_made_again() -> None:
    notes: list[str] = []
    with on_air() as server:
        address, done = proxied(server.address, [1000, 1000])
        with open_live(f"ws://{address}/live", notes.append) as live:
            frames = map(live.medium.__getitem__, count())
            while sum("connecting again" in note for note in notes) < 2:
                next(frames)
            for _ in range(20):
                next(frames)
        done.set()
    assert sum("connecting again" in note for note in notes) == 2


@pytest.mark.parametrize("form", ["ws://{}/live", "http://{}/live.json"])
def test_a_server_that_is_started_again_is_felt_again(form: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """However often it is not there meanwhile."""
    monkeypatch.setattr("touchfield.network.access._ENDING_S", 0.01)  # it is killed
    monkeypatch.setattr(live_client, "_LONGEST_PAUSE_S", 0.1)
    tried = threading.Semaphore(0)
    monkeypatch.setattr(live_client, "reason", lambda error: tried.release() or reason(error))
    notes: list[str] = []
    with ExitStack() as second:
        with ExitStack() as first:
            server = first.enter_context(on_air())
            live = second.enter_context(open_stream(form.format(server.address), notes.append))
            for i in range(30):  # numbers that the second one's are below
                live.medium[i]
            server.end = lambda: None  # type: ignore[method-assign]  # nobody is told
        for _ in range(4):
            assert tried.acquire(timeout=30)
        second.enter_context(on_air(Access(port=int(server.address.rpartition(":")[2]))))
        frames = live.medium.make_frame
        number = frames.stream_frame(0)  # type: ignore[attr-defined]
        for after in range(30, 200):
            live.medium[after]
            if frames.stream_frame(0) != number:  # type: ignore[attr-defined]
                break
        else:
            pytest.fail("frames go on as if they were those of the first")
        for i in range(after, after + 10):
            got, number = live.medium[i], frames.stream_frame(i)  # type: ignore[attr-defined]
            np.testing.assert_allclose(got.to_dense(), field(number % 60).to_dense(), atol=0.2)
    assert "another programme begins" in notes and not any("of no use" in note for note in notes), notes
    assert (
        sum("connecting again" in note for note in notes[: notes.index("another programme begins")]) == 1
    ), notes


def test_a_server_that_is_gone_for_good_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("touchfield.network.access._ENDING_S", 0.01)  # it is killed
    monkeypatch.setattr(live_client, "PATIENCE_S", 0.3)
    with ExitStack() as first, ExitStack() as second:
        server = first.enter_context(on_air())
        live = second.enter_context(open_stream(f"ws://{server.address}/live"))
        live.medium[0]
        server.end = lambda: None  # type: ignore[method-assign]  # nobody is told
        first.close()
        with pytest.raises(SourceError, match="Check the address"):
            [live.medium[i] for i in range(1, 200)]


def test_a_segment_is_a_file_of_its_own(tmp_path: Path) -> None:
    sender, (opening, _, second) = sender_of(2)
    (tmp_path / "segment.touch").write_bytes(file_of(opening, second))
    with open_stream(tmp_path / "segment.touch") as opened:
        assert len(opened.medium) == 5 and opened.reader.provenance["source"] == "test"
        for i in range(5):
            np.testing.assert_allclose(opened.medium[i].to_dense(), field(5 + i).to_dense(), atol=0.2)
    with LiveServer(sender, Access(port=0)) as server:
        for name, data in (("1", second), ("1.touch", file_of(opening, second)), ("opening", opening)):
            with urlopen(f"http://{server.address}/live/{name}") as answer:
                assert answer.read() == data
        assert status_of(server.address, "/live/2.touch") == 404
        with open_live(f"http://{server.address}/live.json") as live:
            assert live.frames.stream_frame(0) == 5  # it begins with the newest
    message = sender.add(LiveSegment(10, 5, b"body", b"beside"))
    with TouchReader(io.BytesIO(file_of(opening, message))) as reader:
        assert (reader.read_segment(0), reader.read_vibration(0)) == (b"body", b"beside")
    with pytest.raises(FormatError):
        file_of(opening, second[:-1])
