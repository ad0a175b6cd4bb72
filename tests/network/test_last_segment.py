"""The end of a live stream at both ends: a receiver that lags still gets the newest segment, then the end."""

from __future__ import annotations

import asyncio
from threading import Timer
from typing import Any

import aiohttp
import numpy as np
import pytest

from live_makers import field, segment, sender_of
from touchfield.network.access import Access
from touchfield.network.live import (
    END,
    MAX_SEGMENTS,
    Ended,
    LiveReceiver,
    LiveSegment,
    LiveSender,
    Lost,
    Opened,
)
from touchfield.network.live_client import open_live
from touchfield.network.live_server import LiveServer

COUNT = 12


def pending_messages(sender: LiveSender, subscriber: Any) -> list[bytes]:
    """All messages that are pending for a receiver."""
    messages = []
    while (message := sender.next(subscriber)) is not None:
        messages.append(message)
    return messages


@pytest.mark.parametrize("read", range(COUNT + 1))
def test_a_slow_receiver_gets_the_last_segment_and_the_end(read: int) -> None:
    sender, _ = sender_of(0)
    slow = sender.joined()
    early = [sender.next(slow)]
    for number in range(COUNT):
        sender.add(segment(5 * number))
        early += [sender.next(slow)] if number < read else []
    sender.end()
    late = pending_messages(sender, slow)
    assert late[-1] == END and late.count(END) == 1 and pending_messages(sender, slow) == []
    receiver = LiveReceiver()
    events = [
        event for message in (*early, *late) if message is not None for event in receiver.receive(message)
    ]
    assert isinstance(events[0], Opened) and events[-2:] == [segment(5 * (COUNT - 1)), Ended()]
    got = [event.first_frame // 5 for event in events if isinstance(event, LiveSegment)]
    unread_count = COUNT - read
    queued = list(range(read, COUNT)) if unread_count <= MAX_SEGMENTS else [COUNT - 1]
    assert got == [*range(read), *queued], "all that is kept, or the newest alone"
    lost_frames = sum(event.frame_count for event in events if isinstance(event, Lost))
    assert lost_frames == (0 if unread_count <= MAX_SEGMENTS or not read else 5 * (unread_count - 1)), (
        "a receiver that had none knows of none"
    )
    assert slow.skipped == (0 if unread_count <= MAX_SEGMENTS else unread_count - 1)


def test_a_receiver_that_joins_after_the_end_gets_the_last_segment_and_the_end() -> None:
    sender, (opening, *_, newest) = sender_of(COUNT)
    sender.end()
    assert pending_messages(sender, sender.joined()) == [opening, newest, END]


def large(number: int) -> LiveSegment:
    """A segment that fills the buffers of a connection."""
    return LiveSegment(5 * number, 5, bytes([number]) * (1 << 20))


def test_a_paused_socket_gets_the_last_segment_and_the_end() -> None:
    sender, _ = sender_of(0)

    async def received(address: str) -> list[bytes]:
        async with (
            aiohttp.ClientSession() as session,
            session.ws_connect(f"ws://{address}/live", max_msg_size=1 << 26) as socket,
        ):
            messages = [(await socket.receive()).data]
            socket._response.connection.transport.pause_reading()
            for number in range(40):
                server.add(large(number))
                await asyncio.sleep(0.002)
            server.end()
            await asyncio.sleep(0.2)
            socket._response.connection.transport.resume_reading()
            async for message in socket:
                messages.append(message.data)
            return messages

    with LiveServer(sender, Access(port=0)) as server:
        opening, *segments, end = asyncio.run(received(server.address))
    receiver = LiveReceiver()
    events = [event for message in (opening, *segments) for event in receiver.receive(message)]
    assert end == END and events[-1] == large(39)
    assert any(isinstance(event, Lost) for event in events) and server.skipped, "it did lag"


def test_a_manifest_read_after_the_end_lists_the_last_segments() -> None:
    sender, _ = sender_of(0)

    async def fetch(address: str, path: str) -> Any:
        async with aiohttp.ClientSession() as session, session.get(f"http://{address}/{path}") as answer:
            return await (answer.json() if path.endswith(".json") else answer.read())

    with LiveServer(sender, Access(port=0)) as server:
        messages = [server.add(segment(5 * number)) for number in range(COUNT)]
        server.end()
        manifest = asyncio.run(fetch(server.address, "live.json"))
        numbers = [entry["number"] for entry in manifest["segments"]]
        assert manifest["is_ended"] and numbers == list(range(COUNT - MAX_SEGMENTS, COUNT))
        assert asyncio.run(fetch(server.address, f"live/{COUNT - 1}")) == messages[-1]


@pytest.mark.parametrize("form", ["ws", "http"])
def test_the_client_returns_the_last_segment_of_an_ended_stream(form: str) -> None:
    sender, _ = sender_of(COUNT)
    url = {"ws": "ws://{}/live", "http": "http://{}/live.json"}[form]
    with LiveServer(sender, Access(port=0)) as server:
        server.end()
        with open_live(url.format(server.address)) as stream:
            frames = stream.medium.make_frame
            for i in range(5):
                number = frames.stream_frame(i)  # type: ignore[attr-defined]
                assert number == 5 * (COUNT - 1) + i
                np.testing.assert_allclose(stream.medium[i].to_dense(), field(number).to_dense(), atol=0.2)


def test_an_empty_manifest_does_not_mean_the_end() -> None:
    sender, _ = sender_of(0)
    with LiveServer(sender, Access(port=0)) as server:

        def add_first() -> None:
            server.add(segment(0))
            server.end()

        timer = Timer(0.6, add_first)
        timer.start()
        with open_live(f"http://{server.address}/live.json") as stream:
            np.testing.assert_allclose(stream.medium[4].to_dense(), field(4).to_dense(), atol=0.2)
        timer.join()


@pytest.mark.parametrize("origins", [(), ("https://a.example",), ("*",)])
def test_only_allowed_origins_read_a_live_stream(origins: tuple[str, ...]) -> None:
    sender, _ = sender_of(2)

    async def allowed(address: str) -> list[str | None]:
        found = []
        async with aiohttp.ClientSession() as session:
            for path in ("live.json", "live/opening", "live/1"):
                headers = {"Origin": "https://a.example"}
                async with session.get(f"http://{address}/{path}", headers=headers) as answer:
                    found.append(answer.headers.get("Access-Control-Allow-Origin"))
        return found

    with LiveServer(sender, Access(port=0, origins=origins)) as server:
        assert asyncio.run(allowed(server.address)) == ["https://a.example" if origins else None] * 3
