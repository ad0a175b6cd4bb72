"""Live streams over loopback: a sender in time, a server, receivers, and faults of a network."""

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
from touchfield.network.opening import open_stream
from touchfield.pipeline import encode
from touchfield.pipeline.spec import EncodeSpec
from touchfield.render.player import Player
from touchfield.sources.stored import StoredScene
from touchfield.tasks.live import LiveSpec, Sent, _Layer, broadcast, open_sender
from touchfield.tasks.play import PlaySpec, play


def test_frames_are_sent_in_time() -> None:
    prepared, sender = open_sender(medium(), EncodeSpec())
    now = [0.0]
    took: list[tuple[float, LiveSegment]] = []

    def send(segment: LiveSegment) -> bytes:
        took.append((now[0], segment))
        return sender.add(segment)

    def pause(seconds: float) -> None:
        if len(took) < 6:
            time.sleep(0.01)  # the encoder's thread
        now[0] += seconds

    sent = broadcast(
        prepared, send, LiveSpec(0.1, loop=True, seconds=3.0), clock_s=lambda: now[0], pause=pause
    )
    assert sent.frames + sent.left_out == 150 and sent.segments == len(took) >= 3
    assert all(segment.first_frame % 5 == 0 for _, segment in took)
    assert all(at - segment.stop / 50 >= -1e-9 for at, segment in took)  # nothing before its time


def test_segments_of_a_static_world_begin_with_the_same_key_frame() -> None:
    rng = np.random.default_rng(1)
    world = field(5).to_dense() * rng.uniform(0.2, 1, (16, 16, 16, 1)).astype(np.float32)
    noisy = [world * (1 + rng.normal(0, 3e-4, world.shape).astype(np.float32)) for _ in range(6)]
    fields = [ForceField.from_dense(GRID, dense) for dense in (*noisy, 0.5 * world)]
    prepared, _ = open_sender(HapticMedium.from_frames(fields, 50.0, HEAD.axes), EncodeSpec())
    now, bodies = [0.0], list[bytes]()

    def pause(seconds: float) -> None:
        for _ in range(1000):  # wait for the encoder's thread, which must skip nothing
            if len(bodies) >= int(now[0] * 50 + 0.5) // 2:
                break
            time.sleep(0.005)
        now[0] += seconds

    def send(segment: LiveSegment) -> None:
        bodies.append(segment.body)

    broadcast(prepared, send, LiveSpec(0.04), clock_s=lambda: now[0], pause=pause)
    readers = [BodyReader(body, prepared.medium.grid, exact=False) for body in bodies]
    firsts = [reader.records(count)[0].payload for reader, count in zip(readers, (2, 2, 2, 1), strict=True)]
    assert firsts[0] == firsts[1] == firsts[2] != firsts[3]


def test_an_interrupt_ends_a_broadcast_cleanly() -> None:
    prepared, sender = open_sender(medium(), EncodeSpec())
    now, notes = [0.0], list[str]()

    def pause(seconds: float) -> None:
        now[0] += seconds
        if now[0] > 0.5:
            raise KeyboardInterrupt

    sent = broadcast(prepared, sender.add, LiveSpec(0.1, loop=True), notes.append, lambda: now[0], pause)
    assert 0 < sent.frames <= 25 and sent.frames + sent.left_out >= 24 and notes[-1].startswith("interrupted")


def test_a_slow_source_is_reported_at_once() -> None:
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


def test_a_broadcast_and_a_segment_have_at_least_one_frame() -> None:
    prepared, sender = open_sender(replace(medium(), rate_hz=20.0), EncodeSpec())
    looks = iter(range(10_000))
    spec = LiveSpec(0.01, seconds=0.01)
    sent = broadcast(
        prepared, sender.add, spec, clock_s=lambda: 1e-6 * next(looks), pause=lambda seconds: None
    )
    assert (sent.frames, sent.segments, sent.left_out) == (1, 1, 0)


def test_skipped_frames_are_reported_at_each_doubling() -> None:
    sent, notes = Sent(), list[str]()
    for _ in range(9):
        sent.leave_out(1, "slow", notes.append)
    assert [note.split()[1] for note in notes] == ["1", "2", "4", "8"] and sent.left_out == 9


@pytest.mark.parametrize("wrong", [{"segment_s": 0.0}, {"segment_s": 11.0}, {"seconds": 0.0}])
def test_invalid_times_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(InvalidArgument):
        LiveSpec(**wrong)  # type: ignore[arg-type]


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
    ("numbers", "message"),
    [(["1e999"], "that is none"), ([3, 3], "ascend"), ([4, 3], "ascend"), ([-1, 0], "ascend")],
)
def test_a_manifest_with_infinite_or_unordered_numbers_is_refused(
    numbers: list[object], message: str
) -> None:
    segments = ", ".join(f'{{"number": {n}}}' for n in numbers)
    with pytest.raises(SourceError, match=message):
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


def test_a_live_stream_is_played_until_its_end() -> None:
    notes, players = list[str](), list[Player]()

    def is_played() -> bool:  # independent of the time to start
        return any(player.statistics().get("frames_used", 0) > 20 for player in players)

    with on_air(is_over=is_played) as server:
        played = play(
            f"ws://{server.address}/live",
            PlaySpec("sim", seconds=60.0),
            on_note=notes.append,
            on_player=players.append,
        )
    assert played.error is None and "the sender has ended the stream" in played.notes
    assert played.statistics["frames_used"] > 20 and played.statistics["last_force_n"] == 0


def test_a_live_stream_is_played_on_an_array_until_its_end() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as array:
        array.bind(("127.0.0.1", 0))
        packet_sizes: list[int] = []
        listens = threading.Thread(target=lambda: packet_sizes.append(len(array.recv(1 << 14))), daemon=True)
        listens.start()
        with on_air(is_over=lambda: bool(packet_sizes)) as server:
            device = f"osc:127.0.0.1:{array.getsockname()[1]}"
            played = play(f"ws://{server.address}/live", PlaySpec(device, seconds=60.0))
    assert "the sender has ended the stream" in played.notes and played.statistics["sent"] > 0


def test_silent_connections_are_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    """A hundred connections where sixty fit: the rest are closed at once, the sixty soon; a receiver gets
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
            time.sleep(0.7)  # a client that sent a request stays, however long it is silent
            assert [live.medium[i].support_count > 0 for i in range(20)] == [True] * 20
        for link in silent:
            link.close()


def connection_with_request(address: str, path: str, *headers: str) -> socket.socket:
    """A connection that has sent a request."""
    host, port = address.split(":")
    link = socket.create_connection((host, int(port)), timeout=5)
    link.sendall("\r\n".join([f"GET {path} HTTP/1.1", f"Host: {address}", *headers, "", ""]).encode())
    return link


def response_status(address: str, path: str) -> int:
    """The status of the response to a request."""
    with connection_with_request(address, path) as link:
        return int(link.recv(1 << 12).split()[1])


UPGRADE = (
    "Connection: Upgrade", "Upgrade: websocket", "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
    "Sec-WebSocket-Version: 13",
)  # fmt: skip


def test_connections_and_responses_are_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    """A connection too many is closed at once; a response too many is refused, until others have ended."""
    monkeypatch.setattr("touchfield.network.access._max_connections", lambda: 3)
    monkeypatch.setattr("touchfield.network.access._MAX_BUSY", 1)
    monkeypatch.setattr("touchfield.network.access._ENDING_S", 0.01)
    with LiveServer(sender_of(1)[0], Access(port=0)) as server, ExitStack() as others:
        for _ in range(2):
            assert [response_status(server.address, "/live.json") for _ in range(3)] == [200] * 3
            with connection_with_request(server.address, "/live", *UPGRADE) as hand:
                assert hand.recv(12) == b"HTTP/1.1 101"
                assert response_status(server.address, "/live.json") == 503
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
def test_a_failed_response_frees_its_slot(
    method: str, path: str, status: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With capacity for one response at once: an error of each kind, then a response."""
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

    for route in ("/", "/none", "/moved", "/fault", "/gone"):
        application.router.add_get(route, answer)

    async def status_after(address: str, method: str, path: str) -> int:
        host, port = address.split(":")
        reader, writer = await asyncio.open_connection(host, int(port))
        writer.write(f"{method} {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n".encode())
        try:
            fields = (await reader.read()).split()
        except ConnectionError:
            fields = []
        writer.close()
        return int(fields[1]) if fields else 0

    async def statuses() -> list[int]:
        is_over, address = asyncio.Event(), asyncio.get_running_loop().create_future()
        server = asyncio.ensure_future(run(application, Access(port=0), address.set_result, is_over))
        where = await address
        found = [
            await status_after(where, *request_line)
            for request_line in ((method, path), ("GET", "/"), ("GET", "/"))
        ]
        is_over.set()
        await server
        return found

    assert asyncio.run(statuses()) == [status, 200, 200]


def test_an_address_in_use_is_an_error() -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port, messages = other.getsockname()[1], list[str]()

        def enter() -> None:
            try:
                LiveServer(sender_of(0)[0], Access(port=port)).__enter__()
            except InvalidArgument as error:
                messages.append(str(error))

        thread = threading.Thread(target=enter, daemon=True)
        thread.start()
        thread.join(10)
    assert messages and f"127.0.0.1:{port}" in messages[0] and "--port" in messages[0]
    with pytest.raises(InvalidArgument, match=r"a\.\.b:0: .*--host"):
        LiveServer(sender_of(0)[0], Access("a..b", port=0, is_open=True)).__enter__()


def test_receivers_miss_nothing_next_to_faulty_clients() -> None:
    """Ten receivers miss nothing next to one that never reads, one that talks and one that sends garbage."""
    with on_air() as server:
        host, port = server.address.split(":")
        mute = connection_with_request(server.address, "/live", *UPGRADE)
        garbage = socket.create_connection((host, int(port)))
        garbage.sendall(b"\x16\x03\x01" + bytes(range(256)) * 8)
        idle = [socket.create_connection((host, int(port))) for _ in range(50)]

        async def receive() -> list[list[int]]:
            import aiohttp

            async with aiohttp.ClientSession() as session:

                async def one(says: str) -> list[int]:
                    receiver, first_frames = LiveReceiver(), list[int]()
                    async with session.ws_connect(f"ws://{server.address}/live") as link:
                        if says:
                            await link.send_str(says)
                        async for message in link:
                            for event in receiver.receive(message.data):
                                assert not isinstance(event, Lost | Refused)
                                first_frames += [event.first_frame] if isinstance(event, LiveSegment) else []
                            if len(first_frames) == 8:
                                break
                    return first_frames

                return await asyncio.gather(*(one("") for _ in range(10)), one("hello"))

        *heard, talker = asyncio.run(receive())
        assert all(
            len(first_frames) == 8 and np.diff(first_frames).tolist() == [5] * 7 for first_frames in heard
        )
        assert len(talker) < 8  # a client that talks is dropped
        with open_stream(f"ws://{server.address}/live"):
            assert server.max_receivers >= 11  # at once, even if there are fewer now
        for link in (mute, garbage, *idle):
            link.close()


def test_a_client_that_does_not_read_its_segment_is_dropped(
    client_dropped: threading.Event, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("touchfield.network.live_server._PATIENCE_S", 0.3)
    sender = sender_of(0)[0]
    with LiveServer(sender, Access(port=0)) as server:
        server.add(LiveSegment(0, 5, bytes(1 << 25)))
        with connection_with_request(server.address, "/live/0") as link:
            assert client_dropped.wait(30)
            received = 0
            with suppress(ConnectionError):
                while part := link.recv(1 << 20):
                    received += len(part)
        assert received < 1 << 25 and server.dropped == 0
        with connection_with_request(server.address, "/live", *UPGRADE):
            deadline_s = time.monotonic() + 30
            while not server.dropped and time.monotonic() < deadline_s:
                time.sleep(0.01)
        assert server.dropped == 1, "of receivers alone it is told"


def test_unauthorised_receivers_are_refused() -> None:
    access = Access(port=0, token="a long word")
    with on_air(access) as server:
        wrong = open_live(f"ws://{server.address}/live?token=not%20that")
        with pytest.raises(SourceError, match="found 401 ") as caught, wrong:
            pass
        assert "that" not in str(caught.value).replace("and that it is on", "")
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


def test_addresses_are_printed_after_compilation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    encode(StoredScene(medium()), tmp_path / "some.touch", EncodeSpec(nw=4))
    warm = _Layer.warm

    def warm_and_print(lane: _Layer, frame: ForceField) -> float:
        print("compiling", file=sys.stderr)
        return warm(lane, frame)

    monkeypatch.setattr(_Layer, "warm", warm_and_print)
    assert _exit_code(["live", str(tmp_path / "some.touch"), "--port", "0", "--on-air-s", "0.1"]) == 0
    stderr = capsys.readouterr().err
    assert 0 <= stderr.rindex("compiling") < stderr.index("ws://")


def test_a_receiver_waits_for_the_first_segment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_client, "_ANSWER_S", 1.0)
    monkeypatch.setattr(live_client, "REPORT_AFTER_S", 0.1)
    sender, notes = sender_of(0)[0], list[str]()
    with LiveServer(sender, Access(port=0)) as server:
        threading.Timer(1.25, lambda: server.add(segment(0))).start()
        with open_live(f"ws://{server.address}/live", notes.append) as live:
            assert live.medium[0].support_count
    assert "its sender may be starting" in notes[0]


def test_another_programme_with_another_head_must_be_reopened() -> None:
    client, other = live_client._Client("ws://127.0.0.1:1/live", lambda note: None), LiveSender()
    other.open(replace(HEAD, rate_hz=25.0))
    client._take(sender_of(0)[0].opening)
    with pytest.raises(
        SourceError, match=r"another programme; expected the one that was opened\. Open it again"
    ):
        client._take(other.opening)
    client._loop.close()


def test_missing_live_streams_are_errors() -> None:
    with (
        pytest.raises(InvalidArgument, match="address of a live stream: found 'here'"),
        open_live("udp://here"),
    ):
        pass
    with pytest.raises(SourceError, match="Check the address"), open_live("ws://127.0.0.1:1/live"):
        pass
    with (
        on_air() as server,
        pytest.raises(SourceError, match="404"),
        open_live(f"http://{server.address}/other/live.json"),
    ):
        pass


def proxied(address: str, cut_after_bytes: list[int]) -> tuple[str, threading.Event]:
    """A relay in front of a server that cuts connections after the given bytes, and the last one never."""
    listener = socket.create_server(("127.0.0.1", 0))
    listener.settimeout(0.05)
    host, port = address.split(":")
    done = threading.Event()

    def relay(link: socket.socket, max_bytes: int) -> None:
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
                    if passed > max_bytes:
                        link.shutdown(socket.SHUT_RDWR)
                        return

    def run() -> None:
        limits = list(cut_after_bytes)
        while not done.is_set():
            try:
                link, _ = listener.accept()
            except TimeoutError:
                continue
            max_bytes = limits.pop(0) if limits else 1 << 40
            threading.Thread(target=relay, args=(link, max_bytes), daemon=True).start()

    name = f"127.0.0.1:{listener.getsockname()[1]}"
    listener_name = name.encode()
    threading.Thread(target=run, daemon=True).start()
    return name, done


def test_a_cut_connection_is_renewed() -> None:
    notes: list[str] = []
    with on_air() as server:
        address, done = proxied(server.address, [1000, 1000])
        with open_live(f"ws://{address}/live", notes.append) as live:
            frames = map(live.medium.__getitem__, count())
            while sum("connection lost, retrying" in note for note in notes) < 2:
                next(frames)
            for _ in range(20):
                next(frames)
        done.set()
    assert sum("connection lost, retrying" in note for note in notes) == 2
    assert notes.count("reconnected") == 2


@pytest.mark.parametrize("form", ["ws://{}/live", "http://{}/live.json"])
def test_a_restarted_server_is_played_again(form: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """It may be absent any number of times in between."""
    monkeypatch.setattr("touchfield.network.access._ENDING_S", 0.01)  # as if killed
    monkeypatch.setattr(live_client, "_LONGEST_PAUSE_S", 0.1)
    tried = threading.Semaphore(0)
    monkeypatch.setattr(live_client, "reason", lambda error: tried.release() or reason(error))
    notes: list[str] = []
    with ExitStack() as second:
        with ExitStack() as first:
            server = first.enter_context(on_air())
            live = second.enter_context(open_stream(form.format(server.address), notes.append))
            for i in range(30):  # beyond the numbers of the second server
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
        sum("connection lost, retrying" in note for note in notes[: notes.index("another programme begins")])
        == 1
    ), notes


def test_a_server_that_stays_absent_ends_the_stream(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("touchfield.network.access._ENDING_S", 0.01)  # as if killed
    monkeypatch.setattr(live_client, "PATIENCE_S", 0.3)
    with ExitStack() as first, ExitStack() as second:
        server = first.enter_context(on_air())
        live = second.enter_context(open_stream(f"ws://{server.address}/live"))
        live.medium[0]
        server.end = lambda: None  # type: ignore[method-assign]  # nobody is told
        first.close()
        with pytest.raises(SourceError, match="Check the address"):
            [live.medium[i] for i in range(1, 200)]


def test_a_segment_is_a_complete_file(tmp_path: Path) -> None:
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
        assert response_status(server.address, "/live/2.touch") == 404
        with open_live(f"http://{server.address}/live.json") as live:
            assert live.frames.stream_frame(0) == 5  # play begins with the newest segment
    message = sender.add(LiveSegment(10, 5, b"body", b"beside"))
    with TouchReader(io.BytesIO(file_of(opening, message))) as reader:
        assert (reader.read_segment(0), reader.read_vibration(0)) == (b"body", b"beside")
    with pytest.raises(FormatError):
        file_of(opening, second[:-1])
