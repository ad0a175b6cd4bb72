"""A video of depth: 9 to 16 bits of grey a pixel, coded without loss (FFV1, 16-bit PNG), in MKV, AVI, MOV or MP4.

As of a folder of pictures it must be said how many stored units are in one metre, and which camera it was. 0 is
unknown, and so is 65535. The rate is the average rate of the stream. The camera stands still: a video has no poses.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from touchfield.errors import MissingExtra, SourceError
from touchfield.sources.camera import DepthSequence, Intrinsics
from touchfield.sources.folder_sequence import (
    DepthCode,
    is_layout,
    opener,
    placed_sequence,
    require_scale,
    source_rate,
)
from touchfield.sources.grey_video import VIDEO_SUFFIXES, GreyVideo, VideoHeader, video_header
from touchfield.sources.intrinsics_file import camera_of
from touchfield.sources.registry import SourceKind

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.sources.options import SourceOptions

__all__ = ["KIND", "DepthVideo", "rate_of_header", "read_sequence"]


class DepthVideo(DepthSequence):
    """Depth frames of a video, decoded when they are asked for.

    Parameters
    ----------
    video : GreyVideo
        Of more than 8 bits a pixel.
    code : DepthCode
    intrinsics : Intrinsics
    rate_hz : float
    """

    def __init__(self, video: GreyVideo, code: DepthCode, intrinsics: Intrinsics, rate_hz: float) -> None:
        self.video, self.code, self.intrinsics, self.rate_hz = video, code, intrinsics, rate_hz
        self.name, self.frame_count = str(video.path), video.frame_count
        self.width, self.height = video.header.width, video.header.height

    def depth_m(self, frame: int) -> NDArray[np.float32]:
        """See `DepthSequence.depth_m`."""
        values = self.video.values(frame)
        if values.dtype != np.uint16:
            raise _shallow(f"{self.name}, frame {frame}", "a frame of 8 bits")
        return self.code.metres(values)


def read_sequence(path: Path, options: SourceOptions) -> DepthSequence:
    """A video of depth.

    Raises
    ------
    MissingExtra
        If PyAV is not installed.
    SourceError
        If the file is no whole video of deep grey frames, or the scale or the intrinsics are not known.
    """
    if path.is_dir():
        raise SourceError(str(path), "a folder", "a video", "Name its kind with --as depth-folder.")
    header = video_header(path)
    if not header.is_deep_grey:
        raise _shallow(str(path), f"{header.codec} video of {header.pixels} pixels")
    folder = path.absolute().parent
    camera = camera_of(str(path), options.intrinsics, (folder,), (header.width, header.height))
    units_per_m = require_scale(str(path), options, "uint16", camera)
    video = DepthVideo(GreyVideo(path), DepthCode(units_per_m), camera.intrinsics, rate_of_header(header, options))
    return placed_sequence(video, options, (folder,), camera)


def rate_of_header(header: VideoHeader, options: SourceOptions) -> float:
    """Frames a second of a video: its average rate; where it has none, as of any source that does not say."""
    return header.rate_hz or source_rate(options)


def _shallow(where: str, found: str) -> SourceError:
    return SourceError(
        where,
        found,
        "16-bit grey (gray16le, gray12le, ...)",
        "It looks like an ordinary video: take --as saliency, or --as relative-depth with its depth beside it.",
    )


def _recognise(path: Path) -> bool:
    if path.suffix.lower() not in VIDEO_SUFFIXES or not path.is_file():
        return False
    try:
        return video_header(path).is_deep_grey
    except (MissingExtra, SourceError):
        return True  # so that the user is told which extra reads videos, or what is wrong with this one


KIND = SourceKind(
    "depth-video",
    "video of depth: 16-bit grey in MKV, AVI, MOV, MP4 (needs --depth-scale and --intrinsics; extra: video)",
    is_layout(_recognise),
    opener(read_sequence),
)
