"""Web server of a live stream: sends segments over WebSocket, and offers the latest ones over HTTP by a
manifest that is updated as they come.

The sender never waits: each receiver takes segments at its own pace, and one that does not read is dropped.
"""

from __future__ import annotations

import asyncio
from contextlib import suppress
from functools import partial
from typing import Final

from touchfield.network.access import (
    Access,
    Background,
    ClientDropped,
    Pages,
    add_get,
    add_pages,
    dropped_unless_read,
    guarded,
    open_socket,
    web,
)
from touchfield.network.live import MEDIA_TYPE, LiveSegment, LiveSender, file_of

_NOT_CACHED: Final = {"Cache-Control": "no-store"}
_CACHED: Final = {"Cache-Control": "public, max-age=60, immutable"}
_PRIVATE: Final = {"Cache-Control": "private, max-age=60, immutable"}
"""A shared cache does not ask for the token: what needs one is for the receiver alone."""

_PATIENCE_S: Final = 10.0
"""Maximum time that a receiver may take to read a message."""


class LiveServer(Background):
    """Serves a live stream from a thread of its own; a context manager.

    Parameters
    ----------
    sender : LiveSender
    access : Access
    pages : Pages, optional
        Pages for browsers, at /view.
    coarse : LiveSender, optional
        Sender of the coarse layer, which is served at /coarse/live; the stream is at /live.

    Attributes
    ----------
    receivers : int
        Number of receivers that are connected.
    max_receivers : int
        Largest number of receivers that were connected at the same time.
    skipped : int
        Number of segments that slow receivers did not get.
    dropped : int
        Number of receivers that were disconnected because they did not read.
    """

    def __init__(
        self, sender: LiveSender, access: Access, pages: Pages | None = None, coarse: LiveSender | None = None
    ) -> None:
        super().__init__(access, pages)
        self._senders = [layer_sender for layer_sender in (sender, coarse) if layer_sender is not None]
        self._news = asyncio.Event()
        self.receivers = self.max_receivers = self.skipped = self.dropped = 0

    def add(self, segment: LiveSegment, *, is_coarse: bool = False) -> bytes:
        """Append a segment, or one of the coarse layer; return its message."""
        message = self._senders[is_coarse].add(segment)
        self._wake_threadsafe()
        return message

    def end(self) -> None:
        """End the stream for all receivers."""
        for sender in self._senders:
            sender.end()
        self._wake_threadsafe()

    def _wake_threadsafe(self) -> None:
        with suppress(RuntimeError):  # the loop is closed
            self._loop.call_soon_threadsafe(self._wake)

    def _wake(self) -> None:
        self._news, old = asyncio.Event(), self._news
        old.set()

    def _application(self) -> web.Application:
        served = guarded(self._access)
        get = partial(add_get, served)
        for layer, sender in zip(("/live", "/coarse/live"), self._senders):
            get(layer, partial(self._follow, sender))
            get(f"{layer}.json", partial(self._manifest, sender))
            get(f"{layer}/opening", partial(self._opening, sender))
            get(rf"{layer}/{{number:\d{{1,9}}}}{{ending:(\.touch)?}}", partial(self._segment, sender))
        add_pages(served, "", self._pages)
        return served

    async def _follow(self, sender: LiveSender, request: web.Request) -> web.StreamResponse:
        socket = await open_socket(request, _PATIENCE_S)
        receiver = sender.joined()
        self.receivers += 1
        self.max_receivers = max(self.max_receivers, self.receivers)
        listener = asyncio.ensure_future(_ended(socket))
        try:
            while not socket.closed:
                news = self._news
                message = sender.next(receiver)
                if message is not None:
                    async with dropped_unless_read(request, _PATIENCE_S):
                        await socket.send_bytes(message)
                elif receiver.is_over:
                    break
                else:
                    waits = asyncio.ensure_future(news.wait())
                    await asyncio.wait({waits, listener}, return_when=asyncio.FIRST_COMPLETED)
                    waits.cancel()
                    if listener.done():
                        break
        except ClientDropped:
            self.dropped += 1
        except ConnectionError:
            pass
        finally:
            listener.cancel()
            self.receivers -= 1
            self.skipped += receiver.skipped
        return socket

    async def _answer(self, sender: LiveSender, request: web.Request, data: bytes | None) -> web.Response:
        programme = request.query.get("programme")
        if data is None or programme not in (None, sender.programme):
            raise web.HTTPNotFound(text="no such segment now", headers=_NOT_CACHED)
        headers = {**self._access.cors(request), **_NOT_CACHED}
        if programme is not None:  # else the next programme has the same address
            headers |= _PRIVATE if self._access.token else _CACHED
        answer = web.Response(body=data, content_type=MEDIA_TYPE, headers=headers)
        with suppress(ConnectionError):
            async with dropped_unless_read(request, _PATIENCE_S):
                await answer.prepare(request)
                await answer.write_eof()
        return answer

    async def _manifest(self, sender: LiveSender, request: web.Request) -> web.Response:
        headers = {**self._access.cors(request), **_NOT_CACHED}
        return web.json_response(sender.manifest(), headers=headers)

    async def _opening(self, sender: LiveSender, request: web.Request) -> web.Response:
        return await self._answer(sender, request, sender.opening or None)

    async def _segment(self, sender: LiveSender, request: web.Request) -> web.Response:
        """Answer with a segment's message, or with a complete file if the name ends in .touch."""
        message = sender.message(int(request.match_info["number"]))
        if message is not None and request.match_info["ending"]:
            message = file_of(sender.opening, message)
        return await self._answer(sender, request, message)


async def _ended(socket: web.WebSocketResponse) -> None:
    """Return when the receiver closes, or sends anything, which it should not."""
    await socket.receive()
