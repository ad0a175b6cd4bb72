"""Reads a height map and its georeference from a TIFF (OGC 19-008r4, GeoTIFF 1.1), decoded by tifffile.

Used: every integer and floating type, tiles, planar bands, BigTIFF; pixel scale or transformation matrix,
the units of positions and heights, GDAL's tags of gaps, scale, offset and unit, masks and alpha bands, and a
world file beside the picture. A page of more than `MAX_PIXELS` samples is decoded a row of tiles at a time
and reduced (`large_maps`); an overview is read in its place, where one is fine enough. What changes the
geometry and is not used is named in the notes: further pages and bands, tie points without a scale, a tilt,
and GDAL's ``.aux.xml``.
"""

from __future__ import annotations

import logging
import math
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from touchfield.errors import SourceError, TouchfieldError, import_extra, reason
from touchfield.files import require_plain
from touchfield.sources.images.pictures import opened
from touchfield.sources.terrain.height_map import UPRIGHT, Affine, GeoReference, unit_of
from touchfield.sources.terrain.large_maps import bound_samples, is_large, reduce_map
from touchfield.sources.terrain.tiff_bands import map_bands, missing_codec

_PIXEL_SCALE, _TIEPOINT, _MATRIX = 33550, 33922, 34264
_GEO_KEYS, _GEO_DOUBLES, _GDAL_METADATA, _GDAL_NODATA = 34735, 34736, 42112, 42113
_GEO_TAGS: Final = (
    _PIXEL_SCALE, _TIEPOINT, _MATRIX, _GEO_KEYS, _GEO_DOUBLES, _GDAL_METADATA, _GDAL_NODATA,
)  # fmt: skip
_MODEL_TYPE, _GEOGRAPHIC_CRS, _ANGULAR_UNITS, _PROJECTED_CRS = 1024, 2048, 2054, 3072
_LINEAR_UNITS, _LINEAR_UNIT_SIZE, _VERTICAL_CRS, _VERTICAL_UNITS = 3076, 3077, 4096, 4099
_GEOGRAPHIC, _GEOCENTRIC, _USER_DEFINED = 2, 3, 32767
_UNITS_M: Final = {
    9001: 1.0, 9002: 0.3048, 9003: 1200 / 3937, 9005: 0.3047972654, 9014: 1.8288, 9036: 1000.0, 9096: 0.9144,
    1025: 0.001, 1033: 0.01,
}  # fmt: skip
"""EPSG codes of metre, international, US survey and Clarke's foot, fathom, km, yard, mm and cm."""
_UNITS_DEG: Final = {9101: 180 / math.pi, 9102: 1.0, 9103: 1 / 60, 9104: 1 / 3600, 9105: 0.9, 9122: 1.0}
_REDUCED, _MASK = 1, 4  # bits of NewSubfileType
_COLOURS: Final = {2: "RGB", 3: "palette", 5: "CMYK", 6: "YCbCr"}
_ALPHA: Final = (1, 2)
_MAX_PAGES: Final = 64
_FINE_SAMPLES: Final = 1 << 22  # of an overview: 2048 x 2048, twice the finest lattice of a workspace
_MAX_STRETCH: Final = 0.01  # between the factors of rows and columns of an overview
_ITEM: Final = re.compile(r"<Item\s+([^<>]*)>([^<]*)</Item>")
_ATTRIBUTE: Final = re.compile(r'(\w+)="([^"]*)"')
_AUXILIARY: Final = re.compile(rb"<(Scale|Offset|NoDataValue|UnitType|GeoTransform|GCPList)[ >]")
_AUXILIARY_BYTES: Final = 1 << 20
_WORLD_BYTES: Final = 4096


def read_tiff(path: Path) -> tuple[NDArray[Any], GeoReference]:
    """Read the first band of the first page, [rows, cols], and what the file states about it.

    Samples that a mask or an alpha band hides are NaN. Raises `SourceError` if it is no TIFF of numbers, or
    needs a codec that is not installed; `MissingExtra` without tifffile.
    """
    with _pages(path) as tiff:
        page = tiff.pages[0]
        _require_numbers(path, page)
        further = _further_pages(tiff, page)
        notes = _band_notes(page)
        if further.page_count:
            notes += ("The file has several pages of this size: the first is read.",)
        tags = {code: page.tags[code].value for code in _GEO_TAGS if code in page.tags}
        reference = reference_of(path, tags)
        is_elevation = reference.is_elevation or page.dtype.kind == "f"
        reference = reference._replace(is_elevation=is_elevation, notes=notes + reference.notes)
        shape = page.imagelength, page.imagewidth
        if not is_large(shape):
            values, mask = _first_band(path, page), further.mask_of(page)
            if mask is not None:
                values = np.where(_decoded(path, mask) != 0, values.astype(np.float64), np.nan)
            return values, reference
        chosen = further.overview(page)
        bands = map_bands(path, chosen, _alpha_band(chosen), further.mask_of(chosen))
        return reduce_map(
            path, bands, (chosen.imagelength, chosen.imagewidth), reference,
            overview_of=None if chosen is page else shape,
        )  # fmt: skip


def tiff_is_grey(path: Path) -> bool:
    """Return True if the first page of a TIFF has numbers, not colours. Reads the header only."""
    with _pages(path) as tiff:
        return int(tiff.pages[0].photometric) not in _COLOURS


@contextmanager
def _pages(path: Path) -> Iterator[Any]:
    """Open a TIFF with tifffile; its errors, of any type for damaged files, become `SourceError`."""
    tifffile = import_extra("tifffile", f"{path}, a TIFF", "tifffile", "sources")
    require_plain(path, "a picture")
    log = logging.getLogger("tifffile")
    was_disabled, log.disabled = log.disabled, True  # it reports on stderr what becomes an error or a gap
    try:
        with tifffile.TiffFile(path) as tiff:
            yield tiff
    except (TouchfieldError, GeneratorExit):
        raise
    except Exception as error:
        found = f"a TIFF that is damaged, or of a form that is not read ({reason(error)})"
        raise SourceError(str(path), found, "a whole TIFF of numbers", "Check the file.") from error
    finally:
        log.disabled = was_disabled


def _require_numbers(path: Path, page: Any) -> None:
    colour = _COLOURS.get(int(page.photometric))
    if colour or page.dtype is None or page.dtype.kind not in "fiu" or page.axes not in ("YX", "YXS", "SYX"):
        found = f"a picture in {colour} colours" if colour else f"samples {page.dtype} of axes {page.axes}"
        expected = "one number a pixel, whole or floating"
        raise SourceError(str(path), found, expected, "Save the heights themselves, not a picture of them.")
    bound_samples(path, page.imagelength, page.imagewidth)


def _alpha_bands(page: Any) -> list[int]:
    count = page.shape[page.axes.index("S")] if "S" in page.axes else 1
    kinds = [int(kind) for kind in page.extrasamples]
    return [count - len(kinds) + n for n, kind in enumerate(kinds) if kind in _ALPHA]


def _alpha_band(page: Any) -> int | None:
    """Return the number of the band that hides samples, if there is one besides the first."""
    alpha = _alpha_bands(page)
    return alpha[0] if alpha and alpha[0] > 0 else None


def _band_notes(page: Any) -> tuple[str, ...]:
    """Return a note on bands of numbers that are not read."""
    count, alpha = page.shape[page.axes.index("S")] if "S" in page.axes else 1, _alpha_bands(page)
    others = [n for n in range(1, count) if n not in alpha]
    return (f"The file has {len(others) + 1} bands of numbers: the first is read.",) if others else ()


def _first_band(path: Path, page: Any) -> NDArray[Any]:
    """Return the first band of a page, NaN where an alpha band is 0."""
    values = _decoded(path, page)
    if page.axes == "YX":
        return values
    bands, alpha = np.moveaxis(values, page.axes.index("S"), 0), _alpha_band(page)
    return bands[0] if alpha is None else np.where(bands[alpha] != 0, bands[0].astype(np.float64), np.nan)


def _decoded(path: Path, page: Any) -> NDArray[Any]:
    """Decode a page; by Pillow, which has codecs of its own, if tifffile lacks imagecodecs."""
    try:
        return np.asarray(page.asarray())
    except ValueError as error:
        if "imagecodecs" not in str(error):
            raise
        with suppress(SourceError), opened(path, ("TIFF",)) as picture:
            values = np.array(picture)
            if values.shape == page.shape and values.dtype.kind == page.dtype.kind:
                return values.astype(page.dtype)
        raise missing_codec(path, page) from error


class _FurtherPages(NamedTuple):
    """Pages after the first: masks and overviews, and the number of others that are as large."""

    masks: tuple[Any, ...]
    overviews: tuple[Any, ...]
    page_count: int

    def mask_of(self, page: Any) -> Any:
        """Return the page that hides samples of a page; None if there is none."""
        return next((mask for mask in self.masks if mask.shape[:2] == page.shape[:2]), None)

    def overview(self, page: Any) -> Any:
        """Return the smallest overview that is fine enough for a workspace, else the page itself."""
        fine = [p for p in self.overviews if p.imagelength * p.imagewidth >= _FINE_SAMPLES]
        return min(fine, key=lambda p: p.imagelength * p.imagewidth, default=page)


def _further_pages(tiff: Any, first: Any) -> _FurtherPages:
    masks, overviews, count = [], [], 0
    for page in _pages_after_first(tiff):
        kind = int(page.subfiletype)
        if kind & _MASK:
            masks.append(page)
        elif kind & _REDUCED:
            is_alike = page.axes == first.axes and page.dtype == first.dtype
            if is_alike and _is_smaller_copy(page, first):
                overviews.append(page)
        elif page.shape[:2] == first.shape[:2]:
            count += 1
    return _FurtherPages(tuple(masks), tuple(overviews), count)


def _pages_after_first(tiff: Any) -> Iterator[Any]:
    with suppress(IndexError):
        for index in range(1, _MAX_PAGES):
            yield tiff.pages[index]


def _is_smaller_copy(page: Any, first: Any) -> bool:
    """Return True if a page has the proportions of the first, to the rounding of its size."""
    by_row, by_col = first.imagelength / page.imagelength, first.imagewidth / page.imagewidth
    return bool(min(by_row, by_col) > 1 and abs(by_row / by_col - 1) < _MAX_STRETCH)


# -- georeference ------------------------------------------------------------------------------------------
def reference_of(path: Path, tags: Mapping[int, Any]) -> GeoReference:
    """Return what the tags of a TIFF and a world file beside it state. Malformed tags are ignored."""
    keys = _geo_keys(tags)
    affine, notes = _affine(tags)
    if affine is None:
        affine = read_world_file(path)
    angular_deg = _UNITS_DEG.get(int(keys.get(_ANGULAR_UNITS, 9102)), 1.0)
    is_degrees = _is_degrees(keys)
    if is_degrees and affine and angular_deg != 1:
        a, b, c, d, e, f = (value * angular_deg for value in affine)
        affine = a, b, c, d, e, f
    if keys.get(_MODEL_TYPE) == _GEOCENTRIC:
        notes += (f"Geocentric positions are not used; {UPRIGHT} with -t_srs.",)
        affine = None
    unit_m, unit_notes = _linear_unit(keys)
    vertical_m, scale, offset, height_notes = _heights(keys, tags, unit_m)
    nodata = _nodata(tags)
    is_elevation = bool(affine or keys or nodata or scale != 1 or offset or _GDAL_METADATA in tags)
    return GeoReference(
        affine, None, None, is_degrees, unit_m, vertical_m, scale, offset, nodata, is_elevation,
        (*notes, *unit_notes, *height_notes, *_auxiliary_notes(path)), epsg=_epsg(keys, is_degrees),
    )  # fmt: skip


def _geo_keys(tags: Mapping[int, Any]) -> dict[int, float]:
    """Return the GeoKeys whose values are one number; text keys are left out."""
    directory, doubles = _numbers(tags, _GEO_KEYS), _numbers(tags, _GEO_DOUBLES)
    keys: dict[int, float] = {}
    for i in range(4, len(directory) - 3, 4):
        key, location, count, value = map(int, directory[i : i + 4])
        if location == 0:
            keys[key] = value
        elif location == _GEO_DOUBLES and count == 1 and value < len(doubles):
            keys[key] = doubles[value]
    return keys


def _is_degrees(keys: Mapping[int, float]) -> bool | None:
    model = keys.get(_MODEL_TYPE)
    if model is not None:
        return model == _GEOGRAPHIC
    return True if _GEOGRAPHIC_CRS in keys and _PROJECTED_CRS not in keys else None


def _epsg(keys: Mapping[int, float], is_degrees: bool | None) -> int | None:
    """Return the EPSG code of the coordinate system; None if it has none, or is defined by the file."""
    code = int(keys.get(_GEOGRAPHIC_CRS if is_degrees else _PROJECTED_CRS, 0))
    return code if 0 < code < _USER_DEFINED else None


def _affine(tags: Mapping[int, Any]) -> tuple[Affine | None, tuple[str, ...]]:
    """Return the affine of the pixel scale, else of the matrix, and notes on what of them is not used."""
    scale, tie, matrix = (_numbers(tags, tag) for tag in (_PIXEL_SCALE, _TIEPOINT, _MATRIX))
    if len(scale) >= 2 and scale[0] and scale[1]:
        i, j, _, x, y, _ = tie[:6] if len(tie) >= 6 else [math.nan] * 6
        sx, sy = scale[:2]
        notes = ("ScaleY is below 0: row 0 is south, as GeoTIFF defines it; GDAL reads it as north.",)
        return (sx, 0.0, x - i * sx, 0.0, -sy, y + j * sy), notes[: sy < 0]
    if len(matrix) == 16:
        a, b, _, c, d, e, _, f = matrix[:8]
        notes = ("The tilt of heights in the transformation matrix is not used.",)
        return (a, b, c, d, e, f), notes[: bool(matrix[8] or matrix[9])]
    if len(tie) >= 12:
        return None, (f"Positions of {len(tie) // 6} tie points are not used; {UPRIGHT}.",)
    return None, ()


def _linear_unit(keys: Mapping[int, float]) -> tuple[float, tuple[str, ...]]:
    code = int(keys.get(_LINEAR_UNITS, 9001))
    unit_m = keys.get(_LINEAR_UNIT_SIZE) if code == _USER_DEFINED else _UNITS_M.get(code)
    if unit_m is not None and unit_m > 0:
        return unit_m, ()
    note = f"The unit of positions, EPSG {code}, is unknown: metres are assumed (--cell-size-m)."
    return 1.0, (note,)


def _heights(
    keys: Mapping[int, float], tags: Mapping[int, Any], unit_m: float
) -> tuple[float, float, float, tuple[str, ...]]:
    """Return metres of a unit of height, scale and offset of stored values, and notes."""
    items = _gdal_items(tags)
    scale, offset, notes = items.get("scale", 1.0), items.get("offset", 0.0), tuple[str, ...]()
    pixel_scale, tie = _numbers(tags, _PIXEL_SCALE), _numbers(tags, _TIEPOINT)
    if len(pixel_scale) == 3 and pixel_scale[2] not in (0, 1) and "scale" not in items:
        if _VERTICAL_CRS in keys and len(tie) >= 6:
            scale, offset = pixel_scale[2], tie[5] - tie[2] * pixel_scale[2]
        else:
            notes += (
                f"ScaleZ {pixel_scale[2]:g} is not used, as no vertical reference is given (--height-scale).",
            )
    code, vertical_m = keys.get(_VERTICAL_UNITS), 1.0
    if code is not None:
        vertical_m = _UNITS_M.get(int(code), 0.0)
        if not vertical_m:
            vertical_m = 1.0
            notes += (
                f"The unit of heights, EPSG {code:g}, is unknown: metres are assumed (--height-scale).",
            )
    elif items.get("unittype"):
        vertical_m, unit_notes = unit_of(str(items["unittype"]), "heights")
        notes += unit_notes
    elif unit_m != 1:
        notes += (
            f"Positions have a unit of {unit_m:.6g} m; that of heights is not given: metres are assumed "
            "(--height-scale).",
        )
    return vertical_m, float(scale), float(offset), notes


def _gdal_items(tags: Mapping[int, Any]) -> dict[str, Any]:
    """Return scale, offset and unit type of the first band from GDAL's metadata."""
    items: dict[str, Any] = {}
    for head, text in _ITEM.findall(str(tags.get(_GDAL_METADATA, ""))):
        attributes: dict[str, str] = dict(_ATTRIBUTE.findall(head))
        role = (attributes.get("role") or attributes.get("name") or "").lower()
        if attributes.get("sample", "0") != "0":
            continue
        if role == "unittype":
            items[role] = text.strip()
        elif role in ("scale", "offset"):
            with suppress(ValueError):
                value = float(text)
                if math.isfinite(value) and not (role == "scale" and value == 0):
                    items[role] = value
    return items


def _nodata(tags: Mapping[int, Any]) -> tuple[float, ...]:
    with suppress(ValueError):
        return (float(str(tags.get(_GDAL_NODATA, "")).strip(" \0")),)
    return ()


def _numbers(tags: Mapping[int, Any], tag: int) -> list[float]:
    values = tags.get(tag, ())
    values = values if isinstance(values, tuple | list) else (values,)
    try:
        numbers = [float(v) for v in values]
    except (TypeError, ValueError, ZeroDivisionError):
        return []
    return numbers if all(map(math.isfinite, numbers)) else []


# -- files beside the picture ------------------------------------------------------------------------------
def read_world_file(path: Path) -> Affine | None:
    """Return the affine of a world file beside a picture (``.tfw``, ``.tifw``, ``.wld``), if there is one.

    Its six lines are A, D, B, E, C, F; C and F are the centre of the first pixel.
    """
    suffix = path.suffix.lower()
    for name in (f".{suffix[1]}{suffix[-1]}w", f"{suffix}w", ".wld"):
        beside = path.with_suffix(name)
        with suppress(OSError, ValueError):
            if beside.is_file() and beside.stat().st_size <= _WORLD_BYTES:
                a, d, b, e, c, f = map(float, beside.read_text("latin-1").split())
                if all(map(math.isfinite, (a, b, c, d, e, f))):
                    return a, b, c - (a + b) / 2, d, e, f - (d + e) / 2
    return None


def _auxiliary_notes(path: Path) -> tuple[str, ...]:
    """Return a note on the geometry in an ``.aux.xml`` of GDAL beside the picture."""
    beside = path.with_name(path.name + ".aux.xml")
    with suppress(OSError):
        if beside.is_file():
            with beside.open("rb") as stream:
                names = sorted({n.decode() for n in _AUXILIARY.findall(stream.read(_AUXILIARY_BYTES))})
            if names:
                mend = f"gdal_translate {path.name} NEW.tif writes it into the picture"
                return (f"{beside.name} is not used ({', '.join(names)}); {mend}.",)
    return ()
