"""Decodes a page of a TIFF in bands of rows, for maps that are too large as a whole.

Memory is bounded by a row of tiles, `MAX_PIXELS` samples at most; a strip may have as many.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from touchfield.errors import SourceError
from touchfield.sources.images.pictures import MAX_PIXELS
from touchfield.sources.terrain.large_maps import Bands, RowQueue, bands_of

_BUFFER_BYTES: Final = 1 << 24  # of encoded tiles that are read ahead
_SEPARATE: Final = 2  # PlanarConfiguration: a plane for each band


def map_bands(path: Path, page: Any, alpha: int | None, mask: Any) -> Bands:
    """Yield the first band of a page in bands of rows, NaN where the band `alpha` or the page `mask` is 0.

    Raises `SourceError` for strips or rows of tiles that are too large, or without a codec.
    """
    values = _bands(path, page, 0)
    hidden = [] if alpha is None else [RowQueue(_bands(path, page, alpha))]
    if mask is not None:
        hidden.append(RowQueue(_bands(path, mask, 0)))
    for band in values:
        for queue in hidden:
            band = np.where(queue.take(len(band)) != 0, band.astype(np.float64), np.nan)
        yield band


def missing_codec(path: Path, page: Any) -> SourceError:
    """Return the error for a page whose compression needs imagecodecs."""
    name = getattr(page.compression, "name", page.compression)
    mend = 'Install a codec with: pip install "touchfield[geotiff]"'
    return SourceError(str(path), f"a TIFF compressed by {name}", "a codec for it", mend)


def _bands(path: Path, page: Any, number: int) -> Iterator[NDArray[Any]]:
    """Yield one band of a page, [n, cols] at a time."""
    rows, cols = page.imagelength, page.imagewidth
    if page.is_memmappable:
        return iter(_mapped(path, page, number))
    height, width, *bands = page.chunks
    height = min(height, rows)  # a single strip may state any number of rows
    if math.prod((height, max(width, cols), *bands)) > MAX_PIXELS:
        found = f"a map of {rows} x {cols} samples in pieces of {height} x {width}"
        mend = "Store it in tiles: gdal_translate -co TILED=YES -co COMPRESS=DEFLATE IN.tif OUT.tif"
        raise SourceError(str(path), found, f"at most {MAX_PIXELS} samples in a row of pieces", mend)
    return _decoded_bands(path, page, number)


def _mapped(path: Path, page: Any, number: int) -> Bands:
    """Return bands of a page that is stored as one plain array."""
    import tifffile

    values = tifffile.memmap(path, page=page.index, mode="r").reshape(page.shape)
    if page.axes != "YX":
        values = np.moveaxis(values, page.axes.index("S"), 0)[number]
    return bands_of(lambda start, stop: values[start:stop], *values.shape)


def _decoded_bands(path: Path, page: Any, number: int) -> Iterator[NDArray[Any]]:
    """Yield rows of tiles, or strips; a missing tile has the page's value of no data, as GDAL stores it."""
    rows, cols = page.imagelength, page.imagewidth
    plane, sample = (number, 0) if int(page.planarconfig) == _SEPARATE else (0, number)
    band, first = np.empty((0, 0), page.dtype), -1
    for decoded, (at_plane, _, row, col, _), (_, height, width, _) in _segments(path, page):
        if at_plane < plane:
            continue
        if at_plane > plane:
            break
        if row != first:
            if first >= 0:
                yield band
            band, first = np.full((min(height, rows - row), cols), page.nodata, page.dtype), row
        if decoded is not None:
            part = decoded[0, : len(band), : min(width, cols - col), sample]
            band[: len(part), col : col + part.shape[1]] = part
    yield band


def _segments(path: Path, page: Any) -> Iterator[Any]:
    """Yield the decoded tiles or strips of a page in the order of rows; one thread bounds what is decoded."""
    try:
        yield from page.segments(maxworkers=1, sort=False, buffersize=_BUFFER_BYTES)
    except ValueError as error:
        if "imagecodecs" in str(error):
            raise missing_codec(path, page) from error
        raise
