"""Frames of one video track of a movie that has several: its depth, and the picture beside it.

A track of depth is deep grey (FFmpeg's gray9 to gray16), as recorders of depth cameras and FFmpeg write it;
one that is named IR is none. A pass in order decodes each frame once; going back starts the file again.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from touchfield.errors import SourceError
from touchfield.sources.camera import MAX_FRAMES
from touchfield.sources.images.movies import DEEP_GREY, is_cover, map_size, opened_container, reduced
from touchfield.sources.images.pictures import InOrder, bound_pixels, require_size
from touchfield.sources.images.plane_means import has_planes, plane_means

_OPTIONS: Final = {"err_detect": "crccheck+explode"}
_INFRARED: Final = "IR"  # the name of that track in recordings of Azure Kinect and Femto


@dataclass(frozen=True)
class VideoTracks:
    """Indices of the video tracks of a movie, covers left out.

    colours, depths : tuple of int
        Tracks of pictures, and of depth.
    infrared : int
        How many tracks of deep grey are named as no depth.
    """

    colours: tuple[int, ...]
    depths: tuple[int, ...]
    infrared: int = 0


def video_tracks(path: Path) -> VideoTracks:
    """List the video tracks of a movie; SourceError if it cannot be read, MissingExtra without PyAV."""
    colours, depths, infrared = list[int](), list[int](), 0
    with opened_container(path) as container:
        for stream in container.streams.video:
            if is_cover(stream):
                continue
            pixels = "" if stream.codec_context is None else stream.codec_context.pix_fmt or ""
            if not DEEP_GREY.fullmatch(pixels):
                colours.append(stream.index)
            elif stream.metadata.get("title", "") == _INFRARED:
                infrared += 1
            else:
                depths.append(stream.index)
    return VideoTracks(tuple(colours), tuple(depths), infrared)


class TrackFrames(InOrder):
    """The frames of the track `index` of a movie.

    Values are those of `GreyVideo` for a track of depth, uint16 [height, width], and else those of
    `ColourVideo`, sRGB, uint8 [map height, map width, 3]. `size` is width and height; `times_s` float64
    [frames] are on the clock of the movie, ascending; `rate_hz` is None if the file does not state it.
    """

    def __init__(self, path: Path, index: int) -> None:
        self.path, self._index = path, index
        with opened_container(path) as container:
            stream = container.streams[index]
            context, rate = stream.codec_context, stream.average_rate
            if context is None:  # the codec's name is damaged
                mend = "Copy it again."
                raise SourceError(str(path), "a video of no codec that is known", "a whole video", mend)
            bound_pixels(path, context.width, context.height)
            self.size, self.pixels = (context.width, context.height), context.pix_fmt or ""
            self.rate_hz = float(rate) if rate and rate > 0 else None
            stamps = [packet.pts for packet in container.demux(stream) if packet.size]
            unit_s = float(stream.time_base or 0)
        if not stamps or len(stamps) > MAX_FRAMES:
            raise SourceError(str(path), f"a video track of {len(stamps)} frames", f"1 to {MAX_FRAMES}")
        if any(stamp is None for stamp in stamps):
            raise SourceError(str(path), "frames without a time", "a time of each", "Copy it again.")
        self.times_s = np.sort(np.array(stamps, np.float64)) * unit_s
        super().__init__(str(path), len(stamps))

    def _iterate(self, first: int) -> Iterator[NDArray[Any]]:
        with opened_container(self.path) as container:
            stream = container.streams[self._index]
            stream.codec_context.options = dict(_OPTIONS)
            for number, picture in enumerate(container.decode(stream)):
                if picture.is_corrupt:
                    raise SourceError(str(self.path), "a damaged frame", "a whole video", "Copy it again.")
                require_size(str(self.path), (picture.width, picture.height), self.size, "as before")
                if number >= first:
                    yield self._values(picture)

    def _values(self, picture: Any) -> NDArray[Any]:
        if DEEP_GREY.fullmatch(self.pixels):
            values = picture.to_ndarray()
            return np.ascontiguousarray(values.astype(values.dtype.newbyteorder("="), copy=False))
        size = map_size(*self.size)
        if size != self.size and has_planes(picture):
            return plane_means(picture, size)
        return reduced(picture.to_ndarray(format="rgb24"))
