"""`Board`: the pins of a display while symbols are put on them, and the `Layout` that comes of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from scipy import ndimage

from touchfield.arrays import Bools, Int32s
from touchfield.maps.guidelines import PinRules

FREE: Final = -1
"""Owner of a pin of no symbol."""
AROUND: Final = np.ones((3, 3), np.bool_)
"""A pin and its eight neighbours."""


@dataclass(frozen=True)
class Placed:
    """A symbol on the pins.

    kind : str; Its class, or "label".
    role : str; "line", "area", "point" or "label".
    names : tuple of str; Names of the features that it shows; the text of a label.
    cells : tuple of int; Of a label, the dots of each Braille cell: bit n is dot n + 1.
    """

    kind: str
    role: str
    names: tuple[str, ...] = ()
    cells: tuple[int, ...] = ()


@dataclass(frozen=True)
class Layout:
    """Symbols on the pins of a display.

    raised : bool [rows, columns]; The pins that are up, row 0 at the top.
    owner : int32 [rows, columns]; Index of the symbol to whose place a pin belongs, up or down; `FREE`.
    symbols : tuple of Placed
    rules : PinRules
    """

    raised: Bools
    owner: Int32s
    symbols: tuple[Placed, ...]
    rules: PinRules


@dataclass
class Board:
    """The pins of a display, on which symbols are put that keep their distance."""

    rows: int
    columns: int
    rules: PinRules
    symbols: list[Placed] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.raised = np.zeros((self.rows, self.columns), np.bool_)
        self.owner = np.full((self.rows, self.columns), FREE, np.int32)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.rows, self.columns

    def blocked(self) -> Bools:
        """Return the pins that are closer to a symbol than another symbol may be, its own included."""
        return self.near(self.owner != FREE)

    def near(self, mask: Bools) -> Bools:
        """Return the pins that are closer to those of a mask than another symbol may be."""
        return np.asarray(ndimage.binary_dilation(mask, self.rules.too_close))

    def put(self, symbol: Placed, place: Bools, raised: Bools) -> None:
        """Put a symbol on the pins of `place`, of which those of `raised` are up."""
        self.owner[place] = len(self.symbols)
        self.raised[place] = raised[place]
        self.symbols.append(symbol)

    def clear(self, place: Bools) -> None:
        """Take the pins of `place` from the symbols that they belong to."""
        self.owner[place] = FREE
        self.raised[place] = False

    def fits(self, rows: int, columns: int, free: Bools) -> Bools:
        """Return where the top left pin of a box of free pins may be, bool [rows, columns]."""
        sums = np.zeros((self.rows + 1, self.columns + 1), np.int64)
        sums[1:, 1:] = np.cumsum(np.cumsum(free, 0), 1)
        can_start = np.zeros(self.shape, np.bool_)
        if rows <= self.rows and columns <= self.columns:
            count = sums[rows:, columns:] - sums[:-rows, columns:] - sums[rows:, :-columns]
            count = count + sums[:-rows, :-columns]
            can_start[: count.shape[0], : count.shape[1]] = count == rows * columns
        return can_start

    def layout(self) -> Layout:
        """Return what was put."""
        return Layout(self.raised, self.owner, tuple(self.symbols), self.rules)


def parts_of(mask: Bools) -> list[Bools]:
    """Return the connected parts of a mask, of pins that touch by a side or a corner."""
    labels, count = ndimage.label(mask, AROUND)
    return [np.asarray(labels == n + 1) for n in range(count)]
