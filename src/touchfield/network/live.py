"""The protocol of a live stream, independent of how it is transported: checks incoming messages and turns
them into events such as a segment, a loss or the end.

A live stream is the start of a file that does not end (docs/format/live.md): its *opening*, which is magic,
version, HEAD with the maximum frame count, PROV, and the OBJT of each body of coder `objects`; then
*segments*, each a SEGM, preceded by a VIBR if something vibrates. Every message contains one complete opening
or segment, so that a message that is lost, late, repeated or damaged costs only itself. An empty message
marks the end of the stream.

The sender keeps the opening and the latest segments, and for each receiver only its position: a slow receiver
is moved on to the newest segment.
"""

from __future__ import annotations

import io
import secrets
import struct
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from threading import Lock
from typing import IO, Any, Final

from touchfield.container.records import (
    MAGIC,
    MAX_OBJECTS,
    OBJECTS_CODER,
    Head,
    ObjectRecord,
    Provenance,
    Segment,
    Vibration,
)
from touchfield.container.wire import (
    OPENING_SIZE,
    ByteSource,
    encode_record,
    find_record,
    read_opening,
    read_record,
    records_between,
)
from touchfield.container.writer import TouchWriter, opening_of
from touchfield.errors import CorruptFile, FormatError, InvalidArgument, SourceError
from touchfield.files import read_up_to

MEDIA_TYPE: Final = "haptics/vnd.touchfield"
"""Media type of a ``.touch`` file (RFC 9695 registers the tree; haptics/hmpg is MPEG's)."""

ENDLESS: Final = (1 << 31) - 1
"""`HEAD.frame_count` of a live stream."""

MAX_BYTES: Final = 1 << 26
"""Maximum size of a message."""

MAX_SEGMENTS: Final = 4
"""Number of segments that a sender keeps for late receivers."""

_MAX_RECORDS: Final = MAX_OBJECTS + 3
"""Records of an opening that are looked at: HEAD, PROV, the objects, and one that is too many."""

_MAX_LEAD: Final = 8
"""On an open transport, a segment this many segments after the latest needs a successor to count."""

END: Final = b""
"""The message that the stream has ended."""


# -- events ------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Opened:
    """A programme has started: its head, its provenance, and the bodies of coder `objects`."""

    head: Head
    provenance: Mapping[str, str]
    objects: tuple[ObjectRecord, ...] = ()


@dataclass(frozen=True)
class LiveSegment:
    """A segment that can be decoded: its body, and its vibration."""

    first_frame: int
    frame_count: int
    body: bytes
    vibration: bytes | None = None

    @property
    def stop(self) -> int:
        """The frame after its last one."""
        return self.first_frame + self.frame_count


@dataclass(frozen=True)
class Lost:
    """Frames that were missing when later ones arrived."""

    first_frame: int
    frame_count: int


@dataclass(frozen=True)
class Refused:
    """A message that was refused, and the reason."""

    reason: str


@dataclass(frozen=True)
class Ended:
    """The sender has ended the stream."""


Event = Opened | LiveSegment | Lost | Refused | Ended


class LiveReceiver:
    """The receiving end of a live stream.

    With `is_open` anyone may send, as with datagrams; a single message then cannot move the position far.
    """

    def __init__(self, is_open: bool = False) -> None:
        self.is_open = is_open
        self._opening, self._is_over = b"", False
        self._next: int | None = None
        self._length = 0
        self._doubted: LiveSegment | None = None

    def receive(self, message: bytes) -> list[Event]:
        """Take a message and return its events.

        An invalid message yields the event `Refused`; no error is raised.
        """
        try:
            return self._events(message)
        except FormatError as error:
            return [Refused(str(error))]

    def _events(self, message: bytes) -> list[Event]:
        if self._is_over:
            return [Refused("a message behind the end")]
        if message == END:
            self._is_over = True
            return [Ended()]
        if message.startswith(MAGIC):
            if message == self._opening:  # repeated for late receivers
                return []
            opened = _parse_opening(message)
            self._opening, self._next = message, None
            return [opened]
        if message[:4] not in (b"SEGM", b"VIBR"):
            return [Refused("neither an opening nor a segment")]
        if not self._opening:
            return [Refused("a segment before any opening")]
        segment = _parse_segment(message)
        expected = segment.first_frame if self._next is None else self._next
        if segment.first_frame < expected:
            return [Refused(f"frames from {segment.first_frame}, late or again: {expected} is next")]
        accepted = [segment]
        if self.is_open and self._next is not None and segment.stop - expected > _MAX_LEAD * self._length:
            doubted, self._doubted = self._doubted, segment
            if doubted is None or doubted.stop > segment.first_frame:
                return []
            accepted = [doubted, segment]
        self._next, self._length, self._doubted = segment.stop, segment.frame_count, None
        events: list[Event] = []
        for live_segment in accepted:
            events += (
                [Lost(expected, live_segment.first_frame - expected)]
                if live_segment.first_frame > expected
                else []
            )
            events, expected = [*events, live_segment], live_segment.stop
        return events


def _parse_opening(message: bytes) -> Opened:
    source = _source(message, "opening")
    read_opening(source)
    tags = [record.tag for record in islice(records_between(source, OPENING_SIZE, source.size), _MAX_RECORDS)]
    object_count, has_provenance = tags.count("OBJT"), tags[1:2] not in ([], ["OBJT"])
    layouts = (Head, *(Provenance,) * has_provenance, *(ObjectRecord,) * object_count)
    head, *others = _read_records(source, OPENING_SIZE, layouts)
    if head.frame_count != ENDLESS:
        raise CorruptFile("opening: HEAD.frame_count", str(head.frame_count), f"{ENDLESS} of a live stream")
    if (head.coder == OBJECTS_CODER) != (object_count > 0):
        expected = f"one or more with coder {OBJECTS_CODER!r}, else none"
        raise CorruptFile("opening", f"{object_count} OBJT with coder {head.coder!r}", expected)
    pairs = others[0].pairs if has_provenance else ()
    return Opened(head, {pair.key: pair.value for pair in pairs}, tuple(others[has_provenance:]))


def _parse_segment(message: bytes) -> LiveSegment:
    layouts = (Vibration, Segment) if message.startswith(b"VIBR") else (Segment,)
    *vibrations, frames = _read_records(_source(message, "segment"), 0, layouts)
    if any(
        (vibration.first_frame, vibration.frame_count) != (frames.first_frame, frames.frame_count)
        for vibration in vibrations
    ):
        raise CorruptFile("segment", "a VIBR of other frames", "one of its own")
    return LiveSegment(
        frames.first_frame, frames.frame_count, frames.body, vibrations[0].body if vibrations else None
    )


def _read_records(source: ByteSource, offset: int, layouts: tuple[type, ...]) -> list[Any]:
    """Read the records from an offset on, which must be exactly these layouts."""
    values: list[Any] = []
    for layout in layouts:
        record = find_record(source, offset, source.size)
        values.append(read_record(source, record, layout)[0])
        offset = record.end
    if offset != source.size:
        raise CorruptFile(source.name, f"{source.size - offset} bytes behind it", "none")
    return values


def file_of(opening: bytes, message: bytes) -> bytes:
    """Return a segment as a ``.touch`` file, for decoders that only read files.

    Its frames start at 0.

    Raises FormatError if the opening or the message is invalid.
    """
    live, segment, file = _parse_opening(opening), _parse_segment(message), io.BytesIO()
    with TouchWriter(file) as writer:
        writer.write_head(replace(live.head, frame_count=segment.frame_count), live.provenance)
        for record in live.objects:
            writer.write_object(record)
        if segment.vibration is not None:
            writer.write_vibration(0, segment.frame_count, segment.vibration)
        writer.write_segment(0, segment.frame_count, segment.body)
    return file.getvalue()


def _source(message: bytes, name: str) -> ByteSource:
    if len(message) > MAX_BYTES:
        raise CorruptFile(name, f"{len(message)} bytes", f"at most {MAX_BYTES}")
    data: Any = io.BytesIO(message)
    data.name = name
    return ByteSource(data)


# -- sending -----------------------------------------------------------------------------------------------


@dataclass
class Subscriber:
    """The position of a receiver.

    Attributes
    ----------
    skipped : int
        Number of segments that were skipped.
    is_over : bool
        Whether it was sent the end.
    """

    skipped: int = 0
    is_over: bool = False
    _is_open: bool = False
    _next: int = 0


class LiveSender:
    """Sending end: takes segments and provides messages to any number of receivers.

    Thread-safe: one thread may encode while another sends.

    Attributes
    ----------
    opening : bytes
        Empty before `open`.
    programme : str
        Random identifier in the opening; empty before `open`.
    """

    def __init__(self) -> None:
        self._lock = Lock()
        self.opening, self.programme = b"", ""
        self._latest: deque[tuple[int, LiveSegment, bytes]] = deque(maxlen=MAX_SEGMENTS)
        self._count, self._is_ended = 0, False

    def open(
        self,
        head: Head,
        provenance: Mapping[str, str] | None = None,
        objects: Sequence[ObjectRecord] = (),
    ) -> None:
        """Start a programme, whose frames start at 0; its opening contains a random identifier.

        Raises InvalidArgument if `objects`, the bodies of coder `objects`, make the opening too long.
        """
        programme = secrets.token_hex(8)
        provenance_pairs = {**(provenance or {}), "programme": programme}
        records = [encode_record("OBJT", record) for record in objects]
        opening = b"".join((*opening_of(replace(head, frame_count=ENDLESS), provenance_pairs), *records))
        if len(opening) > MAX_BYTES:
            found = f"an opening of {len(opening)} bytes"
            raise InvalidArgument("bodies", found, f"at most {MAX_BYTES}", "Take a smaller --nw.")
        with self._lock:
            if self.opening:
                raise InvalidArgument("open", "a second call", "one")
            self.opening, self.programme = opening, programme

    def add(self, segment: LiveSegment) -> bytes:
        """Append a segment; return its message."""
        frames = {"first_frame": segment.first_frame, "frame_count": segment.frame_count}
        message = encode_record("SEGM", Segment(**frames, body=segment.body))
        if segment.vibration is not None:
            message = encode_record("VIBR", Vibration(**frames, body=segment.vibration)) + message
        if len(message) > MAX_BYTES:
            raise InvalidArgument(
                "segment", f"{len(message)} bytes", f"at most {MAX_BYTES}", "Take shorter segments."
            )
        with self._lock:
            if not self.opening or self._is_ended:
                raise InvalidArgument("add", "a stream that is not open", "open before, end behind")
            latest = self._latest[-1][1].stop if self._latest else 0
            if segment.first_frame < latest:
                raise InvalidArgument("segment", f"frames from {segment.first_frame}", f"{latest} or later")
            self._latest.append((self._count, segment, message))
            self._count += 1
        return message

    def end(self) -> None:
        """Mark the end of the stream."""
        with self._lock:
            self._is_ended = True

    def joined(self) -> Subscriber:
        """Return a new receiver, which starts with the newest segment."""
        with self._lock:
            return Subscriber(_next=max(0, self._count - 1))

    def next(self, receiver: Subscriber) -> bytes | None:
        """Return the next message for a receiver; None if there is none yet, or after the end."""
        with self._lock:
            if not receiver._is_open:
                receiver._is_open = bool(self.opening)
                return self.opening or None
            if receiver._next < self._count:
                oldest = self._latest[0][0]
                if receiver._next < oldest:  # too slow: continue with the newest segment
                    receiver.skipped += self._count - 1 - receiver._next
                    receiver._next = self._count - 1
                message = self._latest[receiver._next - oldest][2]
                receiver._next += 1
                return message
            if self._is_ended and not receiver.is_over:
                receiver.is_over = True
                return END
            return None

    def manifest(self) -> dict[str, Any]:
        """Return the latest segments for HTTP receivers; the keys are stable."""
        with self._lock:
            segments = [
                {
                    "number": number,
                    "first_frame": segment.first_frame,
                    "frames": segment.frame_count,
                    "bytes": len(message),
                }
                for number, segment, message in self._latest
            ]
            programme = {"programme": self.programme} if self.programme else {}
            return {"is_ended": self._is_ended, **programme, "segments": segments}

    def message(self, number: int) -> bytes | None:
        """Return the message of a segment of the manifest; None if it is no longer kept."""
        with self._lock:
            return next(
                (message for segment_number, _, message in self._latest if segment_number == number), None
            )


# -- through a pipe ----------------------------------------------------------------------------------------

_LENGTH: Final = struct.Struct("<I")


def write_message(file: IO[bytes], message: bytes) -> None:
    """Write a message and flush."""
    file.write(_LENGTH.pack(len(message)) + message)
    file.flush()


def messages(file: IO[bytes], name: str) -> Iterator[bytes]:
    """Yield the messages of a pipe up to its end.

    The pipe may end before the stream. Raises SourceError if it ends within a message, or a message exceeds
    the maximum length.
    """
    while length := read_up_to(file, _LENGTH.size):
        count = _LENGTH.unpack(length)[0] if len(length) == _LENGTH.size else MAX_BYTES + 1
        if count > MAX_BYTES:
            raise SourceError(name, f"{length!r}", f"the length of a message, at most {MAX_BYTES}")
        message = read_up_to(file, count)
        if len(message) < count:
            raise SourceError(name, "its end within a message", "whole messages of touchfield live SOURCE -")
        yield message
