"""Pictures in colour over time: of a video, of an animated GIF, WebP or PNG, of a folder; each read when it is asked.

What is transparent is black. Pictures are given as means over the pixels of a small map (`reduced`), so that nothing
keeps a large one.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol

import numpy as np

from touchfield.errors import SourceError
from touchfield.sources.camera import require_frame
from touchfield.sources.grey_video import MAX_FRAMES, GreyVideo
from touchfield.sources.pictures import InOrder, bound_pixels, opened, require_size

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Colours = NDArray[np.uint8]

__all__ = ["ANIMATED_SUFFIXES", "ColourVideo", "PictureFiles", "Pictures", "StillOrAnimated", "map_size", "reduced"]

ANIMATED_SUFFIXES: Final = (".gif",)
"""Of animations that are told by their name; animated WebP and PNG look like pictures."""

LONGER_SIDE_PX: Final = 64
"""Of the reduced picture, as Hou & Zhang have it."""

_FORMATS: Final = ("PNG", "JPEG", "WEBP", "BMP", "TIFF", "GIF")
_SHALLOW_MODES: Final = (
    "1", "L", "LA", "La", "P", "PA", "RGB", "RGBA", "RGBa", "RGBX", "CMYK", "YCbCr", "LAB", "HSV",
)  # fmt: skip
_UNSAID_MS: Final = 100  # for a GIF frame without a duration, as browsers have it


class Pictures(Protocol):
    """Pictures of one size in pixels over time, each given as its small map."""

    frame_count: int
    size: tuple[int, int]

    def picture(self, frame: int) -> Colours:
        """One picture, sRGB, uint8 [map height, map width, 3], of `map_size`."""


def map_size(width: int, height: int) -> tuple[int, int]:
    """Width and height of the reduced picture; a smaller picture keeps its size."""
    factor = max(1.0, max(width, height) / LONGER_SIDE_PX)
    return max(1, round(width / factor)), max(1, round(height / factor))


def reduced(colours: Colours) -> Colours:
    """A picture, uint8 [height, width, 3], as means over the pixels of `map_size`."""
    from PIL import Image

    height, width = colours.shape[:2]
    size = map_size(width, height)
    if size == (width, height):
        return colours
    return np.asarray(Image.fromarray(colours).resize(size, Image.Resampling.BOX))


class ColourVideo(GreyVideo):
    """The frames of an ordinary video, in colour; see `GreyVideo`."""

    def picture(self, frame: int) -> Colours:
        """See `Pictures`."""
        return self.values(frame)

    def _values(self, picture: Any) -> Colours:
        return reduced(picture.to_ndarray(format="rgb24"))


class PictureFiles:
    """Pictures in at least one file, of one size, one a frame; of an animated one, the first.

    Raises `SourceError` if the first is no picture of 8 bits a colour.
    """

    def __init__(self, paths: tuple[Path, ...]) -> None:
        self.paths, self.frame_count = paths, len(paths)
        with _shallow(paths[0]) as image:
            self.size = _size_of(_as_shown(image))

    def picture(self, frame: int) -> Colours:
        """See `Pictures`."""
        require_frame(frame, self.frame_count)
        with _shallow(self.paths[frame]) as image:
            return _small(image, str(self.paths[frame]), self.size)


class StillOrAnimated(InOrder):
    """The pictures of one file: GIF, WebP or PNG that moves, or a still of any kind.

    `rate_hz` is pictures a second on average, None of a still. Raises `SourceError` if it is no picture of 8 bits a
    colour, is damaged, or has too many frames.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with _shallow(path) as image:
            frame_count = int(getattr(image, "n_frames", 1)) if image.format in ("GIF", "WEBP", "PNG") else 1
            if frame_count > MAX_FRAMES:
                raise SourceError(str(path), f"{frame_count} frames", f"at most {MAX_FRAMES}", "Cut it.")
            total_ms = 0.0
            for frame in range(frame_count):
                image.seek(frame)
                if frame == 0 or image.format == "WEBP":  # which tells a duration only once it is decoded
                    image.load()
                total_ms += float(image.info.get("duration") or 0) or _UNSAID_MS
            image.seek(0)
            self.size = _size_of(_as_shown(image))
        self.rate_hz = 1000 * frame_count / total_ms if frame_count > 1 else None
        super().__init__(str(path), frame_count)

    def picture(self, frame: int) -> Colours:
        """See `Pictures`; a pass in order decodes each once, a step back begins anew."""
        return self.at(frame)

    def _from(self, first: int) -> Iterator[Colours]:
        with _shallow(self.path) as image:
            for frame in range(self.frame_count):
                image.seek(frame)
                yield _small(image, f"{self.path}, frame {frame}", self.size)


def _as_shown(image: Any) -> Colours:
    """The pixels of an open picture, upright, sRGB, uint8 [height, width, 3]; transparent ones are black."""
    from PIL import Image, ImageOps

    upright = ImageOps.exif_transpose(image)
    if upright.mode == "P" or "A" in upright.mode or "a" in upright.mode or "transparency" in upright.info:
        shown = upright.convert("RGBA")
        upright = Image.alpha_composite(Image.new("RGBA", shown.size, (0, 0, 0, 255)), shown)
    return np.asarray(upright.convert("RGB"))


def _size_of(colours: Colours) -> tuple[int, int]:
    return colours.shape[1], colours.shape[0]


def _small(image: Any, where: str, size: tuple[int, int]) -> Colours:
    """The small map of an open picture, which must be of this size."""
    colours = _as_shown(image)
    require_size(where, _size_of(colours), size, "as before")
    return reduced(colours)


@contextmanager
def _shallow(path: Path) -> Iterator[Any]:
    """A picture of 8 bits a colour, opened by Pillow."""
    with opened(path, _FORMATS) as image:
        bound_pixels(path, image.width, image.height)
        if image.mode not in _SHALLOW_MODES:
            mend = "16 bits or floats are no colours: they may be depth or heights."
            raise SourceError(str(path), f"a picture of {image.mode} samples", "8 bits a colour", mend)
        yield image
