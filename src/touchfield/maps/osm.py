"""Reads extracts of OpenStreetMap, ``.osm`` (XML) and ``.osm.pbf``, with pyosmium (extra ``map``).

Areas are those that the library assembles from closed ways and from relations of the type multipolygon."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from touchfield.errors import SourceError, import_extra
from touchfield.files import library_faults, plain_size, readable
from touchfield.maps.features import Collector, MapSource, on_plane, require_features
from touchfield.maps.symbols import class_of_tags

MAX_BYTES: Final = 1 << 26
MAX_OBJECTS: Final = 1 << 22
"""Nodes, ways, relations and areas; an extract of a town has some 10^5."""
ATTRIBUTION: Final = "© OpenStreetMap contributors, openstreetmap.org/copyright (ODbL 1.0)"
_EXPECTED: Final = "an extract of OpenStreetMap"


def read_osm(path: Path) -> MapSource:
    """Read the features of an extract.

    Raises `MissingExtra` without pyosmium; `SourceError` if the file cannot be read, or has more than
    `MAX_OBJECTS` objects or than `touchfield.maps.features` allows.
    """
    osmium = import_extra("osmium", f"reading {path.name}", "osmium", "map")
    with readable(path, _EXPECTED):
        size = plain_size(path, _EXPECTED)
    if size > MAX_BYTES:
        raise SourceError(str(path), f"more than {MAX_BYTES} bytes", f"{_EXPECTED} up to that", _HINT)
    found = Collector(str(path))
    with library_faults(path, "what pyosmium does not read", _EXPECTED):
        objects = osmium.FileProcessor(str(path)).with_locations().with_areas()
        for count, item in enumerate(objects):
            if count >= MAX_OBJECTS:
                raise SourceError(str(path), f"more than {MAX_OBJECTS} objects", "up to that", _HINT)
            _add(found, item)
    require_features(found, "roads, paths, buildings, water or parks")
    features, origin = on_plane(found, str(path))
    return MapSource(features, 1.0, origin, found.notes(), ATTRIBUTION, _box(objects.header.box()))


def _box(box: Any) -> tuple[float, float, float, float] | None:
    """Return the box of an extract; its ways go beyond it."""
    if not box.valid():
        return None
    low, high = box.bottom_left, box.top_right
    return low.lon, low.lat, high.lon, high.lat


_HINT: Final = "Cut out a smaller area first: osmium extract -b WEST,SOUTH,EAST,NORTH IN -o OUT."


def _add(found: Collector, item: Any) -> None:
    if not len(item.tags):
        return
    shape = "point" if item.is_node() else "line" if item.is_way() else "area" if item.is_area() else ""
    if not shape:
        return
    tags = {tag.k: tag.v for tag in item.tags}
    kind = class_of_tags(tags, shape)
    if kind is None:
        if shape == "line" and not item.is_closed():
            found.left_out["lines without a known tag"] += 1
        elif shape == "area" and class_of_tags(tags, "line") is None:
            found.left_out["areas without a known tag"] += 1
        return
    if shape == "line" and item.is_closed() and tags.get("area") == "yes":
        return
    if shape == "area" and class_of_tags(tags, "line") is not None and tags.get("area") != "yes":
        return  # a closed way of a line's class, such as a roundabout
    found.add(kind, shape, _parts(found, item, shape), tags.get("name", ""), tags.get("level", ""))


def _parts(found: Collector, item: Any, shape: str) -> list[list[tuple[float, float]]]:
    if shape == "point":
        return [[(item.lon, item.lat)]]
    if shape == "line":
        return [_points(found, item.nodes)]
    return [
        _points(found, ring) for outer in item.outer_rings() for ring in (outer, *item.inner_rings(outer))
    ]


def _points(found: Collector, nodes: Any) -> list[tuple[float, float]]:
    """Return longitudes and latitudes; nodes outside the extract have none."""
    points = [(node.lon, node.lat) for node in nodes if node.location.valid()]
    if len(points) < len(nodes):
        found.left_out["points of ways that lie outside the extract"] += len(nodes) - len(points)
    return points
