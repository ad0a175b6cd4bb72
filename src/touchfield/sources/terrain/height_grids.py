"""Reads height maps from arrays and text: ``.npz``, ``.npy``, Esri's ASCII grid, ``.hgt``, netCDF, xarray.

Sources: Esri, ASCII raster format (ArcGIS Desktop documentation); USGS, SRTM topography (2015): square or
narrow tiles of big-endian int16, named by the latitude and longitude of their south-west corner; CF
conventions 1.11: coordinates, scale_factor, add_offset, _FillValue, units and positive.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Float64s
from touchfield.errors import SourceError, TouchfieldError, import_extra
from touchfield.files import read_bytes
from touchfield.medium.stores.npz import NpzArchive
from touchfield.sources.images.pictures import MAX_PIXELS
from touchfield.sources.terrain.height_map import Affine, GeoReference, affine_of_axes, unit_of

HEIGHT_KEYS: Final = ("elevation", "height", "heights", "heights_m", "z", "dem", "dtm", "dsm")
X_KEYS: Final = ("x", "xs", "x_m", "lon", "longitude", "lons", "easting", "eastings")
Y_KEYS: Final = ("y", "ys", "y_m", "lat", "latitude", "lats", "northing", "northings")
_SCALARS: Final = ("dx", "dy", "xmin", "xmax", "ymin", "ymax", "nodata", "_FillValue", "scale", "offset")
_TRANSFORMS: Final = ("transform", "affine")


# -- .npz --------------------------------------------------------------------------------------------------
def read_npz_map(path: Path) -> tuple[NDArray[Any], GeoReference]:
    """Read the heights of an archive, [rows, cols], and their positions.

    Positions are, by preference, arrays of x and y, an affine of six or nine numbers (rasterio), dx and dy.
    Where dy is above 0 row 0 is south, unless ymin, its edge, exceeds ymax. The notes name unused arrays.
    """
    archive = NpzArchive(path)
    headers = {name: archive.header(name) for name in archive.names}
    name = _height_name(path, headers)
    used, rows, cols = {name}, *headers[name].shape
    scalars: dict[str, float] = {n: archive.numbers(n, 1)[0] for n in _SCALARS if n in headers}
    used |= set(scalars)
    values, affine, notes = archive.read(name), None, tuple[str, ...]()
    axes = _npz_axes(archive, headers, rows, cols)
    transform = next((n for n in _TRANSFORMS if n in headers and math.prod(headers[n].shape) in (6, 9)), None)
    if axes:
        used |= {axes.x_name, axes.y_name}
        values = values.T if axes.is_transposed else values
        affine = affine_of_axes(path, axes.x, axes.y)
    elif transform:
        used.add(transform)
        a, b, c, d, e, f = archive.numbers(transform, math.prod(headers[transform].shape))[:6]
        affine = a, b, c, d, e, f
    else:
        affine = _affine_of_steps(scalars, rows, cols)
    unused = [n for n in headers if n not in used]
    if unused:
        notes += (f"Arrays of the file that are not used: {', '.join(unused)[:200]}.",)
    nodata = tuple(scalars[n] for n in ("nodata", "_FillValue") if n in scalars)
    scale = scalars.get("scale", 1.0) or 1.0
    return values, GeoReference(
        affine, nodata=nodata, scale=scale, offset=scalars.get("offset", 0.0), notes=notes
    )


def npz_is_height_map(path: Path) -> bool:
    """Return True if an archive has a map of heights, and no forces."""
    archive = NpzArchive(path)
    is_height = any(n in HEIGHT_KEYS or len(archive.header(n).shape) == 2 for n in archive.names)
    return is_height and "forces_n" not in archive.names


def _height_name(path: Path, headers: Mapping[str, Any]) -> str:
    is_map = {n: len(h.shape) == 2 and h.dtype.kind in "fiu" for n, h in headers.items()}
    maps = [n for n, fits in is_map.items() if fits and n not in (*X_KEYS, *Y_KEYS, *_TRANSFORMS)]
    named = [n for n in HEIGHT_KEYS if n in headers]
    if not named and len(maps) != 1:
        listed = ", ".join(headers) or "(none)"
        expected = f"one named {', '.join(HEIGHT_KEYS)}, or a single map"
        raise SourceError(str(path), f"the arrays {listed}", expected)
    name = (named or maps)[0]
    if not is_map[name]:
        raise SourceError(f"{path}, array {name}", headers[name].description, "numbers [rows, cols]")
    return name


class _Axes(NamedTuple):
    x: Float64s
    y: Float64s
    x_name: str
    y_name: str
    is_transposed: bool


def _npz_axes(archive: NpzArchive, headers: Mapping[str, Any], rows: int, cols: int) -> _Axes | None:
    """Return the positions of columns and rows from arrays of x and y: lines, or maps as of meshgrid."""
    names = [next((n for n in keys if n in headers), None) for keys in (X_KEYS, Y_KEYS)]
    x_name, y_name = names
    if x_name is None or y_name is None or min(rows, cols) < 2:
        return None
    lines = []
    for name, is_x in ((x_name, True), (y_name, False)):
        shape = headers[name].shape
        if headers[name].dtype.kind not in "fiu" or shape not in ((cols,), (rows,), (rows, cols)):
            found = f"{headers[name].description} for heights [{rows}, {cols}]"
            count = cols if is_x else rows
            raise SourceError(f"{archive.path}, array {name}", found, f"{count} numbers")
        values = archive.read(name).astype(np.float64)
        lines.append(values if values.ndim == 1 else values[0] if is_x else values[:, 0])
    x, y = lines
    if (len(x), len(y)) not in ((cols, rows), (rows, cols)):
        found = f"{len(x)} and {len(y)} numbers for heights [{rows}, {cols}]"
        raise SourceError(f"{archive.path}, arrays {x_name} and {y_name}", found, f"{cols} and {rows}")
    return _Axes(x, y, x_name, y_name, len(x) != cols)


def _affine_of_steps(scalars: Mapping[str, float], rows: int, cols: int) -> Affine | None:
    """Return the affine of dx, dy and the edges of a map; row 0 is north if the sign of dy is not given."""
    dx = scalars.get("dx", 0.0)
    dy = scalars.get("dy", -abs(dx))
    if dx == 0 or dy == 0:
        return None
    middle_x = middle_y = math.nan
    if all(n in scalars for n in ("xmin", "xmax", "ymin", "ymax")):
        middle_x, middle_y = (
            scalars[a] / 2 + scalars[b] / 2 for a, b in (("xmin", "xmax"), ("ymin", "ymax"))
        )
        if scalars["ymin"] > scalars["ymax"]:  # the edge of row 0 is north, as in matplotlib's sample
            dy = -abs(dy)
    return dx, 0.0, middle_x - dx * cols / 2, 0.0, dy, middle_y - dy * rows / 2


# -- Esri's ASCII grid -------------------------------------------------------------------------------------
_ASC_HEAD: Final = re.compile(rb"\s*([A-Za-z_]+)[ \t]+(\S+)[ \t]*\r?\n")
_ASC_BYTES: Final = 1 << 30


def asc_is_height_map(path: Path) -> bool:
    """Return True if a text starts as an ASCII grid does; point clouds have the same ending."""
    with path.open("rb") as stream:
        return stream.read(64).lstrip().lower().startswith(b"ncols")


def read_asc(path: Path) -> tuple[NDArray[Any], GeoReference]:
    """Read an ASCII grid, [rows, cols]; row 0 is north."""
    data, at, head = read_bytes(path, _ASC_BYTES, "an ASCII grid"), 0, dict[str, float]()
    while match := _ASC_HEAD.match(data, at):
        try:
            head[match[1].decode().lower()] = float(match[2])
        except ValueError as error:
            found = f"{match[2].decode('latin-1')[:40]!r}"
            raise SourceError(f"{path}, {match[1].decode()}", found, "a number") from error
        at = match.end()
    cell = head.get("cellsize", 0.0)
    dx, dy = head.get("dx", cell), head.get("dy", cell)
    rows, cols = (int(head.get(key, 0)) for key in ("nrows", "ncols"))
    if not (rows > 0 and cols > 0 and rows * cols <= MAX_PIXELS and dx > 0 and dy > 0):
        found = ", ".join(f"{key} {value:g}" for key, value in head.items()) or "no header"
        raise SourceError(str(path), found[:200], f"ncols, nrows (at most {MAX_PIXELS} in all) and cellsize")
    try:
        values = np.array(data[at:].split(), np.float64)
    except ValueError as error:
        raise SourceError(str(path), f"a height that is no number ({error})", "numbers") from error
    if len(values) != rows * cols:
        expected = f"{rows * cols} of {rows} rows of {cols}"
        raise SourceError(str(path), f"{len(values)} heights", expected, "Copy the file again.")
    left = head.get("xllcorner", head.get("xllcenter", math.nan) - dx / 2)
    bottom = head.get("yllcorner", head.get("yllcenter", math.nan) - dy / 2)
    affine = dx, 0.0, left, 0.0, -dy, bottom + dy * rows
    nodata = (head.get("nodata_value", -9999.0),)  # Esri's default
    return values.reshape(rows, cols), GeoReference(affine, nodata=nodata)


# -- .hgt --------------------------------------------------------------------------------------------------
_HGT_SHAPES: Final = {
    2 * rows * cols: (rows, cols)
    for rows, cols in ((1201, 1201), (3601, 3601), (3601, 1801), (1801, 1801), (6001, 6001))
}
_HGT_NAME: Final = re.compile(r"([NS])(\d{1,2})([EW])(\d{1,3})", re.IGNORECASE)


def read_hgt(path: Path) -> tuple[NDArray[Any], GeoReference]:
    """Read a tile of one degree, [rows, cols], metres; row 0 is north, -32768 is unknown."""
    data = read_bytes(path, max(_HGT_SHAPES), "an .hgt tile")
    if len(data) not in _HGT_SHAPES:
        expected = " or ".join(f"{r} x {c}" for r, c in _HGT_SHAPES.values()) + " samples of 2 bytes"
        raise SourceError(str(path), f"{len(data)} bytes", expected, "Unpack it, or download it again.")
    rows, cols = _HGT_SHAPES[len(data)]
    match, notes = _HGT_NAME.match(path.name), tuple[str, ...]()
    south = west = 0
    if match:
        south = int(match[2]) * (1 if match[1] in "Nn" else -1)
        west = int(match[4]) * (1 if match[3] in "Ee" else -1)
    else:
        notes = ("The name gives no latitude, as N46E007.hgt does: the equator is assumed (--cell-size-m).",)
    dx, dy = 1 / (cols - 1), 1 / (rows - 1)
    affine = dx, 0.0, west - dx / 2, 0.0, -dy, south + 1 + dy / 2
    values = np.frombuffer(data, ">i2").reshape(rows, cols)
    return values, GeoReference(affine, is_degrees=True, nodata=(-32768.0,), notes=notes)


# -- netCDF and xarray -------------------------------------------------------------------------------------
class Labelled(NamedTuple):
    """A variable with the names of its dimensions and its attributes, as netCDF and xarray have them."""

    dims: tuple[str, ...]
    values: Any
    attributes: Mapping[str, Any]


_STANDARD_NAMES: Final = (
    "surface_altitude", "height_above_reference_ellipsoid", "height_above_mean_sea_level", "altitude",
    "ground_level_altitude", "sea_floor_depth_below_geoid", "sea_floor_depth",
)  # fmt: skip
_DEGREES: Final = re.compile(r"deg", re.IGNORECASE)
_NETCDF_BYTES: Final = 1 << 30


def read_netcdf(path: Path) -> tuple[NDArray[Any], GeoReference]:
    """Read a map of heights from a netCDF file, [rows, cols] or [frames, rows, cols].

    Version 3 needs nothing more; version 4, which is HDF5, needs h5netcdf (`MissingExtra`).
    """
    with path.open("rb") as stream:
        start = stream.read(4)
    try:
        variables = _netcdf_3(path) if start.startswith(b"CDF") else _netcdf_4(path)
    except TouchfieldError:
        raise
    except Exception as error:  # both libraries raise errors of any type for damaged files
        found = f"a netCDF file that cannot be read ({str(error)[:100]})"
        raise SourceError(str(path), found, "a whole netCDF file", "Copy the file again.") from error
    return map_of_variables(str(path), variables, None)


def _netcdf_3(path: Path) -> dict[str, Labelled]:
    from scipy.io import netcdf_file

    read_bytes(path, _NETCDF_BYTES, "a netCDF file")
    with netcdf_file(str(path), "r", mmap=False, maskandscale=False) as file:
        return {
            name: Labelled(tuple(v.dimensions), v.data, _text_attributes(v._attributes))
            for name, v in file.variables.items()
        }


def _netcdf_4(path: Path) -> dict[str, Labelled]:
    h5netcdf = import_extra("h5netcdf", f"{path}, netCDF 4 (HDF5)", "h5netcdf", "netcdf")
    with h5netcdf.File(path, "r") as file:
        return {
            name: Labelled(tuple(v.dimensions), v[...], _text_attributes(v.attrs))
            for name, v in file.variables.items()
            if v.dtype.kind in "fiu" and math.prod(v.shape) <= MAX_PIXELS
        }


def _text_attributes(attributes: Mapping[str, Any]) -> dict[str, Any]:
    return {k: v.decode("latin-1") if isinstance(v, bytes) else v for k, v in attributes.items()}


def map_of_xarray(array: Any) -> tuple[NDArray[Any], GeoReference]:
    """Return the heights of an xarray DataArray, [rows, cols] or [frames, rows, cols], and its positions.

    Dimensions are recognised by their names or CF attributes. Raises `SourceError` if they are not.
    """
    name = str(array.name or "heights")
    variables = {
        str(key): Labelled(tuple(map(str, c.dims)), np.asarray(c.values), dict(c.attrs))
        for key, c in array.coords.items()
    }
    variables[name] = Labelled(tuple(map(str, array.dims)), np.asarray(array.values), dict(array.attrs))
    return map_of_variables(f"DataArray {name!r}", variables, name)


def map_of_variables(
    where: str, variables: Mapping[str, Labelled], name: str | None
) -> tuple[NDArray[Any], GeoReference]:
    """Return the heights among variables, x last and y before it, and what their attributes state."""
    name = name or _height_variable(where, variables)
    heights, path = variables[name], Path(where)
    dims, values = list(heights.dims), np.asarray(heights.values)
    roles = [_role(dim, variables.get(dim)) for dim in dims]
    if not (roles.count("x") == 1 and roles.count("y") == 1):
        if len(dims) < 2 or "x" in roles or "y" in roles:
            found = f"dimensions {', '.join(dims)}"
            expected = "one of x (x, lon, easting) and one of y (y, lat, northing)"
            raise SourceError(f"{where}, {name}", found, expected, "Rename the dimensions.")
        roles[-2:] = ["y", "x"]
    values, notes = _ordered(values, dims, roles)
    axes = [variables.get(dims[roles.index(role)]) for role in "xy"]
    affine, is_degrees, unit_m = None, None, 1.0
    if axes[0] is not None and axes[1] is not None and min(values.shape[-2:]) > 1:
        affine = affine_of_axes(path, *(np.asarray(axis.values, np.float64) for axis in axes if axis))
        unit = str(axes[0].attributes.get("units", ""))
        is_degrees = True if _DEGREES.match(unit) else False if unit else None
        if unit and not is_degrees:
            unit_m, unit_notes = unit_of(unit, "positions")
            notes += unit_notes
    return values, _cf_reference(heights.attributes, affine, is_degrees, unit_m, notes)


def _height_variable(where: str, variables: Mapping[str, Labelled]) -> str:
    maps = {
        name: v for name, v in variables.items()
        if len(v.dims) >= 2 and np.asarray(v.values).dtype.kind in "fiu"
        and name.lower() not in (*X_KEYS, *Y_KEYS)
    }  # fmt: skip
    named = [n for n in maps if n.lower() in HEIGHT_KEYS]
    named += [n for n, v in maps.items() if v.attributes.get("standard_name") in _STANDARD_NAMES]
    if not named and len(maps) != 1:
        found = f"the maps {', '.join(maps) or '(none)'}"
        raise SourceError(where, found, f"one named {', '.join(HEIGHT_KEYS)}, or a single map")
    return (named or list(maps))[0]


def _role(dim: str, coordinate: Labelled | None) -> str:
    attributes = coordinate.attributes if coordinate else {}
    units, standard_name = str(attributes.get("units", "")), str(attributes.get("standard_name", ""))
    lower = dim.lower()
    for role, keys, direction in (("x", X_KEYS, "east"), ("y", Y_KEYS, "north")):
        if (
            lower in keys
            or attributes.get("axis") == role.upper()
            or units.endswith(f"_{direction}")
            or standard_name == f"projection_{role}_coordinate"
        ):
            return role
    return "time" if lower in ("time", "t", "frame", "frames") else ""


def _ordered(values: NDArray[Any], dims: list[str], roles: list[str]) -> tuple[NDArray[Any], tuple[str, ...]]:
    """Return values as [rows, cols], or [frames, rows, cols] along time, at the first index of others."""
    notes: tuple[str, ...] = ()
    selection: list[Any] = [slice(None)] * len(dims)
    for index, (dim, role) in enumerate(zip(dims, roles, strict=True)):
        if not role:
            selection[index] = 0
            if values.shape[index] > 1:
                notes += (f"The first of {values.shape[index]} along {dim} is read.",)
    left = [role for role in roles if role]
    values = values[tuple(selection)].transpose([left.index(r) for r in ("time", "y", "x") if r in left])
    return values[0] if values.ndim == 3 and len(values) == 1 else values, notes


def _cf_reference(
    attributes: Mapping[str, Any],
    affine: Affine | None,
    is_degrees: bool | None,
    unit_m: float,
    notes: tuple[str, ...],
) -> GeoReference:
    numbers = {}
    for key in ("scale_factor", "add_offset", "_FillValue", "missing_value"):
        if key in attributes:
            numbers[key] = float(np.asarray(attributes[key]).ravel()[0])
    scale, offset = numbers.get("scale_factor", 1.0) or 1.0, numbers.get("add_offset", 0.0)
    vertical_m = 1.0
    if attributes.get("units"):
        vertical_m, unit_notes = unit_of(str(attributes["units"]), "heights")
        notes += unit_notes
    if attributes.get("positive") == "down":
        scale, offset = -scale, -offset
        notes += ("Values are depths below a level (positive down): heights are their negatives.",)
    nodata = tuple(numbers[key] for key in ("_FillValue", "missing_value") if key in numbers)
    return GeoReference(
        affine, None, None, is_degrees, unit_m, vertical_m, scale, offset, nodata, notes=notes
    )
