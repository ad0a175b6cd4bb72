"""Receives a live stream over WebSocket, HTTP, UDP datagrams or a pipe.

It makes a medium of the messages.

The client reconnects when a connection ends; frames that it missed are lost, and this is reported.
"""

from __future__ import annotations

import asyncio
import json
import math
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from threading import Event as Flag, Thread
from typing import Any, Final, Self
from urllib.parse import urlsplit, urlunsplit

from touchfield.container.remote import is_live, is_remote, without_secret
from touchfield.errors import InvalidArgument, SourceError, TouchfieldError, naming_file, reason
from touchfield.files import standard_input
from touchfield.network.live import MAX_BYTES, Ended, LiveReceiver, LiveSegment, Opened, messages
from touchfield.network.live_medium import PATIENCE_S, REPORT_AFTER_S, LiveFrames, LiveStream
from touchfield.network.live_scene import live_frames

_SHORTEST_PAUSE_S, _LONGEST_PAUSE_S = 0.1, 2.0  # between two tries to connect
_POLL_S: Final = 0.05
_ANSWER_S: Final = 10.0
_HINT: Final = "Check the address, and that it is on."
_LIVE_FORMS: Final = "ws://HOST:PORT/live, http://HOST:PORT/live.json, udp://HOST:PORT, or - for a pipe"
_MAX_MANIFEST_BYTES: Final = 1 << 16
_COARSE_WAIT_S: Final = 5.0  # time to wait for a coarse layer once the stream has opened


def require_live(url: str, where: str) -> None:
    """Raise InvalidArgument that names `where` unless a text is an address of a live stream.

    Nothing is connected. These are the addresses of `touchfield.container.remote.is_live`.
    """
    if not is_live(url):
        raise InvalidArgument(where, repr((without_secret(url) if is_remote(url) else url)[:80]), _LIVE_FORMS)
    if url.lower().startswith("udp:"):
        from touchfield.network.udp import require_listener

        require_listener(url, where)
    elif url != "-":
        try:
            parts = urlsplit(url)
            has_host = bool(parts.hostname) and parts.port != 0  # `port` raises for one above 65535
        except ValueError:
            has_host = False
        if not has_host:
            expected = f"a host, and a port from 1 to 65535 if there is one: {_LIVE_FORMS}"
            raise InvalidArgument(where, repr(without_secret(url)[:80]), expected)


@contextmanager
def open_live(
    url: str, report: Callable[[str], None] = lambda note: None, coarse: str | None = None
) -> Iterator[LiveStream]:
    """Open a live stream, which is received in a thread until the block ends.

    `coarse` is the address of its coarse layer, which replaces frames of the stream that are lost or late. If
    that layer has not started some seconds after the stream, this is reported and the stream is played alone.

    Raises InvalidArgument if an address is none; SourceError if there is no stream, or its first segment has
    not come within a minute.
    """
    require_live(url, "address of a live stream")
    if coarse is not None:
        require_live(coarse, "coarse")
    with ExitStack() as stack:
        coarse_client: _Client | None = None
        if coarse is not None:
            coarse_client = _Client(coarse, lambda note: report(f"coarse layer: {note}"), is_layered=True)
            stack.enter_context(coarse_client)
        yield stack.enter_context(
            _Client(url, report, coarse_client, is_layered=coarse_client is not None)
        ).stream()


class _Client:
    """Receiver of a stream in a thread; a context manager."""

    def __init__(
        self, url: str, report: Callable[[str], None], coarse: _Client | None = None, is_layered: bool = False
    ) -> None:
        self._url, self._report, self._coarse, self._is_layered = url, report, coarse, is_layered
        self._name = "standard input" if url == "-" else without_secret(url)
        self._is_udp = url.lower().startswith("udp:")
        self._receiver = LiveReceiver(is_open=self._is_udp and "?" not in url)  # without a token
        self._frames: LiveFrames | None = None
        self._has_segment, self._is_lost = Flag(), False
        self._error: TouchfieldError = SourceError(self._name, "nothing in time", "a live stream", _HINT)
        self._loop = asyncio.new_event_loop()
        self._task: asyncio.Task[None] | None = None
        self._thread = Thread(target=self._run, name="touchfield-receiver", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(RuntimeError):
            self._loop.call_soon_threadsafe(lambda: self._task and self._task.cancel())
        self._thread.join(0.1 if self._url == "-" else 5)  # waiting for a pipe cannot be interrupted

    def stream(self) -> LiveStream:
        """Wait for the first segment and return the stream."""
        if not self._has_segment.wait(REPORT_AFTER_S):
            self._report(
                f"waiting for a first segment of {self._name}, a minute at most: its sender may be starting"
            )
            self._has_segment.wait(PATIENCE_S - REPORT_AFTER_S)
        if self._frames is None:
            raise self._error
        return LiveStream(self._name, self._frames)

    def layer(self, report: Callable[[str], None]) -> LiveFrames | None:
        """Return the frames of the coarse layer; None, after a report, if it does not start."""
        if self._has_segment.wait(_COARSE_WAIT_S) and self._frames is not None:
            return self._frames
        if not isinstance(self._error, SourceError):  # the request itself is invalid
            raise self._error
        report(f"without its coarse layer: {self._error}")
        self.__exit__()
        return None

    def _run(self) -> None:
        try:
            if self._url == "-":
                self._by_pipe()
                return
            self._task = self._loop.create_task(self._receive())
            self._loop.run_until_complete(self._task)
        except asyncio.CancelledError:
            pass
        except Exception as error:
            if not isinstance(error, TouchfieldError):
                error = SourceError(self._name, reason(error), "a live stream")
            self._error = error
            if self._frames is not None:
                self._frames.fail(error)
        finally:
            self._has_segment.set()
            self._loop.close()

    @property
    def _lost_note(self) -> str:
        return "no connection" if self._frames is None else "connection lost"

    def _take(self, message: bytes) -> bool:
        """Take a message; return True once the stream is over."""
        if self._is_lost:
            self._is_lost = False
            self._report("reconnected" if self._frames is not None else "connected")
        events = self._receiver.receive(message)
        for event in events:
            if isinstance(event, Opened):
                if self._frames is None:
                    coarse = None if self._coarse is None else self._coarse.layer(self._report)
                    with naming_file(self._name):
                        self._frames = live_frames(event, self._report, coarse)
                elif _programme(event) == _programme(self._frames.opened):
                    self._report("another programme begins")
                    self._frames.start_programme()
                else:  # a player of the previous programme must open the stream again
                    raise SourceError(
                        self._name, "another programme", "the one that was opened", "Open it again."
                    )
            elif self._frames is None:
                self._error = SourceError(self._name, getattr(event, "reason", "its end"), "a live stream")
            else:
                self._frames.take(event)
                if isinstance(event, LiveSegment):
                    self._has_segment.set()
        return any(isinstance(event, Ended) for event in events)

    async def _receive(self) -> None:
        if self._is_udp:
            from touchfield.network.udp import listen

            await listen(self._url, self._take, self._is_layered, self._report)
            return
        import aiohttp

        reported_s: float | None = None
        timeout = aiohttp.ClientTimeout(total=_ANSWER_S, sock_connect=_ANSWER_S)
        async with aiohttp.ClientSession(timeout=timeout) as session:
            follow = self._by_socket if self._url.lower().startswith("ws") else self._by_manifest
            while True:
                try:
                    if await follow(session):
                        return
                    found = "it ended"
                except (aiohttp.ClientError, OSError, TimeoutError) as error:
                    found = reason(error)
                    if isinstance(
                        error, aiohttp.ClientResponseError
                    ):  # its text contains the address with the token
                        found = f"{error.status} {error.message}"
                latest_s = -math.inf if self._frames is None else self._frames.received_s
                silent_s = time.monotonic() - latest_s
                if silent_s > PATIENCE_S:
                    raise SourceError(self._name, found, "a live stream", _HINT)
                if latest_s != reported_s:
                    self._report(f"{self._lost_note}, retrying ({found})")
                    self._is_lost, reported_s = True, latest_s
                await asyncio.sleep(min(max(_SHORTEST_PAUSE_S, silent_s / 2), _LONGEST_PAUSE_S))

    async def _by_socket(self, session: Any) -> bool:
        """Receive until the connection ends; return True if the stream is over."""
        import aiohttp

        async with session.ws_connect(
            self._url, max_msg_size=MAX_BYTES, heartbeat=_ANSWER_S, compress=0
        ) as socket:
            async for message in socket:
                if message.type is aiohttp.WSMsgType.BINARY and await asyncio.to_thread(
                    self._take, message.data
                ):
                    return True
        return False

    def _by_pipe(self) -> None:
        """Receive messages from standard input until the stream is over."""
        for message in messages(standard_input(), self._name):
            if self._take(message):
                return
        raise SourceError(self._name, "its end", "a live stream, of touchfield live SOURCE -")

    async def _by_manifest(self, session: Any) -> bool:
        """Poll the manifest and fetch its segments; return True if the stream is over."""
        parts = urlsplit(self._url)
        folder = parts.path.removesuffix(".json")

        async def got(path: str, max_bytes: int, programme: str = "") -> bytes:
            query = "&".join(filter(None, (parts.query, programme)))
            async with session.get(urlunsplit((parts.scheme, parts.netloc, path, query, ""))) as answer:
                if answer.status != 200:
                    raise OSError(f"{answer.status} {answer.reason}")
                data: bytes = await answer.content.read(max_bytes + 1)
                while len(data) <= max_bytes and (
                    more := await answer.content.read(max_bytes + 1 - len(data))
                ):
                    data += more
                if len(data) > max_bytes:
                    raise SourceError(self._name, f"more than {max_bytes} bytes", f"at most {max_bytes}")
                return data

        programme, next_number = "", None
        while True:
            manifest = await got(parts.path, _MAX_MANIFEST_BYTES)
            is_over, numbers, named = _manifest(manifest, self._name)
            if next_number is None:
                programme, next_number = named, -1
                await asyncio.to_thread(self._take, await got(f"{folder}/opening", MAX_BYTES, programme))
            if named != programme or (numbers and numbers[-1] + 1 < next_number):
                return False  # another programme
            numbers = numbers[-1:] if next_number < 0 else [n for n in numbers if n >= next_number]
            for number in numbers:
                message = await got(f"{folder}/{number}", MAX_BYTES, programme)
                await asyncio.to_thread(self._take, message)
                next_number = number + 1
            if is_over:
                return await asyncio.to_thread(self._take, b"")
            await asyncio.sleep(_POLL_S)


def _programme(opened: Opened) -> tuple[object, ...]:
    """Return what must stay the same in another programme: the head, and the fields of the bodies."""
    return opened.head, opened.objects


def _manifest(data: bytes, name: str) -> tuple[bool, list[int], str]:
    """Return whether a stream is over, the ascending numbers of its segments, and the query of its programme.

    The query is empty if the sender names no programme.
    """
    try:
        manifest = json.loads(data)
        numbers = [int(segment["number"]) for segment in manifest["segments"]]
        is_over, programme = bool(manifest["is_ended"]), str(manifest.get("programme", ""))
    except (ValueError, TypeError, KeyError, OverflowError, RecursionError):
        raise SourceError(name, "a manifest that is none", "one of a live stream") from None
    if sorted(set(numbers)) != numbers or (numbers and numbers[0] < 0):
        raise SourceError(name, "numbers that do not ascend", "those of a live stream")
    if programme and not (programme.isascii() and programme.isalnum() and len(programme) <= 64):
        raise SourceError(name, "a programme that is none", "up to 64 letters and digits")
    return is_over, numbers, f"programme={programme}" if programme else ""
