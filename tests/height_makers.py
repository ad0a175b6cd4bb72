"""A slope of 16 x 16 heights, 10 m apart, and GeoTIFF with any tags."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import tifffile

ROWS = 115.0 - np.arange(16.0)[:, None]
NORTH_UP = (ROWS + 0.01 * np.arange(16.0)).astype(np.float32)  # falls to the south, rises to the east
NORTH_UP.flags.writeable = False
METRES = (1, 1, 0, 2, 1024, 0, 1, 1, 1025, 0, 1, 1)
SCALE, TIE = (33550, (10.0, 10.0, 0.0)), (33922, (0.0, 0.0, 0.0, 5e5, 4.2e6, 0.0))
SIZE_M = np.array([150.0, 150.0])


def geotiff(path: Path, values: np.ndarray, *tags: tuple[int, Any], **options: Any) -> Path:
    """Write a TIFF with tags: a tuple of doubles, of shorts for the GeoKeys, or text."""
    extra = []
    for code, content in tags:
        kind = 2 if isinstance(content, str) else 3 if code == 34735 else 12
        extra.append((code, kind, 0 if kind == 2 else len(content), content, True))
    tifffile.imwrite(path, values, extratags=extra, metadata=None, **{"photometric": "minisblack", **options})
    return path


def matrix(a: float, b: float, c: float, d: float, e: float, f: float) -> tuple[int, Any]:
    return 34264, (a, b, 0.0, c, d, e, 0.0, f, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


def gdal(*items: str) -> tuple[int, str]:
    return 42112, f"<GDALMetadata>{''.join(items)}</GDALMetadata>"


def data_array(**attributes: Any) -> Any:
    """The slope with y that rises, so that row 0 is south."""
    import xarray

    x, y = 10.0 * np.arange(16), 10.0 * np.arange(16)
    return xarray.DataArray(NORTH_UP[::-1].copy(), {"y": y, "x": x}, ("y", "x"), "ground", attributes)
