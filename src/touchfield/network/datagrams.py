"""Sends messages as UDP datagrams that survive losses: adds repair data (forward error correction) and
spreads each message over time. This file only converts; `udp` sends.

A message (`touchfield.network.live`) is cut into symbols, to which RaptorQ (RFC 6330) adds repair symbols.
Any set of as many symbols as the message has, rarely one or two more, restores it. The datagrams of a message
are spread over the time of the following messages, so that a burst of losses hits only a few of each. This
module uses no sockets.

A datagram: magic, stream u32, number u32, bytes of the message u32, bytes of a symbol u16, CRC-32 of the rest
u32, then RaptorQ's packet of 4 bytes and a symbol. With a token the stream is a u64, and a message
authentication code (HMAC, RFC 2104) takes the place of the CRC.
"""

from __future__ import annotations

import hashlib
import hmac
import struct
import time
import zlib
from collections import deque
from collections.abc import Callable
from functools import lru_cache
from itertools import zip_longest
from typing import Any, Final, NamedTuple

from touchfield.container.records import MAGIC
from touchfield.errors import InvalidArgument, import_extra
from touchfield.network.live import MAX_BYTES

raptorq = import_extra("raptorq", "datagrams with parity", "raptorq", "broadcast")

_MAGIC, _KEYED_MAGIC = b"TF", b"TK"
_HEAD: Final = struct.Struct("<2sIIIHI")
_KEYED_HEAD: Final = struct.Struct("<2sQIIH16s")
_MAC: Final = 16
"""Bytes of the code of a keyed datagram: the first half of HMAC-SHA-256."""

_SALT: Final = b"touchfield datagrams"
_ROUNDS: Final = 600_000
"""Rounds of PBKDF2 (RFC 8018), which make each guess of a token from a recorded datagram cost a quarter of a
second."""

_MIN_TOKEN: Final = 8
_PACKET: Final = 4
_SYMBOLS: Final = 36
"""Minimum number of symbols of a message; with fewer symbols the fraction of repair symbols grows."""

_MIN_REPAIR: Final = 3
_SPREAD: Final = 8
"""Number of messages over whose time the datagrams of one message are spread."""

_MIN_SYMBOL, _MAX_SYMBOL = 128, 1152
_BLOCK: Final = 56403
"""Symbols of a block of RFC 6330, at most; its number is the first byte of a packet."""

MAX_DATAGRAM: Final = _KEYED_HEAD.size + _PACKET + _MAX_SYMBOL
MAX_OPEN: Final = 24
"""Maximum number of incomplete messages."""

_MAX_WAITING_BYTES: Final = 1 << 27
"""Maximum total size of the incomplete messages in bytes; above it the oldest is given up."""

_SILENT_S: Final = 2.0
_MAX_CANDIDATES: Final = 16
_MAX_PAST: Final = 4096
"""Maximum number of earlier streams whose position is remembered."""

MAX_NUMBER: Final = (1 << 32) - 1
"""Number of the last message of a stream; another stream follows."""

_NEEDS_TOKEN: Final = "datagrams of a sender with a token arrive: add ?token=WORD to the address"
_NEEDS_NO_TOKEN: Final = "datagrams without a token arrive and are refused: does the sender have --token?"
_OTHER_TOKEN: Final = "datagrams of another token, or forged ones, arrive and are refused"
_EARLIER: Final = (
    "datagrams of an earlier stream are refused: a recording, or the clock of the sender was set back (open "
    "it again)"
)


@lru_cache(8)
def _key(token: str) -> bytes:
    """Return the key of a token: PBKDF2 with HMAC-SHA-256, 32 bytes.

    Raises InvalidArgument if the token is shorter than 8 characters.
    """
    if len(token) < _MIN_TOKEN:
        raise InvalidArgument("token", f"{len(token)} characters", f"{_MIN_TOKEN} or more")
    return hashlib.pbkdf2_hmac("sha256", token.encode("utf-8", "surrogatepass"), _SALT, _ROUNDS)


def stream_of_time(time_ns: int, is_coarse: bool) -> int:
    """Return the identifier of a stream with a token: microseconds since 1970, odd for a coarse layer."""
    return (time_ns // 2000 << 1 | is_coarse) & 0xFFFFFFFFFFFFFFFF


class Datagrams:
    """Sending end: converts messages to datagrams.

    Parameters
    ----------
    stream : int
        Identifier of this stream among others that may reach the same receiver, 0 to 2^32 - 1; with a token
        that of `stream_of_time`, larger than those of earlier streams.
    repair : float
        Number of repair symbols as a fraction of the other symbols; InvalidArgument if it is not 0 to 4.
    token : str, optional
        Secret of sender and receivers, from which the key of each datagram's code is derived; at least 8
        characters.
    """

    def __init__(self, stream: int, repair: float = 0.22, token: str | None = None) -> None:
        if not 0 <= repair <= 4:
            raise InvalidArgument("repair", f"{repair:g}", "0 to 4, such as 0.22")
        self._stream, self._repair, self._number = stream, repair, 0
        self._key = None if token is None else _key(token)
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
        self._number += 1
        if self._number > MAX_NUMBER:  # a receiver lets no number go back
            self._number, self._stream = 0, self._following_stream()
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

    def _following_stream(self) -> int:
        return self._stream + 2 if self._key is not None else (self._stream + 1) & 0xFFFFFFFF

    def _datagram(self, length: int, symbol: int, packet: bytes) -> bytes:
        values = (self._stream, self._number, length, symbol)
        if self._key is None:
            return _HEAD.pack(_MAGIC, *values, _checksum(values, packet)) + packet
        return _KEYED_HEAD.pack(_KEYED_MAGIC, *values, _code(self._key, values, packet)) + packet


_Values = tuple[int, int, int, int]
"""Stream, number, bytes of the message, and bytes of a symbol."""


def _checksum(values: _Values, packet: bytes) -> int:
    return zlib.crc32(packet, zlib.crc32(_HEAD.pack(_MAGIC, *values, 0)))


def _code(key: bytes, values: _Values, packet: bytes) -> bytes:
    return hmac.digest(key, _KEYED_HEAD.pack(_KEYED_MAGIC, *values, bytes(_MAC)) + packet, "sha256")[:_MAC]


class _Datagram(NamedTuple):
    """A parsed datagram with a valid checksum or code."""

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
        self.packets = set[bytes]()
        """Payload identifiers of the packets that were received."""

        self.remaining = 2 * (-(-length // symbol)) + 64
        """Number of further datagrams that are accepted."""


class Gathering:
    """The receiving end of one stream: datagrams in, messages out in order.

    Numbers of a stream never go back, and no message is delivered twice: what was received before, and is
    sent again by anyone, has no effect. Another stream may replace the first after two seconds in which it
    brought nothing new.

    Without a token anyone may send. The first stream received is used. A second datagram must confirm its
    first number, another stream, and a number more than `_SPREAD` above the newest, which needs the same
    silence. A stream has one opening, and a forged datagram costs one message.

    With a token, datagrams without the code of its key are refused. A later stream of the same layer replaces
    an earlier one at once, never the other way.

    Parameters
    ----------
    max_open : int
        Maximum number of incomplete messages, 1 to 24; fewer if another layer covers losses.
    clock_s : callable
        Clock; returns seconds.
    token : str, optional
        Secret of sender and receivers.

    Attributes
    ----------
    refused : int
        Number of datagrams that were damaged, forged, old or of another stream.
    lost : int
        Number of messages that were given up.
    notes : list of str
        Why datagrams are refused, each reason once; the caller may clear it.
    """

    def __init__(
        self,
        max_open: int = MAX_OPEN,
        clock_s: Callable[[], float] = time.monotonic,
        token: str | None = None,
    ) -> None:
        self._stream: int | None = None
        self._is_confirmed = False
        self._key = None if token is None else _key(token)
        self._clock_s, self._received_s = clock_s, clock_s()
        self._next, self._newest = 0, -1
        self._max_open, self._opening = max_open, b""
        self._parts: dict[int, _Part] = {}
        self._candidates: deque[_Datagram] = deque(maxlen=_MAX_CANDIDATES)
        self._past: dict[int, int] = {}
        self._noted: set[str] = set()
        self.notes: list[str] = []
        self.refused = self.lost = 0

    def receive(self, datagram: bytes) -> list[bytes]:
        """Take a datagram; return the messages that are now complete and next in order."""
        parsed = _parse(datagram, self._key)
        if parsed is None:
            if self._stream is None:
                self._note(_mismatch(datagram, self._key))
            return self._refuse()
        if self._stream is None:  # followed once a second datagram confirms it
            self._stream, self._received_s = parsed.stream, self._clock_s()
        if self._is_confirmed and parsed.stream == self._stream and self._is_near(parsed.number):
            return self._accept(parsed)
        if not self._is_later(parsed):
            return self._refuse()
        confirming = [
            candidate
            for candidate in self._candidates
            if candidate != parsed
            and candidate.stream == parsed.stream
            and abs(candidate.number - parsed.number) <= _SPREAD
        ]
        is_first = not self._is_confirmed and parsed.stream == self._stream
        is_silent = self._clock_s() - self._received_s > _SILENT_S
        if self._key is None and not (confirming and (is_first or is_silent)):
            self._candidates.append(parsed)
            return [] if is_first else self._refuse()
        received = [*confirming, parsed]
        if not self._is_confirmed or parsed.stream != self._stream:
            self._follow(parsed.stream, min(candidate.number for candidate in received))
        self._candidates.clear()
        return [message for candidate in received for message in self._accept(candidate)]

    def _is_near(self, number: int) -> bool:
        """Return True for a number of the followed stream that needs no confirmation."""
        if self._key is not None:
            return number >= self._newest - MAX_OPEN
        return -MAX_OPEN <= number - self._newest <= _SPREAD

    def _is_later(self, datagram: _Datagram) -> bool:
        """Return True unless the datagram is older than what was received of its stream, or its stream is."""
        stream = self._stream
        if datagram.stream == stream:
            return datagram.number > self._newest
        if self._key is None or stream is None:
            return datagram.number >= self._past.get(datagram.stream, 0)
        is_same_layer = (datagram.stream ^ stream) & 1 == 0
        if is_same_layer and datagram.stream < stream:
            self._note(_EARLIER)
        return is_same_layer and datagram.stream > stream

    def _follow(self, stream: int, number: int) -> None:
        """Follow another stream from a number on, and remember where the last one was left."""
        if self._stream is not None and self._is_confirmed:
            self._past.pop(self._stream, None)
            self._past[self._stream] = max(self._next, self._newest + 1)
            if len(self._past) > _MAX_PAST:
                self._past.pop(next(iter(self._past)))
        self._stream, self._is_confirmed, self._next, self._newest = stream, True, number, -1
        self._parts, self._opening = {}, b""

    def _refuse(self) -> list[bytes]:
        self.refused += 1
        return []

    def _note(self, note: str | None) -> None:
        if note is not None and note not in self._noted:
            self._noted.add(note)
            self.notes.append(note)

    def _accept(self, datagram: _Datagram) -> list[bytes]:
        if datagram.number < self._next:
            return []  # late, or redundant
        self._newest = max(self._newest, datagram.number)
        part = self._parts.get(datagram.number)
        if part is None:
            part = self._parts[datagram.number] = _Part(datagram.length, datagram.symbol)
        identifier = datagram.packet[:_PACKET]
        if (part.length, part.symbol) != (datagram.length, datagram.symbol) or part.remaining <= 0:
            self.refused += 1
        elif part.message is None and identifier not in part.packets:
            part.packets.add(identifier)
            part.remaining -= 1
            self._received_s = self._clock_s()
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


def _parse(datagram: bytes, key: bytes | None) -> _Datagram | None:
    """Return the values of a datagram; None if it is invalid, or its checksum or code does not match."""
    head = _HEAD if key is None else _KEYED_HEAD
    if not head.size + _PACKET < len(datagram) <= MAX_DATAGRAM:
        return None
    magic, stream, number, length, symbol, check = head.unpack_from(datagram)
    packet = datagram[head.size :]
    is_ours = magic == (_MAGIC if key is None else _KEYED_MAGIC) and 0 < length <= MAX_BYTES
    is_ours &= symbol % 8 == 0 and _MIN_SYMBOL <= symbol <= _MAX_SYMBOL and len(packet) == symbol + _PACKET
    if not is_ours:
        return None
    values = (stream, number, length, symbol)
    is_intact = (
        _checksum(values, packet) == check
        if key is None
        else hmac.compare_digest(_code(key, values, packet), check)
    )
    if not is_intact or not packet[0] * _BLOCK * symbol < length <= symbol * 65536:
        return None
    return _Datagram(*values, packet)


def _mismatch(datagram: bytes, key: bytes | None) -> str | None:
    """Return why a datagram of a whole stream is refused: its form, or its token; None if it is damaged."""
    if datagram[:2] == _KEYED_MAGIC:
        return _NEEDS_TOKEN if key is None else _OTHER_TOKEN
    is_unkeyed = key is not None and _parse(datagram, None) is not None
    return _NEEDS_NO_TOKEN if is_unkeyed else None
