"""Builds the record TMAP of a map: its views by level, and the index of its named features."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy import ndimage

from touchfield.arrays import Float64s, Int32s, Int64s
from touchfield.container.map_record import (
    MAX_NAMES,
    MAX_SYMBOL_NAMES,
    ROLES,
    VERSION,
    MapKind,
    MapLevel,
    MapName,
    MapPlace,
    TactileMap,
    ViewSymbol,
    encode_view,
)
from touchfield.maps.board import AROUND, FREE
from touchfield.maps.features import Feature, MapSource
from touchfield.maps.labels import Label, Translator
from touchfield.maps.layout import Drawn
from touchfield.maps.pins import Window
from touchfield.maps.symbols import symbols
from touchfield.maps.zooms import Level

MAX_CELLS: Final = 256
_Key = tuple[str, str]
"""Class and name."""


@dataclass(frozen=True)
class MapTexts:
    """Texts of a map.

    title : str; Its name.
    language : str; Language of the titles and of the Braille.
    classes : mapping of str to str; Title of each class.
    """

    title: str
    language: str
    classes: Mapping[str, str]


def map_record(
    read: MapSource,
    box: tuple[Float64s, Float64s],
    levels: Sequence[Level],
    texts: MapTexts,
    braille: Translator | None,
) -> tuple[TactileMap, tuple[str, ...]]:
    """Return the record of a map that was drawn, and notes on what the index leaves out.

    `box` is the part of the map that is shown.
    """
    tables, layout = _Tables(), levels[0].views[0].layout
    views = tuple(_view(drawn, tables) for level in levels for drawn in level.views)
    places, notes = _places(read, box, levels, tables)
    rows, columns = layout.raised.shape
    record = TactileMap(
        version=VERSION,
        title=_shortened(texts.title),
        attribution=_shortened(read.attribution),
        language=texts.language[:64] if braille else "",
        is_drawing=int(read.origin_deg is None),
        origin_deg=read.origin_deg or (0.0, 0.0),
        rows=rows,
        columns=columns,
        pitch_mm=layout.rules.pitch_mm,
        kinds=tuple(_kind(name, texts.classes, braille) for name in tables.kinds),
        names=tuple(MapName(text=text, cells=_cells(text, braille)) for text in tables.names),
        places=places,
        levels=tuple(_level(level) for level in levels),
        views=views,
    )
    return record, notes


class _Tables:
    """Classes and names by their index."""

    def __init__(self) -> None:
        self.kinds: dict[str, int] = {}
        self.names: dict[str, int] = {}

    def kind(self, name: str) -> int:
        return self.kinds.setdefault(name, len(self.kinds))

    def name(self, text: str) -> int:
        return self.names.setdefault(text, len(self.names))


def _shortened(text: str) -> str:
    """Return a text of at most 256 bytes without control characters."""
    plain = "".join(c if c.isprintable() else " " for c in text)
    return plain.encode("utf-8", "replace")[:256].decode("utf-8", "ignore")


def _kind(name: str, titles: Mapping[str, str], braille: Translator | None) -> MapKind:
    title = titles.get(name, name)
    return MapKind(name=name, title=title, cells=_cells(title, braille))


def _cells(text: str, braille: Translator | None) -> bytes:
    return b"" if braille is None else bytes(braille.cells(text)[:MAX_CELLS])


def _level(level: Level) -> MapLevel:
    grid = level.grid
    return MapLevel(
        pin_step=grid.first.step,
        west=grid.first.west,
        north=grid.first.north,
        pan_rows=grid.pan_rows,
        pan_columns=grid.pan_columns,
        view_rows=grid.view_rows,
        view_columns=grid.view_columns,
    )


# -- views -------------------------------------------------------------------------------------------------
def _view(drawn: Drawn, tables: _Tables) -> bytes:
    """Return a view, in which the pins of one symbol are told apart by the name of their feature."""
    layout, names = drawn.layout, _own_names(drawn)
    codes = (layout.owner.astype(np.int64) + 1) * (len(drawn.named) + 1) + names + 1
    found, index = np.unique(codes, return_inverse=True)
    owners, named = np.divmod(found, len(drawn.named) + 1)
    label_of = _labels_by_symbol(drawn)
    listed = []
    indices: tuple[int, ...]
    for owner, name in zip(owners.tolist(), named.tolist()):
        if owner - 1 in label_of:
            label = label_of[owner - 1]
            indices, kind, role = (tables.name(label.name),), label.kind, "label"
            text, cells = label.text, bytes(label.cells)
        else:
            kind, text = drawn.named[name - 1] if name else ("", "")
            indices = (tables.name(text),) if name else ()
            placed = layout.symbols[owner - 1] if owner else None
            kind, role = (placed.kind, placed.role) if placed else (kind, "area")
            text, cells = "", b""
        if owner or name:
            listed.append(
                ViewSymbol(
                    role=ROLES.index(role),
                    kind=tables.kind(kind),
                    names=indices[:MAX_SYMBOL_NAMES],
                    text=text,
                    cells=cells,
                )
            )
    has_empty = bool(len(found)) and found[0] == 0
    owner_of = index.reshape(layout.owner.shape).astype(np.int32) - int(has_empty)
    return encode_view(tuple(listed), layout.raised, owner_of)


def _labels_by_symbol(drawn: Drawn) -> dict[int, Label]:
    """Return the labels by the number of their symbol; both are in the same order."""
    numbers = (n for n, placed in enumerate(drawn.layout.symbols) if placed.role == "label")
    return dict(zip(numbers, drawn.labels, strict=True))


def _own_names(drawn: Drawn) -> Int64s:
    """Return the index of the name of each pin, `FREE` where its symbol shows another class.

    Within a room its name counts, though no pin of it is up.
    """
    layout, table = drawn.layout, symbols()
    is_named = np.zeros((len(layout.symbols) + 1, len(drawn.named) + 1), np.bool_)
    for n, (kind, _) in enumerate(drawn.named):
        shown_as = {kind, table[kind].widens} if kind in table else {kind}
        is_named[:-1, n] = [s.kind in shown_as and s.role != "label" for s in layout.symbols]
        is_named[-1, n] = kind in table and bool(table[kind].outline)
    keeps = is_named[layout.owner, drawn.name_at]
    return np.where(keeps, drawn.name_at, FREE).astype(np.int64)


# -- index -------------------------------------------------------------------------------------------------
def _places(
    read: MapSource, box: tuple[Float64s, Float64s], levels: Sequence[Level], tables: _Tables
) -> tuple[tuple[MapPlace, ...], tuple[str, ...]]:
    """Return the index, by the order of the file, and notes."""
    boxes = _boxes(read.features, box, levels[0])
    kept = boxes[:MAX_NAMES]
    first = _first_levels(kept, levels)
    places = tuple(
        MapPlace(
            name=tables.name(name),
            kind=tables.kind(kind),
            first_level=level,
            box=(float(low[0]), float(low[1]), float(high[0]), float(high[1])),
        )
        for ((kind, name), low, high), level in zip(kept, first)
    )
    if len(kept) == len(boxes):
        return places, ()
    return places, (f"{len(boxes) - len(kept)} names are not in the index, which has {MAX_NAMES}.",)


def _boxes(
    features: Sequence[Feature], box: tuple[Float64s, Float64s], level: Level
) -> list[tuple[_Key, Float64s, Float64s]]:
    """Return the boxes of the named features within a box, by the order of the file.

    Lines and areas of one class and name are one place where they are within a fingertip on `level`, the
    first one.
    """
    ends: dict[tuple[str, str, int], list[tuple[int, Float64s, Float64s]]] = {}
    for n, feature in enumerate(features):
        if not feature.name:
            continue
        low = np.min([part.min(axis=0) for part in feature.parts], axis=0)
        high = np.max([part.max(axis=0) for part in feature.parts], axis=0)
        if (low > box[1]).any() or (high < box[0]).any():
            continue
        key = (feature.kind, feature.name, n if feature.shape == "point" else -1)
        ends.setdefault(key, []).append((n, np.maximum(low, box[0]), np.minimum(high, box[1])))
    found = [
        (group[0][0], (kind, name), *_joined([low for _, low, _ in group], [high for _, _, high in group]))
        for (kind, name, _), members in ends.items()
        for group in _near_groups(members, level)
    ]
    return [(key, low, high) for _, key, low, high in sorted(found, key=lambda place: place[0])]


def _joined(lows: Sequence[Float64s], highs: Sequence[Float64s]) -> tuple[Float64s, Float64s]:
    return np.min(lows, axis=0), np.max(highs, axis=0)


def _near_groups(
    members: list[tuple[int, Float64s, Float64s]], level: Level
) -> list[list[tuple[int, Float64s, Float64s]]]:
    """Divide boxes into groups that are within a fingertip of each other on the pins of a level.

    On pins, because the time is then bounded however many boxes there are.
    """
    if len(members) == 1:
        return [members]
    window, reach = level.grid.first, level.views[0].layout.rules.displacement_pins / 2
    covered = np.zeros((window.rows, window.columns), np.bool_)
    corners = []
    for _, low, high in members:
        top, left = window.to_pins(np.array([[low[0], high[1]]]))[0] - reach
        bottom, right = window.to_pins(np.array([[high[0], low[1]]]))[0] + reach
        first = max(round(top), 0), max(round(left), 0)
        covered[first[0] : max(round(bottom), 0) + 1, first[1] : max(round(right), 0) + 1] = True
        corners.append((min(first[0], window.rows - 1), min(first[1], window.columns - 1)))
    part_of = ndimage.label(covered, AROUND)[0]
    groups: dict[int, list[tuple[int, Float64s, Float64s]]] = {}
    for corner, member in zip(corners, members):
        groups.setdefault(int(part_of[corner]), []).append(member)
    return list(groups.values())


def _first_levels(places: Sequence[tuple[_Key, Float64s, Float64s]], levels: Sequence[Level]) -> list[int]:
    """Return the first level on which each place is drawn; the number of levels if on none."""
    by_key: dict[_Key, list[int]] = {}
    for n, (key, _, _) in enumerate(places):
        by_key.setdefault(key, []).append(n)
    first = [len(levels)] * len(places)
    for zoom, level in reversed([*enumerate(levels)]):
        for window, drawn in zip(level.grid.windows(), level.views):
            names = _shown_names(drawn)
            for index in np.unique(names[names != FREE]):
                for n in by_key.get(drawn.named[index], ()):
                    if _meets(names == index, window, drawn, places[n][1], places[n][2]):
                        first[n] = zoom
    return first


def _shown_names(drawn: Drawn) -> Int32s:
    """Return the names of pins, those of the texts of a drawing where their labels stand."""
    names = _own_names(drawn).astype(np.int32)
    index = {key: n for n, key in enumerate(drawn.named)}
    for n, label in _labels_by_symbol(drawn).items():
        names[drawn.layout.owner == n] = index.get((label.kind, label.name), FREE)
    return names


def _meets(pins: np.ndarray, window: Window, drawn: Drawn, low: Float64s, high: Float64s) -> bool:
    """True if pins are within a fingertip of a box of the map."""
    rows, columns = np.nonzero(pins)
    margin = window.step * (drawn.layout.rules.displacement_pins + 2)
    x, y = window.west + window.step * columns, window.north - window.step * rows
    is_near = (x >= low[0] - margin) & (x <= high[0] + margin)
    is_near &= (y >= low[1] - margin) & (y <= high[1] + margin)
    return bool(is_near.any())
