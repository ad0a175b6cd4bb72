"""Finds the reader of a map by the ending of its file, and cuts out what is requested."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from touchfield.arrays import Float64s
from touchfield.errors import InvalidArgument, SourceError, require_one_of
from touchfield.maps.features import EARTH_RADIUS_M, MapSource, levels_of
from touchfield.maps.geojson import read_geojson
from touchfield.maps.osm import read_osm
from touchfield.maps.svg import read_svg

READERS: Final[dict[str, Callable[[Path], MapSource]]] = {
    ".geojson": read_geojson, ".json": read_geojson, ".osm": read_osm, ".pbf": read_osm, ".svg": read_svg,
}  # fmt: skip
"""Reader of each ending."""
SAMPLES: Final = {"park": "nelson_square.geojson"}
"""Files of `touchfield.maps.samples`, by name."""


def read_map(path: str | Path) -> MapSource:
    """Read the features of a map or a drawing, or of a sample, ``sample:park``.

    Raises `InvalidArgument` for an unknown ending, `MissingExtra` if the reader's library is not installed,
    and `SourceError` for a file that cannot be read or goes beyond the limits.
    """
    name = str(path).removeprefix("sample:")
    if name != str(path):
        require_one_of("sample", name, SAMPLES)
        path = Path(__file__).with_name("samples") / SAMPLES[name]
    reader = READERS.get(Path(path).suffix.lower())
    if reader is None:
        expected = f"a map or a drawing: {', '.join(READERS)}"
        hint = f"Convert it first: ogr2ogr OUT.geojson {Path(path).name}." if Path(path).is_file() else ""
        raise InvalidArgument(str(path), f"the ending {Path(path).suffix!r}", expected, hint)
    return reader(Path(path))


def on_level(source: MapSource, level: str) -> MapSource:
    """Return the features of a floor, and those that state none.

    Raises `SourceError` that lists the floors if no feature states this one.
    """
    stated = [levels_of(feature.level) for feature in source.features]
    if not any(level in levels for levels in stated):
        known = sorted(set().union(*stated))[:20]
        found = f"floors {', '.join(known)}" if known else "no feature that states a floor"
        raise SourceError(f"level {level}", found, "a floor of the map")
    features = zip(source.features, stated)
    return replace(source, features=tuple(f for f, levels in features if not levels or level in levels))


def box_of(source: MapSource, box: tuple[float, float, float, float] | None) -> tuple[Float64s, Float64s]:
    """Return the corners of what is drawn, in the coordinates of the features.

    `box` is west, south, east, north in degrees, or left, top, right, bottom in the drawing's unit; None is
    the box that the file states, or else of all features. Raises `InvalidArgument` if it has no extent or
    nothing lies in it.
    """
    points = [part for feature in source.features for part in feature.parts]
    lows = np.array([part.min(axis=0) for part in points])
    highs = np.array([part.max(axis=0) for part in points])
    box = source.box_deg if box is None else box
    if box is None:
        return lows.min(axis=0), highs.max(axis=0)
    low, high = _corners(source, box)
    if not (np.isfinite([low, high]).all() and (high > low).all()):
        raise InvalidArgument("box", ",".join(f"{v:g}" for v in box), "two corners, the lower one first")
    if not ((lows <= high) & (highs >= low)).all(axis=1).any():
        whole = ", ".join(f"{v:.7g}" for v in _degrees(source, lows.min(axis=0), highs.max(axis=0)))
        raise InvalidArgument("box", "nothing in it", f"a part of the map, which is {whole}")
    return low, high


def _corners(source: MapSource, box: tuple[float, float, float, float]) -> tuple[Float64s, Float64s]:
    if source.origin_deg is None:
        left, top, right, bottom = box
        return np.array([left, -bottom]), np.array([right, -top])
    scale = metres_of_degree(source.origin_deg[1])
    corners = (np.array(box).reshape(2, 2) - source.origin_deg) * scale
    return corners[0], corners[1]


def metres_of_degree(latitude_deg: float) -> Float64s:
    """Return the metres of a degree of longitude and of latitude on the plane of a map, float64 [2]."""
    degree_m = float(np.radians(EARTH_RADIUS_M))
    return np.array([degree_m * np.cos(np.radians(latitude_deg)), degree_m])


def _degrees(source: MapSource, low: Float64s, high: Float64s) -> list[float]:
    """Return a box as an option states it."""
    if source.origin_deg is None:
        return [float(v) for v in (low[0], -high[1], high[0], -low[1])]
    scale = metres_of_degree(source.origin_deg[1])
    return [float(v) for corner in (low, high) for v in corner / scale + source.origin_deg]
