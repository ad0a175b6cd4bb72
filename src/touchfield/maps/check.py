"""Checks a drawn map on its pins against the guidelines, apart from the code that drew it.

Distances are measured between the pins that are up, pair by pair; nothing of the drawing's masks is used.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from touchfield.arrays import Bools, Float64s, Int64s
from touchfield.maps.board import Layout
from touchfield.maps.braille import cells_of
from touchfield.maps.guidelines import guidelines
from touchfield.maps.symbols import symbol_of

MAX_LISTED: Final = 20
_REACH_PINS: Final = 8
"""Distances up to this many pins are measured."""


@dataclass(frozen=True)
class Checked:
    """What a check found.

    violations : tuple of str; One sentence each, at most `MAX_LISTED`.
    min_gap_mm : float or None; Least distance between the edges of two symbols, if two are within 8 pins.
    """

    violations: tuple[str, ...]
    min_gap_mm: float | None


def check(layout: Layout) -> Checked:
    """Check distances, sizes, styles and labels of a map on its pins."""
    min_gap_mm, close = _distances(layout)
    found = [*close, *_merged_lines(layout), *_sizes(layout), *_styles(layout), *_labels(layout)]
    stray = int((layout.raised & (layout.owner < 0)).sum())
    if stray:
        found.append(f"{stray} pins are up that belong to no symbol.")
    return Checked(tuple(found[:MAX_LISTED]), min_gap_mm)


def _distances(layout: Layout) -> tuple[float | None, list[str]]:
    """Return the least distance between the edges of pins of two symbols, and those that are too small."""
    pitch_mm, dot_mm = layout.rules.pitch_mm, float(guidelines()["dot_mm"].value)
    up = np.argwhere(layout.raised)
    if not len(up):
        return None, []
    pairs = cKDTree(up).query_pairs(_REACH_PINS, output_type="ndarray")
    first, second = (layout.owner[tuple(up[pairs[:, side]].T)] for side in (0, 1))
    is_other = first != second
    pairs, first, second = pairs[is_other], first[is_other], second[is_other]
    if not len(pairs):
        return None, []
    gaps_mm = pitch_mm * np.hypot(*(up[pairs[:, 0]] - up[pairs[:, 1]]).T) - dot_mm
    close = np.flatnonzero(gaps_mm < float(guidelines()["gap_mm"].value) - 1e-9)
    return float(gaps_mm.min()), [
        _too_close(layout, up[pairs[n, 0]], first[n], second[n], gaps_mm[n]) for n in close
    ]


def _too_close(layout: Layout, at: Int64s, first: int, second: int, gap_mm: Float64s) -> str:
    kinds = " and ".join(layout.symbols[n].kind for n in (first, second))
    return f"row {at[0]}, column {at[1]}: {kinds} are {float(gap_mm):.2f} mm apart."


def _merged_lines(layout: Layout) -> list[str]:
    """Find squares of four raised pins in a line: two lines that are felt as one."""
    found = []
    for n, placed in enumerate(layout.symbols):
        if placed.role != "line":
            continue
        up = layout.raised & (layout.owner == n)
        for row, column in np.argwhere(up[:-1, :-1] & up[1:, :-1] & up[:-1, 1:] & up[1:, 1:]):
            found.append(f"row {row}, column {column}: lines of {placed.kind} merge.")
    return found


def _sizes(layout: Layout) -> list[str]:
    """Find symbols that are smaller than the guidelines allow."""
    dot_mm, pitch_mm = float(guidelines()["dot_mm"].value), layout.rules.pitch_mm
    least = {role: float(guidelines()["min_symbol_mm"].value) for role in ("area", "point")}
    found = []
    for n, placed in enumerate(layout.symbols):
        rows, columns = np.nonzero(layout.owner == n)
        extent_mm = (
            [pitch_mm * float(np.ptp(side)) + dot_mm for side in (rows, columns)] if len(rows) else [0.0]
        )
        if min(extent_mm) < least.get(placed.role, 0.0) - 1e-9:
            found.append(f"A symbol of {placed.kind} is {min(extent_mm):.2f} mm across.")
    return found


def _styles(layout: Layout) -> list[str]:
    """Find more kinds of symbol than can be told apart, and kinds that look alike."""
    limit, found = int(guidelines()["max_kinds"].value), []
    for role in ("line", "area", "point"):
        kinds = sorted({placed.kind for placed in layout.symbols if placed.role == role})
        if len(kinds) > limit:
            found.append(f"{len(kinds)} kinds of {role} ({', '.join(kinds)}) are more than {limit}.")
        looks: dict[object, str] = {}
        for kind in kinds:
            symbol = symbol_of(kind)
            look = kind if symbol is None else symbol.look
            if look in looks:
                found.append(f"{looks[look]} and {kind} have the same symbol.")
            looks.setdefault(look, kind)
    return found


def _labels(layout: Layout) -> list[str]:
    """Find labels whose pins are not the Braille of their text."""
    found = []
    for n, placed in enumerate(layout.symbols):
        if placed.role != "label":
            continue
        rows, columns = np.nonzero(layout.owner == n)
        box = layout.raised[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
        owned: Bools = layout.owner[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1] == n
        if not owned.all() or cells_of(box, layout.rules.cell_pins) != placed.cells:
            found.append(f"The label {placed.names[0]!r} is covered.")
    return found
