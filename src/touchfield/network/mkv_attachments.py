"""Finds a ``.touch`` file among the attachments of a Matroska or WebM file (RFC 9559), by its content.

Matroska has no track for data in time. The attachment is the whole file with the record of its start; the
first picture, from which that counts, is found in the clusters.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final, NamedTuple

from touchfield.container.records import MAGIC
from touchfield.container.wire import ByteSource
from touchfield.errors import CorruptFile, SourceError
from touchfield.network.touch_track import MAX_BYTES, TouchTrack, Window, require_few

_EBML: Final = b"\x1a\x45\xdf\xa3"
_ATTACHMENTS, _FILE, _FILE_DATA = 0x1941A469, 0x61A7, 0x465C
_SEGMENT, _INFO, _TIMESTAMP_SCALE = 0x18538067, 0x1549A966, 0x2AD7B1
_TRACKS, _TRACK, _TRACK_NUMBER, _TRACK_TYPE = 0x1654AE6B, 0xAE, 0xD7, 0x83
_CLUSTER, _CLUSTER_TIME, _GROUP, _BLOCK, _SIMPLE = 0x1F43B675, 0xE7, 0xA0, 0xA1, 0xA3
_PARENTS: Final = {_SEGMENT, _INFO, _ATTACHMENTS, _FILE, _TRACKS, _TRACK, _CLUSTER, _GROUP}
_VIDEO: Final = 1
_MAX_ELEMENTS: Final = 1 << 20
_BLOCKS: Final = 64
"""Pictures may be stored out of order: so many blocks are compared to find the first."""


class _Element(NamedTuple):
    kind: int
    start: int
    stop: int


def is_matroska(start: bytes) -> bool:
    """Whether a file that starts with these bytes is Matroska or WebM."""
    return start.startswith(_EBML)


def find_touch(source: ByteSource) -> tuple[TouchTrack, ...]:
    """The attachments that are ``.touch`` files, in their order; one that is empty if there is none."""
    files, window = list[bytes](), Window(source)
    scale, time, video = 1_000_000, 0, set[int]()
    number, times, parents = 0, dict[bool, list[int]](), set(_PARENTS)
    for kind, start, stop in _elements(window, source.name, parents):
        if kind == _FILE_DATA:
            files += filter(None, [_touch_data(source, start, stop)])
            require_few(files, source.name)
        elif kind == _TIMESTAMP_SCALE:
            scale = _number(window, start, stop)
        elif kind == _TRACK_NUMBER:
            number = _number(window, start, stop)
        elif kind == _TRACK_TYPE and _number(window, start, stop) == _VIDEO:
            video.add(number)
        elif kind == _CLUSTER_TIME:
            time = _number(window, start, stop)
        elif kind in (_BLOCK, _SIMPLE):
            track, shift = _block(window, start, stop)
            found = times.setdefault(track in video, [])
            if len(found) < _BLOCKS:
                found.append(time + shift)
            elif files and (track in video or not video):
                break
            elif track in video:
                parents.discard(_CLUSTER)  # no more is needed of them
    first = min(times.get(True) or times.get(False) or [0])
    return tuple(TouchTrack(attachment=data, picture_s=first * scale / 1e9) for data in files or [b""])


def _elements(window: Window, name: str, parents: set[int]) -> Iterator[_Element]:
    """The elements in the order of the file, those of the kinds `parents` before their members."""
    position = 0
    for _ in range(_MAX_ELEMENTS):
        if position + 2 > window.size:
            return
        head = window.read(position, min(12, window.size - position))
        kind_size = _length_of(head[0])
        if kind_size > 4 or kind_size + 1 > len(head):
            raise CorruptFile(f"{name}: element at byte {position}", f"{head[:4]!r}", "its kind")
        kind = int.from_bytes(head[:kind_size], "big")
        size_size = _length_of(head[kind_size])
        if size_size > 8 or kind_size + size_size > len(head):
            raise CorruptFile(f"{name}: element at byte {position}", f"{head!r}", "its length")
        start, mask = position + kind_size + size_size, (1 << 7 * size_size) - 1
        length = int.from_bytes(head[kind_size : kind_size + size_size], "big") & mask
        stop = window.size if length == mask else min(start + length, window.size)
        yield _Element(kind, start, stop)
        position = start if kind in parents or length == mask else stop
    raise CorruptFile(name, f"more than {_MAX_ELEMENTS} elements before its touch", "fewer")


def _length_of(first: int) -> int:
    """Bytes of a number by its first one; 9 if that is 0."""
    return 9 - first.bit_length()


def _number(window: Window, start: int, stop: int) -> int:
    return int.from_bytes(window.read(start, min(8, stop - start)), "big")


def _block(window: Window, start: int, stop: int) -> tuple[int, int]:
    """Track of a block, and its time after that of the cluster."""
    head = window.read(start, min(12, stop - start))
    size = _length_of(head[0]) if head else 9
    if size > 8 or len(head) < size + 2:
        return 0, 0
    track = int.from_bytes(head[:size], "big") & (1 << 7 * size) - 1
    return track, int.from_bytes(head[size : size + 2], "big", signed=True)


def _touch_data(source: ByteSource, start: int, stop: int) -> bytes:
    if source.read_at(start, min(len(MAGIC), stop - start)) != MAGIC:
        return b""
    if stop - start > MAX_BYTES:
        raise SourceError(source.name, f"more than {MAX_BYTES} bytes of touch", "less")
    return source.read_at(start, stop - start)
