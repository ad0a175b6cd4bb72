"""Geometry on the pins of a display: where an area, a line and a window lie on rows and columns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Bools, Float64s, Int64s
from touchfield.errors import InvalidArgument


@dataclass(frozen=True)
class Window:
    """The part of a map that a display shows.

    west, north : float; Coordinates of the pin in row 0 and column 0.
    step : float; Distance between neighbouring pins, in the unit of the coordinates.
    rows, columns : int
    """

    west: float
    north: float
    step: float
    rows: int
    columns: int

    @classmethod
    def around(cls, low: Float64s, high: Float64s, rows: int, columns: int) -> Window:
        """Return the window that shows a box as large as possible, in the middle.

        A box without an extent gets one unit. Raises `InvalidArgument` for a box that is not finite.
        """
        extent = np.asarray(high, np.float64) - np.asarray(low, np.float64)
        if not np.isfinite(extent).all() or (extent < 0).any() or np.abs([low, high]).max() > 1e12:
            raise InvalidArgument("box", f"from {low} to {high}", "finite coordinates, the lower ones first")
        step = float(max(extent[0] / max(columns - 1, 1), extent[1] / max(rows - 1, 1))) or 1.0 / columns
        middle = (np.asarray(low) + np.asarray(high)) / 2
        west = float(middle[0] - step * (columns - 1) / 2)
        return cls(west, float(middle[1] + step * (rows - 1) / 2), step, rows, columns)

    def to_pins(self, points: Float64s) -> Float64s:
        """Return (row, column) of points, float64 [n, 2]."""
        return np.stack([(self.north - points[:, 1]) / self.step, (points[:, 0] - self.west) / self.step], 1)


def fill(rings: list[Float64s], rows: int, columns: int) -> Bools:
    """Return the pins whose centre lies inside an odd number of rings, bool [rows, columns].

    `rings` are (row, column) [n, 2] each, open or closed, and may cross themselves.
    """
    edges = [_edges(ring) for ring in rings]
    start, stop = np.concatenate([e[0] for e in edges]), np.concatenate([e[1] for e in edges])
    inside = np.zeros((rows, columns), np.bool_)
    first = max(0, int(np.ceil(max(min(start[:, 0].min(), stop[:, 0].min()), 0.0))))
    last = min(rows - 1, int(np.floor(min(max(start[:, 0].max(), stop[:, 0].max()), float(rows)))))
    for row in range(first, last + 1):
        crosses = (start[:, 0] <= row) != (stop[:, 0] <= row)
        a, b = start[crosses], stop[crosses]
        at = np.sort(a[:, 1] + (row - a[:, 0]) / (b[:, 0] - a[:, 0]) * (b[:, 1] - a[:, 1]))
        inside[row] = np.searchsorted(at, np.arange(columns), "right") % 2 == 1
    return inside


def _edges(ring: Float64s) -> tuple[Float64s, Float64s]:
    return ring, np.roll(ring, -1, axis=0)


def trace(line: Float64s, rows: int, columns: int) -> list[Int64s]:
    """Return the pins along a line as paths of neighbours, (row, column) int64 [n, 2] each.

    `line` is (row, column) [n, 2]; vertices that follow each other on one pin count once. A path ends where
    the line leaves the display. Neighbours touch by a side or a corner, and a path cuts corners.
    """
    moves = (np.diff(np.rint(line), axis=0) != 0).any(axis=1)
    line = line[np.concatenate([[True], moves])]
    line = line if len(line) > 1 else np.repeat(line, 2, axis=0)
    start, stop, is_inside = _clipped(line[:-1], line[1:], rows, columns)
    start, stop = start[is_inside], stop[is_inside]
    ends = np.rint(np.stack([start, stop], axis=1)).astype(np.int16)
    is_short = np.abs(stop - start).max(axis=1) <= 1  # as those of a contour line: no pin between its ends
    pieces = [ends[n] if short else _straight(start[n], stop[n]) for n, short in enumerate(is_short.tolist())]
    if not pieces:
        return []
    pins = np.concatenate(pieces)
    steps = np.abs(np.diff(pins, axis=0)).max(axis=1)
    pins, steps = pins[np.concatenate([[True], steps > 0])], steps[steps > 0]
    return [_without_corners(path) for path in np.split(pins, 1 + np.flatnonzero(steps > 1))]


def _without_corners(path: Int64s) -> Int64s:
    """Return a path without the pins whose neighbours touch each other."""
    path = path.astype(np.int64)
    is_corner = np.zeros(len(path), np.bool_)
    is_corner[1:-1] = np.abs(path[2:] - path[:-2]).max(axis=1) <= 1
    for n in np.flatnonzero(is_corner):  # of corners in a row every other one is cut
        is_corner[n] = not is_corner[n - 1]
    path = path[~is_corner]
    is_new = np.ones(len(path), np.bool_)
    is_new[1:] = (np.diff(path, axis=0) != 0).any(axis=1)  # a line may turn back
    return np.asarray(path[is_new])


def _straight(start: Float64s, stop: Float64s) -> NDArray[np.int16]:
    """Return the pins of a straight piece within the display."""
    count = int(np.ceil(np.abs(stop - start).max())) + 1
    return np.rint(np.linspace(start, stop, count)).astype(np.int16)


def _clipped(start: Float64s, stop: Float64s, rows: int, columns: int) -> tuple[Float64s, Float64s, Bools]:
    """Clip pieces of a line to the display (Liang and Barsky); returns ends and which are inside."""
    first, last = np.zeros(len(start)), np.ones(len(start))
    step = stop - start
    is_inside = np.ones(len(start), np.bool_)
    for axis, high in ((0, rows - 0.51), (1, columns - 0.51)):
        for sign, distance in ((-1, start[:, axis] + 0.49), (1, high - start[:, axis])):
            speed = sign * step[:, axis]
            with np.errstate(divide="ignore", invalid="ignore"):
                at = distance / speed
            first = np.where(speed < 0, np.maximum(first, at), first)
            last = np.where(speed > 0, np.minimum(last, at), last)
            is_inside &= (speed != 0) | (distance >= 0)
    is_inside &= first <= last
    return start + first[:, None] * step, start + last[:, None] * step, is_inside
