"""Frames of a grey video as arrays, by their number, through PyAV (the extra ``video``).

Containers are Matroska, AVI, MOV and MP4; FFmpeg is told which by the suffix, so that nothing else that it knows
(play lists, which name other files and addresses) is ever opened. Frames are counted by reading every packet, never
by what a header says; a header that promises more than there is tells of a file that was cut. Decoding goes forward
from the last key frame, so a pass in order decodes each frame once.

A damaged frame is an error where the decoder tells it (PNG does). FFmpeg's decoder of FFV1 does not: it fills damaged
slices from the frame before, which nothing but its log says.
"""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.errors import MissingExtra, SourceError, TouchfieldError
from touchfield.sources.pictures import InOrder, bound_pixels, require_size

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["DEEP_GREY", "VIDEO_SUFFIXES", "GreyVideo", "VideoHeader", "video_header"]

VIDEO_SUFFIXES: Final = (".mkv", ".avi", ".mov", ".mp4")

DEEP_GREY: Final = re.compile(r"gray(9|10|12|14|16)(le|be)")
"""FFmpeg's names of the pixel formats with one number of 9 to 16 bits a pixel."""

MAX_FRAMES: Final = 1 << 20

_FORMATS: Final = {".mkv": "matroska", ".avi": "avi", ".mov": "mov", ".mp4": "mov"}
_STRICT: Final = {"err_detect": "crccheck+explode"}  # a damaged frame is an error where the codec can tell
_NEUTRAL: Final = 12  # 8-bit levels by which red, green and blue of a grey may differ after lossy coding


@dataclass(frozen=True)
class VideoHeader:
    """Head of a video stream: size in pixels, FFmpeg's names of pixel format and codec, and the average rate."""

    width: int
    height: int
    pixels: str
    codec: str
    rate_hz: float | None

    @property
    def is_deep_grey(self) -> bool:
        """True if a pixel is one number of more than 8 bits."""
        return DEEP_GREY.fullmatch(self.pixels) is not None


def video_header(path: Path) -> VideoHeader:
    """The header of the first video stream.

    Raises `MissingExtra` without PyAV; `SourceError` if the file is no video, or its frames are too large.
    """
    with _opened(path) as (_, stream):
        return _header(path, stream)


class GreyVideo(InOrder):
    """The frames of a video whose pixels are one number, or whose colours are all grey.

    Raises `MissingExtra` if PyAV is not installed; `SourceError` if the file is no video, is damaged or cut, or has
    no frame.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with _opened(path) as (container, stream):
            self.header = _header(path, stream)
            self._stamps, self._keys = _scan(path, container, stream, self.header.rate_hz)
        super().__init__(str(path), len(self._stamps))
        self.size = self.header.width, self.header.height

    def values(self, frame: int) -> NDArray[Any]:
        """The numbers of one frame, uint8 or uint16 [height, width], in the machine's byte order.

        Raises `SourceError` if it cannot be decoded, differs in size from the first, or is in colour.
        """
        return self.at(frame).copy()

    def _begin(self, frame: int) -> int:
        return self._keys[bisect_right(self._keys, frame) - 1]

    def _from(self, first: int) -> Iterator[NDArray[Any]]:
        """The numbers of the frames from a key frame on; the file stays open as long as they are asked for."""
        with _opened(self.path) as (container, stream):
            stream.codec_context.options = dict(_STRICT)
            if first:
                container.seek(self._stamps[first], stream=stream, backward=True)
            is_at_key = first == 0
            for picture in container.decode(stream):
                if not is_at_key:
                    if picture.pts is not None and picture.pts < self._stamps[first]:
                        continue
                    if picture.pts != self._stamps[first]:  # the file has no index that one can go by
                        self._keys = [0]
                        break
                    is_at_key = True
                yield self._array(picture)
        if not is_at_key:
            yield from islice(self._from(0), first, None)

    def _array(self, picture: Any) -> NDArray[Any]:
        if picture.is_corrupt:
            raise SourceError(str(self.path), "a damaged frame", "a whole video", "Copy it again.")
        header = self.header
        require_size(str(self.path), (picture.width, picture.height), (header.width, header.height), "as before")
        return self._values(picture)

    def _values(self, picture: Any) -> NDArray[Any]:
        """The values of a frame that is whole and of the right size."""
        if picture.format.name == "gray" or DEEP_GREY.fullmatch(picture.format.name):
            values = picture.to_ndarray()
            return np.ascontiguousarray(values.astype(values.dtype.newbyteorder("="), copy=False))
        colours = picture.to_ndarray(format="rgb24")
        if int((colours.max(axis=2) - colours.min(axis=2)).max()) > _NEUTRAL:
            mend = "Give the grey map, not a coloured one."
            raise SourceError(str(self.path), "a frame in colour", "grey frames", mend)
        return np.ascontiguousarray(colours[:, :, 1])


def _header(path: Path, stream: Any) -> VideoHeader:
    context, rate = stream.codec_context, stream.average_rate
    bound_pixels(path, context.width, context.height)
    pixels = context.pix_fmt or "unknown pixels"
    rate_hz = float(rate) if rate and rate > 0 else None
    return VideoHeader(context.width, context.height, pixels, context.name, rate_hz)


def _scan(path: Path, container: Any, stream: Any, rate_hz: float | None) -> tuple[list[int], list[int]]:
    """Time stamps of all frames, and the numbers of the key frames from which decoding can begin.

    Only where the stamps ascend is a packet's number that of its frame; else decoding always begins at frame 0.
    """
    stamps: list[int] = []
    keys: list[int] = []
    for packet in container.demux(stream):
        if not packet.size:
            continue
        if len(stamps) == MAX_FRAMES:
            raise SourceError(str(path), f"more than {MAX_FRAMES} frames", "a shorter video", "Cut it into parts.")
        if packet.is_keyframe:
            keys.append(len(stamps))
        stamps.append(-1 if packet.pts is None else packet.pts)
    if not stamps:
        raise SourceError(str(path), "a video without a frame", "at least one frame")
    promised = stream.frames
    period_s = 1 / rate_hz if rate_hz else 0.0
    told = re.fullmatch(r"(\d+):(\d+):([\d.]+)", stream.metadata.get("DURATION", ""))
    if told and period_s and stream.time_base:  # Matroska counts no frames, but says how long a track is
        duration_s = 3600 * int(told[1]) + 60 * int(told[2]) + float(told[3])
        lost = duration_s - (max(stamps) * float(stream.time_base) + period_s)
        promised = len(stamps) + round(lost / period_s) if lost > 1.5 * period_s else 0
    if promised > len(stamps):
        found = f"{len(stamps)} frames where its header says {promised}"
        raise SourceError(str(path), found, "a whole video", "Copy it again.")
    ascends = min(stamps) >= 0 and all(a < b for a, b in zip(stamps, stamps[1:]))
    return stamps, sorted({0, *keys}) if ascends else [0]


@contextmanager
def _opened(path: Path) -> Iterator[tuple[Any, Any]]:
    """The container and its first video stream; what FFmpeg raises is a `SourceError`."""
    try:
        av: Any = import_module("av")
    except ImportError as error:
        raise MissingExtra("a video", "PyAV", "video") from error
    form = _FORMATS.get(path.suffix.lower())
    if form is None:
        raise SourceError(str(path), f"the suffix {path.suffix!r}", " ".join(VIDEO_SUFFIXES))
    try:
        with av.open(
            str(path.absolute()), format=form, options={"protocol_whitelist": "file"}, metadata_errors="replace"
        ) as container:
            if not container.streams.video:
                raise SourceError(str(path), "no video in the file", "a video stream")
            stream = container.streams.video[0]
            if stream.codec_context is None:  # damage has hidden the codec's name
                raise SourceError(str(path), "a video of no codec that is known", "a whole video", "Copy it again.")
            yield container, stream
    except TouchfieldError:
        raise
    except (av.error.FFmpegError, ValueError, OverflowError) as error:  # PyAV raises others of these for odd headers
        found = f"a video that cannot be read ({getattr(error, 'strerror', None) or error})"
        raise SourceError(str(path), found, "a whole video", "Copy the file again.") from error
    except OSError as error:
        raise SourceError(str(path), error.strerror or str(error), "a video that can be read") from error
