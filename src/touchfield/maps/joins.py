"""Which neighbouring pins of a symbol are joined on paper and in relief, so that a finger feels a line."""

from __future__ import annotations

import numpy as np

from touchfield.arrays import Bools
from touchfield.maps.board import Layout
from touchfield.maps.symbols import RELIEF, symbols

Pair = tuple[tuple[int, int], tuple[int, int]]
"""Row and column of two neighbouring pins."""


def joined(layout: Layout) -> list[Pair]:
    """Return the pairs of neighbouring raised pins of one line or solid area.

    Where dotted lines meet, two dots may be neighbours; a line between them would be another class.
    """
    is_joined = [(s.role == "line" and _is_stroke(s.kind)) or is_solid(s.kind) for s in layout.symbols]
    return _pairs(layout, layout.raised & np.array([*is_joined, False])[layout.owner])


def contours(layout: Layout) -> list[Pair]:
    """Return the pairs of neighbouring pins of one contour line, up or down: on paper it is a thin line."""
    return _pairs(layout, of_relief(layout))


def of_relief(layout: Layout) -> Bools:
    """Return the pins of contour lines, bool [rows, columns]."""
    is_relief = np.array([symbol.kind == RELIEF for symbol in layout.symbols] + [False])
    return np.asarray(is_relief[layout.owner])


def _is_stroke(kind: str) -> bool:
    return kind != RELIEF and not (kind in symbols() and symbols()[kind].is_dotted)


def is_solid(kind: str) -> bool:
    """True if all pins of a class are up, and joined."""
    return kind in symbols() and symbols()[kind].is_solid


def _pairs(layout: Layout, joins: Bools) -> list[Pair]:
    """Return the pairs of neighbouring pins of one symbol among those of a mask.

    Two pins of a line that touch by a corner are no pair if a pin beside both joins them: a junction would be
    filled.
    """
    pairs = []
    rows, columns = joins.shape
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        for row, column in np.argwhere(joins).tolist():
            owner, other = layout.owner[row, column], (row + down, column + right)
            if not (other[0] < rows and 0 <= other[1] < columns and joins[other]):
                continue
            beside = ((row, column + right), (row + down, column)) if down and right else ()
            is_filled = layout.symbols[owner].role == "line" and any(
                joins[pin] and layout.owner[pin] == owner for pin in beside
            )
            if layout.owner[other] == owner and not is_filled:
                pairs.append(((row, column), other))
    return pairs
