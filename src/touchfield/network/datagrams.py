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
from touchfield.network.live import MAX_BYTES

raptorq = import_extra("raptorq", "datagrams with parity", "raptorq", "broadcast")

_MAGIC: Final = b"TF"
_HEAD: Final = struct.Struct("<2sIIIHI")
_PACKET: Final = 4
_SYMBOLS: Final = 36
"""Least number of pieces of a message: the fewer there are, the larger the share of repair."""

_MIN_REPAIR: Final = 3
_SPREAD: Final = 8
"""Messages over whose time the datagrams of one are spread; the last ones come so many messages later."""

_MIN_SYMBOL, _MAX_SYMBOL = 128, 1152
_BLOCK: Final = 56403
"""Symbols of a block of RFC 6330, at most; its number is the first byte of a packet."""

MAX_DATAGRAM: Final = _HEAD.size + _PACKET + _MAX_SYMBOL
MAX_OPEN: Final = 24
"""Messages that are waited for at once."""

_MAX_WAITING_BYTES: Final = 1 << 27
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
        """All that is waiting still, at the end of a stream."""
        datagrams: list[bytes] = []
        while self._waiting:
            datagrams += self._due()
        return datagrams

    def _due(self) -> list[bytes]:
        turns = zip_longest(
            *(parts.pop(0) for parts in self._waiting)
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
        self.remaining = 2 * (-(-length // symbol)) + 64
        """Datagrams that are looked at, whatever comes."""


class Gathering:
    """The receiving end of the first stream that comes: datagrams in, messages out, in their order, whatever
    comes.

    Where none of its datagrams has come for two seconds, another stream that comes takes its place. One
    datagram alone, forged, costs one message: another datagram must bear out what it tells of another stream,
    or of a number further than `_SPREAD` above the newest or `MAX_OPEN` below it, and a stream has one
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

    def __init__(self, max_open: int = MAX_OPEN, clock_s: Callable[[], float] = time.monotonic) -> None:
        self._stream: int | None = None
        self._clock_s, self._received_s = clock_s, clock_s()
        self._next, self._newest = 0, -1
        self._max_open, self._opening = max_open, b""
        self._parts: dict[int, _Part] = {}
        self._unconfirmed: _Datagram | None = None
        self.refused = self.lost = 0

    def receive(self, datagram: bytes) -> list[bytes]:
        """Take a datagram; the messages that are whole now, and next in order."""
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
            return []  # late, or what was sent beyond need
        self._newest = max(self._newest, datagram.number)
        part = self._parts.get(datagram.number)
        if part is None:
            part = self._parts[datagram.number] = _Part(datagram.length, datagram.symbol)
        if part.message is not None:
            return []  # what was sent beyond need
        if (part.length, part.symbol) != (datagram.length, datagram.symbol) or part.remaining <= 0:
            self.refused += 1
        else:
            part.remaining -= 1
            is_repeated = datagram.length == len(self._opening) and datagram.packet[_PACKET:] in self._opening
            part.message = self._opening if is_repeated else part.decoder.decode(datagram.packet)
            if part.message is not None and part.message.startswith(MAGIC):
                self._opening = self._opening or part.message  # told again, it holds up no segment behind it
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
