"""Sends messages as UDP datagrams that survive losses: adds repair data (forward error correction) and
spreads each message over time. This file only converts; `udp` sends.

A message (`touchfield.network.live`) is cut into symbols, to which RaptorQ (RFC 6330) adds repair symbols.
Any set of as many symbols as the message has, rarely one or two more, restores it. The datagrams of a message
are spread over the time of the following messages, so that a burst of losses hits only a few of each. This
module uses no sockets.

A datagram: magic, stream u32, number u32, bytes of the message u32, bytes of a symbol u16, CRC-32 of the rest
u32, then RaptorQ's packet of 4 bytes and a symbol.
"""

from __future__ import annotations

import struct
import time
import zlib
from collections import deque
from collections.abc import Callable
from itertools import zip_longest
from typing import Any, Final, NamedTuple

from touchfield.container.records import MAGIC
from touchfield.errors import InvalidArgument, import_extra
from touchfield.network.live import MAX_BYTES

raptorq = import_extra("raptorq", "datagrams with parity", "raptorq", "broadcast")

_MAGIC: Final = b"TF"
_HEAD: Final = struct.Struct("<2sIIIHI")
_PACKET: Final = 4
_SYMBOLS: Final = 36
"""Minimum number of symbols of a message; with fewer symbols the fraction of repair symbols grows."""

_MIN_REPAIR: Final = 3
_SPREAD: Final = 8
"""Number of messages over whose time the datagrams of one message are spread."""

_MIN_SYMBOL, _MAX_SYMBOL = 128, 1152
_BLOCK: Final = 56403
"""Symbols of a block of RFC 6330, at most; its number is the first byte of a packet."""

MAX_DATAGRAM: Final = _HEAD.size + _PACKET + _MAX_SYMBOL
MAX_OPEN: Final = 24
"""Maximum number of incomplete messages."""

_MAX_WAITING_BYTES: Final = 1 << 27
"""Maximum total size of the incomplete messages in bytes; above it the oldest is given up."""

_SILENT_S: Final = 2.0


class Datagrams:
    """Sending end: converts messages to datagrams.

    Parameters
    ----------
    stream : int
        Identifier of this stream among others that may reach the same receiver, 0 to 2^32 - 1.
    repair : float
        Number of repair symbols as a fraction of the other symbols; InvalidArgument if it is not 0 to 4.
    """

    def __init__(self, stream: int, repair: float = 0.22) -> None:
        if not 0 <= repair <= 4:
            raise InvalidArgument("repair", f"{repair:g}", "0 to 4, such as 0.22")
        self._stream, self._repair, self._number = stream, repair, 0
        self._waiting: deque[list[list[bytes]]] = deque()

    def add(self, message: bytes) -> list[bytes]:
        """Add a message; return the datagrams to be sent now.

        These are parts of this message and of earlier ones.
        """
        if not 0 < len(message) <= MAX_BYTES:
            raise InvalidArgument("message", f"{len(message)} bytes", f"1 to {MAX_BYTES}")
        symbol = min(max(-(-len(message) // _SYMBOLS), _MIN_SYMBOL), _MAX_SYMBOL) // 8 * 8
        packets = raptorq.Encoder.with_defaults(message, symbol + _PACKET).get_encoded_packets(
            max(_MIN_REPAIR, round(self._repair * -(-len(message) // symbol)))
        )
        datagrams = [self._datagram(len(message), symbol, packet) for packet in packets]
        self._number = (self._number + 1) & 0xFFFFFFFF
        self._waiting.append([datagrams[i::_SPREAD] for i in range(_SPREAD)])
        return self._due()

    def flush(self) -> list[bytes]:
        """Return all remaining datagrams, at the end of a stream."""
        datagrams: list[bytes] = []
        while self._waiting:
            datagrams += self._due()
        return datagrams

    def _due(self) -> list[bytes]:
        turns = zip_longest(
            *(parts.pop(0) for parts in self._waiting)
        )  # interleaved, so that messages share bursts of losses
        datagrams = [datagram for turn in turns for datagram in turn if datagram is not None]
        while self._waiting and not self._waiting[0]:
            self._waiting.popleft()
        return datagrams

    def _datagram(self, length: int, symbol: int, packet: bytes) -> bytes:
        head = (_MAGIC, self._stream, self._number, length, symbol)
        crc = zlib.crc32(packet, zlib.crc32(_HEAD.pack(*head, 0)))
        return _HEAD.pack(*head, crc) + packet


class _Datagram(NamedTuple):
    """A parsed datagram with a valid checksum."""

    stream: int
    number: int
    length: int
    symbol: int
    packet: bytes


class _Part:
    """An incomplete message."""

    def __init__(self, length: int, symbol: int) -> None:
        self.length, self.symbol = length, symbol
        self.decoder: Any = raptorq.Decoder.with_defaults(length, symbol + _PACKET)
        self.message: bytes | None = None
        self.remaining = 2 * (-(-length // symbol)) + 64
        """Number of further datagrams that are accepted."""


class Gathering:
    """The receiving end of one stream: datagrams in, messages out in order.

    The first stream received is used; another stream may replace it after two seconds without any of its
    datagrams. A single forged datagram costs one message: a switch to another stream, or to a number more
    than `_SPREAD` above the newest or `MAX_OPEN` below it, must be confirmed by a second datagram, and a
    stream has one opening. If the forged datagram is the first of all, it costs as many messages as may be
    incomplete, or the first two seconds.

    Parameters
    ----------
    max_open : int
        Maximum number of incomplete messages, 1 to 24; fewer if another layer covers losses.
    clock_s : callable
        Clock; returns seconds.

    Attributes
    ----------
    refused : int
        Number of datagrams that were damaged or of another stream.
    lost : int
        Number of messages that were given up.
    """

    def __init__(self, max_open: int = MAX_OPEN, clock_s: Callable[[], float] = time.monotonic) -> None:
        self._stream: int | None = None
        self._clock_s, self._received_s = clock_s, clock_s()
        self._next, self._newest = 0, -1
        self._max_open, self._opening = max_open, b""
        self._parts: dict[int, _Part] = {}
        self._unconfirmed: _Datagram | None = None
        self.refused = self.lost = 0

    def receive(self, datagram: bytes) -> list[bytes]:
        """Take a datagram; return the messages that are now complete and next in order."""
        parsed = _parse(datagram)
        if parsed is None:
            self.refused += 1
            return []
        now = self._clock_s()
        if parsed.stream == self._stream and -MAX_OPEN <= parsed.number - self._newest <= _SPREAD:
            self._received_s = now
            return self._accept(parsed)
        earlier, self._unconfirmed = self._unconfirmed or parsed, parsed
        is_confirmed = (
            earlier != parsed
            and earlier.stream == parsed.stream
            and abs(earlier.number - parsed.number) <= _SPREAD
        )
        is_confirmed &= parsed.stream == self._stream or now - self._received_s > _SILENT_S
        if not is_confirmed and self._stream is not None:
            self.refused += 1
            return []
        if parsed.stream != self._stream or parsed.number < self._newest:
            self._stream, self._next, self._newest = parsed.stream, min(parsed.number, earlier.number), -1
            self._parts, self._opening = {}, b""
        self._received_s, self._unconfirmed = now, None
        return [
            message
            for parsed_datagram in dict.fromkeys((earlier, parsed))
            for message in self._accept(parsed_datagram)
        ]

    def _accept(self, datagram: _Datagram) -> list[bytes]:
        if datagram.number < self._next:
            return []  # late, or redundant
        self._newest = max(self._newest, datagram.number)
        part = self._parts.get(datagram.number)
        if part is None:
            part = self._parts[datagram.number] = _Part(datagram.length, datagram.symbol)
        if part.message is not None:
            return []  # redundant
        if (part.length, part.symbol) != (datagram.length, datagram.symbol) or part.remaining <= 0:
            self.refused += 1
        else:
            part.remaining -= 1
            is_repeated = datagram.length == len(self._opening) and datagram.packet[_PACKET:] in self._opening
            part.message = self._opening if is_repeated else part.decoder.decode(datagram.packet)
            if part.message is not None and part.message.startswith(MAGIC):
                self._opening = self._opening or part.message  # a repeated opening delays no later segment
                part.message = self._opening  # a stream has no other
        return self._release()

    def _release(self) -> list[bytes]:
        messages: list[bytes] = []
        while self._parts:
            part = self._parts.get(self._next)
            following = self._next + 1
            if part is not None and part.message is not None:
                messages.append(part.message)
            elif (
                self._newest - self._next < self._max_open
                and sum(part_size.length for part_size in self._parts.values()) <= _MAX_WAITING_BYTES
            ):
                break
            else:
                oldest = self._newest - self._max_open + 1
                following = max(
                    following, min([oldest, *(number for number in self._parts if number > self._next)])
                )
                self.lost += following - self._next
            self._parts.pop(self._next, None)
            self._next = following
        return messages


def _parse(datagram: bytes) -> _Datagram | None:
    if not _HEAD.size + _PACKET < len(datagram) <= MAX_DATAGRAM:
        return None
    magic, stream, number, length, symbol, crc = _HEAD.unpack_from(datagram)
    packet = datagram[_HEAD.size :]
    is_ours = magic == _MAGIC and 0 < length <= MAX_BYTES
    is_ours &= symbol % 8 == 0 and _MIN_SYMBOL <= symbol <= _MAX_SYMBOL and len(packet) == symbol + _PACKET
    is_ours &= packet[0] * _BLOCK * symbol < length <= symbol * 65536
    if (
        not is_ours
        or zlib.crc32(packet, zlib.crc32(_HEAD.pack(magic, stream, number, length, symbol, 0))) != crc
    ):
        return None
    return _Datagram(stream, number, length, symbol, packet)
