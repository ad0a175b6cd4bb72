"""Draws the lines of one class as a network of paths one pin wide, in which no two lines merge.

Lines are drawn from the longest to the shortest. Where a line comes so close to the network that the two
would be felt as one, it follows the network if they are joined there, and is cut if they are not: a bridge is
a gap, and the carriageways of a road are one line. Spurs and pieces shorter than a line can be are left out.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy import ndimage

from touchfield.arrays import Bools, Int64s
from touchfield.maps.board import AROUND, parts_of
from touchfield.maps.features import Feature
from touchfield.maps.pins import Window, trace
from touchfield.maps.symbols import Symbol

_MAX_PASSES = 4
"""Of pruning: a spur of a spur of a spur."""


@dataclass
class Network:
    """The lines of a class on the pins.

    pins : bool [rows, columns]; One pin wide.
    drawn : list of (Feature, Bools); Each line and its own pins.
    """

    pins: Bools
    drawn: list[tuple[Feature, Bools]] = field(default_factory=list)


def network_of(
    features: Sequence[Feature], symbol: Symbol, window: Window, blocked: Bools, min_pins: int
) -> Network:
    """Draw the lines of a class where the display is not `blocked`, none shorter than `min_pins`."""
    network = Network(np.zeros((window.rows, window.columns), np.bool_))
    traced = [(feature, _paths(feature, window)) for feature in features]
    traced.sort(key=lambda item: -sum(map(len, item[1])))
    vertices: set[tuple[float, float]] = set()
    for feature, paths in traced:
        own = {(float(x), float(y)) for part in feature.parts for x, y in np.round(part, 6)}
        joints = None if symbol.joins == "touch" else _joints(own & vertices, window)
        vertices |= own
        near = np.asarray(ndimage.binary_dilation(network.pins, AROUND))
        mask = np.zeros_like(network.pins)
        for path in paths:
            for piece in _pieces(path, ~blocked[tuple(path.T)]):
                for kept in _apart(piece, near[tuple(piece.T)], joints):
                    mask[tuple(kept.T)] = True
        network.pins |= mask
        network.drawn.append((feature, mask))
    thin(network.pins)
    prune(network.pins, min_pins)
    return network


def _paths(feature: Feature, window: Window) -> list[Int64s]:
    return [
        path for part in feature.parts for path in trace(window.to_pins(part), window.rows, window.columns)
    ]


def _joints(vertices: set[tuple[float, float]], window: Window) -> Bools:
    """Return the pins at and around vertices."""
    mask = np.zeros((window.rows, window.columns), np.bool_)
    if vertices:
        pins = np.rint(window.to_pins(np.array(sorted(vertices)))).astype(np.int64)
        is_inside = ((pins >= 0) & (pins < mask.shape)).all(axis=1)
        mask[tuple(pins[is_inside].T)] = True
    return np.asarray(ndimage.binary_dilation(mask, AROUND))


def _pieces(path: Int64s, is_kept: Bools) -> list[Int64s]:
    """Return the runs of a path that are kept."""
    edges = np.flatnonzero(np.diff(is_kept.astype(np.int8), prepend=0, append=0))
    return [path[start:stop] for start, stop in zip(edges[::2], edges[1::2])]


def _apart(piece: Int64s, is_near: Bools, joints: Bools | None) -> list[Int64s]:
    """Return the parts of a piece that are drawn beside a network that it is near in places.

    Where the two are joined, the last pin that is near stays: it touches the network.
    """
    is_kept = ~is_near
    edges = np.flatnonzero(np.diff(is_near.astype(np.int8), prepend=0, append=0))
    for start, stop in zip(edges[::2], edges[1::2]):
        if joints is None or joints[tuple(piece[start:stop].T)].any():
            is_kept[start] |= start > 0
            is_kept[stop - 1] |= stop < len(piece)
    return _pieces(piece, is_kept)


def thin(mask: Bools) -> None:
    """Remove pins until no four form a square; lines stay connected unless only a cut removes a square."""
    while True:
        squares = np.argwhere(mask[:-1, :-1] & mask[1:, :-1] & mask[:-1, 1:] & mask[1:, 1:])
        if not len(squares):
            return
        for row, column in squares:
            corners = [(row, column), (row, column + 1), (row + 1, column), (row + 1, column + 1)]
            if all(mask[corner] for corner in corners):
                removable = [corner for corner in corners if _is_simple(mask, *corner)]
                mask[(removable or corners)[0]] = False


def _is_simple(mask: Bools, row: int, column: int) -> bool:
    """True if the neighbours of a pin stay connected without it."""
    around = np.zeros((3, 3), np.bool_)
    top, left = max(row - 1, 0), max(column - 1, 0)
    part = mask[top : row + 2, left : column + 2]
    around[top - row + 1 :, left - column + 1 :][: part.shape[0], : part.shape[1]] = part
    around[1, 1] = False
    return int(ndimage.label(around, AROUND)[1]) == 1


def prune(mask: Bools, min_pins: int) -> None:
    """Remove spurs and separate pieces of fewer pins than `min_pins`."""
    for _ in range(_MAX_PASSES):
        spurs = [spur for end in ends_of(mask) if (spur := _spur(mask, end, min_pins))]
        if not spurs:
            break
        for spur in spurs:
            mask[tuple(np.array(spur).T)] = False
    for part in parts_of(mask):
        if part.sum() < min_pins:
            mask[part] = False


def _neighbours(mask: Bools, pin: tuple[int, int]) -> list[tuple[int, int]]:
    row, column = pin
    return [
        (r, c)
        for r in range(max(row - 1, 0), min(row + 2, mask.shape[0]))
        for c in range(max(column - 1, 0), min(column + 2, mask.shape[1]))
        if mask[r, c] and (r, c) != pin
    ]


def ends_of(mask: Bools) -> list[tuple[int, int]]:
    """Return the pins of a network that have one neighbour."""
    count = ndimage.convolve(mask.astype(np.int8), AROUND.astype(np.int8), mode="constant")
    return [(int(r), int(c)) for r, c in np.argwhere(mask & (count == 2))]


def _spur(mask: Bools, end: tuple[int, int], min_pins: int) -> list[tuple[int, int]]:
    """Return the pins from an end to where the network branches; none if these are enough for a line."""
    walked, pin = [end], end
    while len(walked) < min_pins:
        ahead = [other for other in _neighbours(mask, pin) if other not in walked]
        if len(ahead) > 1:
            return walked[:-1]
        if not ahead:
            return []
        pin = ahead[0]
        walked.append(pin)
    return []


def dashes(mask: Bools, on: int, off: int) -> Bools:
    """Return the pins of a network that are up: `on` of them, then `off` down, from an end of each part.

    A rest that is shorter than a dash is down, unless it is all of its part.
    """
    if not off:
        return mask
    raised = np.zeros_like(mask)
    for part in parts_of(mask):
        first = np.argwhere(part)[0]
        start = next(iter(ends_of(part)), (int(first[0]), int(first[1])))
        depths = {start: 0}
        queue = deque([start])
        while queue:
            pin = queue.popleft()
            raised[pin] = depths[pin] % (on + off) < on
            for other in _neighbours(part, pin):
                if other not in depths:
                    depths[other] = depths[pin] + 1
                    queue.append(other)
        found = parts_of(raised & part) if on > 1 else []
        rests = [dash for dash in found if dash.sum() < on]
        for rest in rests if len(rests) < len(found) else []:
            raised[rest] = False
    return raised
