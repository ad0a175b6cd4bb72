"""Reads height maps from arrays and text: ``.npz``, ``.npy``, Esri's ASCII grid, ``.hgt``, netCDF, xarray.

Sources: Esri, ASCII raster format (ArcGIS Desktop documentation); USGS, SRTM topography (2015): square or
narrow tiles of big-endian int16, named by the latitude and longitude of their south-west corner; CF
conventions 1.11: coordinates, scale_factor, add_offset, _FillValue, units and positive.
"""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Float64s
from touchfield.errors import SourceError, TouchfieldError, import_extra
from touchfield.files import read_bytes, readable, require_plain
from touchfield.medium.stores.npz import NpzArchive, read_exactly
from touchfield.sources.images.pictures import MAX_PIXELS
from touchfield.sources.terrain.height_map import Affine, GeoReference, affine_of_axes, unit_of
from touchfield.sources.terrain.large_maps import (
    MAX_SAMPLES,
    bands_of,
    bound_samples,
    is_large,
    reduce_map,
)

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
    affine, notes = None, tuple[str, ...]()
    axes = _npz_axes(archive, headers, rows, cols)
    transform = next((n for n in _TRANSFORMS if n in headers and math.prod(headers[n].shape) in (6, 9)), None)
    if axes:
        used |= {axes.x_name, axes.y_name}
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
    reference = GeoReference(
        affine, nodata=nodata, scale=scale, offset=scalars.get("offset", 0.0), notes=notes
    )
    return _npz_values(archive, name, axes is not None and axes.is_transposed, reference)


def _npz_values(
    archive: NpzArchive, name: str, is_transposed: bool, reference: GeoReference
) -> tuple[NDArray[Any], GeoReference]:
    """Read the heights of an archive, [rows, cols]; those of a large map in bands, reduced."""
    rows, cols = archive.header(name).shape
    if not is_large((rows, cols)):
        values = archive.read(name)
        return (values.T if is_transposed else values), reference
    bound_samples(archive.path, rows, cols)
    with archive.open(name) as (header, stream):
        lines, length = (cols, rows) if header.is_fortran else (rows, cols)
        kind = header.dtype

        def read_lines(start: int, stop: int) -> NDArray[Any]:
            count = (stop - start) * length
            data = read_exactly(stream, count * kind.itemsize, f"{archive.path}, array {name}")
            return np.frombuffer(data, kind).reshape(-1, length)

        values, reference = reduce_map(
            archive.path, bands_of(read_lines, lines, length), (lines, length), reference
        )
    if header.is_fortran != is_transposed:
        values, reference = values.T, reference.transposed()
    return values, reference


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
        mend = "Rename the array of heights, or store it alone."
        raise SourceError(str(path), f"the arrays {listed}", expected, mend)
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
_ASC_HEAD_BYTES: Final = 4096
_ASC_BLOCK_BYTES: Final = 1 << 24


def asc_is_height_map(path: Path) -> bool:
    """Return True if a text starts as an ASCII grid does; point clouds have the same ending."""
    with path.open("rb") as stream:
        return stream.read(64).lstrip().lower().startswith(b"ncols")


def read_asc(path: Path) -> tuple[NDArray[Any], GeoReference]:
    """Read an ASCII grid, [rows, cols]; row 0 is north."""
    require_plain(path, "an ASCII grid")
    with readable(path), path.open("rb") as stream:
        data, at, head = stream.read(_ASC_HEAD_BYTES), 0, dict[str, float]()
        while match := _ASC_HEAD.match(data, at):
            try:
                head[match[1].decode().lower()] = float(match[2])
            except ValueError as error:
                found = f"{match[2].decode('latin-1')[:40]!r}"
                raise SourceError(f"{path}, {match[1].decode()}", found, "a number") from error
            at = match.end()
        cell = head.get("cellsize", 0.0)
        dx, dy = head.get("dx", cell), head.get("dy", cell)
        stated = (head.get(key, 0.0) for key in ("nrows", "ncols"))
        rows, cols = (int(count) if 0 < count <= MAX_SAMPLES else 0 for count in stated)  # also inf and NaN
        if not (rows > 0 and cols > 0 and rows * cols <= MAX_SAMPLES and dx > 0 and dy > 0):
            found = ", ".join(f"{key} {value:g}" for key, value in head.items()) or "no header"
            expected = f"ncols, nrows (at most {MAX_SAMPLES} in all) and cellsize"
            raise SourceError(str(path), found[:200], expected)
        left = head.get("xllcorner", head.get("xllcenter", math.nan) - dx / 2)
        bottom = head.get("yllcorner", head.get("yllcenter", math.nan) - dy / 2)
        affine = dx, 0.0, left, 0.0, -dy, bottom + dy * rows
        nodata = (head.get("nodata_value", -9999.0),)  # Esri's default
        reference, shape = GeoReference(affine, nodata=nodata), (rows, cols)
        stream.seek(at)
        bands = _asc_bands(path, stream, rows, cols)
        if is_large(shape):
            bound_samples(path, rows, cols)
            return reduce_map(path, bands, shape, reference)
        return np.concatenate(list(bands)), reference


def _asc_bands(path: Path, stream: IO[bytes], rows: int, cols: int) -> Iterator[Float64s]:
    """Yield the rows of an ASCII grid, [n, cols] at a time; heights may be in lines of any length."""
    count, rest, left = 0, b"", np.empty(0)
    while True:
        data = stream.read(_ASC_BLOCK_BYTES)
        text = rest + data
        cut = max(text.rfind(b" "), text.rfind(b"\n"), text.rfind(b"\t")) + 1 if data else len(text)
        rest = text[cut:]
        if len(rest) > _ASC_BLOCK_BYTES:
            raise SourceError(str(path), f"{len(rest)} characters without a space", "numbers")
        try:
            heights = np.array(text[:cut].split(), np.float64)
        except ValueError as error:
            raise SourceError(str(path), f"a height that is no number ({error})", "numbers") from error
        count += len(heights)
        if count > rows * cols or (not data and count < rows * cols):
            found = f"{count} heights" if not data else f"more than {rows * cols} heights"
            expected = f"{rows * cols} of {rows} rows of {cols}"
            raise SourceError(str(path), found, expected, "Copy the file again.")
        heights = np.concatenate([left, heights])
        whole = len(heights) // cols * cols
        left = heights[whole:]
        if whole:
            yield heights[:whole].reshape(-1, cols)
        if not data:
            return


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
    """A variable with the names of its dimensions and its attributes, as netCDF and xarray have them.

    `values` are an array, or a variable of a file or a DataArray that reads what is indexed.
    """

    dims: tuple[str, ...]
    values: Any
    attributes: Mapping[str, Any]


_STANDARD_NAMES: Final = (
    "surface_altitude", "height_above_reference_ellipsoid", "height_above_mean_sea_level", "altitude",
    "ground_level_altitude", "sea_floor_depth_below_geoid", "sea_floor_depth",
)  # fmt: skip
_DEGREES: Final = re.compile(r"deg", re.IGNORECASE)


def read_netcdf(path: Path) -> tuple[NDArray[Any], GeoReference]:
    """Read a map of heights from a netCDF file, [rows, cols] or [frames, rows, cols].

    Version 3 needs nothing more; version 4, which is HDF5, needs h5netcdf (`MissingExtra`).
    """
    require_plain(path, "a netCDF file")
    with readable(path), path.open("rb") as stream:
        start = stream.read(4)
    opened = _netcdf_3 if start.startswith(b"CDF") else _netcdf_4
    try:
        with opened(path) as variables:
            return map_of_variables(str(path), variables, None)
    except TouchfieldError:
        raise
    except Exception as error:  # both libraries raise errors of any type for damaged files
        found = f"a netCDF file that cannot be read ({str(error)[:100]})"
        raise SourceError(str(path), found, "a whole netCDF file", "Copy the file again.") from error


@contextmanager
def _netcdf_3(path: Path) -> Iterator[dict[str, Labelled]]:
    from scipy.io import netcdf_file

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # maps of the file are closed with the last array
        with netcdf_file(str(path), "r", mmap=True, maskandscale=False) as file:
            yield {
                name: Labelled(tuple(v.dimensions), v.data, _text_attributes(v._attributes))
                for name, v in file.variables.items()
            }


@contextmanager
def _netcdf_4(path: Path) -> Iterator[dict[str, Labelled]]:
    h5netcdf = import_extra("h5netcdf", f"{path}, netCDF 4 (HDF5)", "h5netcdf", "netcdf")
    with h5netcdf.File(path, "r") as file:
        yield {
            name: Labelled(tuple(v.dimensions), v, _text_attributes(v.attrs))
            for name, v in file.variables.items()
            if v.dtype.kind in "fiu"
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
    variables[name] = Labelled(tuple(map(str, array.dims)), array, dict(array.attrs))
    return map_of_variables(f"DataArray {name!r}", variables, name)


def map_of_variables(
    where: str, variables: Mapping[str, Labelled], name: str | None
) -> tuple[NDArray[Any], GeoReference]:
    """Return the heights among variables, x last and y before it, and what their attributes state."""
    name = name or _height_variable(where, variables)
    heights, path = variables[name], Path(where)
    dims = list(heights.dims)
    roles = [_role(dim, variables.get(dim)) for dim in dims]
    if not (roles.count("x") == 1 and roles.count("y") == 1):
        if len(dims) < 2 or "x" in roles or "y" in roles:
            found = f"dimensions {', '.join(dims)}"
            expected = "one of x (x, lon, easting) and one of y (y, lat, northing)"
            raise SourceError(f"{where}, {name}", found, expected, "Rename the dimensions.")
        roles[-2:] = ["y", "x"]
    ordered, notes = _ordered(heights.values, dims, roles)
    axes = [variables.get(dims[roles.index(role)]) for role in "xy"]
    affine, is_degrees, unit_m = None, None, 1.0
    if axes[0] is not None and axes[1] is not None and min(ordered.shape[-2:]) > 1:
        x, y = (_line(f"{where}, {dims[roles.index(r)]}", a) for r, a in zip("xy", axes, strict=True) if a)
        affine = affine_of_axes(path, x, y)
        unit = str(axes[0].attributes.get("units", ""))
        is_degrees = True if _DEGREES.match(unit) else False if unit else None
        if unit and not is_degrees:
            unit_m, unit_notes = unit_of(unit, "positions")
            notes += unit_notes
    return _read_ordered(path, ordered, _cf_reference(heights.attributes, affine, is_degrees, unit_m, notes))


def _line(where: str, axis: Labelled) -> Float64s:
    """Return the positions along an axis, float64 [count]."""
    if len(axis.dims) != 1 or is_large(axis.values.shape):
        raise SourceError(where, f"an array of shape {axis.values.shape}", "one number for each sample")
    return np.asarray(axis.values[:], np.float64)


def _height_variable(where: str, variables: Mapping[str, Labelled]) -> str:
    maps = {
        name: v for name, v in variables.items()
        if len(v.dims) >= 2 and v.values.dtype.kind in "fiu"
        and name.lower() not in (*X_KEYS, *Y_KEYS)
    }  # fmt: skip
    named = [n for n in maps if n.lower() in HEIGHT_KEYS]
    named += [n for n, v in maps.items() if v.attributes.get("standard_name") in _STANDARD_NAMES]
    if not named and len(maps) != 1:
        found = f"the maps {', '.join(maps) or '(none)'}"
        expected = f"one named {', '.join(HEIGHT_KEYS)}, or a single map"
        raise SourceError(where, found, expected, "Rename the map of heights, or store it alone.")
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


class _Ordered(NamedTuple):
    """How a variable is read as [rows, cols] or [frames, rows, cols], which is its `shape`.

    `selection` has an index of each dimension of the variable; `order` permutes those that are left.
    """

    values: Any
    selection: tuple[Any, ...]
    order: tuple[int, ...]
    row_dim: int
    frame_dim: int | None
    shape: tuple[int, ...]

    def read(self, frame: int | None = None, rows: slice = slice(None)) -> NDArray[Any]:
        """Read all values, or those of a frame, or of some rows of it."""
        index = list(self.selection)
        index[self.row_dim] = rows
        if self.frame_dim is not None and frame is not None:
            index[self.frame_dim] = slice(frame, frame + 1)
        return np.array(self.values[tuple(index)]).transpose(self.order)


def _ordered(values: Any, dims: list[str], roles: list[str]) -> tuple[_Ordered, tuple[str, ...]]:
    """Return how values are read along time, y and x, at the first index of others, and notes on those."""
    notes: tuple[str, ...] = ()
    selection: list[Any] = [slice(None)] * len(dims)
    for index, (dim, role) in enumerate(zip(dims, roles, strict=True)):
        if not role:
            selection[index] = 0
            if values.shape[index] > 1:
                notes += (f"The first of {values.shape[index]} along {dim} is read.",)
    left = [role for role in roles if role]
    named = [role for role in ("time", "y", "x") if role in left]
    order, shape = tuple(map(left.index, named)), tuple(values.shape[roles.index(role)] for role in named)
    frame_dim = roles.index("time") if "time" in roles else None
    return _Ordered(values, tuple(selection), order, roles.index("y"), frame_dim, shape), notes


def _read_ordered(
    path: Path, ordered: _Ordered, reference: GeoReference
) -> tuple[NDArray[Any], GeoReference]:
    """Read [rows, cols] or [frames, rows, cols]; each frame of a large series in bands, reduced."""
    if not is_large(ordered.shape):
        values = ordered.read()
        return (values[0] if values.ndim == 3 and len(values) == 1 else values), reference
    *count, rows, cols = ordered.shape
    frame_count = math.prod(count)
    if path.is_file():
        bound_samples(path, rows, cols)
    pieces = getattr(ordered.values, "chunks", None)  # h5netcdf: shape; dask: sizes along each dimension
    unit = pieces[ordered.row_dim] if pieces and isinstance(pieces[0], int) else 1
    if pieces and isinstance(pieces[0], int) and is_large(pieces):
        mend = "Store it in smaller chunks: nccopy -c time/1,y/256,x/256 IN.nc OUT.nc"
        raise SourceError(str(path), f"chunks of {pieces}", f"at most {MAX_PIXELS} samples", mend)
    frames, result = [], reference
    for frame in range(frame_count):

        def read_rows(start: int, stop: int, frame: int = frame) -> NDArray[Any]:
            return ordered.read(frame, slice(start, stop)).reshape(stop - start, cols)

        bands = bands_of(read_rows, rows, cols, unit)
        heights, reduced = reduce_map(path, bands, (rows, cols), reference, frame_count=frame_count)
        frames.append(heights)
        result = reduced._replace(notes=tuple(dict.fromkeys((*result.notes, *reduced.notes))))
    return (frames[0] if frame_count == 1 else np.stack(frames)), result


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
