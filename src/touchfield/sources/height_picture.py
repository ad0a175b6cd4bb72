"""Grey pictures as arrays of heights, through Pillow: PNG of 8 and 16 bits, TIFF of integers and floats; GeoTIFF.

OGC 19-008r4, GeoTIFF 1.1: tags 33550 ModelPixelScale, 33922 ModelTiepoint, 34264 ModelTransformation and 34735
GeoKeyDirectory; 42113 is GDAL's nodata tag. Degrees become metres on the ellipsoid WGS 84 (NGA.STND.0036) at
the map's middle latitude: one scale for the whole map, no projection.
"""

from __future__ import annotations

import math
import struct
import warnings
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.errors import SourceError

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["GeoTags", "degree_m", "is_grey_picture", "read_geo_tags", "read_picture"]

PIXEL_SCALE, TIEPOINT, TRANSFORMATION, GEO_KEYS, GDAL_NODATA = 33550, 33922, 34264, 34735, 42113
MODEL_TYPE_KEY, LINEAR_UNITS_KEY, VERTICAL_UNITS_KEY = 1024, 3076, 4099
GEOGRAPHIC: Final = 2
UNITS_M: Final = {9001: 1.0, 9002: 0.3048, 9003: 1200 / 3937}
"""EPSG codes of the metre, the international foot and the US survey foot."""

WGS84_AXIS_M: Final = 6378137.0
WGS84_E2: Final = 0.00669437999014

GREY_MODES: Final = ("L", "LA", "I", "F", "I;16", "I;16L", "I;16B", "I;16N", "I;16S", "I;16BS")
_FAULTS = (OSError, ValueError, SyntaxError, EOFError, KeyError, IndexError, TypeError, struct.error, zlib.error,
           OverflowError, MemoryError, RuntimeError, AttributeError)  # fmt: skip
"""Errors of Pillow's readers for bytes at fault."""


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
    """True if Pillow knows the picture and it has one grey channel; reads the head only."""
    try:
        with _opened(path) as picture:
            return picture.mode in GREY_MODES
    except SourceError:
        return False


def read_picture(path: Path) -> tuple[NDArray[Any], GeoTags, bool]:
    """The grey values [rows, cols] of a picture, NaN where unknown; its tags; whether they are heights.

    They are by their nature where they are floats, or of a TIFF with a place on Earth. Raises `SourceError` if the
    picture cannot be read or is in colour.
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


# -- GeoTIFF -------------------------------------------------------------------------------------------------


def degree_m(latitude_deg: float) -> tuple[float, float]:
    """Metres of one degree of latitude and of one degree of longitude, on WGS 84."""
    sine2 = math.sin(math.radians(latitude_deg)) ** 2
    across = WGS84_AXIS_M / math.sqrt(1 - WGS84_E2 * sine2)
    along = across * (1 - WGS84_E2) / (1 - WGS84_E2 * sine2)
    return math.radians(along), math.radians(across * math.cos(math.radians(latitude_deg)))


@dataclass(frozen=True)
class GeoTags:
    """Place and units of samples, as a file says; None where it does not.

    Attributes
    ----------
    cell : (float, float) or None; (dy, dx) in units of the map.
    middle : (float, float) or None; y and x of the middle of the map, in units of the map.
    unit_m, vertical_unit_m : float; Metres of one unit across, where it is not degrees, and of one unit of height.
    """

    cell: tuple[float, float] | None = None
    middle: tuple[float, float] | None = None
    is_degrees: bool | None = None
    unit_m: float = 1.0
    vertical_unit_m: float | None = 1.0
    nodata: float | None = None


def read_geo_tags(tags: Mapping[int, Any], rows: int, cols: int) -> GeoTags:
    """Read the tags of a picture of `rows` x `cols`; what is missing or malformed is left out."""
    cell, middle = _placement(tags, rows, cols)
    keys = _geo_keys(_numbers(tags, GEO_KEYS))
    model = keys.get(MODEL_TYPE_KEY)
    nodata = str(tags.get(GDAL_NODATA, "")).strip(" \0")
    try:
        missing = float(nodata)
    except ValueError:
        missing = None
    return GeoTags(
        cell,
        middle,
        None if model is None else model == GEOGRAPHIC,
        UNITS_M.get(keys.get(LINEAR_UNITS_KEY, 9001), 1.0),
        UNITS_M.get(keys.get(VERTICAL_UNITS_KEY, 9001), 1.0),
        missing,
    )


def _placement(
    tags: Mapping[int, Any], rows: int, cols: int
) -> tuple[tuple[float, float] | None, tuple[float, float] | None]:
    scale, tie = _numbers(tags, PIXEL_SCALE), _numbers(tags, TIEPOINT)
    matrix = _numbers(tags, TRANSFORMATION)
    if len(scale) >= 2 and scale[0] > 0 and scale[1] > 0:
        dx, dy = scale[0], scale[1]
        if len(tie) < 6:
            return (dy, dx), None
        return (dy, dx), (tie[4] - dy * (rows / 2 - tie[1]), tie[3] + dx * (cols / 2 - tie[0]))
    is_turned = len(matrix) == 16 and (matrix[1] != 0 or matrix[4] != 0)
    if len(matrix) == 16 and matrix[0] and matrix[5] and not is_turned:
        middle = (matrix[7] + matrix[5] * rows / 2, matrix[3] + matrix[0] * cols / 2)
        return (abs(matrix[5]), abs(matrix[0])), middle
    return None, None


def _numbers(tags: Mapping[int, Any], tag: int) -> list[float]:
    values = tags.get(tag, ())
    values = values if isinstance(values, tuple | list) else (values,)
    try:
        numbers = [float(v) for v in values]
    except (TypeError, ValueError, ZeroDivisionError):
        return []
    return numbers if all(map(math.isfinite, numbers)) else []


def _geo_keys(directory: list[float]) -> dict[int, int]:
    """The keys whose value stands in the directory itself (location 0)."""
    entries = [directory[i : i + 4] for i in range(4, len(directory) - 3, 4)]
    return {int(key): int(value) for key, location, _, value in entries if location == 0}
