"""Serves a page that shows a file together with the hand that plays it on a device, updated 60 times a
second."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Final
from urllib.parse import quote

from touchfield.network.access import (
    Access,
    Background,
    Pages,
    add_get,
    add_pages,
    dropped_unless_read,
    guarded,
    is_utf8,
    open_socket,
    web,
)
from touchfield.network.file_response import send_file
from touchfield.network.live import MEDIA_TYPE

if TYPE_CHECKING:
    from touchfield.render.player import Player

_PERIOD_S: Final = 1 / 60
_PATIENCE_S: Final = 5.0


class Bridge(Background):
    """A server for the page of one file and the hand that plays it.

    Parameters
    ----------
    stream : Path
        The ``.touch`` file.
    access : Access
    pages : Pages
    """

    def __init__(self, stream: Path, access: Access, pages: Pages) -> None:
        super().__init__(access, pages)
        self._stream = stream
        self._name = stream.name if is_utf8(stream.name) else "stream.touch"
        self._hand: Player | None = None

    @property
    def page(self) -> str:
        """The address of the page."""
        return f"http://{self.address}/view/{quote(self._name)}#hand"

    def follow(self, hand: Player) -> None:
        """Show this hand from now on."""
        self._hand = hand

    def _application(self) -> web.Application:
        served = guarded(self._access)
        add_get(served, "/hand", self._send_positions)
        add_pages(served, "/{name:(?s:.*)}", self._pages)
        add_get(served, "/{name:(?s:.*)}", self._file)
        return served

    async def _file(self, request: web.Request) -> web.StreamResponse:
        if request.match_info["name"] != self._name:
            raise web.HTTPNotFound
        headers = {
            "Content-Type": MEDIA_TYPE,
            "X-Content-Type-Options": "nosniff",
            "Cache-Control": "no-cache",
        }
        return await send_file(request, self._stream, headers)

    async def _send_positions(self, request: web.Request) -> web.StreamResponse:
        """Send the hand's position in the field, metres, and the medium's time, seconds, when they change."""
        socket = await open_socket(request)
        before: tuple[float, ...] = ()
        with suppress(ConnectionError):
            while not (socket.closed or self._is_over.is_set()):
                hand = self._hand
                now = () if hand is None else (*hand.position_m, hand.media_s)
                if now and now != before:
                    async with dropped_unless_read(request, _PATIENCE_S):
                        await socket.send_json(now)
                    before = now
                await asyncio.sleep(_PERIOD_S)
        return socket
