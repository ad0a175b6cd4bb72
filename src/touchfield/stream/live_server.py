"""A live stream on the web: segments to any number of receivers by WebSocket, and a rolling manifest by HTTP.

The sender never waits: what is coded is put before all receivers, and each takes what it can in its own time. Who
does not read is left.
"""

from __future__ import annotations

import asyncio
from contextlib import suppress
from typing import Final

from touchfield.stream.access import (
    Access,
    Background,
    ConnectionLeft,
    Pages,
    add_pages,
    guarded,
    left_unless_read,
    web,
)
from touchfield.stream.live import MEDIA_TYPE, LiveSegment, LiveSender, file_of

_PATIENCE_S: Final = 10.0
"""How long a receiver may take for a message."""


class LiveServer(Background):
    """Serves a live stream from a thread of its own; a context manager.

    Parameters
    ----------
    sender : LiveSender
    access : Access
    pages : Pages, optional
        For browsers, at /view.
    coarse : LiveSender, optional
        Of the coarse layer, which is at /coarse/live as the stream is at /live.

    Attributes
    ----------
    receivers : int
        That are there now.
    most_receivers : int
        That were there at once.
    skipped : int
        Segments that slow receivers were moved on over.
    left : int
        Receivers that did not read, and were left.
    """

    def __init__(
        self, sender: LiveSender, access: Access, pages: Pages | None = None, coarse: LiveSender | None = None
    ) -> None:
        super().__init__(access, pages)
        self._sender, self._coarse, self._news = sender, coarse, asyncio.Event()
        self.receivers = self.most_receivers = self.skipped = self.left = 0

    def add(self, segment: LiveSegment, *, is_coarse: bool = False) -> bytes:
        """Have a segment sent, or one of the coarse layer; its message."""
        sender = self._coarse if is_coarse else self._sender
        assert sender is not None
        message = sender.add(segment)
        self._tell()
        return message

    def end(self) -> None:
        """Say to all that nothing follows."""
        for sender in filter(None, (self._sender, self._coarse)):
            sender.end()
        self._tell()

    def _tell(self) -> None:
        with suppress(RuntimeError):  # the loop is closed
            self._loop.call_soon_threadsafe(self._wake)

    def _wake(self) -> None:
        self._news, old = asyncio.Event(), self._news
        old.set()

    def _application(self) -> web.Application:
        served = guarded(self._access)
        for layer in ("live",) if self._coarse is None else ("live", "coarse/live"):
            served.router.add_get(f"/{layer}", self._follow)
            served.router.add_get(f"/{layer}.json", self._manifest)
            served.router.add_get(f"/{layer}/opening", self._opening)
            served.router.add_get(rf"/{layer}/{{number:\d{{1,9}}}}{{ending:(\.touch)?}}", self._segment)
        add_pages(served, "", self._pages)
        return served

    def _asked(self, request: web.Request) -> LiveSender:
        """The sender of the layer that a request is for."""
        return self._coarse if self._coarse is not None and request.path.startswith("/coarse") else self._sender

    async def _follow(self, request: web.Request) -> web.StreamResponse:
        socket = web.WebSocketResponse(heartbeat=_PATIENCE_S, max_msg_size=1 << 10, compress=False)
        await socket.prepare(request)
        sender = self._asked(request)
        receiver = sender.joined()
        self.receivers += 1
        self.most_receivers = max(self.most_receivers, self.receivers)
        listener = asyncio.ensure_future(_ended(socket))
        try:
            while not socket.closed:
                news = self._news
                message = sender.next(receiver)
                if message is not None:
                    async with left_unless_read(request, _PATIENCE_S):
                        await socket.send_bytes(message)
                elif receiver.is_over:
                    break
                else:
                    waits = asyncio.ensure_future(news.wait())
                    await asyncio.wait({waits, listener}, return_when=asyncio.FIRST_COMPLETED)
                    waits.cancel()
                    if listener.done():
                        break
        except ConnectionLeft:
            self.left += 1
        except ConnectionError:
            pass
        finally:
            listener.cancel()
            self.receivers -= 1
            self.skipped += receiver.skipped
        return socket

    async def _answer(self, request: web.Request, data: bytes | None) -> web.Response:
        if data is None:
            raise web.HTTPNotFound(text="no such segment now")
        answer = web.Response(body=data, content_type=MEDIA_TYPE, headers=self._access.cors(request))
        with suppress(ConnectionError):
            async with left_unless_read(request, _PATIENCE_S):
                await answer.prepare(request)
                await answer.write_eof()
        return answer

    async def _manifest(self, request: web.Request) -> web.Response:
        headers = {**self._access.cors(request), "Cache-Control": "no-store"}
        return web.json_response(self._asked(request).manifest(), headers=headers)

    async def _opening(self, request: web.Request) -> web.Response:
        return await self._answer(request, self._asked(request).opening or None)

    async def _segment(self, request: web.Request) -> web.Response:
        """A segment's message, or with the ending a file of its own, for whoever decodes files."""
        sender = self._asked(request)
        message = sender.message(int(request.match_info["number"]))
        if message is not None and request.match_info["ending"]:
            message = file_of(sender.opening, message)
        return await self._answer(request, message)


async def _ended(socket: web.WebSocketResponse) -> None:
    """Return where the receiver closes, or speaks: it has nothing to say."""
    await socket.receive()
