"""Live streams: the core without sockets, a server and receivers on loopback, and what a bad network does to them."""

from __future__ import annotations

import asyncio
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from touchfield.codec.touch.encoder import TouchEncoder
from touchfield.codec.touch.spec import TouchSpec
from touchfield.container import Head
from touchfield.errors import FormatError, InvalidArgument, SourceError
from touchfield.job import EncodeSpec
from touchfield.job.live import LiveSpec, broadcast, opened_sender
from touchfield.job.play import PlaySpec, play
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.stream.live import (
    END,
    ENDLESS,
    Ended,
    LiveReceiver,
    LiveSegment,
    LiveSender,
    Lost,
    Opened,
    Refused,
    file_of,
)  # fmt: skip
from touchfield.stream.live_medium import LiveEnd, LiveFrames, LiveStream

GRID = Grid((16, 16, 16), (0.01,) * 3, (-0.075,) * 3)
ENCODER = TouchEncoder(GRID, TouchSpec(effort="fast"))
HEAD = Head(
    grid_shape=GRID.shape, spacing_m=GRID.spacing_m, origin_m=GRID.origin_m, rate_hz=50.0, frame_count=1,
    axes="x right, y up, z towards the user", device_name="phantom-omni", device_type=1, force_max_n=3.3,
    mapping_scale=1.0, mapping_offset_m=(0.0, 0.0, 0.0), weber_fraction=0.1, force_threshold_n=0.05, friction=0.0,
    damping_n_s_per_m=0.0, tags=("direct",), coder="touch", coder_parameters=ENCODER.parameters,
)  # fmt: skip


def field(number: int) -> ForceField:
    """A field that tells its number by its height."""
    dense = np.zeros((16, 16, 16, 3), np.float32)
    dense[:, :, : 2 + number % 12] = (0, 0, 2)
    return ForceField.from_dense(GRID, dense)


def segment(first: int, count: int = 5) -> LiveSegment:
    return LiveSegment(first, count, ENCODER.encode_segment([field(first + i) for i in range(count)]).body)


def sender_of(count: int) -> tuple[LiveSender, list[bytes]]:
    sender = LiveSender()
    sender.open(HEAD, {"source": "test"})
    return sender, [sender.opening, *(sender.add(segment(5 * i)) for i in range(count))]


# -- the core -------------------------------------------------------------------------------------------------


def test_messages_become_events_again() -> None:
    _, messages = sender_of(3)
    receiver = LiveReceiver()
    events = [event for message in [*messages, END] for event in receiver.receive(message)]
    assert events == [
        Opened(replace(HEAD, frame_count=ENDLESS), {"source": "test"}), *(segment(5 * i) for i in range(3)), Ended(),
    ]  # fmt: skip
    assert [type(e) for e in receiver.receive(messages[1])] == [Refused]


def test_a_message_that_is_lost_late_told_twice_or_damaged_costs_only_itself() -> None:
    _, (opening, *segments) = sender_of(6)
    receiver = LiveReceiver()
    assert isinstance(receiver.receive(segments[0])[0], Refused)  # no opening yet
    assert isinstance(receiver.receive(opening)[0], Opened) and receiver.receive(opening) == []
    assert receiver.receive(segments[0]) == [segment(0)]
    assert isinstance(receiver.receive(segments[0])[0], Refused)
    assert receiver.receive(segments[2]) == [Lost(5, 5), segment(10)]
    assert "late" in receiver.receive(segments[1])[0].reason  # type: ignore[union-attr]
    half = sender_of(1)[0].add(replace(segment(0), first_frame=14))  # one of its frames has been felt
    assert "late" in receiver.receive(half)[0].reason  # type: ignore[union-attr]
    damaged = bytearray(segments[3])
    damaged[40] ^= 1
    assert isinstance(receiver.receive(bytes(damaged))[0], Refused)
    assert receiver.receive(segments[4]) == [Lost(15, 5), segment(20)]
    for garbage in (b"x", segments[5][:-1], segments[5] + b"x", opening[:-3], opening + segments[5], bytes(100)):
        assert [type(e) for e in receiver.receive(garbage)] == [Refused]
    assert receiver.receive(segments[5]) == [segment(25)]


@settings(max_examples=200, deadline=None)
@given(st.lists(st.one_of(st.binary(max_size=200), st.integers(0, 6).map(lambda i: _MESSAGES[i])), max_size=12))
def test_whatever_comes_is_an_event_and_no_error(messages: list[bytes]) -> None:
    receiver = LiveReceiver()
    for message in messages:
        for event in receiver.receive(message):
            assert isinstance(event, Opened | LiveSegment | Lost | Refused | Ended)


_MESSAGES = [*sender_of(5)[1], END]


class Broadcast(RuleBasedStateMachine):
    """Receivers that come and read at their own pace: what each gets is in order, and little is kept for it."""

    def __init__(self) -> None:
        super().__init__()
        self.sender, self.bodies = LiveSender(), 0
        self.sender.open(HEAD)
        self.receivers: dict[int, tuple[object, LiveReceiver, list[int]]] = {}
        self.is_over = False

    @precondition(lambda self: not self.is_over)
    @rule(gap=st.sampled_from([0, 0, 0, 5]))
    def send(self, gap: int) -> None:
        self.bodies += gap
        self.sender.add(LiveSegment(self.bodies, 5, b"body"))
        self.bodies += 5

    @precondition(lambda self: len(self.receivers) < 4)
    @rule()
    def join(self) -> None:
        self.receivers[len(self.receivers)] = (self.sender.joined(), LiveReceiver(), [])

    @precondition(lambda self: self.receivers)
    @rule(pick=st.integers(0, 3), count=st.integers(1, 6))
    def read(self, pick: int, count: int) -> None:
        subscriber, receiver, seen = self.receivers[pick % len(self.receivers)]
        for _ in range(count):
            message = self.sender.next(subscriber)  # type: ignore[arg-type]
            if message is None:
                break
            for event in receiver.receive(message):
                assert not isinstance(event, Refused)
                if isinstance(event, LiveSegment):
                    seen.append(event.first_frame)

    @precondition(lambda self: not self.is_over)
    @rule()
    def end(self) -> None:
        self.sender.end()
        self.is_over = True
        with pytest.raises(InvalidArgument):
            self.sender.add(LiveSegment(self.bodies, 5, b"body"))

    @invariant()
    def in_order_and_bounded(self) -> None:
        for subscriber, _, seen in self.receivers.values():
            assert seen == sorted(set(seen))
            assert subscriber.skipped + len(seen) <= self.bodies // 5 + 1  # type: ignore[attr-defined]
        assert len(self.sender.manifest()["segments"]) <= 4


TestBroadcast = Broadcast.TestCase
TestBroadcast.settings = settings(max_examples=60, stateful_step_count=30, deadline=None)


def test_who_is_slow_is_moved_on_to_the_newest() -> None:
    sender, _ = sender_of(1)
    slow = sender.joined()
    assert sender.next(slow) == sender.opening
    for i in range(1, 20):
        sender.add(segment(5 * i))
    receiver = LiveReceiver()
    receiver.receive(sender.opening)
    message = sender.next(slow)
    assert message is not None and receiver.receive(message) == [segment(95)] and slow.skipped == 19
    assert sender.next(slow) is None


# -- the medium -----------------------------------------------------------------------------------------------


def frames_of(*events: LiveSegment | Lost) -> LiveFrames:
    frames = LiveFrames(Opened(replace(HEAD, frame_count=ENDLESS), {}))
    for event in events:
        frames.take(event)
    return frames


def test_frames_are_those_that_were_sent_and_lost_ones_hold_no_force() -> None:
    frames = frames_of(segment(10), Lost(15, 5), segment(20))
    for i in (0, 4, 10, 14):
        np.testing.assert_allclose(frames(i).to_dense(), field(10 + i).to_dense(), atol=0.2)
    assert not frames(7).support_count and frames.lost == 5
    assert frames.is_there(14) and not frames.is_there(15)


def test_who_has_fallen_behind_goes_on_with_the_newest() -> None:
    notes: list[str] = []
    frames = LiveFrames(Opened(replace(HEAD, frame_count=ENDLESS), {}), notes.append)
    for i in range(8):
        frames.take(segment(5 * i))
    np.testing.assert_allclose(frames(3).to_dense(), field(35).to_dense(), atol=0.2)
    assert frames.skipped == 32 and frames.stream_frame(3) == 35 and "behind" in notes[0]


class Hand:
    """A player with a clock of its own."""

    def __init__(self, media_s: float) -> None:
        self.media_s, self.speed = media_s, 1.0

    def seek(self, time_s: float) -> None:
        self.media_s = time_s

    def set_speed(self, speed: float) -> None:
        self.speed = speed


@pytest.mark.parametrize("begins_s", [-1.5, -0.2, 0.0, 0.2, 4.0])
def test_play_stays_at_what_is_due(begins_s: float) -> None:
    """Segments of a tenth of a second come up to 30 ms late: soon play is behind the latest of them, and not far."""
    now, rng = [0.0], np.random.default_rng(4)
    opened = Opened(replace(HEAD, frame_count=ENDLESS), {})
    frames = LiveFrames(opened, clock_s=lambda: now[0])
    live, hand, waits = LiveStream("live", opened, frames, False), Hand(begins_s), 0
    late, sent = rng.uniform(0, 0.03, 60), 0
    bodies = [segment(5 * i) for i in range(12)]
    for step in range(500):
        now[0] = 0.01 * step
        while now[0] >= 0.1 * sent + late[sent]:
            frames.take(replace(bodies[sent % 12], first_frame=5 * sent))
            sent += 1
        if step % 10 == 0:
            live.keep_up(hand)
        if step > 300:
            waits += hand.media_s * 50 > 5 * sent
            assert -0.06 < now[0] - hand.media_s < 0.08
        hand.media_s += 0.01 * hand.speed
    assert waits == 0


@pytest.mark.parametrize(("here_s", "there_s"), [(1000.0, 0.0), (0.0, 60.0), (-300.0, 0.0)])
def test_a_clock_that_jumps_is_followed(here_s: float, there_s: float) -> None:
    """The receiver's clock jumps after two seconds, or the sender's: half a second later play is where it was."""
    now, sent = 0.0, 0
    frames = LiveFrames(Opened(replace(HEAD, frame_count=ENDLESS), {}), clock_s=lambda: now + here_s * (now >= 2))
    live, hand = LiveStream("live", Opened(HEAD, {}), frames, False), Hand(0.0)
    bodies = [segment(5 * i) for i in range(12)]
    for step in range(500):
        now = 0.01 * step
        while now >= 0.1 * (sent + 1):
            skipped = round(there_s * 50) * (now >= 2)
            frames.take(replace(bodies[sent % 12], first_frame=5 * sent + skipped))
            sent += 1
        if step % 10 == 0:
            live.keep_up(hand)
        if step > 260 or 150 < step < 199:
            assert -0.02 < now + there_s * (now >= 2) - hand.media_s - 0.1 < 0.1
            assert frames.is_there(int(hand.media_s * 50))
        hand.media_s += 0.01 * hand.speed


def test_a_segment_that_cannot_be_decoded_costs_only_itself() -> None:
    bad = LiveSegment(5, 5, b"\0" * 50)
    frames = frames_of(segment(0), bad, segment(10))
    assert frames.lost == 5 and not frames(5).support_count and frames(10).support_count


def test_the_end_and_silence_are_told() -> None:
    frames = frames_of(segment(0))
    with pytest.raises(SourceError, match="far ahead"):
        frames(100_000)
    frames.take(Ended())
    assert frames(4).support_count and frames.is_there(5)
    with pytest.raises(LiveEnd):
        frames(5)
    clock = iter(range(0, 1000, 20))
    silent = LiveFrames(Opened(replace(HEAD, frame_count=ENDLESS), {}), clock_s=lambda: float(next(clock)))
    silent.take(segment(0))
    with pytest.raises(SourceError, match="no segment for 10 s"):
        silent(7)


# -- on the air -----------------------------------------------------------------------------------------------


def medium() -> HapticMedium:
    return HapticMedium.from_frames([field(i) for i in range(50)], 50.0, HEAD.axes)


def test_frames_go_on_the_air_in_time() -> None:
    prepared, sender = opened_sender(medium(), EncodeSpec())
    now = [0.0]
    took: list[tuple[float, LiveSegment]] = []

    def send(one: LiveSegment) -> bytes:
        took.append((now[0], one))
        return sender.add(one)

    def pause(seconds: float) -> None:
        time.sleep(0.01)  # the coder's thread
        now[0] += seconds

    sent = broadcast(prepared, send, LiveSpec(0.1, loop=True, seconds=3.0), clock_s=lambda: now[0], pause=pause)
    assert sent.frames + sent.left_out == 150 and sent.segments == len(took) >= 3
    assert all(one.first_frame % 5 == 0 for _, one in took)
    assert all(at - one.stop / 50 >= -1e-9 for at, one in took)  # nothing before its time


@pytest.mark.parametrize("wrong", [{"segment_s": 0.0}, {"segment_s": 11.0}, {"seconds": 0.0}])
def test_times_that_cannot_be(wrong: dict[str, float]) -> None:
    with pytest.raises(InvalidArgument):
        LiveSpec(**wrong)  # type: ignore[arg-type]


pytest.importorskip("aiohttp", reason="live streams need the extra broadcast")
from touchfield.stream.access import Access  # noqa: E402
from touchfield.stream.live_client import open_live  # noqa: E402
from touchfield.stream.live_server import LiveServer  # noqa: E402
from touchfield.stream.opened import open_stream  # noqa: E402


@contextmanager
def on_air(access: Access = Access(port=0), segments: int = 10**6) -> Iterator[LiveServer]:
    """A server that sends a segment of five frames every tenth of a second."""
    done, sender = threading.Event(), sender_of(0)[0]
    bodies = [segment(5 * i) for i in range(12)]

    def run(server: LiveServer) -> None:
        for i in range(segments):
            server.add(replace(bodies[i % 12], first_frame=5 * i))
            if done.wait(0.1):
                return
        server.end()

    with LiveServer(sender, access) as server:
        thread = threading.Thread(target=run, args=(server,), daemon=True)
        thread.start()
        yield server
        done.set()
        thread.join()


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
    notes: list[str] = []
    with on_air() as server:  # code is loaded or compiled first, and takes none of the time below
        assert play(f"ws://{server.address}/live", PlaySpec("sim", seconds=0.2)).error is None
    with on_air(segments=40) as server:
        played = play(f"ws://{server.address}/live", PlaySpec("sim", seconds=20.0), tell=notes.append)
    assert played.error is None and "the sender has ended the stream" in played.notes
    assert played.statistics["frames_used"] > 20 and played.statistics["last_force_n"] == 0


def test_connections_that_say_nothing_are_left(monkeypatch: pytest.MonkeyPatch) -> None:
    """A hundred connections where sixty fit: the others are closed, and soon the sixty, and a receiver hears all."""
    monkeypatch.setattr("touchfield.stream.access._most_connections", lambda: 60)
    monkeypatch.setattr("touchfield.stream.access._PATIENCE_S", 0.5)

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


def test_many_receivers_and_bad_ones_beside_them() -> None:
    """Ten that read, one that never does, one that talks, and one that sends garbage: the ten miss nothing."""
    with on_air() as server:
        host, port = server.address.split(":")
        mute = socket.create_connection((host, int(port)))
        mute.sendall(
            f"GET /live HTTP/1.1\r\nHost: {server.address}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n"
            "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n".encode()
        )
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
        assert server.most_receivers >= 11
        for link in (mute, garbage, *idle):
            link.close()


def test_who_may_not_receive() -> None:
    access = Access(port=0, token="a long word")
    with on_air(access) as server:
        with pytest.raises(SourceError, match="401"), open_live(f"ws://{server.address}/live"):
            pass
        with open_live(f"ws://{server.address}/live?token=a%20long%20word") as live:
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


def test_what_is_not_there_is_told() -> None:
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
            for i in range(80):
                live.medium[i]
        done.set()
    assert sum("connecting again" in note for note in notes) == 2


def test_a_segment_is_a_file_of_its_own(tmp_path: Path) -> None:
    _, (opening, _, second) = sender_of(2)
    (tmp_path / "segment.touch").write_bytes(file_of(opening, second))
    with open_stream(tmp_path / "segment.touch") as opened:
        assert len(opened.medium) == 5 and opened.reader.provenance["source"] == "test"
        for i in range(5):
            np.testing.assert_allclose(opened.medium[i].to_dense(), field(5 + i).to_dense(), atol=0.2)
    with pytest.raises(FormatError):
        file_of(opening, second[:-1])
