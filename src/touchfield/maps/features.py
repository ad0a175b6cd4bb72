"""`Feature` and `MapSource`: what the readers of maps and drawings return, and the limits of their inputs.

Coordinates are float64 [n, 2], x right and y up: metres of a local plane for maps, the file's own unit for
drawings.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from touchfield.arrays import Float64s
from touchfield.errors import SourceError

MAX_FEATURES: Final = 1 << 17
MAX_POINTS: Final = 1 << 20
MAX_NAME_LETTERS: Final = 80
MAX_LATITUDE_DEG: Final = 85.0
"""Beyond it a plane with the scale of its middle is no map of the land."""
MAX_EXTENT_DEG: Final = 20.0
EARTH_RADIUS_M: Final = 6371008.8
"""Mean radius of the earth, WGS 84."""


@dataclass(frozen=True)
class Feature:
    """A feature of a map.

    kind : str; Its class, a name in `touchfield.maps.symbols`; "text" for a word of a drawing, which has no
        symbol.
    shape : str; "line", "area" or "point".
    parts : tuple of float64 [n, 2]; The rings of an area, of which points inside an odd number belong to it;
        the lines, or the points.
    name : str; "" if it has none.
    level : str; The floors that it states, "" if none.
    """

    kind: str
    shape: str
    parts: tuple[Float64s, ...]
    name: str = ""
    level: str = ""


@dataclass(frozen=True)
class MapSource:
    """The features of a file.

    unit_m : float or None; Metres of a unit of the coordinates; None for a drawing.
    origin_deg : (float, float); Longitude and latitude of the coordinates' origin; of a map only.
    notes : tuple of str; What was found and not read.
    attribution : str; What the licence of the data requires, "" if nothing is known.
    box_deg : four floats or None; West, south, east and north of the extract, where the file states it.
    title : str; "" if the file states none.
    """

    features: tuple[Feature, ...]
    unit_m: float | None = None
    origin_deg: tuple[float, float] | None = None
    notes: tuple[str, ...] = ()
    attribution: str = ""
    box_deg: tuple[float, float, float, float] | None = None
    title: str = ""


@dataclass
class Collector:
    """Collects the features of a file, and counts points and what is left out.

    Raises `SourceError` from `add` if there are more than the limits.
    """

    where: str
    features: list[Feature] = field(default_factory=list)
    left_out: Counter[str] = field(default_factory=Counter)
    point_count: int = 0

    def add(
        self,
        kind: str,
        shape: str,
        parts: Iterable[Sequence[Any] | Float64s],
        name: str = "",
        level: str = "",
    ) -> None:
        """Add a feature; parts that are too short for its shape, or not finite, are counted as left out."""
        min_points = {"point": 1, "line": 2, "area": 3}[shape]
        arrays = []
        for part in parts:
            array = np.asarray(part, np.float64).reshape(-1, 2)
            self._count(len(array))
            if len(array) < min_points or not np.isfinite(array).all():
                self.left_out[f"{shape}s without {min_points} finite points"] += 1
            else:
                arrays.append(array)
        if arrays:
            if len(self.features) >= MAX_FEATURES:
                raise SourceError(self.where, f"more than {MAX_FEATURES} features", "up to that", _HINT)
            self.features.append(Feature(kind, shape, tuple(arrays), clean_name(name), level[:40]))

    def _count(self, points: int) -> None:
        self.point_count += points
        if self.point_count > MAX_POINTS:
            raise SourceError(self.where, f"more than {MAX_POINTS} points", "up to that", _HINT)

    def notes(self) -> tuple[str, ...]:
        """Return a note for each kind of thing that was left out."""
        return tuple(f"Left out: {count} {what}." for what, count in self.left_out.most_common(12))


_HINT: Final = "Cut out a smaller area first."
_IN_METRES: Final = (
    "If they are metres, state their system: ogr2ogr -s_srs EPSG:3857 -t_srs EPSG:4326 OUT.geojson IN."
)


def clean_name(text: str) -> str:
    """Return a name on one line without control characters, of at most `MAX_NAME_LETTERS`."""
    line = " ".join("".join(c if c.isprintable() else " " for c in text).split())
    return line if len(line) <= MAX_NAME_LETTERS else line[: MAX_NAME_LETTERS - 1].rstrip() + "…"


def on_plane(source: Collector, where: str) -> tuple[tuple[Feature, ...], tuple[float, float]]:
    """Convert features in degrees to metres around the middle of their box; returns also that middle.

    The plane is equirectangular, true to scale along its middle parallel: over a town its error is less than
    a pin. Raises `SourceError` for coordinates that are no degrees, or too far apart.
    """
    points = [part for feature in source.features for part in feature.parts]
    low = np.min([part.min(axis=0) for part in points], axis=0)
    high = np.max([part.max(axis=0) for part in points], axis=0)
    is_degrees = (np.abs([low[0], high[0]]) <= 180).all() and (np.abs([low[1], high[1]]) <= 90).all()
    found = f"longitudes {low[0]:.9g} to {high[0]:.9g} and latitudes {low[1]:.9g} to {high[1]:.9g}"
    if not is_degrees:
        raise SourceError(where, found, "longitude, then latitude, in degrees (WGS 84)", _IN_METRES)
    if np.max(np.abs([low[1], high[1]])) > MAX_LATITUDE_DEG or np.max(high - low) > MAX_EXTENT_DEG:
        expected = f"up to {MAX_EXTENT_DEG:g} degrees, within {MAX_LATITUDE_DEG:g} of the equator"
        raise SourceError(where, found, expected, _HINT)
    longitude, latitude = (float(value) for value in (low + high) / 2)
    scale = EARTH_RADIUS_M * np.radians([math.cos(math.radians(latitude)), 1.0])
    features = tuple(
        Feature(f.kind, f.shape, tuple((p - (longitude, latitude)) * scale for p in f.parts), f.name, f.level)
        for f in source.features
    )
    return features, (longitude, latitude)


def require_features(source: Collector, expected: str) -> None:
    """Raise `SourceError` with what was left out if nothing was read."""
    if not source.features:
        found = "nothing that can be drawn"
        if source.left_out:
            found += f" ({', '.join(f'{n} {what}' for what, n in source.left_out.most_common(3))})"
        raise SourceError(source.where, found, expected)


def levels_of(text: str) -> set[str]:
    """Return the floors of a tag such as ``0;1`` or ``0-2``."""
    levels: set[str] = set()
    for word in text.split(";"):
        first, dash, last = word.strip().rpartition("-")
        is_range = dash and _is_whole(first) and _is_whole(last) and 0 <= int(last) - int(first) <= 200
        levels.update(map(str, range(int(first), int(last) + 1)) if is_range else [word.strip()])
    return levels - {""}


def _is_whole(text: str) -> bool:
    digits = text.removeprefix("-")
    return digits.isascii() and digits.isdigit() and len(digits) < 5
