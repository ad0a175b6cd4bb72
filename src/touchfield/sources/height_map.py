"""Height maps from files: elevation models (``.npz``, ``.npy``, GeoTIFF) and grey pictures (PNG, TIFF).

Row 0 is north. What a file does not say is assumed, and the assumption told in a note: one metre between
samples, one metre a unit; of a picture without a scale, a relief of a fifth of its shorter side.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from touchfield.errors import InvalidArgument, MissingExtra, SourceError
from touchfield.medium.npz_archive import NpzArchive, map_npy, read_npy_header
from touchfield.sources.height_picture import GeoTags, degree_m, is_grey_picture, read_picture
from touchfield.sources.height_scene import HeightScene
from touchfield.sources.options import SourceOptions
from touchfield.sources.registry import SourceKind
from touchfield.sources.scene import Scene

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["KIND", "jacksboro_scene"]

HEIGHT_KEYS: Final = ("elevation", "height", "heights", "heights_m", "z")
PLACE_KEYS: Final = ("dx", "dy", "xmin", "xmax", "ymin", "ymax")
COORDINATE_KEYS: Final = (("latitude", "longitude"), ("lat", "lon"), ("y", "x"))
UNEVEN: Final = 0.1
"""Steps between coordinates may differ by this share: rows of a Mercator map do, by little."""

PICTURES: Final = (".png", ".tif", ".tiff")
LATITUDE_LIMIT_DEG: Final = 89.0
"""Nearer to a pole the degrees of longitude are no cells of one width."""

PICTURE_RELIEF: Final = 0.2
"""Relief of a picture without a scale, of its shorter side: as a landscape under the hand, not a wall."""


class _Map(NamedTuple):
    """Heights as stored, float [rows, cols] or [frames, rows, cols], NaN where unknown, and their place."""

    heights: NDArray[np.floating[Any]]
    place: GeoTags = GeoTags()


def _scene(path: Path, found: _Map, options: SourceOptions) -> HeightScene:
    """The scene of a map, with what had to be assumed in its notes."""
    if found.heights.ndim not in (2, 3) or min(found.heights.shape[-2:]) < 2 or not found.heights.size:
        raise SourceError(str(path), f"heights of shape {found.heights.shape}", "[rows, cols], at least 2 x 2")
    if not np.isfinite(found.heights).any():
        raise SourceError(str(path), "no known height", "at least one")
    place = found.place
    if _is_in_degrees(place) and place.middle is not None and abs(place.middle[0]) > LATITUDE_LIMIT_DEG:
        raise SourceError(
            str(path), f"the latitude {place.middle[0]:.4g}", f"at most {LATITUDE_LIMIT_DEG} either way"
        )
    cell_m, notes = _cell_m(place, options)
    unit_m, more = _height_unit_m(found, cell_m, options)
    heights = found.heights if unit_m == 1 else found.heights.astype(np.float64) * unit_m
    try:
        return HeightScene(
            heights,
            cell_m,
            exaggeration=options.exaggeration,
            rate_hz=options.rate_hz or 30.0,
            notes=(*notes, *more),
            name=str(path),
        )
    except InvalidArgument as error:
        raise SourceError(f"{path}, {error.where}", error.found, error.expected) from error


def _cell_m(place: GeoTags, options: SourceOptions) -> tuple[tuple[float, float], list[str]]:
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


def _height_unit_m(found: _Map, cell_m: tuple[float, float], options: SourceOptions) -> tuple[float, list[str]]:
    unit_m = found.place.vertical_unit_m if options.height_scale is None else options.height_scale
    if unit_m is not None:
        return unit_m, []
    known = found.heights[np.isfinite(found.heights)]
    span = float(known.max()) - float(known.min())
    side = min(n * d for n, d in zip(found.heights.shape[-2:], cell_m, strict=True))
    unit_m = PICTURE_RELIEF * side / span if span > 0 else 1.0
    note = (
        f"The picture gives no scale of heights: {unit_m:.4g} m a unit is assumed, a relief of {span * unit_m:.3g} m."
    )
    return unit_m, [note]


# -- the formats ---------------------------------------------------------------------------------------------


def _from_npz(path: Path) -> _Map:
    archive = NpzArchive(path)
    headers = {name: archive.header(name) for name in archive.names}
    flat = [name for name, h in headers.items() if len(h.shape) == 2 and h.dtype.kind in "fiu"]
    named = [name for name in HEIGHT_KEYS if name in headers]
    if not named and len(flat) != 1:
        listed = ", ".join(headers) or "(none)"
        raise SourceError(str(path), f"the arrays {listed}", f"one named {', '.join(HEIGHT_KEYS)}, or a single map")
    name = (named or flat)[0]
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


def _coordinates(
    archive: NpzArchive, shape: tuple[int, ...]
) -> tuple[NDArray[np.float64], NDArray[np.float64], bool | None] | None:
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


def _from_npy(path: Path) -> _Map:
    return _Map(_known(map_npy(path)))


def _from_picture(path: Path) -> _Map:
    values, tags, is_elevation = read_picture(path)
    return _Map(_known(values), tags if is_elevation else replace(tags, vertical_unit_m=None))


def _known(values: NDArray[Any]) -> NDArray[np.floating[Any]]:
    """As floating point, NaN where not finite."""
    heights: NDArray[np.floating[Any]] = values.astype(np.float64 if values.dtype.itemsize > 2 else np.float32)
    heights[~np.isfinite(heights)] = np.nan
    return heights


def jacksboro_scene(exaggeration: float = 1.0) -> HeightScene:
    """A real elevation model without a download: the Jacksboro fault, Tennessee, from matplotlib's sample data.

    344 x 403 samples of about 93 m by 74 m, heights 236 to 1076 m (int16; USGS, by way of matplotlib).

    Raises `MissingExtra` if matplotlib is not installed.
    """
    try:
        from matplotlib import cbook
    except ImportError as error:
        raise MissingExtra("the bundled elevation model", "matplotlib", "report") from error
    sample = Path(cbook.get_sample_data("jacksboro_fault_dem.npz", asfileobj=False))
    return _scene(sample, _from_npz(sample), SourceOptions(exaggeration=exaggeration))


# -- the kind ------------------------------------------------------------------------------------------------


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
        return suffix in PICTURES and is_grey_picture(path)
    except (SourceError, OSError):
        return False


def _open(path: Path, options: SourceOptions) -> Scene:
    suffix = path.suffix.lower()
    readers = {".npz": _from_npz, ".npy": _from_npy, **dict.fromkeys(PICTURES, _from_picture)}
    if suffix not in readers:
        raise SourceError(str(path), f"a file named {suffix or 'without suffix'}", ", ".join(readers))
    return _scene(path, readers[suffix](path), options)


KIND = SourceKind(
    "height-map", "a height map: elevation .npz, .npy or GeoTIFF, or a grey .png or .tif", _recognise, _open
)
