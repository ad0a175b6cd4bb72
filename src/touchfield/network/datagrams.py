"""Messages over a network that loses, delays, repeats and damages: datagrams with parity, sent interleaved.

A message (`touchfield.network.live`) is cut into symbols, to which RaptorQ (RFC 6330) adds repair symbols;
any that are as many as the first, and rarely one or two more, give it back. The datagrams of a message are
spread over the time of the next ones too, so that a burst of losses takes a few of each. No sockets here:
datagrams in, messages out.

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
from touchfield.network.live import MOST_BYTES

raptorq = import_extra("raptorq", "datagrams with parity", "raptorq", "broadcast")

_MAGIC: Final = b"TF"
_HEAD: Final = struct.Struct("<2sIIIHI")
_PACKET: Final = 4
_SYMBOLS: Final = 36
"""Least number of pieces of a message: the fewer there are, the larger the share of repair."""

_LEAST_REPAIR: Final = 3
_SPREAD: Final = 8
"""Messages over whose time the datagrams of one are spread; the last ones come so many messages later."""

_LEAST_SYMBOL, _MOST_SYMBOL = 128, 1152
_BLOCK: Final = 56403
"""Symbols of a block of RFC 6330, at most; its number is the first byte of a packet."""

MOST_DATAGRAM: Final = _HEAD.size + _PACKET + _MOST_SYMBOL
MOST_OPEN: Final = 24
"""Messages that are waited for at once."""

_MOST_WAITING: Final = 1 << 27
"""Bytes of the messages that are waited for; beyond, the oldest is given up."""

_SILENT_S: Final = 2.0


class Datagrams:
    """The sending end.

    Parameters
    ----------
    stream : int
        Names this stream among others that may come to the same place, 0 to 2^32 - 1.
    repair : float
        Repair symbols, share of the others; InvalidArgument if it is not 0 to 4.
    """

    def __init__(self, stream: int, repair: float = 0.22) -> None:
        if not 0 <= repair <= 4:
            raise InvalidArgument("repair", f"{repair:g}", "0 to 4, such as 0.22")
        self._stream, self._repair, self._number = stream, repair, 0
        self._waiting: deque[list[list[bytes]]] = deque()

    def add(self, message: bytes) -> list[bytes]:
        """The datagrams to be sent now that there is a further message: some of it, and some of those before."""
        if not 0 < len(message) <= MOST_BYTES:
            raise InvalidArgument("message", f"{len(message)} bytes", f"1 to {MOST_BYTES}")
        symbol = min(max(-(-len(message) // _SYMBOLS), _LEAST_SYMBOL), _MOST_SYMBOL) // 8 * 8
        packets = raptorq.Encoder.with_defaults(message, symbol + _PACKET).get_encoded_packets(
            max(_LEAST_REPAIR, round(self._repair * -(-len(message) // symbol)))
        )
        datagrams = [self._datagram(len(message), symbol, packet) for packet in packets]
        self._number = (self._number + 1) & 0xFFFFFFFF
        self._waiting.append([datagrams[i::_SPREAD] for i in range(_SPREAD)])
        return self._due()

    def flush(self) -> list[bytes]:
        """All that is waiting still, at the end of a stream."""
        datagrams: list[bytes] = []
        while self._waiting:
            datagrams += self._due()
        return datagrams

    def _due(self) -> list[bytes]:
        turns = zip_longest(
            *(shares.pop(0) for shares in self._waiting)
        )  # one of each in turn: bursts are shared
        datagrams = [datagram for turn in turns for datagram in turn if datagram is not None]
        while self._waiting and not self._waiting[0]:
            self._waiting.popleft()
        return datagrams

    def _datagram(self, length: int, symbol: int, packet: bytes) -> bytes:
        head = (_MAGIC, self._stream, self._number, length, symbol)
        crc = zlib.crc32(packet, zlib.crc32(_HEAD.pack(*head, 0)))
        return _HEAD.pack(*head, crc) + packet


class _Datagram(NamedTuple):
    """A datagram that is whole, and one of a stream."""

    stream: int
    number: int
    length: int
    symbol: int
    packet: bytes


class _Part:
    """A message that is waited for."""

    def __init__(self, length: int, symbol: int) -> None:
        self.length, self.symbol = length, symbol
        self.decoder: Any = raptorq.Decoder.with_defaults(length, symbol + _PACKET)
        self.message: bytes | None = None
        self.most = 2 * (-(-length // symbol)) + 64
        """Datagrams that are looked at, whatever comes."""


class Gathering:
    """The receiving end of the first stream that comes: datagrams in, messages out, in their order, whatever
    comes.

    Where none of its datagrams has come for two seconds, another stream that comes takes its place. One
    datagram alone, forged, costs one message: another datagram must bear out what it tells of another stream,
    or of a number further than `_SPREAD` above the newest or `MOST_OPEN` below it, and a stream has one
    opening. Where it is the first of all, it costs as many messages as are waited for, or the first two
    seconds.

    Parameters
    ----------
    most_open : int
        Messages that are waited for at once; fewer where something else is felt meanwhile, 1 to 24.
    clock_s : callable
        Seconds.

    Attributes
    ----------
    refused : int
        Datagrams that are damaged or foreign.
    lost : int
        Messages that were given up.
    """

    def __init__(self, most_open: int = MOST_OPEN, clock_s: Callable[[], float] = time.monotonic) -> None:
        self._stream: int | None = None
        self._clock_s, self._came_s = clock_s, clock_s()
        self._next, self._newest = 0, -1
        self._most_open, self._opening = most_open, b""
        self._parts: dict[int, _Part] = {}
        self._doubted: _Datagram | None = None
        self.refused = self.lost = 0

    def receive(self, datagram: bytes) -> list[bytes]:
        """Take a datagram; the messages that are whole now, and next in order."""
        one = _told(datagram)
        if one is None:
            self.refused += 1
            return []
        now = self._clock_s()
        if one.stream == self._stream and -MOST_OPEN <= one.number - self._newest <= _SPREAD:
            self._came_s = now
            return self._taken(one)
        doubted, self._doubted = self._doubted or one, one
        is_borne_out = (
            doubted != one and doubted.stream == one.stream and abs(doubted.number - one.number) <= _SPREAD
        )
        is_borne_out &= one.stream == self._stream or now - self._came_s > _SILENT_S
        if not is_borne_out and self._stream is not None:
            self.refused += 1
            return []
        if one.stream != self._stream or one.number < self._newest:
            self._stream, self._next, self._newest = one.stream, min(one.number, doubted.number), -1
            self._parts, self._opening = {}, b""
        self._came_s, self._doubted = now, None
        return [message for each in dict.fromkeys((doubted, one)) for message in self._taken(each)]

    def _taken(self, one: _Datagram) -> list[bytes]:
        if one.number < self._next:
            return []  # late, or what was sent beyond need
        self._newest = max(self._newest, one.number)
        part = self._parts.get(one.number)
        if part is None:
            part = self._parts[one.number] = _Part(one.length, one.symbol)
        if part.message is not None:
            return []  # what was sent beyond need
        if (part.length, part.symbol) != (one.length, one.symbol) or part.most <= 0:
            self.refused += 1
        else:
            part.most -= 1
            is_told_again = one.length == len(self._opening) and one.packet[_PACKET:] in self._opening
            part.message = self._opening if is_told_again else part.decoder.decode(one.packet)
            if part.message is not None and part.message.startswith(MAGIC):
                self._opening = self._opening or part.message  # told again, it holds up no segment behind it
                part.message = self._opening  # a stream has no other
        return self._released()

    def _released(self) -> list[bytes]:
        messages: list[bytes] = []
        while self._parts:
            part = self._parts.get(self._next)
            beyond = self._next + 1
            if part is not None and part.message is not None:
                messages.append(part.message)
            elif (
                self._newest - self._next < self._most_open
                and sum(one.length for one in self._parts.values()) <= _MOST_WAITING
            ):
                break
            else:
                least = self._newest - self._most_open + 1
                beyond = max(beyond, min([least, *(number for number in self._parts if number > self._next)]))
                self.lost += beyond - self._next
            self._parts.pop(self._next, None)
            self._next = beyond
        return messages


def _told(datagram: bytes) -> _Datagram | None:
    if not _HEAD.size + _PACKET < len(datagram) <= MOST_DATAGRAM:
        return None
    magic, stream, number, length, symbol, crc = _HEAD.unpack_from(datagram)
    packet = datagram[_HEAD.size :]
    is_ours = magic == _MAGIC and 0 < length <= MOST_BYTES
    is_ours &= symbol % 8 == 0 and _LEAST_SYMBOL <= symbol <= _MOST_SYMBOL and len(packet) == symbol + _PACKET
    is_ours &= packet[0] * _BLOCK * symbol < length <= symbol * 65536
    if (
        not is_ours
        or zlib.crc32(packet, zlib.crc32(_HEAD.pack(magic, stream, number, length, symbol, 0))) != crc
    ):
        return None
    return _Datagram(stream, number, length, symbol, packet)
