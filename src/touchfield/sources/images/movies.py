"""Reads frames of videos and of folders of pictures, grey or in colour, as arrays by their number.

Videos are read through PyAV (the extra ``video``). The suffix selects FFmpeg's container format, so that no
other format (play lists, which name other files and addresses) is ever opened. Frames are counted by reading
every packet; a header that declares more indicates a truncated file. A pass in order decodes each frame once.
Damaged frames are errors if the decoder reports them; FFV1's silently fills damaged slices from the previous
frame.

Colour pictures, with transparency as black, are reduced to means over the pixels of a small map (`reduced`).
"""

from __future__ import annotations

import re
import shlex
from bisect import bisect_right
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Float64s
from touchfield.errors import SourceError, TouchfieldError, import_extra
from touchfield.files import file_error, readable, require_plain
from touchfield.sources.camera import MAX_FRAMES
from touchfield.sources.images.pictures import (
    PHOTO_FORMATS,
    InOrder,
    PictureHeader,
    bound_pixels,
    opened,
    require_size,
)
from touchfield.sources.images.plane_means import has_planes, plane_means
from touchfield.sources.images.png_rows import require_all_rows

Colours = NDArray[np.uint8]

LONGER_SIDE_PX: Final = 64  # of the reduced picture, as in Hou & Zhang
DEEP_GREY: Final = re.compile(r"gray(9|10|12|14|16)(le|be)")
"""FFmpeg's names of the pixel formats with one number of 9 to 16 bits a pixel."""

_FORMATS: Final = {".mkv": "matroska", ".avi": "avi", ".mov": "mov", ".mp4": "mov", ".gif": "gif"}
VIDEO_SUFFIXES: Final = tuple(_FORMATS)
"""Endings of the videos that are sources of `encode`."""

_MOVIE_FORMATS: Final = {**_FORMATS, ".m4v": "mov", ".webm": "matroska", ".ts": "mpegts"}
MOVIE_SUFFIXES: Final = tuple(_MOVIE_FORMATS)
"""Endings of movies, which have sound too: none of the others is a form in which depth is recorded."""

_OPTIONS: Final = {"err_detect": "crccheck+explode", "trans_color": "0"}
"""Decoder options: damaged data are an error, and transparent pixels of a GIF are black."""
_READ: Final = "a video that can be read"
_GIF_TAIL: Final = 4096  # bytes at the end, zeros of a padding included
_UNEVEN: Final = 1.5  # longest over shortest time between frames, from which a note is given
_ROUNDED_S: Final = 1.5e-3  # times in whole milliseconds, as Matroska stores them, differ by one
_MAX_EVEN_HZ: Final = 100
_NEUTRAL: Final = 12  # 8-bit levels by which red, green and blue of a grey may differ after lossy coding


@dataclass(frozen=True)
class VideoHeader:
    """Header of a video stream.

    It has the size in pixels, FFmpeg's names of pixel format and codec, the average rate, and a note on other
    tracks.
    """

    width: int
    height: int
    pixels: str
    codec: str
    rate_hz: float | None
    track_note: str = ""

    @property
    def is_deep_grey(self) -> bool:
        """True if a pixel is one value of more than 8 bits."""
        return DEEP_GREY.fullmatch(self.pixels) is not None


def video_header(path: Path) -> VideoHeader:
    """Read the header of the video stream that is read: the track DEPTH of a recorder, else the first."""
    with _opened(path) as (_, _, header):
        return header


def unfinished_note(path: Path) -> tuple[str, ...]:
    """Return a note for a GIF without its last byte: it declares no number of frames to compare with."""
    if path.suffix.lower() != ".gif":
        return ()
    with path.open("rb") as stream:
        stream.seek(max(0, path.stat().st_size - _GIF_TAIL))
        end = stream.read(_GIF_TAIL).rstrip(b"\0")
    if end.endswith(b";"):
        return ()
    return ("The file does not end as a GIF does: frames may be missing. Copy it again.",)


def uneven_note(path: Path, gaps_s: Float64s, rate_hz: float | None) -> tuple[str, ...]:
    """Return a note if the frames of a video are at unequal times, with a command that repeats frames.

    `gaps_s` float64 [frames - 1] are the seconds from one frame to the next; 0 if they are unknown.
    """
    gaps_s = gaps_s[gaps_s > 0]
    if len(gaps_s) == 0 or gaps_s.max() <= _UNEVEN * gaps_s.min() + _ROUNDED_S:
        return ()
    rate = "one rate" if rate_hz is None else f"{rate_hz:.4g} a second"
    frequent_hz = min(_MAX_EVEN_HZ, round(1 / float(gaps_s.min())) or 1)
    name = shlex.quote(path.name)
    return (
        f"The frames are {gaps_s.min():.3g} to {gaps_s.max():.3g} s apart, and are read at {rate}. For their "
        f"own times: ffmpeg -i {name} -vf fps={frequent_hz} -c:v ffv1 even.mkv, then encode even.mkv",
    )


class GreyVideo(InOrder):
    """The frames of a grey video.

    `times_s` float64 [frames] are their times on the clock of the movie, ascending, in seconds.

    Raises `MissingExtra` if PyAV is not installed.
    """

    paths: tuple[Path, ...] = ()
    headers: tuple[PictureHeader, ...] = ()

    def __init__(self, path: Path) -> None:
        self.path = path
        with _opened(path) as (container, stream, self.header):
            self._stamps, self._keys = _scan(path, container, stream, self.header.rate_hz)
            self.times_s = np.sort(self._stamps) * float(stream.time_base or 0)
        super().__init__(str(path), len(self._stamps))
        self.size, self.rate_hz = (self.header.width, self.header.height), self.header.rate_hz
        tracks = (self.header.track_note,) if self.header.track_note else ()
        self.notes = (
            *tracks,
            *unfinished_note(path),
            *uneven_note(path, np.diff(self.times_s), self.rate_hz),
        )

    def _decode_start(self, frame: int) -> int:
        return self._keys[bisect_right(self._keys, frame) - 1]

    def _iterate(self, first: int) -> Iterator[NDArray[Any]]:
        """Yield the values of the frames from a key frame on.

        The file stays open meanwhile.
        """
        with _opened(self.path) as (container, stream, _):
            stream.codec_context.options = dict(_OPTIONS)
            if first:
                container.seek(self._stamps[first], stream=stream, backward=True)
            is_at_key = first == 0
            for picture in container.decode(stream):
                if not is_at_key:
                    if picture.pts is not None and picture.pts < self._stamps[first]:
                        continue
                    if picture.pts != self._stamps[first]:  # the index of the file is unreliable
                        self._keys = [0]
                        break
                    is_at_key = True
                if picture.is_corrupt:
                    raise SourceError(str(self.path), "a damaged frame", "a whole video", "Copy it again.")
                size = self.header.width, self.header.height
                require_size(str(self.path), (picture.width, picture.height), size, "as before")
                yield self._values(picture)
        if not is_at_key:
            yield from islice(self._iterate(0), first, None)

    def _values(self, picture: Any) -> NDArray[Any]:
        """Return the values of a frame, uint8 or uint16 [height, width], in native byte order."""
        if self.header.is_deep_grey != bool(DEEP_GREY.fullmatch(picture.format.name)):
            found = f"a frame of {picture.format.name} pixels"
            raise SourceError(str(self.path), found, f"{self.header.pixels}, as before")
        if picture.format.name == "gray" or DEEP_GREY.fullmatch(picture.format.name):
            values = picture.to_ndarray()
            return np.ascontiguousarray(values.astype(values.dtype.newbyteorder("="), copy=False))
        colours = picture.to_ndarray(format="rgb24")
        if int((colours.max(axis=2) - colours.min(axis=2)).max()) > _NEUTRAL:
            mend = "Give the grey map, not a coloured one."
            raise SourceError(str(self.path), "a frame in colour", "grey frames", mend)
        return np.ascontiguousarray(colours[:, :, 1])


def _scan(path: Path, container: Any, stream: Any, rate_hz: float | None) -> tuple[list[int], list[int]]:
    """Return the time stamps of all frames, and the numbers of the key frames at which decoding can start.

    A packet's number is that of its frame only if the stamps ascend; otherwise decoding always starts at
    frame 0.
    """
    stamps: list[int] = []
    keys: list[int] = []
    for packet in container.demux(stream):
        if not packet.size:
            continue
        if len(stamps) == MAX_FRAMES:
            raise SourceError(
                str(path), f"more than {MAX_FRAMES} frames", "a shorter video", "Cut it into parts."
            )
        if packet.is_keyframe:
            keys.append(len(stamps))
        stamps.append(-1 if packet.pts is None else packet.pts)
    if not stamps:
        raise SourceError(str(path), "a video without a frame", "at least one frame")
    declared = stream.frames
    period_s = 1 / rate_hz if rate_hz else 0.0
    length = re.fullmatch(r"(\d+):(\d+):([\d.]+)", stream.metadata.get("DURATION", ""))
    if (
        length and period_s and stream.time_base
    ):  # Matroska stores no frame count, but the duration of a track
        duration_s = 3600 * int(length[1]) + 60 * int(length[2]) + float(length[3])
        missing_s = duration_s - (max(stamps) * float(stream.time_base) + period_s)
        declared = len(stamps) + round(missing_s / period_s) if missing_s > 1.5 * period_s else 0
    if declared > len(stamps):
        found = f"{len(stamps)} frames where its header says {declared}"
        raise SourceError(str(path), found, "a whole video", "Copy it again.")
    ascends = min(stamps) >= 0 and all(a < b for a, b in zip(stamps, stamps[1:]))
    return stamps, sorted({0, *keys}) if ascends else [0]


def is_cover(stream: Any) -> bool:
    """True for a still picture that a player shows in place of a video, such as the cover of an album."""
    from av.stream import Disposition

    return stream.type == "video" and bool(stream.disposition & Disposition.attached_pic)


def _depth_track(streams: Any) -> tuple[Any, str]:
    """Return the track of depth of an Azure Kinect or Femto, else the first, and a note on the others.

    Source: Azure Kinect DK, record file format: the tracks COLOR, DEPTH and IR, in any order.
    """
    if len(streams) == 1:
        return streams[0], ""
    names = [stream.metadata.get("title", "") or f"number {n + 1}" for n, stream in enumerate(streams)]
    index = names.index("DEPTH") if "DEPTH" in names else 0
    others = ", ".join(name[:40] for n, name in enumerate(names[:8]) if n != index)
    return streams[index], f"Of {len(streams)} video tracks {names[index][:40]} is read; not {others}."


@contextmanager
def opened_container(path: Path) -> Iterator[Any]:
    """Open a movie with PyAV, in the container format of its suffix.

    FFmpeg's errors within the block become `SourceError`. Raises `MissingExtra` if PyAV is not installed.
    """
    av = import_extra("av", "a video", "PyAV", "video")
    form = _MOVIE_FORMATS.get(path.suffix.lower())
    if form is None:
        raise SourceError(str(path), f"the suffix {path.suffix!r}", " ".join(MOVIE_SUFFIXES))
    require_plain(path, _READ)
    with readable(path, _READ):
        path.stat()
    try:
        with av.open(
            str(path.absolute()),
            format=form,
            options={"protocol_whitelist": "file"},
            metadata_errors="replace",
        ) as container:
            yield container
    except TouchfieldError:
        raise
    except (
        av.error.FFmpegError,
        ValueError,
        OverflowError,
    ) as error:  # PyAV raises the others for odd headers
        found = f"a video that cannot be read ({getattr(error, 'strerror', None) or error})"
        raise SourceError(str(path), found, "a whole video", "Copy the file again.") from error
    except OSError as error:
        raise file_error(path, error, _READ) from error


@contextmanager
def _opened(path: Path) -> Iterator[tuple[Any, Any, VideoHeader]]:
    """Open the container, the video stream that is read (`video_header`) and its header."""
    with opened_container(path) as container:
        if not container.streams.video:
            raise SourceError(str(path), "no video in the file", "a video stream")
        streams = container.streams.video
        stream, track_note = _depth_track([track for track in streams if not is_cover(track)] or streams)
        context, rate = stream.codec_context, stream.average_rate
        if context is None:  # the codec's name is damaged
            raise SourceError(
                str(path), "a video of no codec that is known", "a whole video", "Copy it again."
            )
        bound_pixels(path, context.width, context.height)
        pixels, rate_hz = context.pix_fmt or "unknown pixels", float(rate) if rate and rate > 0 else None
        header = VideoHeader(context.width, context.height, pixels, context.name, rate_hz, track_note)
        yield container, stream, header


# -- colour ------------------------------------------------------------------------------------------------
def map_size(width: int, height: int) -> tuple[int, int]:
    """Return width and height of the reduced picture.

    A smaller picture keeps its size.
    """
    factor = max(1.0, max(width, height) / LONGER_SIDE_PX)
    return max(1, round(width / factor)), max(1, round(height / factor))


def reduced(colours: Colours) -> Colours:
    """Reduce a picture, uint8 [height, width, 3], to means over the pixels of `map_size`."""
    from PIL import Image

    height, width = colours.shape[:2]
    size = map_size(width, height)
    if size == (width, height):
        return colours
    return np.asarray(Image.fromarray(colours).resize(size, Image.Resampling.BOX))


class ColourVideo(GreyVideo):
    """The frames of a colour video: sRGB, uint8 [map height, map width, 3], of `map_size`."""

    def _values(self, picture: Any) -> Colours:
        size = map_size(picture.width, picture.height)
        if size != (picture.width, picture.height) and has_planes(picture):
            return plane_means(picture, size)
        return reduced(picture.to_ndarray(format="rgb24"))


class ColourPictures:
    """Picture files of one size as frames like those of `ColourVideo`."""

    rate_hz = None
    notes: tuple[str, ...] = ()

    def __init__(self, paths: tuple[Path, ...]) -> None:
        self.paths, self.frame_count = paths, len(paths)
        with _shallow(paths[0]) as image:
            self.size = _upright_rgb(image).shape[1::-1]

    def values(self, frame: int) -> Colours:
        with _shallow(self.paths[frame]) as image:
            return reduced(_upright_rgb(image, str(self.paths[frame]), self.size))


def _upright_rgb(image: Any, where: str = "", size: tuple[int, int] | None = None) -> Colours:
    """Return the pixels of an open picture, upright, sRGB, uint8 [height, width, 3].

    Transparency is black.

    If `size` is given, the picture must have it.
    """
    from PIL import Image, ImageOps

    upright = ImageOps.exif_transpose(image)
    if upright.mode == "P" or "A" in upright.mode or "a" in upright.mode or "transparency" in upright.info:
        rgba = upright.convert("RGBA")
        upright = Image.alpha_composite(Image.new("RGBA", rgba.size, (0, 0, 0, 255)), rgba)
    if size:
        require_size(where, upright.size, size, "as before")
    return np.asarray(upright.convert("RGB"))


@contextmanager
def _shallow(path: Path) -> Iterator[Any]:
    """Open a picture of 8 bits a colour with Pillow."""
    with opened(path, PHOTO_FORMATS) as image:
        bound_pixels(path, image.width, image.height)
        if image.mode[0] in "IF":
            mend = "16 bits or floats are no colours: they may be depth or heights."
            raise SourceError(str(path), f"a picture of {image.mode} samples", "8 bits a colour", mend)
        if image.format != "TIFF" and getattr(image, "is_animated", False):
            raise SourceError(
                str(path), "a picture that moves", "a still one", "Make a video or a GIF of it."
            )
        if image.format == "PNG":
            with path.open("rb") as stream:
                require_all_rows(str(path), stream)
        yield image
