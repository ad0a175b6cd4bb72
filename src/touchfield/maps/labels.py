"""Braille labels on a map, which cover nothing, and the pages of the legend.

A name stands on the map if it has room there, else a key of two letters that recalls it, explained in the
legend. A label keeps its distance from everything, and stands within a fingertip of what it names."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy import ndimage

from touchfield.arrays import Bools, Int64s
from touchfield.maps.board import Board, Layout, Placed
from touchfield.maps.braille import Braille, pins_of
from touchfield.maps.guidelines import PinRules, guidelines
from touchfield.maps.symbols import RELIEF, Symbol, relief_symbol, symbols

TEXT: Final = "text"
"""Class of the texts of a drawing."""
MAX_NAME_CELLS: Final = 5
"""Longest name that stands on the map itself, cells; longer ones would fill the display."""
LOW_LETTERS: Final = frozenset("klmnopqrstuvwxyz")
"""Letters of Braille with dot 3 or dot 6, in the lowest row of a cell."""
SWATCH_PINS: Final = 9
"""Columns of the sample of a symbol in the legend."""


class Translator(Protocol):
    """Writes Braille: `touchfield.maps.braille.Braille`, or the stored cells of a map."""

    def cells(self, text: str) -> tuple[int, ...]:
        """Return the dots of each cell: bit n is dot n + 1."""


@dataclass(frozen=True)
class LabelRequest:
    """A name that is wanted on the map, for what lies on some pins, bool [rows, columns].

    With `must_be_inside` the whole label stands on these pins. The name of a solid area, and a text of a
    drawing upon one, may stand in an opening of it if there is no other room.
    """

    name: str
    kind: str
    pins: Bools
    must_be_inside: bool = False


@dataclass(frozen=True)
class Label:
    """A label on the map.

    name, kind : str; What it names, and its class.
    text : str; The name itself, or its key.
    row, column : int; The top left pin of its first cell.
    cells : tuple of int; Bit n is dot n + 1.
    """

    name: str
    kind: str
    text: str
    row: int
    column: int
    cells: tuple[int, ...]

    @property
    def is_key(self) -> bool:
        """True if the text is not the name."""
        return self.text != self.name


def put_labels(
    board: Board, requests: Sequence[LabelRequest], braille: Braille | None
) -> tuple[tuple[Label, ...], tuple[str, ...]]:
    """Put a label for each name where there is room; returns the labels and the names without one.

    Features of one class and name are one thing, such as the parts of a street.
    """
    if braille is None:
        return (), ()
    merged: dict[tuple[str, str], LabelRequest] = {}
    for request in requests:
        key = (request.kind, request.name)
        pins = request.pins | merged[key].pins if key in merged else request.pins
        merged[key] = LabelRequest(request.name, request.kind, pins, request.must_be_inside)
    labels: list[Label] = []
    unlabelled = []
    for request in sorted(merged.values(), key=_importance):
        label = _put(board, request, braille, {label.text for label in labels})
        if label is None:
            unlabelled.append(request.name)
        else:
            labels.append(label)
    return tuple(labels), tuple(dict.fromkeys(unlabelled))


def _importance(request: LabelRequest) -> tuple[int, int, str]:
    priority = symbols()[request.kind].priority if request.kind in symbols() else 0
    return priority, -int(request.pins.sum()), request.name


def _put(board: Board, request: LabelRequest, braille: Braille, taken: set[str]) -> Label | None:
    if not any(braille.cells(request.name)):
        return None  # a key would have an empty line in the legend
    texts = [request.name] if request.name not in taken else []
    key = next((key for key in keys_of(request.name) if key not in taken), None)
    for spot_of in (_spot, _spot_of_opening):
        for text in (*texts, *filter(None, (key,))):
            cells = braille.cells(text)
            if not cells or (text == request.name and len(cells) > MAX_NAME_CELLS):
                continue
            pins = pins_of(cells, board.rules.cell_pins)
            spot = spot_of(board, request, pins.shape)
            if spot is not None:
                row, column = spot
                place, raised = np.zeros(board.shape, np.bool_), np.zeros(board.shape, np.bool_)
                box = np.s_[row : row + pins.shape[0], column : column + pins.shape[1]]
                place[box], raised[box] = True, pins
                board.clear(board.near(place))  # of a solid area; around a free box there is nothing
                board.put(Placed("label", "label", (text,), cells), place, raised)
                return Label(request.name, request.kind, text, row, column, cells)
    return None


def _spot(board: Board, request: LabelRequest, size: tuple[int, int]) -> tuple[int, int] | None:
    """Return the top left pin of the free box that is nearest to what it names, inside it if that is so."""
    free = ~board.blocked()
    if request.must_be_inside:
        free &= request.pins
    return _nearest(board, request, np.argwhere(board.fits(*size, free)), size)


def _spot_of_opening(board: Board, request: LabelRequest, size: tuple[int, int]) -> tuple[int, int] | None:
    """Return the top left pin of a box in a solid area that stays wide enough around it to be felt."""
    is_solid = np.array([s.kind in symbols() and symbols()[s.kind].is_solid for s in board.symbols] + [False])
    solid = is_solid[board.owner]
    if request.kind != TEXT:
        solid &= request.pins
        if request.kind not in symbols() or not symbols()[request.kind].is_solid:
            return None
    around = board.rules.too_close.shape[0] // 2 + board.rules.symbol_pins
    starts = np.argwhere(board.fits(size[0] + 2 * around, size[1] + 2 * around, solid)) + around
    return _nearest(board, request, starts, size)


def _nearest(
    board: Board, request: LabelRequest, starts: Int64s, size: tuple[int, int]
) -> tuple[int, int] | None:
    """Return the one of these top left pins, int64 [n, 2], whose box is nearest to what it names."""
    if not len(starts):
        return None
    distances = ndimage.distance_transform_cdt(~request.pins, "chessboard")
    centre = np.argwhere(request.pins).mean(axis=0)
    spans = sliding_window_view(distances, size).min(axis=(2, 3))[tuple(starts.T)]
    if spans.min() > board.rules.displacement_pins:
        return None
    best = starts[spans == spans.min()]
    middle = best + np.divide(size, 2)
    row, column = best[int(np.square(middle - centre).sum(axis=1).argmin())]
    return int(row), int(column)


def keys_of(name: str) -> Iterator[str]:
    """Yield keys of two letters for a name, those that recall it first.

    One of the letters has dot 3 or dot 6 (`LOW_LETTERS`): without it a finger cannot tell the height of the
    dots. Keys without such a letter come last.

    >>> next(keys_of("Queen Street")), next(keys_of("Bahnhof")), next(keys_of("公園"))
    ('qs', 'bn', 'ak')
    """
    keys = tuple(dict.fromkeys(_keys_of(name)))
    has_low = [not LOW_LETTERS.isdisjoint(key) for key in keys]
    yield from (key for key, is_low in zip(keys, has_low) if is_low)
    yield from (key for key, is_low in zip(keys, has_low) if not is_low)


def _keys_of(name: str) -> Iterator[str]:
    plain = unicodedata.normalize("NFKD", name).lower()
    words = re.findall("[a-z]+", "".join(c for c in plain if not unicodedata.combining(c)))
    letters = "".join(words)
    if len(words) > 1:
        yield words[0][0] + words[1][0]
    yield from (letters[0] + other for other in letters[1:])
    alphabet = "abcdefghijklmnopqrstuvwxyz"
    yield from (first + second for first in (*letters[:1], *alphabet) for second in alphabet)


# -- legend ------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class LegendLine:
    """A line of the legend: a sample of a symbol of the class `kind`, or a `key`, and what it means."""

    sample: Bools
    text: str
    kind: str = ""
    key: str = ""

    @property
    def shows(self) -> str:
        """The class, or the key in letters."""
        return self.kind or f"key {self.key}"


def class_titles(language: str, interval_m: float | None = None) -> dict[str, str]:
    """Return the title of each class in a language; that of relief states the interval of contour lines."""
    titles = {name: symbol.titled(language) for name, symbol in symbols().items()}
    if interval_m is not None:
        titles[RELIEF] = relief_symbol().titled(language).format(interval_m=f"{interval_m:.6g}")
    return titles


def legend_lines(
    layout: Layout, labels: Sequence[Label], titles: Mapping[str, str]
) -> tuple[LegendLine, ...]:
    """Return the lines of the legend: the symbols in use by their titles, then the keys by alphabet."""
    kinds = {placed.kind for placed in layout.symbols}
    known = (*symbols().values(), relief_symbol())
    lines = [
        LegendLine(_sample(symbol), titles.get(symbol.name, symbol.name), symbol.name)
        for symbol in known
        if symbol.name in kinds
    ]
    for label in sorted((label for label in labels if label.is_key), key=lambda label: label.text):
        sample = pins_of(label.cells, layout.rules.cell_pins)
        lines.append(LegendLine(sample, label.name, key=label.text))
    return tuple(lines)


def _sample(symbol: Symbol) -> Bools:
    """Return a sample of a symbol, bool [3, columns]."""
    if symbol.picture:
        return symbol.pattern((3, 3))
    if symbol.texture:
        return symbol.pattern((3, SWATCH_PINS))
    sample = np.zeros((3, SWATCH_PINS), np.bool_)
    is_up = np.arange(SWATCH_PINS) % (symbol.on + symbol.off) < symbol.on
    sample[1] = is_up
    return sample


def legend_pages(
    lines: Sequence[LegendLine], braille: Translator, rows: int, columns: int, rules: PinRules
) -> tuple[tuple[Bools, ...], tuple[str, ...]]:
    """Lay out the legend on pages of pins, bool [rows, columns] each; returns them and notes.

    A text that is wider than the page goes on in the next line, at a blank cell if there is one.
    """
    indent = SWATCH_PINS + 3
    width_cells = (columns - indent - 2) // rules.cell_pins + 1
    per_page = (rows - 3) // rules.braille_line_pins + 1
    if width_cells < int(guidelines()["key_cells"].value) or per_page < 1:
        return (), (f"A display of {rows} x {columns} pins has no room for a legend.",)
    placed: list[tuple[Bools | None, tuple[int, ...]]] = []
    for line in lines:
        wrapped = _wrapped(braille.cells(line.text), width_cells)
        placed += [(line.sample if n == 0 else None, cells) for n, cells in enumerate(wrapped)]
    pages = []
    for start in range(0, len(placed), per_page):
        page = np.zeros((rows, columns), np.bool_)
        for n, (sample, cells) in enumerate(placed[start : start + per_page]):
            top = n * rules.braille_line_pins
            if sample is not None:
                page[top : top + 3, : sample.shape[1]] = sample
            text = pins_of(cells, rules.cell_pins)
            page[top : top + 3, indent : indent + text.shape[1]] = text
        pages.append(page)
    return tuple(pages), ()


def _wrapped(cells: tuple[int, ...], width: int) -> list[tuple[int, ...]]:
    """Return cells in lines of at most `width`, broken at blank cells where there are any."""
    lines = []
    while len(cells) > width:
        stop = next((n for n in range(width, 0, -1) if cells[n] == 0), width)
        lines.append(cells[:stop])
        cells = cells[stop + (cells[stop] == 0) :]
    return [*lines, cells]
