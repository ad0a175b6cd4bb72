"""Height maps from files: elevation models (``.npz``, ``.npy``, GeoTIFF) and grey pictures (PNG, TIFF).

Row 0 is north. What a file does not say is assumed, and the assumption told in a note: one metre between
samples, one metre a unit; of a picture without a scale, a relief of a fifth of its shorter side.

OGC 19-008r4, GeoTIFF 1.1: tags 33550 ModelPixelScale, 33922 ModelTiepoint, 34264 ModelTransformation and 34735
GeoKeyDirectory; 42113 is GDAL's nodata tag. Degrees become metres on the ellipsoid WGS 84 (NGA.STND.0036) at
the map's middle latitude: one scale for the whole map, no projection.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Float64s
from touchfield.errors import SourceError, blamed_on, import_extra
from touchfield.medium.npz import NpzArchive, map_npy, read_npy_header
from touchfield.sources.height_scene import HeightScene
from touchfield.sources.options import SourceOptions
from touchfield.sources.pictures import opened
from touchfield.sources.registry import SourceKind
from touchfield.sources.scene import Scene

HEIGHT_KEYS: Final = ("elevation", "height", "heights", "heights_m", "z")
PLACE_KEYS: Final = ("dx", "dy", "xmin", "xmax", "ymin", "ymax")
COORDINATE_KEYS: Final = (("latitude", "longitude"), ("lat", "lon"), ("y", "x"))
UNEVEN: Final = 0.1  # steps between coordinates may differ by this share: rows of a Mercator map do, by little
PICTURES: Final = (".png", ".tif", ".tiff")
LATITUDE_LIMIT_DEG: Final = 89.0  # nearer to a pole the degrees of longitude are no cells of one width
PICTURE_RELIEF: Final = 0.2
"""Relief of a picture without a scale, of its shorter side: as a landscape under the hand, not a wall."""

_GREY_MODES: Final = ("L", "LA", "I", "F", "I;16", "I;16L", "I;16B", "I;16N", "I;16S", "I;16BS")
_PIXEL_SCALE, _TIEPOINT, _TRANSFORMATION, _GEO_KEYS, _GDAL_NODATA = 33550, 33922, 34264, 34735, 42113
_MODEL_TYPE_KEY, _LINEAR_UNITS_KEY, _VERTICAL_UNITS_KEY = 1024, 3076, 4099
_GEOGRAPHIC: Final = 2
_UNITS_M: Final = {9001: 1.0, 9002: 0.3048, 9003: 1200 / 3937}
"""EPSG codes of the metre, the international foot and the US survey foot."""

_WGS84_AXIS_M: Final = 6378137.0
_WGS84_E2: Final = 0.00669437999014


Pair = tuple[float, float]


@dataclass(frozen=True)
class GeoTags:
    """Place and units of samples, as a file says; None where it does not.

    `cell` is (dy, dx) and `middle` y and x of the middle of the map, both in units of the map, which are `unit_m`
    metres where they are not degrees; `vertical_unit_m` are the metres of one unit of height.
    """

    cell: Pair | None = None
    middle: Pair | None = None
    is_degrees: bool | None = None
    unit_m: float = 1.0
    vertical_unit_m: float | None = 1.0
    nodata: float | None = None


class _Map(NamedTuple):
    """Heights as stored, float [rows, cols] or [frames, rows, cols], NaN where unknown, and their place."""

    heights: NDArray[np.floating[Any]]
    place: GeoTags = GeoTags()


def _scene(path: Path, stored: _Map, options: SourceOptions) -> HeightScene:
    """The scene of a map, with what had to be assumed in its notes."""
    if stored.heights.ndim not in (2, 3) or min(stored.heights.shape[-2:]) < 2 or not stored.heights.size:
        raise SourceError(str(path), f"heights of shape {stored.heights.shape}", "[rows, cols], at least 2 x 2")
    if not np.isfinite(stored.heights).any():
        raise SourceError(str(path), "no known height", "at least one")
    place = stored.place
    if _is_in_degrees(place) and place.middle is not None and abs(place.middle[0]) > LATITUDE_LIMIT_DEG:
        expected = f"at most {LATITUDE_LIMIT_DEG} either way"
        raise SourceError(str(path), f"the latitude {place.middle[0]:.4g}", expected)
    cell_m, told = _cell_m(place, options)
    unit_m, more = _height_unit_m(stored, cell_m, options)
    heights = stored.heights if unit_m == 1 else stored.heights.astype(np.float64) * unit_m
    rate_hz, factor = options.rate_hz or 30.0, options.exaggeration
    notes = (*told, *more)
    with blamed_on(f"{path}, "):
        return HeightScene(heights, cell_m, exaggeration=factor, rate_hz=rate_hz, notes=notes, name=str(path))


def _cell_m(place: GeoTags, options: SourceOptions) -> tuple[Pair, list[str]]:
    """(dy, dx) in metres."""
    if options.cell_size_m is not None:
        return (options.cell_size_m, options.cell_size_m), []
    if place.cell is None:
        return (1.0, 1.0), ["The distance between samples is not given: one metre is assumed (cell size)."]
    dy, dx = place.cell
    if _is_in_degrees(place):
        latitude = 0.0 if place.middle is None else place.middle[0]
        along, across = degree_m(latitude)
        cell_m = (dy * along, dx * across)
        lengths = f"{cell_m[1]:.4g} m east, {cell_m[0]:.4g} m north"
        return cell_m, [f"Degrees are taken as metres at latitude {latitude:.2f}: {lengths}."]
    return (dy * place.unit_m, dx * place.unit_m), []


def _is_in_degrees(place: GeoTags) -> bool:
    if place.is_degrees is not None:
        return place.is_degrees
    if place.cell is None or place.middle is None:
        return False
    latitude, longitude = place.middle
    return abs(latitude) <= 90 and abs(longitude) <= 180 and max(place.cell) < 0.1


def _height_unit_m(stored: _Map, cell_m: Pair, options: SourceOptions) -> tuple[float, list[str]]:
    unit_m = stored.place.vertical_unit_m if options.height_scale is None else options.height_scale
    if unit_m is not None:
        return unit_m, []
    known = stored.heights[np.isfinite(stored.heights)]
    span = float(known.max()) - float(known.min())
    side = min(n * d for n, d in zip(stored.heights.shape[-2:], cell_m, strict=True))
    unit_m = PICTURE_RELIEF * side / span if span > 0 else 1.0
    relief = f"{unit_m:.4g} m a unit is assumed, a relief of {span * unit_m:.3g} m"
    return unit_m, [f"The picture gives no scale of heights: {relief}."]


# -- the formats ---------------------------------------------------------------------------------------------
def _from_npz(path: Path) -> _Map:
    archive = NpzArchive(path)
    headers = {name: archive.header(name) for name in archive.names}
    maps = [name for name, h in headers.items() if len(h.shape) == 2 and h.dtype.kind in "fiu"]
    named = [name for name in HEIGHT_KEYS if name in headers]
    if not named and len(maps) != 1:
        listed = ", ".join(headers) or "(none)"
        raise SourceError(str(path), f"the arrays {listed}", f"one named {', '.join(HEIGHT_KEYS)}, or a single map")
    name = (named or maps)[0]
    if headers[name].dtype.kind not in "fiu":
        raise SourceError(f"{path}, array {name}", f"{headers[name].dtype}", "numbers")
    scalars: dict[str, float] = {n: archive.numbers(n, 1)[0] for n in PLACE_KEYS if n in headers}
    dx, dy = abs(scalars.get("dx", 0.0)), abs(scalars.get("dy", scalars.get("dx", 0.0)))
    has_box = all(n in scalars for n in PLACE_KEYS[2:])
    # north and south may stand the wrong way round, as in matplotlib's sample: only the middle is needed
    y, x = (
        (scalars[a] / 2 + scalars[b] / 2 for a, b in (("ymin", "ymax"), ("xmin", "xmax"))) if has_box else (0.0, 0.0)
    )
    heights = _known(archive.read(name))
    axes = None if dx > 0 else _coordinates(archive, heights.shape[-2:])
    if axes is None:
        return _Map(heights, GeoTags((dy, dx) if dx > 0 and dy > 0 else None, (y, x) if has_box else None))
    rows, columns, is_degrees = axes
    if rows[0] < rows[-1]:  # the first row of a map is its northernmost
        heights = heights[..., ::-1, :]
    dy, dx = (float(abs(a[-1] - a[0])) / (len(a) - 1) for a in (rows, columns))
    middle = (float(rows[0] + rows[-1]) / 2, float(columns[0] + columns[-1]) / 2)
    return _Map(heights, GeoTags((dy, dx), middle, is_degrees))


def _coordinates(archive: NpzArchive, shape: tuple[int, ...]) -> tuple[Float64s, Float64s, bool | None] | None:
    """Coordinates of the rows and columns, and whether they are degrees, where the archive holds them as arrays."""
    for y_name, x_name in COORDINATE_KEYS:
        if not {y_name, x_name} <= set(archive.names):
            continue
        axes = []
        for name, count in ((y_name, shape[0]), (x_name, shape[1])):
            header = archive.header(name)
            if header.shape != (count,) or header.dtype.kind not in "fiu" or count < 2:
                return None
            values = archive.read(name).astype(np.float64)
            steps = np.diff(values)
            if not (np.isfinite(values).all() and steps[0] and np.ptp(steps) <= UNEVEN * abs(steps[0])):
                where = f"{archive.path}, array {name}"
                raise SourceError(where, "coordinates at uneven distances", "even ones", "Resample the map first.")
            axes.append(values)
        return axes[0], axes[1], True if y_name.startswith("lat") else None
    return None


def _from_picture(path: Path) -> _Map:
    """A grey picture: heights by its nature where it is of floats, or a TIFF with a place on Earth."""
    with warnings.catch_warnings(), opened(path) as picture:
        warnings.simplefilter("ignore")  # what is damaged is an error, or heights that are not known
        if picture.mode not in _GREY_MODES:
            found = f"a picture of mode {picture.mode}"
            raise SourceError(str(path), found, "one grey channel", "Convert it to grey first.")
        size = (picture.height, picture.width)
        tags = _geo_tags(dict(getattr(picture, "tag_v2", {})), *size)
        values = np.array(picture.getchannel(0) if picture.mode == "LA" else picture)
    if values.shape != size:
        raise SourceError(str(path), f"values of shape {values.shape}", f"{size}")
    is_elevation = values.dtype.kind == "f" or tags.cell is not None
    if tags.nodata is not None:
        values = values.astype(np.float64)
        with np.errstate(over="ignore"):
            nearest = float(np.float32(tags.nodata))  # the tag is text; the picture holds a float32 near it
        values[(values == tags.nodata) | (values == nearest)] = np.nan
    return _Map(_known(values), tags if is_elevation else replace(tags, vertical_unit_m=None))


def _known(values: NDArray[Any]) -> NDArray[np.floating[Any]]:
    """As floating point, NaN where not finite."""
    heights: NDArray[np.floating[Any]] = values.astype(np.float64 if values.dtype.itemsize > 2 else np.float32)
    heights[~np.isfinite(heights)] = np.nan
    return heights


# -- GeoTIFF ------------------------------------------------------------------------------------------------
def degree_m(latitude_deg: float) -> Pair:
    """Metres of one degree of latitude and of one degree of longitude, on WGS 84."""
    sine2 = math.sin(math.radians(latitude_deg)) ** 2
    across = _WGS84_AXIS_M / math.sqrt(1 - _WGS84_E2 * sine2)
    along = across * (1 - _WGS84_E2) / (1 - _WGS84_E2 * sine2)
    return math.radians(along), math.radians(across * math.cos(math.radians(latitude_deg)))


def _geo_tags(tags: Mapping[int, Any], rows: int, cols: int) -> GeoTags:
    """Read the tags of a picture of `rows` x `cols`; what is missing or malformed is left out."""
    cell, middle = _placement(tags, rows, cols)
    directory = _numbers(tags, _GEO_KEYS)
    entries = (directory[i : i + 4] for i in range(4, len(directory) - 3, 4))
    keys = {int(key): int(value) for key, location, _, value in entries if location == 0}  # which stand here
    model = keys.get(_MODEL_TYPE_KEY)
    nodata = str(tags.get(_GDAL_NODATA, "")).strip(" \0")
    try:
        missing = float(nodata)
    except ValueError:
        missing = None
    unit_m, vertical_m = (_UNITS_M.get(keys.get(key, 9001), 1.0) for key in (_LINEAR_UNITS_KEY, _VERTICAL_UNITS_KEY))
    return GeoTags(cell, middle, None if model is None else model == _GEOGRAPHIC, unit_m, vertical_m, missing)


def _placement(tags: Mapping[int, Any], rows: int, cols: int) -> tuple[Pair | None, Pair | None]:
    scale, tie = _numbers(tags, _PIXEL_SCALE), _numbers(tags, _TIEPOINT)
    matrix = _numbers(tags, _TRANSFORMATION)
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


# -- the kind -----------------------------------------------------------------------------------------------
def jacksboro_scene(exaggeration: float = 1.0) -> HeightScene:
    """The Jacksboro fault, Tennessee, from matplotlib's sample data; `MissingExtra` if that is not installed.

    344 x 403 samples of about 93 m by 74 m, heights 236 to 1076 m (int16; USGS, by way of matplotlib).
    """
    cbook = import_extra("matplotlib.cbook", "the bundled elevation model", "matplotlib", "report")
    sample = Path(cbook.get_sample_data("jacksboro_fault_dem.npz", asfileobj=False))
    return _scene(sample, _from_npz(sample), SourceOptions(exaggeration=exaggeration))


def _recognise(path: Path) -> bool:
    suffix = path.suffix.lower()
    names = f"{path.parent.name}/{path.name}".lower()
    if not path.is_file() or any(word in names for word in ("depth", "disp")):
        return False
    try:
        if suffix == ".npz":
            archive = NpzArchive(path)
            if "forces_n" in archive.names:
                return False
            return any(n in HEIGHT_KEYS or len(archive.header(n).shape) == 2 for n in archive.names)
        if suffix == ".npy":
            with path.open("rb") as stream:
                return len(read_npy_header(stream, str(path)).shape) == 2
        if suffix not in PICTURES:
            return False
        with opened(path) as picture:  # reads the head only
            return picture.mode in _GREY_MODES
    except (SourceError, OSError):
        return False


def _open(path: Path, options: SourceOptions) -> Scene:
    suffix = path.suffix.lower()
    readers: dict[str, Callable[[Path], _Map]] = {".npz": _from_npz, **dict.fromkeys(PICTURES, _from_picture)}
    readers[".npy"] = lambda file: _Map(_known(map_npy(file)))
    if suffix not in readers:
        raise SourceError(str(path), f"a file named {suffix or 'without suffix'}", ", ".join(readers))
    return _scene(path, readers[suffix](path), options)


KIND = SourceKind(
    "height-map", "a height map: elevation .npz, .npy or GeoTIFF, or a grey .png or .tif", _recognise, _open
)
