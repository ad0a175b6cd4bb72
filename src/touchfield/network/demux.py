"""Extracts the ``.touch`` file of a movie, also after other programs have copied the movie (paper section 6).

The touch is found by its content in MP4, MOV, MPEG-TS, Matroska, and HLS playlists of these; no other library
is needed. If the movie has none, the file NAME.touch next to it takes its place: programs that drop tracks
which they do not know leave such a sidecar alone.
"""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any, BinaryIO, Final, NamedTuple
from urllib.parse import unquote

from touchfield.atomic import atomic_path
from touchfield.container import TouchReader
from touchfield.container.wire import ByteSource
from touchfield.errors import InvalidArgument, SourceError, require_ending
from touchfield.files import (
    file_error,
    read_bytes,
    readable,
    refuse_overwriting,
    require_in_folder,
    require_plain,
)
from touchfield.network import mkv_attachments, mp4_tracks, ts_streams
from touchfield.network.mux import Muxed
from touchfield.network.touch_track import (
    MAX_BYTES,
    JoinedTouch,
    TouchTrack,
    join_samples,
    split_sync,
    start_of,
    unwrapped,
)

_START_BYTES: Final = 1024
_PLAYLIST: Final = b"#EXTM3U"
_MAX_PLAYLIST_BYTES: Final = 1 << 22
_COPIED_BYTES: Final = 1 << 20
_MAP: Final = re.compile(r'#EXT-X-MAP:.*?URI="([^"]*)"')
_EXPECTED: Final = "a movie in MP4, MOV, MPEG-TS or Matroska, or an HLS playlist (.m3u8) of such files"
_DROPPED: Final = (
    "Programs drop tracks that they do not know: ffmpeg needs -map 0 -c copy. "
    "Without it, use the file of mux --sidecar: put it next to the movie as {name}."
)


def demux(movie: str | Path, out: str | Path) -> Muxed:
    """Extract the ``.touch`` file of a movie; each segment is checked.

    Raises SourceError if the movie cannot be read, or has no touch; FormatError if the touch is damaged, or
    its beginning is missing.
    """
    require_ending(out, "OUT.touch")
    movie = Path(movie)
    if movie.suffix.lower() == ".mpd":
        hint = f"Its touch is in the file next to it: {movie.with_suffix('.touch').name}."
        raise InvalidArgument(str(movie), "a DASH manifest", "a movie with touch in it", hint)
    refuse_overwriting(out, movie)
    with _opened(movie) as source:
        found = _found(source, movie, Path(out))
    file: Any = BytesIO(found.data)
    file.name = str(movie)
    with TouchReader(file) as reader, atomic_path(Path(out)) as temporary:
        for i in range(reader.object_count):
            reader.read_object(i)
        for i in range(len(reader.segments)):
            reader.read_vibration(i)
        temporary.write_bytes(found.data)
        seconds = reader.head.frame_count / reader.head.rate_hz
        count = len(reader.segments)
    return Muxed(str(out), count, found.touch_bytes, seconds, found.at_s, notes=found.notes)


class _Found(NamedTuple):
    """The file, its bytes in the movie, the second of the movie at which it starts, and notes."""

    data: bytes
    touch_bytes: int
    at_s: float
    notes: tuple[str, ...]


def _found(source: ByteSource, movie: Path, out: Path) -> _Found:
    """The touch of a movie of any supported form, or that of the sidecar of a movie without touch."""
    start = source.read_at(0, min(source.size, _START_BYTES))
    if mkv_attachments.is_matroska(start):
        track = mkv_attachments.find_touch(source)
    elif mp4_tracks.is_mp4(start):
        track = mp4_tracks.find_touch(source)
    elif ts_streams.packet_layout(start) is not None:
        track = ts_streams.find_touch(source)
    else:
        raise SourceError(str(movie), f"a file that starts with {start[:8]!r}", _EXPECTED)
    if track.attachment:
        return _whole_file(track.attachment, track, str(movie))
    if track.samples:
        joined = _joined(track, str(movie))
        return _Found(joined.data, joined.sample_bytes, *start_of(joined, track))
    path = movie.with_suffix(".touch")
    if not path.is_file():
        hint = _DROPPED.format(name=path.name)
        raise SourceError(str(movie), "no track of touch", "a movie that touchfield mux made", hint)
    refuse_overwriting(out, path)
    found = _whole_file(read_bytes(path, MAX_BYTES, "a .touch file"), track, str(path))
    note = f"The movie has no touch: {path.name} next to it is used."
    return found._replace(notes=(note, *found.notes))


def _joined(track: TouchTrack, name: str) -> JoinedTouch:
    samples = unwrapped(track.samples)
    if not samples:
        hint = "Take the whole movie: programs that cut it lose the head of the touch."
        raise SourceError(name, "touch without its head", "its beginning", hint)
    return join_samples(samples, name)


def _whole_file(data: bytes, track: TouchTrack, name: str) -> _Found:
    """What an attachment or a sidecar contains: a file, in most cases with the record of its start."""
    file: Any = BytesIO(data)
    file.name = name
    with TouchReader(file) as reader:
        last = reader.segments[-1]
        start_s, plain = split_sync(data, last.offset + last.length, name)
    if start_s is None:
        return _Found(data, len(data), 0.0, (f"{name} has no record of its start: 0 s is assumed.",))
    return _Found(plain, len(data), track.picture_s + start_s - track.zero_s, ())


@contextmanager
def _opened(movie: Path) -> Iterator[ByteSource]:
    """The bytes of a movie, or those of the parts of a playlist one after the other."""
    require_plain(movie, _EXPECTED)
    with ExitStack() as stack:
        try:
            file: BinaryIO = stack.enter_context(movie.open("rb"))
        except (OSError, ValueError) as error:
            raise file_error(movie, error, _EXPECTED) from None
        if file.read(len(_PLAYLIST)) == _PLAYLIST:
            parts = _parts_of(movie)
            file = stack.enter_context(TemporaryFile())
            for path in parts:
                with readable(path, "a part of the playlist"), path.open("rb") as part:
                    shutil.copyfileobj(part, file, _COPIED_BYTES)
        source = ByteSource(file)
        source.name = str(movie)
        yield source


def _parts_of(playlist: Path) -> list[Path]:
    """The files that an HLS playlist (RFC 8216) names, in its folder, each of them once."""
    text = read_bytes(playlist, _MAX_PLAYLIST_BYTES, "an HLS playlist").decode("utf-8", "replace")
    if "#EXT-X-STREAM-INF" in text:
        hint = "Name one of the playlists that it lists."
        raise SourceError(str(playlist), "a playlist of playlists", "a playlist of media", hint)
    names = list[str]()
    for line in text.splitlines():
        initial = _MAP.match(line)
        if initial:
            names.append(initial[1])
        elif line.strip() and not line.startswith("#"):
            names.append(line.strip())
    paths = [
        require_in_folder(playlist.parent, unquote(name), str(playlist)) for name in dict.fromkeys(names)
    ]
    for path in paths:
        if not os.path.isfile(path):  # unlike Path.is_file, does not raise for a name that is too long
            raise SourceError(f"{playlist}: part", f"no file {path.name!r}", "the parts next to the playlist")
    if not paths:
        raise SourceError(str(playlist), "a playlist without parts", _EXPECTED)
    return paths
