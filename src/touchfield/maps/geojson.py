"""Reads GeoJSON (RFC 7946): a feature's class follows from its properties, which are read as the tags of
OpenStreetMap, or from a property ``class`` or ``kind``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from touchfield.errors import SourceError
from touchfield.json_values import JsonValue, read_json
from touchfield.maps.features import Collector, MapSource, on_plane, require_features
from touchfield.maps.symbols import class_of_tags

MAX_BYTES: Final = 1 << 25
MAX_DEPTH: Final = 8
"""Of collections within collections."""
MAX_TEXT_LETTERS: Final = 200
"""Of a title and of an attribution."""
_EXPECTED: Final = "a GeoJSON file"
_SHAPES: Final = {
    "Point": ("point", 0), "MultiPoint": ("point", 1), "LineString": ("line", 1),
    "MultiLineString": ("line", 2), "Polygon": ("area", 2), "MultiPolygon": ("area", 3),
}  # fmt: skip
"""Shape of each type of geometry, and how deep the arrays around its points are."""
_WGS84: Final = ("CRS84", "4326")


def read_geojson(path: Path) -> MapSource:
    """Read the features of a file.

    Of the collection, ``bbox``, ``name`` (the title) and ``attribution`` or ``copyright`` are read, too.
    Raises `SourceError` that names the location if it is no GeoJSON, has other coordinates than degrees, or
    more features or points than `touchfield.maps.features` allows.
    """
    document = read_json(path, MAX_BYTES, _EXPECTED)
    _require_degrees(document)
    found = Collector(str(path))
    for properties, geometry in _geometries(found, document, {}, 0):
        _add(found, properties, geometry)
    require_features(found, "features with tags such as highway, building or natural, or a property class")
    features, origin = on_plane(found, str(path))
    members = document.members()
    return MapSource(
        features, 1.0, origin, found.notes(), _text(members, "attribution", "copyright"), _box(document),
        _text(members, "name"),
    )  # fmt: skip


def _text(members: Mapping[str, Any], *keys: str) -> str:
    """Return the first of these members that is a text; "" without one."""
    texts = (members.get(key) for key in keys)
    return next((text[:MAX_TEXT_LETTERS] for text in texts if isinstance(text, str)), "")


def _box(document: JsonValue) -> tuple[float, float, float, float] | None:
    """Return west, south, east and north of a member ``bbox`` of two dimensions; None without one."""
    values = document.members().get("bbox")
    if not isinstance(values, list) or len(values) != 4 or not all(map(_is_number, values)):
        return None
    west, south, east, north = map(float, values)
    return (west, south, east, north) if west < east and south < north else None


def _require_degrees(document: JsonValue) -> None:
    """Raise for a member ``crs`` of the older GeoJSON of 2008 that names another system than WGS 84."""
    crs = document.get("crs")
    if crs is None or crs.value is None:
        return
    name = crs.at("properties", {}).at("name", "").text()
    if not any(word in name for word in _WGS84):
        hint = "Convert it first: ogr2ogr -t_srs EPSG:4326 OUT.geojson IN."
        raise crs.wrong(f"the coordinate system {name[:60]!r}", "none (RFC 7946: WGS 84)", hint)


def _geometries(
    found: Collector, value: JsonValue, properties: dict[str, str], depth: int
) -> Iterator[tuple[dict[str, str], JsonValue]]:
    """Yield each plain geometry below a value with the tags of its feature; count features without one."""
    if depth > MAX_DEPTH:
        raise value.wrong("collections within collections", f"at most {MAX_DEPTH} deep")
    kind = value.at("type").text()
    if kind == "FeatureCollection":
        for feature in value.at("features").elements():
            yield from _geometries(found, feature, {}, depth + 1)
    elif kind == "Feature":
        geometry = value.at("geometry", None)
        if geometry.value is None:
            found.left_out["features without a geometry"] += 1
        else:
            yield from _geometries(found, geometry, _tags(value.at("properties", None)), depth + 1)
    elif kind == "GeometryCollection":
        for geometry in value.at("geometries").elements():
            yield from _geometries(found, geometry, properties, depth + 1)
    elif kind in _SHAPES:
        yield properties, value
    else:
        raise value.at("type").refused("a type of GeoJSON")


def _tags(properties: JsonValue) -> dict[str, str]:
    """Return the texts and numbers of a feature's properties, and of their member ``tags``."""
    if properties.value is None:
        return {}
    members = properties.members()
    inner = members.get("tags")
    every = {**members, **(inner if isinstance(inner, dict) else {})}
    return {
        key: str(value)
        for key, value in every.items()
        if isinstance(value, str | int | float) and not isinstance(value, bool) and len(str(value)) < 1000
    }


def _add(found: Collector, tags: dict[str, str], geometry: JsonValue) -> None:
    shape, depth = _SHAPES[geometry.at("type").text()]
    kind = class_of_tags(tags, shape)
    if kind is None:
        found.left_out[f"{shape}s without a known tag"] += 1
        return
    name, level = tags.get("name", ""), tags.get("level", "")
    parts = [_points(part) for part in _arrays(geometry.at("coordinates"), depth)]
    if shape == "point":
        for x_y in (point for part in parts for point in part):
            found.add(kind, shape, [[x_y]], name, level)
    else:
        found.add(kind, shape, parts, name, level)


def _arrays(value: JsonValue, depth: int) -> Iterator[JsonValue]:
    """Yield the arrays of points below a value."""
    if depth <= 1:
        yield JsonValue([value.value], value.file, value.location) if depth == 0 else value
        return
    for element in value.elements():
        yield from _arrays(element, depth - 1)


def _points(part: JsonValue) -> list[tuple[float, float]]:
    points: list[tuple[float, float]] = []
    for position in part.items():
        x_y = position[:2] if isinstance(position, list) else None
        if not x_y or len(x_y) < 2 or not all(_is_number(value) for value in x_y):
            raise _not_a_position(part, position, len(points))
        points.append((float(x_y[0]), float(x_y[1])))
    return points


def _is_number(value: Any) -> bool:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return is_number and abs(value) < 1e300


def _not_a_position(part: JsonValue, position: Any, index: int) -> SourceError:
    where = JsonValue(position, part.file, f"{part.location}[{index}]")
    return where.refused("a position, [longitude, latitude]")
