"""Files of relative depth maps, and the size of the photograph that they belong to."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.errors import SourceError
from touchfield.files import require_plain
from touchfield.sources.pictures import bound_pixels, picture_header, read_picture

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["PHOTO_SUFFIXES", "MapFiles", "photo_size", "read_map"]

PHOTO_SUFFIXES: Final = (".png", ".jpg", ".jpeg", ".webp", ".bmp", ".tif", ".tiff")

_PHOTO_FORMATS: Final = ("PNG", "JPEG", "WEBP", "BMP", "TIFF")
_ORIENTATION: Final = 0x0112
_ON_ITS_SIDE: Final = (5, 6, 7, 8)


class MapFiles:
    """Maps in files, one a frame, read when they are asked for.

    Parameters
    ----------
    paths : tuple of Path

    Raises
    ------
    SourceError
        If one is no picture of the first one's size.
    """

    def __init__(self, paths: tuple[Path, ...]) -> None:
        self.paths, self.frame_count = paths, len(paths)
        first = picture_header(paths[0])
        for path in paths[1:]:
            other = picture_header(path)
            if (other.width, other.height) != (first.width, first.height):
                found = f"{other.width} x {other.height} pixels"
                raise SourceError(str(path), found, f"{first.width} x {first.height}, as in {paths[0].name}")

    def values(self, frame: int) -> NDArray[Any]:
        """The numbers of one map, [height, width]; see `read_map`."""
        return read_map(self.paths[frame])


def read_map(path: Path) -> NDArray[Any]:
    """The numbers of a map: PNG or TIFF of one channel, NPY, or an 8-bit RGB PNG whose channels are all the same.

    Raises
    ------
    SourceError
        If it cannot be read or is in colour.
    """
    header = picture_header(path)
    if (header.channels, header.sample) != (3, "uint8"):
        return read_picture(path)
    from PIL import Image

    bound_pixels(path, header.width, header.height, 3)
    try:
        with Image.open(path, formats=("PNG",)) as image:
            channels = np.asarray(image.convert("RGB"))
    except Exception as error:  # for damaged files Pillow raises almost any kind
        raise SourceError(str(path), f"a damaged picture ({error})", "a whole PNG", "Copy the file again.") from error
    if (channels != channels[:, :, :1]).any():
        raise SourceError(
            str(path),
            "a picture in colour",
            "the grey map",
            "Save the relative depth itself, not a coloured preview.",
        )
    return np.ascontiguousarray(channels[:, :, 0])


def photo_size(path: Path) -> tuple[int, int]:
    """Width and height of a photograph as it is shown, from its head alone.

    Raises
    ------
    SourceError
        If it is no picture.
    """
    from PIL import Image

    require_plain(path, "a picture")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a large photograph is no attack: it is not decoded
            with Image.open(path, formats=_PHOTO_FORMATS) as image:
                width, height = image.size
                is_on_its_side = image.getexif().get(_ORIENTATION) in _ON_ITS_SIDE
    except Image.DecompressionBombError as error:
        raise SourceError(str(path), "a picture of more than 178 million pixels", "a smaller one") from error
    except Exception as error:  # as above
        reason = getattr(error, "strerror", None) or "no picture in it"
        raise SourceError(str(path), f"{reason}", "PNG, JPEG, WebP, BMP or TIFF", "Check the file.") from error
    return (height, width) if is_on_its_side else (width, height)
