"""A live stream without sockets: messages in, events out; who carries the messages is another's matter.

A live stream is the beginning of a file that does not end (docs/format/live.md): its *opening*, which is magic,
version, HEAD with the greatest frame count there is, and PROV; then *segments*, each a SEGM, and before it a VIBR
where something vibrates. Every message holds one opening or one segment whole, so that a message that is lost, late,
told twice or damaged costs only itself. An empty message says that the stream has ended.

The sender keeps the opening and the latest segments, and nothing for a receiver but how far it is: one that is slow
is moved on to the newest segment.
"""

from __future__ import annotations

import io
import struct
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from enum import Enum
from threading import Lock
from typing import IO, Any, Final

from touchfield.container.records import MAGIC, Head, Pair, Provenance, Segment, SegmentEntry, Vibration
from touchfield.container.wire import (
    CRC_SIZE,
    OPENING_SIZE,
    ByteSource,
    encode_opening,
    encode_record,
    find_record,
    read_opening,
    read_record,
)
from touchfield.container.writer import index_and_end
from touchfield.errors import CorruptFile, FormatError, InvalidArgument, SourceError
from touchfield.files import exactly

MEDIA_TYPE: Final = "haptics/vnd.touchfield"
"""Of a ``.touch`` file (RFC 9695 makes the tree; haptics/hmpg is MPEG's)."""

ENDLESS: Final = (1 << 31) - 1
"""`HEAD.frame_count` of a live stream."""

MOST_BYTES: Final = 1 << 26
"""Of a message."""

KEPT: Final = 4
"""Segments that a sender keeps for those who come late."""

END: Final = b""
"""The message that the stream has ended."""


# -- events ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Opened:
    """A programme has begun: its head, and where it comes from."""

    head: Head
    provenance: Mapping[str, str]


@dataclass(frozen=True)
class LiveSegment:
    """Frames that can be decoded: the body of a segment, and what vibrates beside it."""

    first_frame: int
    frame_count: int
    body: bytes
    vibration: bytes | None = None

    @property
    def stop(self) -> int:
        """The first frame behind it."""
        return self.first_frame + self.frame_count


@dataclass(frozen=True)
class Lost:
    """Frames that did not come before those behind them."""

    first_frame: int
    frame_count: int


@dataclass(frozen=True)
class Refused:
    """A message that was of no use, and why."""

    reason: str


@dataclass(frozen=True)
class Ended:
    """The sender has ended the stream."""


Event = Opened | LiveSegment | Lost | Refused | Ended


class _State(Enum):
    WAITING = "no opening yet"
    OPEN = "segments"
    ENDED = "over"


class _Kind(Enum):
    OPENING = "an opening"
    SEGMENT = "a segment"
    END = "the end"
    OTHER = "neither an opening nor a segment"


_NEXT: Final = {
    (_State.WAITING, _Kind.OPENING): _State.OPEN,
    (_State.WAITING, _Kind.END): _State.ENDED,
    (_State.OPEN, _Kind.OPENING): _State.OPEN,
    (_State.OPEN, _Kind.SEGMENT): _State.OPEN,
    (_State.OPEN, _Kind.END): _State.ENDED,
}
"""Transitions; a message that has none is refused, and changes nothing."""


class LiveReceiver:
    """The receiving end of a live stream.

    Attributes
    ----------
    head : Head or None
        Of the programme that is on.
    """

    def __init__(self) -> None:
        self._state = _State.WAITING
        self.head: Head | None = None
        self._opening = b""
        self._next: int | None = None

    def receive(self, message: bytes) -> list[Event]:
        """Take a message; whatever it holds, nothing is raised, and what is wrong with it is an event."""
        kind = _kind_of(message)
        if (self._state, kind) not in _NEXT:
            return [Refused(f"{kind.value}, where the state is: {self._state.value}")]
        try:
            events = self._taken(kind, message)
        except FormatError as error:
            return [Refused(str(error))]
        self._state = _NEXT[self._state, kind]
        return events

    def _taken(self, kind: _Kind, message: bytes) -> list[Event]:
        if kind is _Kind.END:
            return [Ended()]
        if kind is _Kind.OPENING:
            if message == self._opening:  # told again, for those who come later
                return []
            opened = _opened(message)
            self.head, self._opening, self._next = opened.head, message, None
            return [opened]
        return self._following(_segment(message))

    def _following(self, segment: LiveSegment) -> list[Event]:
        expected = self._next
        if expected is not None and segment.first_frame < expected:
            return [Refused(f"frames from {segment.first_frame}, late or again: {expected} is next")]
        self._next = segment.stop
        if expected is None or segment.first_frame == expected:
            return [segment]
        return [Lost(expected, segment.first_frame - expected), segment]


def _kind_of(message: bytes) -> _Kind:
    if not message:
        return _Kind.END
    if message.startswith(MAGIC):
        return _Kind.OPENING
    return _Kind.SEGMENT if message[:4] in (b"SEGM", b"VIBR") else _Kind.OTHER


def _opened(message: bytes) -> Opened:
    source = _source(message, "opening")
    read_opening(source)
    found = find_record(source, OPENING_SIZE, source.size)
    head: Head
    head, _ = read_record(source, found, "HEAD")
    if head.frame_count != ENDLESS:
        raise CorruptFile("opening: HEAD.frame_count", str(head.frame_count), f"{ENDLESS} of a live stream")
    pairs: dict[str, str] = {}
    if found.end < source.size:
        found = find_record(source, found.end, source.size)
        story: Provenance
        story, _ = read_record(source, found, "PROV")
        pairs = {pair.key: pair.value for pair in story.pairs}
    if found.end != source.size:
        raise CorruptFile("opening", f"{source.size - found.end} bytes behind it", "none")
    return Opened(head, pairs)


def _segment(message: bytes) -> LiveSegment:
    source = _source(message, "segment")
    place, beside = 0, None
    if message.startswith(b"VIBR"):
        found = find_record(source, 0, source.size)
        beside, _ = read_record(source, found, "VIBR")
        place = found.end
    found = find_record(source, place, source.size)
    told: Segment
    told, _ = read_record(source, found, "SEGM")
    if found.end != source.size:
        raise CorruptFile("segment", f"{source.size - found.end} bytes behind it", "none")
    if beside is not None and (beside.first_frame, beside.frame_count) != (told.first_frame, told.frame_count):
        raise CorruptFile("segment", "a VIBR of other frames", "one of its own")
    return LiveSegment(told.first_frame, told.frame_count, told.body, beside.body if beside is not None else None)


def file_of(opening: bytes, message: bytes) -> bytes:
    """A segment as a ``.touch`` file of its own, whose frames begin at 0: for decoders that know files alone.

    Raises FormatError if the opening or the message is at fault.
    """
    told, segment = _opened(opening), _segment(message)
    own = {"first_frame": 0, "frame_count": segment.frame_count}
    head = encode_record("HEAD", replace(told.head, frame_count=segment.frame_count))
    pairs = tuple(Pair(key=key, value=value) for key, value in told.provenance.items())
    before = encode_opening() + head + (encode_record("PROV", Provenance(pairs=pairs)) if pairs else b"")
    if segment.vibration is not None:
        before += encode_record("VIBR", Vibration(**own, body=segment.vibration))
    frames = encode_record("SEGM", Segment(**own, body=segment.body))
    crc32 = int.from_bytes(frames[-CRC_SIZE:], "little")
    entry = SegmentEntry(**own, offset=len(before), length=len(frames), crc32=crc32)
    chain = encode_opening() + head[-CRC_SIZE:]
    return before + frames + index_and_end([entry], len(before) + len(frames), chain)


def _source(message: bytes, name: str) -> ByteSource:
    if len(message) > MOST_BYTES:
        raise CorruptFile(name, f"{len(message)} bytes", f"at most {MOST_BYTES}")
    data: Any = io.BytesIO(message)
    data.name = name
    return ByteSource(data)


# -- sending --------------------------------------------------------------------------------------------------


@dataclass
class Subscriber:
    """How far a receiver is.

    Attributes
    ----------
    skipped : int
        Segments that it was moved on over.
    """

    skipped: int = 0
    _is_open: bool = False
    _is_ended: bool = False
    _next: int = 0


class LiveSender:
    """The sending end: takes what a coder writes, and has messages for any number of receivers.

    Safe to use from several threads: one that codes, and one that sends.
    """

    def __init__(self) -> None:
        self._lock = Lock()
        self.opening = b""
        self._kept: deque[tuple[int, LiveSegment, bytes]] = deque(maxlen=KEPT)
        self._count, self._is_ended = 0, False

    def open(self, head: Head, provenance: Mapping[str, str] | None = None) -> None:
        """Begin a programme; its frames begin at 0."""
        pairs = tuple(Pair(key=key, value=value) for key, value in (provenance or {}).items())
        story = encode_record("PROV", Provenance(pairs=pairs)) if pairs else b""
        opening = encode_opening() + encode_record("HEAD", replace(head, frame_count=ENDLESS)) + story
        with self._lock:
            if self.opening:
                raise InvalidArgument("open", "a second call", "one")
            self.opening = opening

    def add(self, segment: LiveSegment) -> bytes:
        """Have a segment sent, behind those before; the message."""
        message, frames = b"", {"first_frame": segment.first_frame, "frame_count": segment.frame_count}
        if segment.vibration is not None:
            message = encode_record("VIBR", Vibration(**frames, body=segment.vibration))
        message += encode_record("SEGM", Segment(**frames, body=segment.body))
        if len(message) > MOST_BYTES:
            raise InvalidArgument(
                "segment", f"{len(message)} bytes", f"at most {MOST_BYTES}", "Take shorter segments."
            )
        with self._lock:
            if not self.opening or self._is_ended:
                raise InvalidArgument("add", "a stream that is not open", "open before, end behind")
            latest = self._kept[-1][1].stop if self._kept else 0
            if segment.first_frame < latest:
                raise InvalidArgument("segment", f"frames from {segment.first_frame}", f"{latest} or later")
            self._kept.append((self._count, segment, message))
            self._count += 1
        return message

    def end(self) -> None:
        """Say that nothing follows."""
        with self._lock:
            self._is_ended = True

    def joined(self) -> Subscriber:
        """A new receiver, which begins with the newest segment."""
        with self._lock:
            return Subscriber(_next=max(0, self._count - 1))

    def next(self, receiver: Subscriber) -> bytes | None:
        """The next message for a receiver that can take one; None where there is none yet, or none any more."""
        with self._lock:
            if not receiver._is_open:
                receiver._is_open = bool(self.opening)
                return self.opening or None
            if receiver._next < self._count:
                oldest = self._kept[0][0]
                if receiver._next < oldest:  # too slow: on to the newest
                    receiver.skipped += self._count - 1 - receiver._next
                    receiver._next = self._count - 1
                message = self._kept[receiver._next - oldest][2]
                receiver._next += 1
                return message
            if self._is_ended and not receiver._is_ended:
                receiver._is_ended = True
                return END
            return None

    def is_over(self, receiver: Subscriber) -> bool:
        """True where a receiver was told the end."""
        return receiver._is_ended

    def manifest(self) -> dict[str, Any]:
        """The latest segments, for those who come by HTTP: stable keys."""
        with self._lock:
            segments = [
                {"number": number, "first_frame": one.first_frame, "frames": one.frame_count, "bytes": len(message)}
                for number, one, message in self._kept
            ]
            return {"is_ended": self._is_ended, "segments": segments}

    def message(self, number: int) -> bytes | None:
        """The message of a segment of the manifest; None where it is none any more."""
        with self._lock:
            return next((message for own, _, message in self._kept if own == number), None)


# -- through a pipe ------------------------------------------------------------------------------------------

_LENGTH: Final = struct.Struct("<I")


def write_message(file: IO[bytes], message: bytes) -> None:
    """Write a message and have it go at once."""
    file.write(_LENGTH.pack(len(message)) + message)
    file.flush()


def messages(file: IO[bytes], name: str) -> Iterator[bytes]:
    """The messages of a pipe up to its end, which may come before that of the stream.

    Raises SourceError if it ends within a message, or a message is too long to be one.
    """
    while length := exactly(file, _LENGTH.size):
        count = _LENGTH.unpack(length)[0] if len(length) == _LENGTH.size else MOST_BYTES + 1
        if count > MOST_BYTES:
            raise SourceError(name, f"{length!r}", f"the length of a message, at most {MOST_BYTES}")
        message = exactly(file, count)
        if len(message) < count:
            raise SourceError(name, "its end within a message", "whole messages of touchfield live SOURCE -")
        yield message
