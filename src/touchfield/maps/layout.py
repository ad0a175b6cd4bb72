"""Draws the features of a map with symbols that a finger can tell apart, on the pins of a display.

A tactile graphic is not a picture with fewer pixels: classes become symbols, the more important is drawn
first, and what follows keeps the distance of the guidelines or is left out and counted. The order is

lines             by class; what crosses a more important line is cut around it
point symbols     beside their place if that is taken
buildings         the solid texture, which a label cannot stand on
labels            Braille, where nothing is (`touchfield.maps.labels`)
textured areas    which make way for all of these
contour lines     of a relief, where nothing else is
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from scipy import ndimage

from touchfield.arrays import Bools, Int32s
from touchfield.maps.board import FREE, Board, Layout, Placed, parts_of
from touchfield.maps.braille import Braille
from touchfield.maps.features import Feature
from touchfield.maps.guidelines import PinRules, guidelines
from touchfield.maps.labels import TEXT, Label, LabelRequest, put_labels
from touchfield.maps.lines import dashes, network_of
from touchfield.maps.pins import Window, fill, trace
from touchfield.maps.relief import Relief
from touchfield.maps.symbols import RELIEF, Symbol, relief_symbol, symbols

MIN_TEXTURE_PINS: Final = 4
"""Fewest pins up by which a texture is known."""
MIN_CONTOUR_PINS: Final = 3
"""Fewest pins up by which the direction of a contour line is felt."""
DOOR_REACH: Final = 2
"""Pins within which a door belongs to a wall."""


@dataclass(frozen=True)
class Drawn:
    """A map on pins.

    layout : Layout
    labels : tuple of Label; Names and keys that stand on the map.
    unlabelled : tuple of str; Names for which there was no room.
    counts : mapping of str to (int, int); For each class, features in the window and features drawn.
    notes : tuple of str; What was left out, and why.
    named : tuple of (str, str); Class and name of the named features that have pins, each once.
    name_at : int32 [rows, columns]; Index in `named` of the feature to which a pin belongs, `FREE` for none.
    contour_pins : (int, int); Pins on contour lines in the window, and those of them that are drawn.
    """

    layout: Layout
    labels: tuple[Label, ...]
    unlabelled: tuple[str, ...]
    counts: Mapping[str, tuple[int, int]]
    notes: tuple[str, ...]
    named: tuple[tuple[str, str], ...]
    name_at: Int32s
    contour_pins: tuple[int, int] = (0, 0)


@dataclass
class _Drawing:
    """A map that is being drawn."""

    board: Board
    window: Window
    features: Mapping[str, list[Feature]]
    seen: Counter[str] = field(default_factory=Counter)
    drawn: Counter[str] = field(default_factory=Counter)
    requests: list[LabelRequest] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    named: dict[tuple[str, str], int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.name_at = np.full(self.board.shape, FREE, np.int32)

    def request(self, feature: Feature, pins: Bools, *, must_be_inside: bool = False) -> None:
        """Ask for a label of a feature that is drawn on some pins, and note its name there."""
        if feature.name and pins.any():
            self.note_name(feature, pins)
            self.requests.append(LabelRequest(feature.name, feature.kind, pins, must_be_inside))

    def note_name(self, feature: Feature, pins: Bools) -> None:
        """Note the name of a feature on some pins."""
        self.name_at[pins] = self.named.setdefault((feature.kind, feature.name), len(self.named))


def draw(
    features: Sequence[Feature],
    window: Window,
    rules: PinRules,
    braille: Braille | None,
    relief: Relief | None = None,
) -> Drawn:
    """Draw features in a window, and the contour lines of `relief`; without `braille` there are no labels."""
    by_kind, notes = _told_apart(features)
    drawing = _Drawing(Board(window.rows, window.columns, rules), window, by_kind, notes=notes)
    _draw_lines(drawing)
    _draw_points(drawing)
    _draw_areas(drawing, is_solid=True)
    _request_texts(drawing)
    areas = _area_masks(drawing)
    labels, unlabelled = put_labels(drawing.board, drawing.requests, braille)
    _draw_areas(drawing, is_solid=False, masks=areas)
    contour_pins = (0, 0) if relief is None else _draw_contours(drawing, relief)
    counts = {kind: (drawing.seen[kind], drawing.drawn[kind]) for kind in drawing.seen}
    return Drawn(
        drawing.board.layout(),
        labels,
        unlabelled,
        counts,
        tuple(drawing.notes),
        tuple(drawing.named),
        drawing.name_at,
        contour_pins,
    )


def told_apart(features: Sequence[Feature]) -> list[Feature]:
    """Return the features of the classes that can be told apart on one map; windows of it show no others."""
    by_kind, _ = _told_apart(features)
    return [feature for feature in features if feature.kind in by_kind]


def _told_apart(features: Sequence[Feature]) -> tuple[dict[str, list[Feature]], list[str]]:
    """Return the features of each class, and notes.

    Left out are classes that feel like a more important one, and those beyond the greatest number.
    """
    by_kind: dict[str, list[Feature]] = {}
    for feature in features:
        by_kind.setdefault(feature.kind, []).append(feature)
    notes = []
    limit = int(guidelines()["max_kinds"].value)
    for shape in ("line", "area", "point"):
        looks: dict[object, str] = {}
        for symbol in symbols().values():
            count = _count_of(by_kind, symbol)
            if symbol.shape != shape or not symbol.is_drawn or not count:
                continue
            if symbol.look in looks:
                reason = f"they would feel like {looks[symbol.look]}"
            elif len(looks) == limit:
                reason = f"more than {limit} kinds of {shape} cannot be told apart"
            else:
                looks[symbol.look] = symbol.titled("en")
                continue
            notes.append(f"Left out: {count} of {symbol.titled('en')}: {reason}.")
            by_kind = {
                kind: features
                for kind, features in by_kind.items()
                if symbol.name not in (kind, symbols()[kind].outline if kind in symbols() else "")
            }
    return by_kind, notes


def _count_of(by_kind: Mapping[str, list[Feature]], symbol: Symbol) -> int:
    """Return the number of features of a class, and of those that are drawn by its line."""
    kinds = [symbol.name, *(other.name for other in symbols().values() if other.outline == symbol.name)]
    return sum(len(by_kind.get(kind, ())) for kind in kinds)


# -- lines -------------------------------------------------------------------------------------------------
def _draw_lines(drawing: _Drawing) -> None:
    for symbol in symbols().values():
        if symbol.shape != "line" or not symbol.is_drawn:
            continue
        outlined = _outlines(drawing, symbol.name)
        features = [*drawing.features.get(symbol.name, ()), *outlined]
        if features:
            _draw_network(drawing, symbol, features)


def _outlines(drawing: _Drawing, line_kind: str) -> list[Feature]:
    """Return the closed lines around the areas that are drawn by this kind of line."""
    outlines = []
    for symbol in symbols().values():
        if symbol.outline != line_kind:
            continue
        for area in drawing.features.get(symbol.name, ()):
            rings = tuple(np.concatenate([ring, ring[:1]]) for ring in area.parts)
            outlines.append(Feature(symbol.name, "line", rings))
            inside = fill([drawing.window.to_pins(r) for r in area.parts], *drawing.board.shape)
            drawing.request(area, inside, must_be_inside=True)
    return outlines


def _draw_network(drawing: _Drawing, symbol: Symbol, features: Sequence[Feature]) -> None:
    board, blocked = drawing.board, drawing.board.blocked()
    network = network_of(features, symbol, drawing.window, blocked, board.rules.line_pins)
    raised, place = dashes(network.pins, symbol.on, symbol.off), network.pins.copy()
    _open_gaps(drawing, symbol.name, place)
    for part in parts_of(place):
        if max(np.ptp(side) for side in np.nonzero(part)) + 1 < board.rules.symbol_pins:
            place[part] = False  # a pier between two doors, too short to be felt as a wall
    for feature, pins in network.drawn:
        own = pins & place
        drawing.seen[feature.kind] += 1
        drawing.drawn[feature.kind] += bool(own.any())
        drawing.request(feature, own)
    names = tuple(dict.fromkeys(f.name for f, pins in network.drawn if f.name and (pins & place).any()))
    for part in parts_of(place):
        board.put(Placed(symbol.name, "line", names), part, raised)


def _open_gaps(drawing: _Drawing, line_kind: str, place: Bools) -> None:
    """Remove the pins of a line at the doors in it."""
    line = np.argwhere(place)
    for symbol in symbols().values():
        if symbol.opens != line_kind:
            continue
        for row, column in _point_pins(drawing, symbol.name):
            drawing.seen[symbol.name] += 1
            distance = np.abs(line - (row, column)).max(axis=1)
            if len(line) and distance.min() <= DOOR_REACH:
                r, c = line[distance.argmin()]
                place[max(r - 1, 0) : r + 2, max(c - 1, 0) : c + 2] = False
                drawing.drawn[symbol.name] += 1


# -- points ------------------------------------------------------------------------------------------------
def _point_pins(drawing: _Drawing, kind: str) -> list[tuple[int, int]]:
    """Return the pins at the points of a class within the window."""
    return [pin for feature in drawing.features.get(kind, ()) if (pin := _pin_of(drawing, feature))]


def _pin_of(drawing: _Drawing, feature: Feature) -> tuple[int, int] | None:
    row, column = np.rint(drawing.window.to_pins(feature.parts[0][:1])[0])
    is_inside = 0 <= row < drawing.board.rows and 0 <= column < drawing.board.columns
    return (int(row), int(column)) if is_inside else None


def _draw_points(drawing: _Drawing) -> None:
    board = drawing.board
    for symbol in symbols().values():
        if not symbol.picture:
            continue
        height, width = len(symbol.picture), len(symbol.picture[0])
        picture = symbol.pattern((height, width))
        for feature in sorted(drawing.features.get(symbol.name, ()), key=lambda f: not f.name):
            pin = _pin_of(drawing, feature)
            if pin is None:
                continue
            drawing.seen[symbol.name] += 1
            starts = np.argwhere(board.fits(height, width, ~board.blocked()))
            distance = np.abs(starts - np.subtract(pin, (height // 2, width // 2))).max(axis=1)
            if not len(starts) or distance.min() > board.rules.displacement_pins:
                continue
            row, column = starts[distance.argmin()]
            place, raised = np.zeros(board.shape, np.bool_), np.zeros(board.shape, np.bool_)
            place[row : row + height, column : column + width] = True
            raised[row : row + height, column : column + width] = picture
            board.put(Placed(symbol.name, "point", (feature.name,) * bool(feature.name)), place, raised)
            drawing.drawn[symbol.name] += 1
            drawing.request(feature, place)


def _request_texts(drawing: _Drawing) -> None:
    """Ask for the texts of a drawing."""
    for feature in drawing.features.get(TEXT, ()):
        pin = _pin_of(drawing, feature)
        if pin is not None:
            mask = np.zeros(drawing.board.shape, np.bool_)
            mask[pin] = True
            drawing.request(feature, mask)


# -- areas -------------------------------------------------------------------------------------------------
def _area_masks(drawing: _Drawing) -> dict[str, list[tuple[Feature, Bools]]]:
    """Return the pins of each feature of the textured areas, and ask for their labels."""
    masks = {}
    for symbol in symbols().values():
        if symbol.texture and not symbol.is_solid:
            masks[symbol.name] = _masks_of(drawing, symbol)
            for feature, mask in masks[symbol.name]:
                drawing.request(feature, mask)
    return masks


def _masks_of(drawing: _Drawing, symbol: Symbol) -> list[tuple[Feature, Bools]]:
    shape, to_pins = drawing.board.shape, drawing.window.to_pins
    masks = [
        (feature, fill([to_pins(ring) for ring in feature.parts], *shape))
        for feature in drawing.features.get(symbol.name, ())
    ]
    for line in symbols().values():
        if line.widens == symbol.name and line.name in drawing.features:
            streams = drawing.features[line.name]
            free = np.zeros(shape, np.bool_)
            network = network_of(streams, line, drawing.window, free, drawing.board.rules.line_pins)
            size = np.ones((drawing.board.rules.symbol_pins,) * 2, np.bool_)
            masks += [(f, np.asarray(ndimage.binary_dilation(pins, size))) for f, pins in network.drawn]
    return masks


def _draw_areas(
    drawing: _Drawing,
    *,
    is_solid: bool,
    masks: Mapping[str, list[tuple[Feature, Bools]]] | None = None,
) -> None:
    board = drawing.board
    for symbol in symbols().values():
        if not symbol.texture or symbol.is_solid != is_solid:
            continue
        found = _masks_of(drawing, symbol) if masks is None else masks[symbol.name]
        blocked = board.blocked()
        whole = np.zeros(board.shape, np.bool_)
        for _, mask in found:
            whole |= mask
        smallest = np.ones((board.rules.symbol_pins,) * 2, np.bool_)
        whole = np.asarray(ndimage.binary_opening(whole & ~blocked, smallest))
        texture, kept = symbol.pattern(board.shape), np.zeros(board.shape, np.bool_)
        for part in parts_of(whole):
            if _is_texture(part & texture):
                names = tuple(dict.fromkeys(f.name for f, mask in found if f.name and (mask & part).any()))
                board.put(Placed(symbol.name, "area", names), part, texture)
                kept |= part
        for feature, mask in found:
            if mask.any() or _touches(drawing, feature):
                drawing.seen[feature.kind] += 1
                drawing.drawn[feature.kind] += bool((mask & kept).any())
            if is_solid:
                drawing.request(feature, mask & kept)


def _is_texture(felt: Bools) -> bool:
    """True if raised pins are felt as a texture: a single row of them would be felt as a line."""
    rows, columns = np.nonzero(felt)
    return len(rows) >= MIN_TEXTURE_PINS and min(len(set(rows)), len(set(columns))) > 1


def _touches(drawing: _Drawing, feature: Feature) -> bool:
    """True if a point of a feature lies in the window."""
    pins = np.concatenate([drawing.window.to_pins(part) for part in feature.parts])
    return bool(((pins >= 0) & (pins <= np.subtract(drawing.board.shape, 1))).all(axis=1).any())


# -- relief ------------------------------------------------------------------------------------------------
def _draw_contours(drawing: _Drawing, relief: Relief) -> tuple[int, int]:
    """Draw contour lines where nothing else is; returns their pins in the window, and those drawn."""
    board, symbol = drawing.board, relief_symbol()
    min_pins = max(board.rules.line_pins, (MIN_CONTOUR_PINS - 1) * (symbol.on + symbol.off) + 1)
    features = relief.contours(drawing.window)
    network = network_of(features, symbol, drawing.window, board.blocked(), min_pins)
    raised = dashes(network.pins, symbol.on, symbol.off)
    for feature, pins in network.drawn:
        drawing.note_name(feature, pins & network.pins)
    for part in parts_of(network.pins):
        names = {f.name: None for f, pins in network.drawn if (pins & part).any()}
        board.put(Placed(RELIEF, "line", tuple(names)), part, raised)
    anywhere = np.zeros(board.shape, np.bool_)
    for feature in features:
        for path in trace(drawing.window.to_pins(feature.parts[0]), *board.shape):
            anywhere[tuple(path.T)] = True
    return int(anywhere.sum()), int(network.pins.sum())
