"""Draws a map at several scales: each zoom level is a grid of overlapping views of the size of the display.

Every view is drawn by itself from the features in it (`touchfield.maps.layout`). Its symbols and labels are
whole and keep their distances; nothing is cut out of a larger picture. The scale doubles from level to level,
and neighbouring views share half of the display.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from touchfield.arrays import Float64s
from touchfield.maps.braille import Braille
from touchfield.maps.features import Feature
from touchfield.maps.guidelines import PinRules
from touchfield.maps.layout import Drawn, draw, told_apart
from touchfield.maps.pins import Window
from touchfield.maps.relief import Relief

MAX_LEVELS: Final = 6
DEFAULT_LEVELS: Final = 4
"""Levels without a request, if it takes as many until nothing is left out."""
MAX_VIEWS: Final = 2048
MAX_FEATURES_DRAWN: Final = 1 << 18
"""Features drawn over all views, each as often as it is in one: some two minutes of processor time."""
MAX_POINTS_DRAWN: Final = 1 << 24


@dataclass(frozen=True)
class ViewGrid:
    """The views of a zoom level: `view_rows` x `view_columns`, the first one in the north west.

    first : Window; Of the first view.
    pan_rows, pan_columns : int; Pins from a view to the next one.
    """

    first: Window
    pan_rows: int
    pan_columns: int
    view_rows: int
    view_columns: int

    @classmethod
    def over(cls, low: Float64s, high: Float64s, whole: Window, zoom: int) -> ViewGrid:
        """Return the views over a box at 2^zoom times the scale of the window that shows all of it."""
        rows, columns, step = whole.rows, whole.columns, whole.step / 2**zoom
        pan = max(rows // 2, 1), max(columns // 2, 1)
        extent = (high - low)[::-1] / step + 1 if zoom else np.array([rows, columns])
        counts = [1 + max(0, math.ceil((e - n) / p - 1e-9)) for e, n, p in zip(extent, (rows, columns), pan)]
        spans = [n + p * (count - 1) for n, p, count in zip((rows, columns), pan, counts)]
        north = whole.north - whole.step * (rows - 1) / 2 + step * (spans[0] - 1) / 2
        west = whole.west + whole.step * (columns - 1) / 2 - step * (spans[1] - 1) / 2
        return cls(Window(west, north, step, rows, columns), *pan, *counts)

    def windows(self) -> Iterator[Window]:
        """Yield the window of each view, from north to south, and from west to east."""
        first = self.first
        for row in range(self.view_rows):
            for column in range(self.view_columns):
                west = first.west + first.step * self.pan_columns * column
                north = first.north - first.step * self.pan_rows * row
                yield Window(west, north, first.step, first.rows, first.columns)


@dataclass(frozen=True)
class Level:
    """A zoom level that was drawn: its grid, and the views in the order of `ViewGrid.windows`."""

    grid: ViewGrid
    views: tuple[Drawn, ...]

    @property
    def is_complete(self) -> bool:
        """True if every feature and name is on it, so that a larger scale shows nothing new."""
        return all(
            not view.unlabelled and all(seen == count for seen, count in view.counts.values())
            for view in self.views
        )


def draw_levels(
    features: Sequence[Feature],
    box: tuple[Float64s, Float64s],
    whole: tuple[Window, Drawn],
    braille: Braille | None,
    count: int | None,
    relief: Relief | None = None,
) -> tuple[tuple[Level, ...], tuple[str, ...]]:
    """Draw `count` zoom levels of a map; returns them and notes.

    `box` is the part of the map that is shown, `whole` the window of all of it and what was drawn there, the
    first level. None draws up to `DEFAULT_LEVELS`, until one shows every feature and name. There are fewer
    if more than `MAX_VIEWS` views, `MAX_FEATURES_DRAWN` or `MAX_POINTS_DRAWN` were necessary. `relief` is
    drawn on every level.
    """
    window, drawn = whole
    levels = [Level(ViewGrid.over(*box, window, 0), (drawn,))]
    shown = _Extents(told_apart(features))
    views = features_drawn = points_drawn = 0
    for zoom in range(1, DEFAULT_LEVELS if count is None else count):
        if count is None and levels[-1].is_complete:
            break
        grid = ViewGrid.over(*box, window, zoom)
        views += grid.view_rows * grid.view_columns
        if views >= MAX_VIEWS:
            return tuple(levels), (_limited(zoom, f"more than {MAX_VIEWS} views"),)
        selected = [shown.within(view) for view in grid.windows()]
        features_drawn += sum(map(len, selected))
        points_drawn += sum(int(shown.points[indices].sum()) for indices in selected)
        if features_drawn > MAX_FEATURES_DRAWN or points_drawn > MAX_POINTS_DRAWN:
            return tuple(levels), (_limited(zoom, f"{features_drawn} features in its views"),)
        levels.append(Level(grid, _views(grid, shown, selected, (drawn.layout.rules, braille), relief)))
    return tuple(levels), ()


def _limited(zoom: int, found: str) -> str:
    return f"Zoom level {zoom + 1} is not made: {found}. Draw a smaller part: --box."


def _views(
    grid: ViewGrid,
    shown: _Extents,
    selected: Sequence[Sequence[int]],
    style: tuple[PinRules, Braille | None],
    relief: Relief | None,
) -> tuple[Drawn, ...]:
    return tuple(
        draw([shown.features[n] for n in indices], window, *style, relief)
        for window, indices in zip(grid.windows(), selected)
    )


class _Extents:
    """Features, and which of them may be in a window."""

    def __init__(self, features: Sequence[Feature]) -> None:
        self.features = features
        self.points = np.array([sum(map(len, f.parts)) for f in features], np.int64)
        self._low = np.array([np.min([part.min(axis=0) for part in f.parts], axis=0) for f in features])
        self._high = np.array([np.max([part.max(axis=0) for part in f.parts], axis=0) for f in features])

    def within(self, window: Window) -> list[int]:
        """Return the indices of the features whose box meets a window, and a pin around it."""
        if not len(self.features):
            return []
        step = window.step
        low = (window.west - step, window.north - step * window.rows)
        high = (window.west + step * window.columns, window.north + step)
        is_near = ((self._low <= high) & (self._high >= low)).all(axis=1)
        return [int(n) for n in np.flatnonzero(is_near)]
