"""Sends a live stream to an address by UDP, and receives one."""

from __future__ import annotations

import asyncio
import secrets
import socket
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any, Final, Literal
from urllib.parse import unquote_plus

from touchfield.errors import InvalidArgument, reason
from touchfield.network.datagrams import MAX_DATAGRAM, MAX_OPEN, Datagrams, Gathering, stream_of_time
from touchfield.network.live import END, LiveSender
from touchfield.options import Address, address

_LAST: Final = b"\0"
"""Message that marks the end of the stream; an empty message cannot be sent."""

_LAST_S: Final = 2.0
"""Time after the end message without another message, after which the stream is over."""

_OPENED_EVERY: Final = 4
"""The opening is repeated before every fourth segment, for late receivers."""

_MAX_PORT: Final = 65535

_LAYERED_OPEN: Final = 11
"""Maximum number of incomplete messages if there is another layer.

Eight are those over whose time a message is spread, and three allow for reordering.
"""

Layer = Literal["alone", "fine", "coarse"]

REPAIR: Final[Mapping[Layer, float]] = {"alone": 0.22, "fine": 0.15, "coarse": 0.4}
"""Fraction of repair symbols by layer. A coarse layer has a seventh of the bytes, replaces lost frames of the
fine one and is protected more. Both together have no larger a fraction of repair symbols than a single
stream.
"""


_WHERE: Final = "address of datagrams"

_Resolved = tuple[socket.AddressFamily, Any]
"""Family of the sockets for an address, and the address as they take it."""


def _parse_address(text: str, where: str = _WHERE) -> Address:
    return address(text.lower().removeprefix("udp://").rstrip("/"), where)


def require_receiver(text: str, where: str, *, is_layered: bool = False) -> None:
    """Raise InvalidArgument that names `where` unless datagrams can be sent to HOST:PORT.

    With `is_layered` they must also have a next port, for a coarse layer.
    """
    _resolve(text, where, "alone")
    if is_layered:
        _resolve(text, where, "coarse")


def _resolve(text: str, where: str, layer: Layer) -> _Resolved:
    """Return where to send the datagrams of a layer."""
    host, port = _parse_address(text, where)
    if layer == "coarse":
        port += 1
        if port > _MAX_PORT:
            found, expected = f"port {port - 1}, with --coarse", f"a port up to {_MAX_PORT - 1}"
            raise InvalidArgument(where, found, expected, "The coarse layer is sent to the next port.")
    try:
        family, _, _, _, to = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
    except OSError as error:
        hint = "Check the name of the host."
        raise InvalidArgument(
            where, f"{text[:80]!r}: {reason(error)}", "a host that is there", hint
        ) from None
    return family, to


def token_of(url: str, where: str = _WHERE) -> str | None:
    """Return the token of an address such as udp://HOST:PORT?token=WORD; None if it has no query.

    Raises InvalidArgument for any other query; the error names `where`.
    """
    _, mark, query = url.partition("?")
    if not mark:
        return None
    name, _, word = query.partition("=")
    if name != "token" or not word or "&" in word:
        raise InvalidArgument(where, "another query", "none, or ?token=WORD")
    return unquote_plus(word, errors="surrogateescape")


def require_listener(url: str, where: str) -> None:
    """Raise InvalidArgument that names `where` unless a text is udp://HOST:PORT, with or without a token."""
    _parse_address(url.partition("?")[0], where)
    token_of(url, where)


class UdpSender:
    """Sends a live stream's messages to an address without waiting; a context manager.

    `layer` sets the protection; a coarse layer is sent to the next port. With a `token`, receivers need it,
    and refuse what others send.
    """

    def __init__(
        self, sender: LiveSender, text: str, layer: Layer = "alone", token: str | None = None
    ) -> None:
        family, self._to = _resolve(text, _WHERE, layer)
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        stream = secrets.randbits(32) if token is None else stream_of_time(time.time_ns(), layer == "coarse")
        self._sender, self._datagrams, self._count = sender, Datagrams(stream, REPAIR[layer], token), 0

    def __enter__(self) -> UdpSender:
        return self

    def __exit__(self, *_: object) -> None:
        self._send([*self._datagrams.add(_LAST), *self._datagrams.flush()])
        self._socket.close()

    def add(self, message: bytes) -> None:
        """Send a segment's message, and parts of earlier ones."""
        if self._count % _OPENED_EVERY == 0:
            self._send(self._datagrams.add(self._sender.opening))
        self._count += 1
        self._send(self._datagrams.add(message))

    def _send(self, datagrams: list[bytes]) -> None:
        for datagram in datagrams:
            with suppress(OSError):  # the send buffer is full, or nobody listens
                self._socket.sendto(datagram, self._to)


class _Protocol(asyncio.DatagramProtocol):
    def __init__(self, queue: asyncio.Queue[bytes]) -> None:
        self._queue = queue

    def datagram_received(self, data: bytes, addr: object) -> None:
        """Queue a datagram; drop it if it is too long or the queue is full."""
        if len(data) <= MAX_DATAGRAM and not self._queue.full():
            self._queue.put_nowait(data)


async def listen(
    text: str,
    take: Callable[[bytes], bool],
    is_layered: bool = False,
    report: Callable[[str], None] = lambda note: None,
) -> None:
    """Receive datagrams at an address, with its token if it has one, until the stream is over.

    That is when ``take(message)`` returns True.

    With `is_layered` another layer covers losses, so that lost messages are given up earlier. `report` is
    called with the reason why datagrams of a sender are refused.
    """
    host, port = _parse_address(text.partition("?")[0])
    gathering, queue = (
        Gathering(max_open=_LAYERED_OPEN if is_layered else MAX_OPEN, token=token_of(text)),
        asyncio.Queue[bytes](1 << 14),
    )
    loop = asyncio.get_running_loop()
    transport, _ = await loop.create_datagram_endpoint(lambda: _Protocol(queue), local_addr=(host, port))
    is_last = False
    try:
        while True:
            try:
                datagram = await asyncio.wait_for(queue.get(), _LAST_S if is_last else None)
            except TimeoutError:
                await asyncio.to_thread(take, END)
                return
            messages = gathering.receive(datagram)
            while gathering.notes:
                report(gathering.notes.pop(0))
            for message in messages:
                is_last = message == _LAST
                if not is_last and await asyncio.to_thread(take, message):
                    return
    finally:
        transport.close()
