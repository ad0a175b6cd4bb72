"""The optional record TMAP: zoom levels of a tactile map, its views, and the index of its named features.

A file with this record is a medium of one frame for every reader. A reader that knows the record can also
pan, zoom and find names (docs/format/maps.md). Views are compressed one by one and expanded when they are
shown, so a small file requires the memory of one view.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from typing import Final

import numpy as np

from touchfield.arrays import Bools, Int32s
from touchfield.container.fields import NAME, Array, Cursor, Listed, Octets, Real, Rest, Text, Whole
from touchfield.container.records import Struct, row
from touchfield.errors import CorruptFile, InvalidArgument, UnsupportedVersion

TAG: Final = "TMAP"
VERSION: Final = 1
MAX_LEVELS: Final = 8
MAX_VIEWS: Final = 4096
MAX_NAMES: Final = 1 << 16
MAX_PINS: Final = 1 << 14
MAX_SYMBOLS: Final = 4096
"""In a view."""
MAX_SYMBOL_NAMES: Final = 64
"""Of a symbol, such as a network of streets; the others are in the index only."""
MAX_SYMBOLS_BYTES: Final = 1 << 18
"""Of the symbols of a view, expanded."""
MAX_RECORD_BYTES: Final = 1 << 26
ROLES: Final = ("line", "area", "point", "label")
"""Roles of a symbol by their numbers."""
_UP: Final = 1 << 15
_SIDE: Final = Whole("u16", 1, 1024)
_POSITION: Final = Real(-1e9, 1e9)
_NAME_INDEX: Final = Whole("u32", 0, MAX_NAMES - 1)
_KIND_INDEX: Final = Whole("u16", 0, 255)
MAP_LEFT_OUT: Final = "the zoom levels and names of the map are left out"
"""Note of what writes the frame of a map alone."""
_MEND: Final = "Make the map again: touchfield map."


@dataclass(frozen=True, kw_only=True)
class MapKind:
    """A class of features."""

    name: str = row(Text(32, NAME, min_bytes=1), "Its name in every language, such as `road`.")
    title: str = row(Text(64), "Its name in the language of the map.")
    cells: bytes = row(Octets(256), "Braille of the title: a byte for each cell, bit n is dot n + 1.")


@dataclass(frozen=True, kw_only=True)
class MapName:
    """A name of one or more features."""

    text: str = row(Text(512, min_bytes=1), "The name.")
    cells: bytes = row(Octets(256), "Its Braille; empty if the map has none.")


@dataclass(frozen=True, kw_only=True)
class MapPlace:
    """A named feature, or several of one class and name, such as the parts of a street."""

    name: int = row(_NAME_INDEX, "Index of its name.")
    kind: int = row(_KIND_INDEX, "Index of its class.")
    first_level: int = row(
        Whole("u8", 0, MAX_LEVELS), "First level on which it is drawn; the number of levels if on none."
    )
    box: tuple[float, float, float, float] = row(Array(_POSITION, 4), "West, south, east, north.")


@dataclass(frozen=True, kw_only=True)
class MapLevel:
    """A zoom level: a grid of views of one scale."""

    pin_step: float = row(Real(1e-9, 1e9), "Distance of neighbouring pins, in units of the map.")
    west: float = row(_POSITION, "x of column 0 of the first view.")
    north: float = row(_POSITION, "y of row 0 of the first view.")
    pan_rows: int = row(_SIDE, "Pins from a view to the next one below.")
    pan_columns: int = row(_SIDE, "Pins from a view to the next one on the right.")
    view_rows: int = row(Whole("u16", 1, MAX_VIEWS), "Views from north to south.")
    view_columns: int = row(Whole("u16", 1, MAX_VIEWS), "Views from west to east.")


@dataclass(frozen=True, kw_only=True)
class TactileMap:
    """Levels, views and index of a map."""

    version: int = row(Whole("u8", 1, 255), "1; a reader passes over a record of any other version.")
    title: str = row(Text(256), "Name of the map, for people.")
    attribution: str = row(Text(256), "What the licence of the data requires; may be empty.")
    language: str = row(
        Text(64), "Language of the titles and the Braille, such as `de`; empty without Braille."
    )
    is_drawing: int = row(
        Whole("u8", 0, 1), "0: the unit is a metre, x east, y north. 1: the unit is that of a drawing, y up."
    )
    origin_deg: tuple[float, float] = row(
        Array(Real(-180, 180), 2), "Longitude and latitude of (0, 0); 0, 0 of a drawing.", "degrees"
    )
    rows: int = row(_SIDE, "Rows of pins of each view.")
    columns: int = row(_SIDE, f"Columns of pins of each view; at most {MAX_PINS} pins.")
    pitch_mm: float = row(Real(0.1, 100), "Distance of neighbouring pins on the display.", "mm")
    kinds: tuple[MapKind, ...] = row(Listed(Struct(MapKind), 256), "Classes that occur.")
    names: tuple[MapName, ...] = row(Listed(Struct(MapName), MAX_NAMES, "u32"), "All names, each once.")
    places: tuple[MapPlace, ...] = row(Listed(Struct(MapPlace), MAX_NAMES, "u32"), "The index.")
    levels: tuple[MapLevel, ...] = row(
        Listed(Struct(MapLevel), MAX_LEVELS), "At least one; the first shows the whole map in one view."
    )
    views: tuple[bytes, ...] = row(
        Listed(Octets(1 << 20), MAX_VIEWS, "u32"),
        "Views of level after level, each from north to south, and from west to east.",
    )


@dataclass(frozen=True, kw_only=True)
class ViewSymbol:
    """A symbol in a view."""

    role: int = row(Whole("u8", 0, 3), "0 line, 1 area, 2 point, 3 Braille label.")
    kind: int = row(_KIND_INDEX, "Index of its class; of a label the class of what it names.")
    names: tuple[int, ...] = row(
        Listed(_NAME_INDEX, MAX_SYMBOL_NAMES), "Names of what it shows; one of a label."
    )
    text: str = row(Text(512), "Of a label, what it says: the name or a key of two letters. Else empty.")
    cells: bytes = row(Octets(64), "Of a label, its Braille. Else empty.")


@dataclass(frozen=True, kw_only=True)
class ViewBody:
    """A view, expanded."""

    symbols: tuple[ViewSymbol, ...] = row(Listed(Struct(ViewSymbol), MAX_SYMBOLS), "Its symbols.")
    pins: bytes = row(
        Rest(), "rows × columns × u16: bit 15 is 1 if the pin is up; the other bits are 0, or 1 + its symbol."
    )


LAYOUTS: Final = (TactileMap, MapKind, MapName, MapPlace, MapLevel, ViewBody, ViewSymbol)
_RECORD: Final = Struct(TactileMap)
_VIEW: Final = Struct(ViewBody)


def encode_map(value: TactileMap) -> bytes:
    """Return the payload of TMAP; raises `InvalidArgument` for a value out of bounds."""
    payload = _RECORD.encode(value, TAG)
    if len(payload) > MAX_RECORD_BYTES:
        found = f"{len(payload)} bytes of views and names"
        raise InvalidArgument("map", found, f"at most {MAX_RECORD_BYTES}", "Make fewer zoom levels: --zooms.")
    try:
        _check(value, "map")
    except CorruptFile as error:
        raise InvalidArgument("map", str(error), "a consistent map") from None
    return payload


def decode_map(payload: bytes, where: str) -> TactileMap:
    """Return the value of a payload of TMAP; its views stay compressed.

    Raises `UnsupportedVersion` for a later version of the record, and `CorruptFile`.
    """
    if payload[:1] and payload[0] > VERSION:
        expected = f"version {VERSION}"
        raise UnsupportedVersion(where, f"a map of version {payload[0]}", expected, "Use a later touchfield.")
    cursor = Cursor(payload, where)
    value: TactileMap = _RECORD.decode(cursor, TAG)
    if cursor.remaining:
        raise cursor.corrupt(TAG, f"{cursor.remaining} bytes after the last field", "none")
    _check(value, where)
    return value


def _check(value: TactileMap, where: str) -> None:
    """Check what concerns several fields."""
    views = sum(level.view_rows * level.view_columns for level in value.levels)
    names, kinds = len(value.names), len(value.kinds)
    faults = (
        (value.rows * value.columns > MAX_PINS, f"{value.rows} x {value.columns} pins", f"up to {MAX_PINS}"),
        (not value.levels, "no levels", "at least one"),
        (views != len(value.views), f"{len(value.views)} views", f"{views}, as the levels say"),
        (
            any(place.name >= names or place.kind >= kinds for place in value.places),
            "a place whose name or class is not there", f"indices below {names} and {kinds}",
        ),
        (
            any(place.first_level > len(value.levels) for place in value.places),
            "a place on a level that is not there", f"up to {len(value.levels)}",
        ),
        (
            any(place.box[0] > place.box[2] or place.box[1] > place.box[3] for place in value.places),
            "a place whose box is reversed", "west, south, east, north",
        ),
    )  # fmt: skip
    for is_wrong, found, expected in faults:
        if is_wrong:
            raise CorruptFile(f"{where}: {TAG}", found, expected, _MEND)


# -- views -------------------------------------------------------------------------------------------------
def encode_view(symbols: tuple[ViewSymbol, ...], raised: Bools, owner: Int32s) -> bytes:
    """Return a compressed view.

    `raised` and `owner` are [rows, columns]; `owner` is the index of the symbol of a pin, -1 for none.
    """
    pins = (owner + 1).astype("<u2") | np.where(raised, np.uint16(_UP), np.uint16(0))
    body = ViewBody(symbols=symbols, pins=pins.astype("<u2").tobytes())
    return zlib.compress(_VIEW.encode(body, "view"), 9)


@dataclass(frozen=True)
class MapView:
    """A view of a map.

    raised : bool [rows, columns]; The pins that are up, row 0 at the top.
    owner : int32 [rows, columns]; Index of the symbol of a pin, -1 for none.
    symbols : tuple of ViewSymbol
    """

    raised: Bools
    owner: Int32s
    symbols: tuple[ViewSymbol, ...]


def decode_view(value: TactileMap, index: int, where: str) -> MapView:
    """Return view `index` of a map; raises `CorruptFile` if its bytes are no view."""
    place, pins = f"{where}: {TAG}.views[{index}]", value.rows * value.columns
    cursor = Cursor(_expanded(value.views[index], 2 * pins + MAX_SYMBOLS_BYTES, place), place)
    body: ViewBody = _VIEW.decode(cursor, "view")
    if len(body.pins) != 2 * pins:
        raise CorruptFile(place, f"{len(body.pins)} bytes of pins", str(2 * pins), _MEND)
    words = np.frombuffer(body.pins, "<u2").reshape(value.rows, value.columns)
    owner = (words & (_UP - 1)).astype(np.int32) - 1
    if owner.max() >= len(body.symbols):
        raise CorruptFile(place, f"a pin of symbol {owner.max()}", f"{len(body.symbols)} symbols", _MEND)
    for symbol in body.symbols:
        if symbol.kind >= len(value.kinds) or any(name >= len(value.names) for name in symbol.names):
            raise CorruptFile(place, "a symbol whose name or class is not there", "those of the map", _MEND)
        if symbol.role == ROLES.index("label") and not symbol.names:
            raise CorruptFile(place, "a label that names nothing", "one name", _MEND)
    return MapView(words >= _UP, owner, body.symbols)


def _expanded(data: bytes, limit: int, where: str) -> bytes:
    """Expand a zlib stream of at most `limit` bytes, without more memory than that."""
    expander = zlib.decompressobj()
    try:
        body = expander.decompress(data, limit + 1)
    except zlib.error as error:
        raise CorruptFile(where, str(error), "a zlib stream", _MEND) from None
    if len(body) > limit or not expander.eof or expander.unused_data:
        raise CorruptFile(where, "more or fewer bytes than a view has", f"at most {limit}", _MEND)
    return body
