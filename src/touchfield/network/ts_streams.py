"""Finds the touch in an MPEG-TS by its content, whatever the stream types of the programme say.

ISO/IEC 13818-1: packets of 188 bytes (192 and 204 with additions), PES packets within them, and their time
stamps of 33 bits at 90 kHz.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

import numpy as np

from touchfield.container.wire import ByteSource
from touchfield.network.touch_track import (
    PROBED_BYTES,
    PROBED_SAMPLES,
    Sample,
    TouchTrack,
    collect,
    is_touch,
    require_few,
)

_SYNC: Final = 0x47
_PACKET: Final = 188
_LAYOUTS: Final = ((188, 0), (192, 4), (204, 0))
"""Bytes from packet to packet, and those before the first one."""

_CHECKED: Final = 4
_PACKETS_READ: Final = 8192
_TICKS: Final = 90000
_WRAP: Final = 1 << 33
_TIMES_READ: Final = 64
"""Pictures may be stored out of order: so many are compared to find the first."""

_NO_HEADER: Final = frozenset((0xBC, 0xBE, 0xBF, 0xF0, 0xF1, 0xF2, 0xF8, 0xFF))
"""Identifiers of streams whose PES packets have no further header."""


def packet_layout(start: bytes) -> tuple[int, int] | None:
    """Step from packet to packet and position of the first one; None if the bytes are no MPEG-TS."""
    for step, first in _LAYOUTS:
        marks = start[first::step][:_CHECKED]
        if marks and all(mark == _SYNC for mark in marks):
            return step, first
    return None


class _Pes(NamedTuple):
    """Header of a PES packet: its stream, its time stamp or None, and where its data starts."""

    stream: int
    stamp: int | None
    start: int
    stop: int | None


@dataclass
class _Stream:
    """What the first PES packets of a PID show."""

    kind: int = 0
    stamps: list[int] = field(default_factory=list)
    probed: int = 0
    is_touch: bool = False


def find_touch(source: ByteSource) -> tuple[TouchTrack, ...]:
    """The touch streams of a movie, in its order; one without samples if there is none.

    The clock of a stream has any start: that of the movie is its first picture. Packets without the sync byte
    are left out; the checks of the touch find what they leave incomplete.
    """
    streams = dict[int, _Stream]()
    for number, _, payload in _packets(source, None):
        _probe(streams.setdefault(number, _Stream()), payload)
    pids = [key for key, stream in streams.items() if stream.is_touch]
    require_few(pids, source.name)
    references = (streams[key].stamps for key in pids) if pids else (s.stamps for s in streams.values())
    reference = next((stamp for stamps in references for stamp in stamps), 0)
    kinds = (range(0xE0, 0xF0), range(0xBD, 0x100))  # pictures, else anything: sound has several kinds
    firsts = (_first_s(streams, pids, reference, kind) for kind in kinds)
    picture_s = next((first for first in firsts if first is not None), 0.0)
    found = tuple(
        TouchTrack(
            collect(_samples(source, pid, reference), source.size, source.name),
            zero_s=picture_s,
            picture_s=picture_s,
        )
        for pid in pids
    )
    return found or (TouchTrack(zero_s=picture_s, picture_s=picture_s),)


def _packets(source: ByteSource, pid: int | None) -> Iterator[tuple[int, bool, bytes]]:
    """PID, whether a PES packet starts, and payload: of one PID, or of all packets that start one."""
    layout = packet_layout(source.read_at(0, min(source.size, _CHECKED * 204 + 4)))
    if layout is None:
        return
    step, first = layout
    position, previous = 0, b""
    while position + first + _PACKET <= source.size:
        size = min(_PACKETS_READ * step, source.size - position)
        rows = size // step + (size % step >= first + _PACKET)
        data = source.read_at(position, min(rows * step, size)).ljust(rows * step, b"\0")
        table: Any = np.frombuffer(data, np.uint8).reshape(rows, step)[:, first : first + _PACKET]
        pids = (table[:, 1].astype(np.uint16) & 0x1F) << 8 | table[:, 2]
        selected = (table[:, 0] == _SYNC) & (table[:, 3] & 0x10 > 0)
        selected &= table[:, 1] & 0x40 > 0 if pid is None else pids == pid
        for row in np.flatnonzero(selected):
            packet = table[row].tobytes()
            if pid is not None and packet == previous:  # a packet may be sent twice
                continue
            previous = packet
            start = 4 + (1 + packet[4] if packet[3] & 0x20 else 0)
            yield int(pids[row]), bool(packet[1] & 0x40), packet[start:]
        position += rows * step


def _pes(data: bytes) -> _Pes | None:
    if len(data) < 9 or data[:3] != b"\0\0\1":
        return None
    stream, length = data[3], int.from_bytes(data[4:6], "big")
    stop = 6 + length if length else None
    if stream in _NO_HEADER:
        return _Pes(stream, None, 6, stop)
    stamp = None
    if data[7] & 0x80 and len(data) >= 14:
        high, middle, low = data[9] >> 1 & 7, data[10:12], data[12:14]
        stamp = high << 30 | int.from_bytes(middle, "big") >> 1 << 15 | int.from_bytes(low, "big") >> 1
    return _Pes(stream, stamp, 9 + data[8], stop)


def _probe(stream: _Stream, payload: bytes) -> None:
    header = _pes(payload)
    if header is None or stream.probed >= _TIMES_READ:
        return
    stream.kind = header.stream
    stream.probed += 1
    if header.stamp is not None:
        stream.stamps.append(header.stamp)
    if stream.probed <= PROBED_SAMPLES:
        stream.is_touch |= is_touch(payload[header.start : header.start + PROBED_BYTES])


def _samples(source: ByteSource, pid: int, reference: int) -> Iterator[Sample]:
    """The data of the PES packets of a PID; one without a time stamp continues the one before."""
    pending = bytearray()
    for _, is_start, payload in _packets(source, pid):
        if is_start and pending:
            yield from _sample(bytes(pending), reference)
            pending.clear()
        if pending or is_start:
            pending += payload
    if pending:
        yield from _sample(bytes(pending), reference)


def _sample(data: bytes, reference: int) -> Iterator[Sample]:
    header = _pes(data)
    if header is not None:
        stamp = header.stamp
        time_s = None if stamp is None else _since(stamp, reference)
        yield Sample(time_s, data[header.start : header.stop])


def _since(stamp: int, reference: int) -> float:
    """Seconds from one time stamp to another, which may have wrapped around in between."""
    ticks = (stamp - reference + _WRAP // 2) % _WRAP - _WRAP // 2
    return ticks / _TICKS


def _first_s(
    streams: dict[int, _Stream], touches: Sequence[int], reference: int, kinds: range
) -> float | None:
    return min(
        (
            _since(stamp, reference)
            for number, stream in streams.items()
            if number not in touches and stream.kind in kinds
            for stamp in stream.stamps
        ),
        default=None,
    )
