"""Pictures in colour over time: of a video, of an animated GIF, WebP or PNG, of a folder; each read when it is asked.

What is transparent is black. Pictures are given as means over the pixels of a small map
(`touchfield.sources.saliency_map.reduced`), so that nothing keeps a large one.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Any, Final, Protocol

import numpy as np

from touchfield.errors import InvalidArgument, SourceError, TouchfieldError
from touchfield.files import require_plain
from touchfield.sources.grey_video import MAX_FRAMES, GreyVideo
from touchfield.sources.pictures import MAX_PIXELS, bound_pixels
from touchfield.sources.saliency_map import map_size, reduced

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Colours = NDArray[np.uint8]

__all__ = ["ANIMATED_SUFFIXES", "ColourVideo", "PictureFiles", "Pictures", "StillOrAnimated"]

ANIMATED_SUFFIXES: Final = (".gif",)
"""Of animations that are told by their name; animated WebP and PNG look like pictures."""

_FORMATS: Final = ("PNG", "JPEG", "WEBP", "BMP", "TIFF", "GIF")
_SHALLOW_MODES: Final = (
    "1",
    "L",
    "LA",
    "La",
    "P",
    "PA",
    "RGB",
    "RGBA",
    "RGBa",
    "RGBX",
    "CMYK",
    "YCbCr",
    "LAB",
    "HSV",
)
_UNSAID_MS: Final = 100  # for a GIF frame without a duration, as browsers have it


class Pictures(Protocol):
    """Pictures over time.

    Attributes
    ----------
    frame_count : int
    width, height : int
        Pixels, the same for every picture.
    map_size : (int, int)
        Width and height of what `picture` gives.
    """

    frame_count: int
    width: int
    height: int

    @property
    def map_size(self) -> tuple[int, int]:
        """See the class."""

    def picture(self, frame: int) -> Colours:
        """One picture as its small map, sRGB, uint8 [map height, map width, 3]."""


class ColourVideo(GreyVideo):
    """The frames of an ordinary video, in colour; see `GreyVideo`.

    Attributes
    ----------
    width, height : int
        Pixels.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.width, self.height = self.header.width, self.header.height

    @property
    def map_size(self) -> tuple[int, int]:
        """See `Pictures`."""
        return map_size(self.width, self.height)

    def picture(self, frame: int) -> Colours:
        """See `Pictures`."""
        return self.values(frame)

    def _values(self, picture: Any) -> Colours:
        return reduced(picture.to_ndarray(format="rgb24"))


class _OfFiles:
    """What pictures that Pillow reads share: their size, and its check."""

    width: int
    height: int

    @property
    def map_size(self) -> tuple[int, int]:
        """See `Pictures`."""
        return map_size(self.width, self.height)

    def _colours(self, image: Any, where: str) -> Colours:
        """The picture that stands in `image` as its small map."""
        colours = _as_shown(image)
        if colours.shape[:2] != (self.height, self.width):
            found = f"{colours.shape[1]} x {colours.shape[0]} pixels"
            raise SourceError(where, found, f"{self.width} x {self.height}, as before", "Give pictures of one size.")
        return reduced(colours)


class PictureFiles(_OfFiles):
    """Pictures in files of one size, one a frame; of an animated one, the first.

    Parameters
    ----------
    paths : tuple of Path
        At least one.

    Raises
    ------
    SourceError
        If the first is no picture of 8 bits a colour.
    """

    def __init__(self, paths: tuple[Path, ...]) -> None:
        self.paths, self.frame_count = paths, len(paths)
        with _opened(paths[0]) as image:
            self.height, self.width = _as_shown(image).shape[:2]

    def picture(self, frame: int) -> Colours:
        """See `Pictures`."""
        if not 0 <= frame < self.frame_count:
            raise InvalidArgument("frame", str(frame), f"0 to {self.frame_count - 1}")
        with _opened(self.paths[frame]) as image:
            return self._colours(image, str(self.paths[frame]))


class StillOrAnimated(_OfFiles):
    """The pictures of one file: GIF, WebP or PNG that moves, or a still of any kind.

    Parameters
    ----------
    path : Path

    Attributes
    ----------
    rate_hz : float or None
        Pictures a second on average; None of a still.

    Raises
    ------
    SourceError
        If it is no picture of 8 bits a colour, is damaged, or has too many frames.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with _opened(path) as image:
            self.frame_count = int(getattr(image, "n_frames", 1)) if image.format in ("GIF", "WEBP", "PNG") else 1
            if self.frame_count > MAX_FRAMES:
                raise SourceError(str(path), f"{self.frame_count} frames", f"at most {MAX_FRAMES}", "Cut it.")
            total_ms = 0.0
            for frame in range(self.frame_count):
                image.seek(frame)
                if frame == 0 or image.format == "WEBP":  # which tells a duration only once it is decoded
                    image.load()
                total_ms += float(image.info.get("duration") or 0) or _UNSAID_MS
            image.seek(0)
            self.height, self.width = _as_shown(image).shape[:2]
        self.rate_hz = 1000 * self.frame_count / total_ms if self.frame_count > 1 else None
        self._coming: Iterator[Colours] = iter(())
        self._next = -1  # number of the picture that comes next; -1: it has not begun, or failed
        self._latest: tuple[int, Colours] | None = None
        self._lock = Lock()

    def picture(self, frame: int) -> Colours:
        """See `Pictures`; a pass in order decodes each once, a step back begins anew."""
        if not 0 <= frame < self.frame_count:
            raise InvalidArgument(f"{self.path}, frame", str(frame), f"0 to {self.frame_count - 1}")
        with self._lock:
            if self._latest is None or self._latest[0] != frame:
                if not 0 <= self._next <= frame:
                    self._coming, self._next = self._from_the_first(), 0
                first, self._next = self._next, -1
                for _ in range(first, frame + 1):
                    colours = next(self._coming)
                self._next, self._latest = frame + 1, (frame, colours)
            return self._latest[1]

    def _from_the_first(self) -> Iterator[Colours]:
        with _opened(self.path) as image:
            for frame in range(self.frame_count):
                image.seek(frame)
                yield self._colours(image, f"{self.path}, frame {frame}")


def _as_shown(image: Any) -> Colours:
    """The pixels of an open picture, upright, sRGB, uint8 [height, width, 3]; transparent ones are black."""
    from PIL import Image, ImageOps

    upright = ImageOps.exif_transpose(image)
    if upright.mode == "P" or "A" in upright.mode or "a" in upright.mode or "transparency" in upright.info:
        shown = upright.convert("RGBA")
        upright = Image.alpha_composite(Image.new("RGBA", shown.size, (0, 0, 0, 255)), shown)
    return np.asarray(upright.convert("RGB"))


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """A picture opened by Pillow; what goes wrong while it is used is a `SourceError`."""
    from PIL import Image

    require_plain(path, "a picture")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of large pictures: they are bounded here
            image = Image.open(path, formats=_FORMATS)
        with image:
            bound_pixels(path, image.width, image.height)
            if image.mode not in _SHALLOW_MODES:
                raise SourceError(
                    str(path),
                    f"a picture of {image.mode} samples",
                    "8 bits a colour",
                    "16 bits or floats are no colours: they may be depth or heights.",
                )
            yield image
    except (TouchfieldError, GeneratorExit):
        raise
    except Image.DecompressionBombError as error:
        raise SourceError(str(path), "a picture that is too large", f"at most {MAX_PIXELS} pixels") from error
    except Exception as error:  # for damaged files Pillow raises almost any kind
        reason = getattr(error, "strerror", None) or error or "no picture in it"
        raise SourceError(str(path), f"a picture that cannot be read ({reason})", "a whole picture") from error
