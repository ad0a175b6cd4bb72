"""`StoredMap`: the map in a ``.touch`` file, to pan, zoom and find places in (docs/format/maps.md)."""

from __future__ import annotations

import difflib
import math
import unicodedata
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Final, NamedTuple

import numpy as np

from touchfield.arrays import Bools
from touchfield.container.map_record import ROLES, MapPlace, MapView, TactileMap, decode_view
from touchfield.errors import InvalidArgument
from touchfield.maps.board import Layout, Placed
from touchfield.maps.guidelines import PinRules
from touchfield.maps.labels import Label, legend_lines, legend_pages

MAX_NEAR: Final = 5
"""Names that are proposed where none matches."""
_KEPT_VIEWS: Final = 16
_LABEL: Final = ROLES.index("label")
MOVES: Final = {"up": (-1, 0), "down": (1, 0), "left": (0, -1), "right": (0, 1)}
"""Rows and columns of views by which a move goes on."""


class Position(NamedTuple):
    """A view: its level, and its row and column among the views of the level."""

    level: int
    row: int
    column: int


@dataclass(frozen=True)
class Found:
    """What a search found.

    places : tuple of MapPlace; The best first: whole names, then beginnings, then parts of names.
    near : tuple of str; Similar names, if there are no places.
    """

    places: tuple[MapPlace, ...]
    near: tuple[str, ...]


class StoredMap:
    """A map of a file: `record` is its record, `where` the file's name in messages."""

    def __init__(self, record: TactileMap, where: str) -> None:
        self.record, self.where = record, where
        counts = [level.view_rows * level.view_columns for level in record.levels]
        self._first = [0, *np.cumsum(counts).tolist()]
        self.view = lru_cache(_KEPT_VIEWS)(self._view)

    @property
    def start(self) -> Position:
        """The view of the whole map."""
        return Position(0, 0, 0)

    def _view(self, position: Position) -> MapView:
        """Return a view; raises `CorruptFile` if its bytes are none."""
        level = self.record.levels[position.level]
        index = self._first[position.level] + position.row * level.view_columns + position.column
        return decode_view(self.record, index, self.where)

    # -- moves ---------------------------------------------------------------------------------------------
    def moved(self, position: Position, move: str) -> Position:
        """Return the view after a move of `MOVES`, "in", "out" or "home"; the same one at an edge.

        Zooming keeps the middle of the view, as far as there are views.
        """
        if move == "home":
            return self.start
        if move in ("in", "out"):
            level = min(max(position.level + (1 if move == "in" else -1), 0), len(self.record.levels) - 1)
            return position if level == position.level else self.nearest(level, self.middle(position))
        level_of = self.record.levels[position.level]
        rows, columns = MOVES[move]
        row = min(max(position.row + rows, 0), level_of.view_rows - 1)
        return Position(
            position.level, row, min(max(position.column + columns, 0), level_of.view_columns - 1)
        )

    def middle(self, position: Position) -> tuple[float, float]:
        """Return the coordinates of the middle of a view."""
        level, record = self.record.levels[position.level], self.record
        column = position.column * level.pan_columns + (record.columns - 1) / 2
        row = position.row * level.pan_rows + (record.rows - 1) / 2
        return level.west + column * level.pin_step, level.north - row * level.pin_step

    def nearest(self, level: int, middle: tuple[float, float]) -> Position:
        """Return the view of a level whose middle is nearest to a point."""
        grid, record = self.record.levels[level], self.record
        column = ((middle[0] - grid.west) / grid.pin_step - (record.columns - 1) / 2) / grid.pan_columns
        row = ((grid.north - middle[1]) / grid.pin_step - (record.rows - 1) / 2) / grid.pan_rows
        return Position(
            level,
            min(max(round(row), 0), grid.view_rows - 1),
            min(max(round(column), 0), grid.view_columns - 1),
        )

    # -- names ---------------------------------------------------------------------------------------------
    @cached_property
    def _plain(self) -> list[str]:
        return [_plain(name.text) for name in self.record.names]

    def find(self, text: str) -> Found:
        """Find places by name: without regard to case and accents."""
        wanted = _plain(text)
        if not wanted:
            raise InvalidArgument("find", repr(text[:80]), "a name")
        ranks = [
            0 if name == wanted else 1 if name.startswith(wanted) else 2 if wanted in name else 3
            for name in self._plain
        ]
        places = [place for place in self.record.places if ranks[place.name] < 3]
        places.sort(key=lambda place: (ranks[place.name], place.first_level, self._plain[place.name]))
        if places:
            return Found(tuple(places), ())
        indexed = {self._plain[place.name]: place.name for place in self.record.places}
        near = difflib.get_close_matches(wanted[:80], indexed, MAX_NEAR)
        return Found((), tuple(self.record.names[indexed[name]].text for name in near))

    def position_of(self, place: MapPlace) -> Position:
        """Return the view in which a place is shown, its middle as near to that of the place as possible."""
        level = min(place.first_level, len(self.record.levels) - 1)
        west, south, east, north = place.box
        middle = (west + east) / 2, (south + north) / 2
        nearest = self.nearest(level, middle)
        if place.first_level >= len(self.record.levels):
            return nearest
        for position in self._around(nearest, place):
            shown = self.view(position).symbols
            if any(place.name in symbol.names and symbol.kind == place.kind for symbol in shown):
                return position
        return nearest

    def _around(self, nearest: Position, place: MapPlace) -> Sequence[Position]:
        """Return the views that meet the box of a place, the nearest first."""
        level, record = self.record.levels[nearest.level], self.record
        west, south, east, north = place.box
        reach = level.pin_step * record.columns, level.pin_step * record.rows
        found = []
        for row in range(level.view_rows):
            for column in range(level.view_columns):
                x, y = self.middle(Position(nearest.level, row, column))
                if west - reach[0] <= x <= east + reach[0] and south - reach[1] <= y <= north + reach[1]:
                    away = math.hypot(x - (west + east) / 2, y - (south + north) / 2)
                    found.append((away, Position(nearest.level, row, column)))
        return [position for _, position in sorted(found)]

    def describe_place(self, place: MapPlace) -> str:
        """Return name and class of a place, and the level on which it is first drawn."""
        name, title = self.record.names[place.name].text, self.record.kinds[place.kind].title
        if place.first_level >= len(self.record.levels):
            return f"{name} ({title}), drawn on no level: too close to others"
        return f"{name} ({title}), from level {place.first_level + 1}"

    # -- views ---------------------------------------------------------------------------------------------
    def scale_text(self, level: int) -> str:
        """Return the scale of a level."""
        step = self.record.levels[level].pin_step
        if self.record.is_drawing:
            return f"{step:.3g} units from pin to pin"
        return f"1:{round(1000 * step / self.record.pitch_mm)}"

    def describe(self, position: Position) -> str:
        """Return what a view shows, as a line for people: level, scale, place among the views, and names."""
        level = self.record.levels[position.level]
        named = [
            (self.record.names[name].text, self.record.kinds[symbol.kind].title)
            for symbol in self.view(position).symbols
            for name in symbol.names
        ]
        listed = ", ".join(f"{name} ({title})" for name, title in dict.fromkeys(named))
        return (
            f"level {position.level + 1} of {len(self.record.levels)}, {self.scale_text(position.level)}, "
            f"row {position.row + 1} of {level.view_rows}, column {position.column + 1} of "
            f"{level.view_columns}: {listed or 'no names'}"
        )

    def layout(self, position: Position) -> Layout:
        """Return the symbols of a view as a layout, as it is drawn and checked."""
        view, record = self.view(position), self.record
        placed = tuple(
            Placed(
                "label" if symbol.role == _LABEL else record.kinds[symbol.kind].name,
                ROLES[symbol.role],
                tuple(record.names[name].text for name in symbol.names),
                tuple(symbol.cells),
            )
            for symbol in view.symbols
        )
        return Layout(view.raised, view.owner, placed, PinRules(record.pitch_mm))

    def labels(self, position: Position) -> tuple[Label, ...]:
        """Return the labels of a view."""
        view, found = self.view(position), []
        for n, symbol in enumerate(view.symbols):
            pins = np.argwhere(view.owner == n)
            if symbol.role == _LABEL and len(pins):
                name, kind = self.record.names[symbol.names[0]].text, self.record.kinds[symbol.kind].name
                row, column = (int(v) for v in pins.min(axis=0))
                found.append(Label(name, kind, symbol.text, row, column, tuple(symbol.cells)))
        return tuple(found)

    def legend(self, position: Position) -> tuple[Bools, ...]:
        """Return the pages of the legend of a view, bool [rows, columns] each; none without Braille."""
        record = self.record
        if not record.language:
            return ()
        layout = self.layout(position)
        up = np.unique(layout.owner[layout.raised])
        felt = Layout(
            layout.raised, layout.owner, tuple(layout.symbols[n] for n in up if n >= 0), layout.rules
        )
        titles = {kind.name: kind.title for kind in record.kinds}
        lines = legend_lines(felt, self.labels(position), titles)
        pages, _ = legend_pages(lines, self, record.rows, record.columns, layout.rules)
        return pages

    @cached_property
    def _cells(self) -> dict[str, tuple[int, ...]]:
        cells = {kind.title: tuple(kind.cells) for kind in self.record.kinds}
        return cells | {name.text: tuple(name.cells) for name in self.record.names}

    def cells(self, text: str) -> tuple[int, ...]:
        """Return the stored Braille of a title or a name, () of any other text."""
        return self._cells.get(text, ())

    # -- report --------------------------------------------------------------------------------------------
    def summary(self) -> dict[str, object]:
        """Stable keys for people and programs."""
        record = self.record
        classes = Counter(record.kinds[place.kind].name for place in record.places)
        return {
            "title": record.title,
            "pins": f"{record.columns} x {record.rows}, {record.pitch_mm:g} mm apart",
            "language": record.language or None,
            "classes": ", ".join(kind.title for kind in record.kinds),
            "named_features": dict(classes.most_common()),
            "not_drawn": sum(place.first_level >= len(record.levels) for place in record.places),
            "attribution": record.attribution or None,
        }

    def level_rows(self) -> list[dict[str, object]]:
        """Return a row for each level: scale, views, and named features that it is the first to show."""
        first = Counter(place.first_level for place in self.record.places)
        return [
            {
                "level": n + 1,
                "scale": self.scale_text(n),
                "views": f"{level.view_columns} x {level.view_rows}",
                "new_names": first[n],
            }
            for n, level in enumerate(self.record.levels)
        ]


def _plain(text: str) -> str:
    """Return a name without case, accents and repeated blanks."""
    decomposed = unicodedata.normalize("NFKD", text.casefold())
    return " ".join("".join(c for c in decomposed if not unicodedata.combining(c)).split())
