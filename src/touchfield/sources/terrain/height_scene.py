"""`HeightScene`: a height map as a scene that is solid below its surface (paper sections 4 and 5.1). This
file also reads height maps from files.

The paper's scenes from depth images treat the depth map as a height map. The distance to the surface is
approximated to first order, phi = (z - h(x, y)) n_z with h interpolated bilinearly: exact for planes, with an
error of about c d^2 / 2 at curvature c and depth d. The normal is that of planes fitted to 5 x 5 samples with
binomial weights, so that noise of one sample hardly affects it; unknown samples and those across a step are
excluded.

Files are elevation models (``.npz``, ``.npy``, GeoTIFF 1.1: OGC 19-008r4) and grey pictures (PNG, TIFF); row
0 is north. Missing values are assumed, with a note: one metre between samples, one metre a unit; for a
picture without a scale, a relief of a fifth of its shorter side. Degrees are converted to metres on the
ellipsoid WGS 84 (NGA.STND.0036) at the central latitude of the map: one scale for the whole map, no
projection.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from touchfield.arrays import Float32s, Float64s
from touchfield.errors import InvalidArgument, SourceError, as_source_error, import_extra, require_positive
from touchfield.medium import ForceField, Grid
from touchfield.medium.stores.npz import NpzArchive, map_npy, read_npy_header
from touchfield.sources.camera import DepthSequence
from touchfield.sources.images.pictures import has_pages, opened
from touchfield.sources.laws import ForceProfile
from touchfield.sources.options import SourceOptions
from touchfield.sources.registry import SourceKind
from touchfield.sources.scene import CAMERA_AXES, DEPTH_UNIT, UP_Z_AXES, MovingScene, Scene

DEPTH_STEP: Final = 0.05  # of the median depth: a larger jump between neighbours is an edge
HEIGHT_KEYS: Final = ("elevation", "height", "heights", "heights_m", "z")
POSITION_KEYS: Final = ("dx", "dy", "xmin", "xmax", "ymin", "ymax")
PICTURES: Final = (".png", ".tif", ".tiff")
GAP_HEIGHTS: Final = (-9999.0, -32767.0, -32768.0, -99999.0)
"""Values that elevation models use for unknown heights."""
LATITUDE_LIMIT_DEG: Final = 89.0
"""Nearer to a pole the width of cells in degrees of longitude varies too much."""
PICTURE_RELIEF: Final = 0.2  # of a picture without a scale, relative to its shorter side

_GREY_MODES: Final = ("L", "LA", "I", "F", "I;16", "I;16L", "I;16B", "I;16N", "I;16S", "I;16BS")
_PIXEL_SCALE, _TIEPOINT, _GEO_KEYS, _GDAL_NODATA = 33550, 33922, 34735, 42113
_SAMPLE_FORMAT, _SIGNED = 339, 2
_MODEL_TYPE_KEY, _LINEAR_UNITS_KEY, _VERTICAL_UNITS_KEY = 1024, 3076, 4099
_GEOGRAPHIC: Final = 2
_UNITS_M: Final = {9001: 1.0, 9002: 0.3048, 9003: 1200 / 3937}
"""EPSG codes of metre, international and US survey foot."""

_WGS84_AXIS_M: Final = 6378137.0
_WGS84_E2: Final = 0.00669437999014


Pair = tuple[float, float]
_Heights = NDArray[np.floating[Any]]


@dataclass(frozen=True)
class HeightLattice:
    """Positions of the samples of a height map, and its solid side.

    Sample (row, col) lies at x0 + col * dx, y0 + row * dy, metres; dx and dy are signed. `facing` is 1 if the
    solid lies below the surface, and -1 if it lies behind the surface and z points away from the viewer.
    Neighbours that differ by more than `step_m` in height are separated by a step.
    """

    x0_m: float
    dx_m: float
    y0_m: float
    dy_m: float
    facing: int = 1
    step_m: float = math.inf

    def __post_init__(self) -> None:
        for name in ("dx_m", "dy_m"):
            value = getattr(self, name)
            if not (value != 0 and math.isfinite(value)):
                raise InvalidArgument(name, repr(value), "a length in metres, not zero")
        if not (math.isfinite(self.x0_m) and math.isfinite(self.y0_m)):
            raise InvalidArgument("x0_m, y0_m", f"{self.x0_m}, {self.y0_m}", "finite metres")
        if self.facing not in (1, -1) or not self.step_m > 0:
            raise InvalidArgument(
                "facing, step_m", f"{self.facing}, {self.step_m}", "1 or -1, a positive height"
            )


class HeightScene(MovingScene):
    """One height map, or several over time.

    There is no force outside it and where it is unknown.

    `heights_m` are metres, NaN where unknown: [rows, cols], [frames, rows, cols], a sequence of arrays, or a
    callable ``heights(frame) -> [rows, cols]`` for `frame_count` frames. `cell_m` is (dy, dx), the distance
    between neighbouring rows and columns, metres: row 0 is then north, the last row at y = 0 and column 0 at
    x = 0; a `HeightLattice` gives other positions. `exaggeration` is a factor on the heights; 1 keeps the
    true proportions.
    """

    is_solid = True

    def __init__(
        self,
        heights_m: ArrayLike | Sequence[ArrayLike] | Callable[[int], ArrayLike],
        cell_m: tuple[float, float] | HeightLattice,
        *,
        axes: str = UP_Z_AXES,
        exaggeration: float = 1.0,
        frame_count: int = 1,
        rate_hz: float = 30.0,
        notes: tuple[str, ...] = (),
        name: str = "height map",
    ) -> None:
        require_positive(exaggeration=exaggeration, rate_hz=rate_hz, frame_count=frame_count)
        if callable(heights_m):
            self._frames: Callable[[int], ArrayLike] = heights_m
            self.frame_count = int(frame_count)
        else:
            frames = _as_frames(heights_m)
            self._frames, self.frame_count = frames.__getitem__, len(frames)
        self.axes, self.rate_hz, self.notes, self.name = axes, float(rate_hz), notes, name
        self.exaggeration = float(exaggeration)
        self._cell_m = cell_m
        self._surface = lru_cache(maxsize=2)(self._prepare)  # a filter requests one frame many times

    @classmethod
    def from_depth_sequence(cls, sequence: DepthSequence, exaggeration: float = 1.0) -> HeightScene:
        """Read depth maps as height maps, as in the paper.

        Pixels are x and y, depth is height, and everything behind the surface is solid.

        Pixels are spaced by their size at the median depth of the first frame with depth, x = (u - cx) / fx
        z_median, so that lengths at that depth are true; nearer things are too large, farther ones too small.
        """
        for frame in range(sequence.frame_count):
            depth = sequence.depth_m(frame)
            known_m = depth[depth > 0]
            if known_m.size:
                break
        else:
            raise SourceError(sequence.name, "no depth in any frame", "at least one known pixel")
        z, k = float(np.median(known_m)), sequence.intrinsics
        dx_m, dy_m = z / k.fx, z / k.fy
        lattice = HeightLattice(
            -k.cx / k.fx * z, dx_m, -k.cy / k.fy * z, dy_m, -1, DEPTH_STEP * z * exaggeration
        )
        note = f"Depth is read as a height map: pixels are spaced as at {z:.3g} m, perspective is not undone."

        def heights(frame: int) -> Float32s:
            depth = sequence.depth_m(frame)
            return np.where(depth > 0, depth, np.float32(np.nan))

        scene = cls(
            heights, lattice, axes=CAMERA_AXES, exaggeration=exaggeration, frame_count=sequence.frame_count,
            rate_hz=sequence.rate_hz, notes=(*sequence.notes, note), name=sequence.name,
        )  # fmt: skip
        scene.unit = DEPTH_UNIT
        return scene

    def _box_m(self, start: int, stop: int) -> Float64s:
        """Return the box of the heights; reads every frame."""
        low, high, shape = math.inf, -math.inf, (2, 2)
        for frame in range(start, stop):
            heights = self._heights(frame)
            known_m = heights[np.isfinite(heights)]
            shape = heights.shape
            if known_m.size:
                low, high = min(low, float(known_m.min())), max(high, float(known_m.max()))
        if low > high:
            raise SourceError(self.name, "no known height", "at least one")
        at = self._lattice(shape)
        xs = sorted((at.x0_m, at.x0_m + at.dx_m * (shape[1] - 1)))
        ys = sorted((at.y0_m, at.y0_m + at.dy_m * (shape[0] - 1)))
        return np.array([[xs[0], ys[0], low], [xs[1], ys[1], high]])

    def field(self, frame: int, grid: Grid, profile: ForceProfile) -> ForceField:
        from touchfield.sources.terrain import kernels

        heights, slopes = self._surface(frame)
        at = self._lattice(heights.shape)
        return ForceField(grid, *kernels.bricks_and_forces(heights, slopes, at, grid, profile))

    def _lattice(self, shape: tuple[int, ...]) -> HeightLattice:
        if isinstance(self._cell_m, HeightLattice):
            return self._cell_m
        dy, dx = self._cell_m
        return HeightLattice(0.0, dx, dy * (shape[0] - 1), -dy)

    def _heights(self, frame: int) -> Float64s:
        heights = np.array(self._frames(frame), np.float64)
        if heights.ndim != 2 or min(heights.shape) < 2:
            raise InvalidArgument(
                self.name, f"heights of shape {heights.shape}", "[rows, cols], at least 2 x 2"
            )
        with np.errstate(over="ignore"):
            heights *= self.exaggeration
        heights[~np.isfinite(heights)] = np.nan
        return heights

    def _prepare(self, frame: int) -> tuple[Float64s, Float32s]:
        from touchfield.sources.terrain import kernels

        heights = self._heights(frame)
        at = self._lattice(heights.shape)
        return heights, kernels.gradients(heights, at.step_m, at.dx_m, at.dy_m)


def _as_frames(heights_m: ArrayLike | Sequence[ArrayLike]) -> list[Float64s]:
    """Return the checked frames of an array or a sequence of arrays."""
    expected = "maps [rows, cols] of one size, at least 2 x 2"
    try:
        stack = np.asarray(heights_m, np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidArgument("heights_m", "no array of numbers", expected) from error
    frames = list(stack) if stack.ndim == 3 else [stack]
    if stack.ndim not in (2, 3) or not frames or min(frames[0].shape) < 2:
        raise InvalidArgument("heights_m", f"shape {stack.shape}", expected)
    return frames


# -- files -------------------------------------------------------------------------------------------------
class _GeoReference(NamedTuple):
    """Positions and units of samples as stated in a file.

    A value is None if the file does not state it.

    `cell` is (dy, dx) and `middle` y and x of the centre of the map, both in units of the map, which are
    `unit_m` metres unless they are degrees; `vertical_unit_m` is the metres of one unit of height.
    """

    cell: Pair | None = None
    middle: Pair | None = None
    is_degrees: bool | None = None
    unit_m: float = 1.0
    vertical_unit_m: float | None = 1.0
    nodata: float | None = None
    notes: tuple[str, ...] = ()


def _scene_of(path: Path, heights: _Heights, reference: _GeoReference, options: SourceOptions) -> HeightScene:
    """Return the scene of a map, [rows, cols] or [frames, rows, cols], with its assumptions in the notes."""
    known_heights = heights[np.isfinite(heights)]
    if not known_heights.size:
        raise SourceError(str(path), "no known height", "at least one")
    lowest = float(known_heights.min())
    notes = reference.notes
    if lowest in GAP_HEIGHTS:
        notes += (f"{lowest:g} is taken for a height: where it marks what is not known, write NaN there.",)
    latitude, longitude = reference.middle or (0.0, 0.0)
    is_degrees = reference.is_degrees
    if is_degrees is None and reference.cell is not None and reference.middle is not None:
        is_degrees = abs(latitude) <= 90 and abs(longitude) <= 180 and max(reference.cell) < 0.1
    if is_degrees and abs(latitude) > LATITUDE_LIMIT_DEG:
        raise SourceError(
            str(path), f"the latitude {latitude:.4g}", f"at most {LATITUDE_LIMIT_DEG} either way"
        )
    dy, dx = reference.cell or (1.0, 1.0)
    if options.cell_size_m is not None:
        cell_m = options.cell_size_m, options.cell_size_m
    elif reference.cell is None:
        cell_m = (1.0, 1.0)
        notes += (
            "The distance of samples is not given: one metre is assumed (--cell-size-m; in .npz dx and dy).",
        )
    elif is_degrees:
        along, across = degree_m(latitude)
        cell_m = dy * along, dx * across
        lengths = f"{cell_m[1]:.4g} m east, {cell_m[0]:.4g} m north"
        notes += (f"Degrees are taken as metres at latitude {latitude:.2f}: {lengths}.",)
    else:
        cell_m = dy * reference.unit_m, dx * reference.unit_m
    unit_m = reference.vertical_unit_m if options.height_scale is None else options.height_scale
    if unit_m is None:
        span = float(known_heights.max()) - float(known_heights.min())
        side = min(n * d for n, d in zip(heights.shape[-2:], cell_m, strict=True))
        unit_m = PICTURE_RELIEF * side / span if span > 0 else 1.0
        relief = f"{unit_m:.4g} m a unit is assumed, a relief of {span * unit_m:.3g} m"
        notes += (f"The picture gives no scale of heights (--height-scale): {relief}.",)
    if unit_m != 1:
        heights = heights.astype(np.float64) * unit_m
    rate_hz, factor = options.rate_hz or 30.0, options.exaggeration
    with as_source_error(f"{path}, "):
        return HeightScene(heights, cell_m, exaggeration=factor, rate_hz=rate_hz, notes=notes, name=str(path))


def _from_npz(path: Path) -> tuple[_Heights, _GeoReference]:
    archive = NpzArchive(path)
    headers = {name: archive.header(name) for name in archive.names}
    maps = [name for name, h in headers.items() if len(h.shape) == 2 and h.dtype.kind in "fiu"]
    named = [name for name in HEIGHT_KEYS if name in headers]
    if not named and len(maps) != 1:
        listed = ", ".join(headers) or "(none)"
        raise SourceError(
            str(path), f"the arrays {listed}", f"one named {', '.join(HEIGHT_KEYS)}, or a single map"
        )
    name = (named or maps)[0]
    if headers[name].dtype.kind not in "fiu":
        raise SourceError(f"{path}, array {name}", f"{headers[name].dtype}", "numbers")
    scalars: dict[str, float] = {n: archive.numbers(n, 1)[0] for n in POSITION_KEYS if n in headers}
    dx, dy = abs(scalars.get("dx", 0.0)), abs(scalars.get("dy", scalars.get("dx", 0.0)))
    middle: Pair | None = None
    if all(n in scalars for n in POSITION_KEYS[2:]):
        # north and south may be swapped, as in matplotlib's sample: only the centre is needed
        y, x = (scalars[a] / 2 + scalars[b] / 2 for a, b in (("ymin", "ymax"), ("xmin", "xmax")))
        middle = y, x
    return _as_heights(archive.read(name)), _GeoReference((dy, dx) if dx > 0 and dy > 0 else None, middle)


def _from_picture(path: Path) -> tuple[_Heights, _GeoReference]:
    """Read a grey picture.

    One of floats, or a TIFF with georeference, is an elevation model.
    """
    expected = "one grey channel of 8 to 16 bits, or of 32, whole or floating"
    with warnings.catch_warnings(), opened(path, expected=expected) as picture:
        warnings.simplefilter("ignore")  # damage is an error, or gives unknown heights
        if picture.mode not in _GREY_MODES:
            found = f"a picture of mode {picture.mode}"
            raise SourceError(str(path), found, "one grey channel", "Convert it to grey first.")
        size = (picture.height, picture.width)
        stored = dict(getattr(picture, "tag_v2", {}))
        tags = _geo_tags(stored, *size)
        values = np.array(picture.getchannel(0) if picture.mode == "LA" else picture)
        if picture.mode == "L" and stored.get(_SAMPLE_FORMAT) == (_SIGNED,):  # Pillow ignores the sign
            values = values.view(np.int8)
    if values.shape != size:
        raise SourceError(str(path), f"values of shape {values.shape}", f"{size}")
    if stored and has_pages(path):
        tags = tags._replace(notes=("The file has several pages of this size: the first is read.",))
    is_elevation = values.dtype.kind == "f" or tags.cell is not None
    if tags.nodata is not None:
        values = values.astype(np.float64)
        with np.errstate(over="ignore"):
            nearest = float(np.float32(tags.nodata))  # the tag is text; samples are the nearest float32
        values[(values == tags.nodata) | (values == nearest)] = np.nan
    return _as_heights(values), tags if is_elevation else tags._replace(vertical_unit_m=None)


def _as_heights(values: NDArray[Any]) -> _Heights:
    """Convert to floating point, NaN if not finite."""
    heights: _Heights = values.astype(np.float64 if values.dtype.itemsize > 2 else np.float32)
    heights[~np.isfinite(heights)] = np.nan
    return heights


def degree_m(latitude_deg: float) -> Pair:
    """Return the metres of one degree of latitude and of longitude, on WGS 84."""
    sine2 = math.sin(math.radians(latitude_deg)) ** 2
    across = _WGS84_AXIS_M / math.sqrt(1 - _WGS84_E2 * sine2)
    along = across * (1 - _WGS84_E2) / (1 - _WGS84_E2 * sine2)
    return math.radians(along), math.radians(across * math.cos(math.radians(latitude_deg)))


def _geo_tags(tags: Mapping[int, Any], rows: int, cols: int) -> _GeoReference:
    """Read the tags of a picture of `rows` x `cols`.

    Missing or malformed ones are ignored.
    """
    cell: Pair | None = None
    middle: Pair | None = None
    scale, tie = _numbers(tags, _PIXEL_SCALE), _numbers(tags, _TIEPOINT)
    if len(scale) >= 2 and scale[0] > 0 and scale[1] > 0:
        dx, dy = scale[:2]
        cell = dy, dx
        if len(tie) >= 6:
            middle = tie[4] - dy * (rows / 2 - tie[1]), tie[3] + dx * (cols / 2 - tie[0])
    directory = _numbers(tags, _GEO_KEYS)
    entries = (directory[i : i + 4] for i in range(4, len(directory) - 3, 4))
    keys = {
        int(key): int(value) for key, location, _, value in entries if location == 0
    }  # values stored inline
    model, missing = keys.get(_MODEL_TYPE_KEY), None
    with suppress(ValueError):
        missing = float(str(tags.get(_GDAL_NODATA, "")).strip(" \0"))
    unit_m, vertical_m = (
        _UNITS_M.get(keys.get(key, 9001), 1.0) for key in (_LINEAR_UNITS_KEY, _VERTICAL_UNITS_KEY)
    )
    return _GeoReference(
        cell, middle, None if model is None else model == _GEOGRAPHIC, unit_m, vertical_m, missing
    )


def _numbers(tags: Mapping[int, Any], tag: int) -> list[float]:
    values = tags.get(tag, ())
    values = values if isinstance(values, tuple | list) else (values,)
    try:
        numbers = [float(v) for v in values]
    except (TypeError, ValueError, ZeroDivisionError):
        return []
    return numbers if all(map(math.isfinite, numbers)) else []


def jacksboro_scene(exaggeration: float = 1.0) -> HeightScene:
    """Return the Jacksboro fault, Tennessee, from matplotlib's sample data.

    Raises `MissingExtra` without it.

    344 x 403 samples of about 93 m by 74 m, heights 236 to 1076 m (int16; USGS, by way of matplotlib).
    """
    cbook = import_extra("matplotlib.cbook", "the bundled elevation model", "matplotlib", "report")
    sample = Path(cbook.get_sample_data("jacksboro_fault_dem.npz", asfileobj=False))
    return _scene_of(sample, *_from_npz(sample), SourceOptions(exaggeration=exaggeration))


def _recognise(path: Path) -> bool:
    suffix = path.suffix.lower()
    names = f"{path.parent.name}/{path.name}".lower()
    if not path.is_file() or any(word in names for word in ("depth", "disp")):
        return False
    if suffix == ".npz":
        archive = NpzArchive(path)
        is_height = any(n in HEIGHT_KEYS or len(archive.header(n).shape) == 2 for n in archive.names)
        return is_height and "forces_n" not in archive.names
    if suffix == ".npy":
        with path.open("rb") as stream:
            return len(read_npy_header(stream, str(path)).shape) == 2
    if suffix not in PICTURES:
        return False
    try:
        with opened(path) as picture:  # reads the header only
            return picture.mode in _GREY_MODES
    except (SourceError, OSError):
        return suffix in PICTURES[1:]  # opening it then reports the unsupported TIFF


def _open(path: Path, options: SourceOptions) -> Scene:
    suffix = path.suffix.lower()
    if suffix == ".npy":
        return _scene_of(path, _as_heights(map_npy(path)), _GeoReference(), options)
    if suffix not in (".npz", *PICTURES):
        expected = ", ".join((".npz", ".npy", *PICTURES))
        raise SourceError(str(path), f"a file named {suffix or 'without suffix'}", expected)
    return _scene_of(path, *(_from_npz if suffix == ".npz" else _from_picture)(path), options)


KIND = SourceKind(
    "height-map", "a height map: elevation .npz, .npy or GeoTIFF, or a grey .png or .tif", _recognise, _open
)
