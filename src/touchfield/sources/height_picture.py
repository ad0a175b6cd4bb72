"""Grey pictures as arrays of heights, through Pillow: PNG of 8 and 16 bits, TIFF of integers and floats."""

from __future__ import annotations

import struct
import warnings
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.errors import SourceError
from touchfield.sources.geotiff import GeoTags, read_geo_tags

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["is_grey_picture", "read_picture"]

GREY_MODES: Final = ("L", "LA", "I", "F", "I;16", "I;16L", "I;16B", "I;16N", "I;16S", "I;16BS")
_FAULTS = (OSError, ValueError, SyntaxError, EOFError, KeyError, IndexError, TypeError, struct.error, zlib.error,
           OverflowError, MemoryError, RuntimeError, AttributeError)  # fmt: skip
"""What Pillow's readers raise for bytes at fault."""


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    from PIL import Image

    try:
        with warnings.catch_warnings():
            # a large elevation model is no attack; Pillow still refuses what is twice as large again
            warnings.simplefilter("ignore")
            with Image.open(path) as picture:
                yield picture
    except SourceError:
        raise
    except Image.DecompressionBombError as error:
        raise SourceError(str(path), "a picture of more than 178 million samples", "a smaller one") from error
    except _FAULTS as error:
        reason = getattr(error, "strerror", None) or error
        raise SourceError(str(path), f"a picture that cannot be read ({reason})", "a whole PNG or TIFF") from error


def is_grey_picture(path: Path) -> bool:
    """Whether Pillow knows the picture and it has one grey channel; reads the head only."""
    try:
        with _opened(path) as picture:
            return picture.mode in GREY_MODES
    except SourceError:
        return False


def read_picture(path: Path) -> tuple[NDArray[Any], GeoTags, bool]:
    """Read the grey values of a picture.

    Returns
    -------
    values : number [rows, cols]
        NaN where the file's nodata value stands.
    tags : GeoTags
        What the tags of a TIFF say.
    is_elevation : bool
        Whether the values are heights by their nature: floats, or a TIFF with a place on Earth.

    Raises
    ------
    SourceError
        If the picture cannot be read or is in colour.
    """
    with _opened(path) as picture:
        if picture.mode not in GREY_MODES:
            raise SourceError(
                str(path), f"a picture of mode {picture.mode}", "one grey channel", "Convert it to grey first."
            )
        size = (picture.height, picture.width)
        tags = read_geo_tags(dict(getattr(picture, "tag_v2", {})), *size)
        values = np.array(picture.getchannel(0) if picture.mode == "LA" else picture)
    if values.shape != size:
        raise SourceError(str(path), f"values of shape {values.shape}", f"{size}")
    is_elevation = values.dtype.kind == "f" or tags.cell is not None
    if tags.nodata is not None:
        values = values.astype(np.float64)
        with np.errstate(over="ignore"):
            nearest = float(np.float32(tags.nodata))  # the tag is text; the picture holds a float32 near it
        values[(values == tags.nodata) | (values == nearest)] = np.nan
    return values, tags, is_elevation
