"""Makes maps and drawings, and writes Braille without liblouis for the tests that are not about it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

INPUTS: Final = Path(__file__).parent / "maps" / "inputs"
FIRST_DECADE: Final = (1, 12, 14, 145, 15, 124, 1245, 125, 24, 245)
"""Dots of a to j; k to t add dot 3, and u to z dots 3 and 6, but for w."""


def letter_cell(letter: str) -> int:
    """Dots of a letter from a to z in the Braille of Louis Braille: bit n is dot n + 1."""
    order = "abcdefghijklmnopqrstuvxyz"
    if letter == "w":
        digits = "2456"
    else:
        decade, place = divmod(order.index(letter), 10)
        digits = f"{FIRST_DECADE[place]}{('', '3', '36')[decade]}"
    return sum(1 << int(digit) - 1 for digit in digits)


class LetterBraille:
    """Letters from a to z by their cells; everything else is an empty cell."""

    def __init__(self) -> None:
        self.table, self.unknown = "letters", set[str]()

    def cells(self, text: str) -> tuple[int, ...]:
        return tuple(letter_cell(c) if "a" <= c <= "z" else 0 for c in text.lower())


def feature(kind: str, coordinates: Sequence[Any], **properties: str) -> dict[str, Any]:
    """A feature of GeoJSON."""
    geometry = {"type": kind, "coordinates": coordinates}
    return {"type": "Feature", "properties": properties, "geometry": geometry}


def write_geojson(path: Path, *features: dict[str, Any], **members: Any) -> Path:
    document = {"type": "FeatureCollection", **members, "features": list(features)}
    path.write_text(json.dumps(document))
    return path


def street(x_0: float, y_0: float, x_1: float, y_1: float, **tags: str) -> dict[str, Any]:
    """A straight line with a vertex in its middle, where others may join it."""
    return feature("LineString", [[x_0, y_0], [(x_0 + x_1) / 2, (y_0 + y_1) / 2], [x_1, y_1]], **tags)


def block(west: float, south: float, east: float, north: float, **tags: str) -> dict[str, Any]:
    """A rectangle."""
    ring = [[west, south], [east, south], [east, north], [west, north], [west, south]]
    return feature("Polygon", [ring], **tags)


def town() -> list[dict[str, Any]]:
    """Two streets that cross, a path, a house, a pond in a park, and a bus stop, of some 150 m."""
    return [
        street(0, 0.0005, 0.0014, 0.0005, highway="primary", name="High Street"),
        street(0.0007, 0, 0.0007, 0.001, highway="residential", name="Mill Lane"),
        street(0, 0.00015, 0.0015, 0.0002, highway="footway"),
        block(0.0001, 0.0006, 0.0004, 0.0008, building="yes", name="Town Hall"),
        block(0.0009, 0.0006, 0.0014, 0.001, leisure="park", name="Green Park"),
        block(0.0011, 0.0007, 0.0013, 0.0009, natural="water"),
        feature("Point", [0.0012, 0.00048], highway="bus_stop", name="Mill"),
    ]
