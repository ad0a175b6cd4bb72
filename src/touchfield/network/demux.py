"""Extracts the ``.touch`` file of a movie, also after other programs have copied the movie (paper section 6).

The touch is found by its content in MP4, MOV, MPEG-TS, Matroska, and HLS playlists of these; no other library
is needed. If the movie has none, the file NAME.touch next to it takes its place: programs that drop tracks
which they do not know leave such a sidecar alone.
"""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Iterator, Sequence
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


def demux(movie: str | Path, out: str | Path, track: str | None = None) -> Muxed:
    """Extract the ``.touch`` file of a movie; each segment is checked.

    `track` selects one of several: the first with this tag in its head, such as "sound", or its number from 1
    on; None is the first. Raises SourceError if the movie cannot be read, or has no touch; InvalidArgument if
    no touch has the tag; FormatError if the touch is damaged, or its beginning is missing.
    """
    require_ending(out, "OUT.touch")
    movie = _movie(movie)
    refuse_overwriting(out, movie)
    with _opened(movie) as source:
        found = _found(source, movie, Path(out), track)
    return _write(found, movie, Path(out))


def demux_all(movie: str | Path, folder: Path) -> tuple[Muxed, ...]:
    """Extract every ``.touch`` file of a movie, in its order, to ``1.touch``, ``2.touch``, ... in a folder.

    Raises as `demux` does.
    """
    movie = _movie(movie)
    with _opened(movie) as source:
        tracks = [track for track in _tracks(source, movie) if track.has_touch]
        if tracks:
            files = [_read(track, str(movie)) for track in tracks]
        else:
            files = [_found(source, movie, folder / "1.touch", None)]
    return tuple(_write(found, movie, folder / f"{n}.touch") for n, found in enumerate(files, 1))


def _movie(movie: str | Path) -> Path:
    """The path of a movie that has its touch in itself; InvalidArgument for a DASH manifest."""
    path = Path(movie)
    if path.suffix.lower() == ".mpd":
        hint = f"Its touch is in the file next to it: {path.with_suffix('.touch').name}."
        raise InvalidArgument(str(path), "a DASH manifest", "a movie with touch in it", hint)
    return path


def _write(found: _Found, movie: Path, out: Path) -> Muxed:
    """Check every segment of a touch, and write it."""
    file: Any = BytesIO(found.data)
    file.name = str(movie)
    with TouchReader(file) as reader, atomic_path(out) as temporary:
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


def _found(source: ByteSource, movie: Path, out: Path, requested: str | None) -> _Found:
    """The requested touch of a movie of any supported form, or the sidecar of a movie without touch."""
    tracks = _tracks(source, movie)
    if any(track.has_touch for track in tracks):
        return _selected(tracks, str(movie), requested)
    path = movie.with_suffix(".touch")
    if not path.is_file():
        hint = _DROPPED.format(name=path.name)
        raise SourceError(str(movie), "no track of touch", "a movie that touchfield mux made", hint)
    refuse_overwriting(out, path)
    found = _whole_file(read_bytes(path, MAX_BYTES, "a .touch file"), tracks[0], str(path))
    note = f"The movie has no touch: {path.name} next to it is used."
    if requested not in (None, "1", *_tags(found, str(path))):
        raise InvalidArgument("--track", f"{requested!r:.80}", f"the tag of {path.name}, or 1")
    return found._replace(notes=(note, *found.notes))


def _tracks(source: ByteSource, movie: Path) -> tuple[TouchTrack, ...]:
    start = source.read_at(0, min(source.size, _START_BYTES))
    if mkv_attachments.is_matroska(start):
        return mkv_attachments.find_touch(source)
    if mp4_tracks.is_mp4(start):
        return mp4_tracks.find_touch(source)
    if ts_streams.packet_layout(start) is not None:
        return ts_streams.find_touch(source)
    raise SourceError(str(movie), f"a file that starts with {start[:8]!r}", _EXPECTED)


def _read(track: TouchTrack, name: str) -> _Found:
    if track.attachment:
        return _whole_file(track.attachment, track, name)
    joined = _joined(track, name)
    return _Found(joined.data, joined.sample_bytes, *start_of(joined, track))


def _selected(tracks: Sequence[TouchTrack], name: str, requested: str | None) -> _Found:
    """The touch with a tag or a number; by default the first, with a note if there are more."""
    numbers = {str(n + 1): track for n, track in enumerate(tracks)}
    if requested in numbers:
        return _read(numbers[requested], name)
    if requested is not None:
        return _with_tag(tracks, name, requested)
    found = _read(tracks[0], name)
    if len(tracks) == 1:
        return found
    note = f"The movie has {len(tracks)} tracks of touch: the first is taken (--track takes another)."
    return found._replace(notes=(note, *found.notes))


def _with_tag(tracks: Sequence[TouchTrack], name: str, requested: str) -> _Found:
    tags = list[str]()
    for track in tracks:
        found = _read(track, name)
        if requested in _tags(found, name):
            return found
        tags += _tags(found, name)
    expected = f"one of {', '.join(dict.fromkeys(tags))}, or a number from 1 to {len(tracks)}"
    raise InvalidArgument("--track", f"{requested!r:.80}", expected, f"{name} has no other touch.")


def _tags(found: _Found, name: str) -> tuple[str, ...]:
    file: Any = BytesIO(found.data)
    file.name = name
    with TouchReader(file) as reader:
        return reader.head.tags


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
