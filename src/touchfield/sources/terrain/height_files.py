"""Recognises and opens files of heights as a `HeightScene`: elevation models and grey pictures."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from touchfield.errors import SourceError, import_extra
from touchfield.medium.stores.npz import map_npy, read_npy_header
from touchfield.sources.images.pictures import MAX_PIXELS, bound_pixels, opened
from touchfield.sources.options import SourceOptions
from touchfield.sources.registry import SourceKind
from touchfield.sources.scene import Scene
from touchfield.sources.terrain.geotiff import read_tiff, read_world_file, tiff_is_grey
from touchfield.sources.terrain.height_grids import (
    asc_is_height_map,
    map_of_xarray,
    npz_is_height_map,
    read_asc,
    read_hgt,
    read_netcdf,
    read_npz_map,
)
from touchfield.sources.terrain.height_map import GeoReference, scene_of
from touchfield.sources.terrain.height_scene import HeightScene
from touchfield.sources.terrain.large_maps import bands_of, bound_samples, is_large, reduce_map

_GREY_MODES: Final = ("L", "LA", "I", "F", "I;16", "I;16L", "I;16B", "I;16N")


def _read_npy(path: Path) -> tuple[NDArray[Any], GeoReference]:
    values = map_npy(path)
    if values.ndim != 2 or not is_large(values.shape):
        return values, GeoReference()
    bound_samples(path, *values.shape)
    bands = bands_of(lambda start, stop: values[start:stop], *values.shape)
    return reduce_map(path, bands, values.shape, GeoReference())


def _read_png(path: Path) -> tuple[NDArray[Any], GeoReference]:
    """Read a grey picture and the world file beside it; it has no unit of heights."""
    with opened(path, expected="one grey channel of 8 or 16 bits") as picture:
        if picture.mode not in _GREY_MODES:
            found = f"a picture of mode {picture.mode}"
            raise SourceError(str(path), found, "one grey channel", "Convert it to grey first.")
        if picture.width * picture.height > MAX_PIXELS:  # Pillow decodes a PNG only as a whole
            mend = f"A GeoTIFF may be larger: gdal_translate -co COMPRESS=DEFLATE {path.name} heights.tif"
            found = f"a PNG of {picture.width} x {picture.height} pixels"
            raise SourceError(str(path), found, f"at most {MAX_PIXELS} pixels", mend)
        bound_pixels(path, picture.width, picture.height)
        values = np.array(picture.getchannel(0) if picture.mode == "LA" else picture)
        size = (picture.height, picture.width)
    if values.shape != size:
        raise SourceError(str(path), f"values of shape {values.shape}", f"{size}")
    affine = read_world_file(path)
    return values, GeoReference(affine, is_elevation=False)


_READERS: Final[dict[str, Callable[[Path], tuple[NDArray[Any], GeoReference]]]] = {
    ".npz": read_npz_map,
    ".npy": _read_npy,
    ".png": _read_png,
    ".tif": read_tiff,
    ".tiff": read_tiff,
    ".asc": read_asc,
    ".hgt": read_hgt,
    ".nc": read_netcdf,
}


def jacksboro_scene(exaggeration: float = 1.0) -> HeightScene:
    """Return the Jacksboro fault, Tennessee, from matplotlib's sample data.

    Raises `MissingExtra` without it.

    344 x 403 samples of about 93 m by 74 m, heights 236 to 1076 m (int16; USGS, by way of matplotlib).
    """
    cbook = import_extra("matplotlib.cbook", "the bundled elevation model", "matplotlib", "report")
    sample = Path(cbook.get_sample_data("jacksboro_fault_dem.npz", asfileobj=False))
    return scene_of(sample, *read_npz_map(sample), SourceOptions(exaggeration=exaggeration))


def scene_of_xarray(array: Any, options: SourceOptions | None = None) -> HeightScene:
    """Return the scene of an xarray DataArray of heights, [y, x] or [time, y, x].

    Positions are its coordinates, with the units, scale and gaps of their CF attributes.
    """
    values, reference = map_of_xarray(array)
    return scene_of(
        Path(f"DataArray {array.name or ''}".strip()), values, reference, options or SourceOptions()
    )


def read_heights(path: Path) -> tuple[NDArray[Any], GeoReference]:
    """Read a map of heights as it is stored, [rows, cols] or [frames, rows, cols], and what is stated of it.

    Raises `SourceError` for an unknown ending, or a file that cannot be read.
    """
    suffix = path.suffix.lower()
    if suffix not in _READERS:
        found = f"a file named {suffix or 'without suffix'}"
        raise SourceError(str(path), found, ", ".join(_READERS))
    return _READERS[suffix](path)


def _recognise(path: Path) -> bool:
    suffix = path.suffix.lower()
    names = f"{path.parent.name}/{path.name}".lower()
    if not path.is_file() or suffix not in _READERS or any(word in names for word in ("depth", "disp")):
        return False
    if suffix == ".npz":
        return npz_is_height_map(path)
    if suffix == ".npy":
        with path.open("rb") as stream:
            return len(read_npy_header(stream, str(path)).shape) == 2
    if suffix == ".asc":
        return asc_is_height_map(path)
    if suffix in (".hgt", ".nc"):
        return True
    if suffix == ".png":
        with opened(path) as picture:  # reads the header only
            return picture.mode in _GREY_MODES
    try:
        return tiff_is_grey(path)
    except (SourceError, OSError):
        return True  # opening it then reports the unsupported TIFF


def _open(path: Path, options: SourceOptions) -> Scene:
    return scene_of(path, *read_heights(path), options)


KIND = SourceKind(
    "height-map",
    "a height map: GeoTIFF, elevation .npz or .npy, .asc, .hgt, netCDF, or a grey .png or .tif",
    _recognise,
    _open,
)
