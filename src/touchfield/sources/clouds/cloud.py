"""`Cloud`: the points of a file, with what it tells about the side from which they were seen."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Bools, Float32s, Float64s, Int64s
from touchfield.errors import SourceError
from touchfield.medium.budget import require_memory
from touchfield.sources.scene import UP_Y_AXES

MIN_POINTS: Final = 16
BYTES_PER_POINT: Final = 3 * 8 + 3 * 4
_CHUNK: Final = 1 << 20
_MAX_EXACT: Final = 1 << 21  # points whose duplicates are looked for
_UNIT_LENGTH: Final = 0.1  # by which the length of a normal may differ from 1 in columns without names
_LESS: Final = "Thin the cloud out, cut it, or set TOUCHFIELD_MEMORY_GIB."


@dataclass(frozen=True)
class Cloud:
    """Points in the units of their file.

    points : float64 [n, 3].
    normals : float32 [n, 3], or [0, 3] if the file has none; of any length, 0 where unknown.
    scanners : tuple of (start, stop, position); Points start to stop - 1 were seen from a position float64
        [3].
    side : str; Facing of the surface if nothing tells it: "outward" or "up".
    unit_m : float or None; Metres of one unit, if the file states it.
    axes : str; As of `Scene`.
    notes : tuple of str.
    """

    points: Float64s
    normals: Float32s = field(default_factory=lambda: np.zeros((0, 3), np.float32))
    scanners: tuple[tuple[int, int, Float64s], ...] = ()
    side: str = "outward"
    unit_m: float | None = None
    axes: str = UP_Y_AXES
    notes: tuple[str, ...] = ()

    def selected(self, is_kept: Bools) -> Cloud:
        """Return the cloud of the points where `is_kept`, bool [n]."""
        before = np.append(0, np.cumsum(is_kept))
        scanners = tuple((int(before[start]), int(before[stop]), at) for start, stop, at in self.scanners)
        normals = self.normals[is_kept] if len(self.normals) else self.normals
        return replace(self, points=self.points[is_kept], normals=normals, scanners=scanners)

    def noted(self, *notes: str) -> Cloud:
        """Return the cloud with further notes; empty ones are left out."""
        return replace(self, notes=(*self.notes, *filter(None, notes)))

    def directions_to_scanner(self) -> Float32s:
        """Return unit vectors from the points to where they were seen from, float32 [n, 3]; 0 if unknown."""
        directions = np.zeros((len(self.points), 3), np.float32)
        for start, stop, position in self.scanners:
            for first in range(start, stop, _CHUNK):
                part = slice(first, min(first + _CHUNK, stop))
                directions[part] = unit_rows(position - self.points[part])
        return directions


def unit_rows(vectors: NDArray[np.floating[Any]]) -> NDArray[np.floating[Any]]:
    """Return vectors [n, 3] of length 1; 0 for those without a length, or not finite."""
    with np.errstate(all="ignore"):
        lengths = np.sqrt(np.einsum("ij,ij->i", vectors, vectors))
        scale = np.divide(1.0, lengths, out=np.zeros_like(lengths), where=lengths > 0)
        units = vectors * scale[:, None]
    units[~np.isfinite(units).all(axis=1)] = 0
    return np.asarray(units)


def are_unit(vectors: NDArray[np.floating[Any]]) -> bool:
    """Return True if vectors [n, 3] look like unit normals."""
    with np.errstate(all="ignore"):
        lengths = np.linalg.norm(vectors[:_CHUNK], axis=1)
    return bool(len(lengths) and (np.abs(lengths - 1) < _UNIT_LENGTH).mean() > 0.9)


def require_points(where: str, count: int) -> None:
    """Raise `InvalidArgument` if points would take too much memory."""
    require_memory(where, f"{count} points", count * BYTES_PER_POINT, _LESS)


def cleaned(cloud: Cloud, where: str) -> Cloud:
    """Return the cloud without points that are no numbers and without duplicates; both are noted.

    Raises `SourceError` if fewer than `MIN_POINTS` remain.
    """
    is_kept: Bools = np.asarray(np.isfinite(cloud.points).all(axis=1))
    invalid = len(is_kept) - int(np.count_nonzero(is_kept))
    if invalid:
        cloud = cloud.selected(is_kept).noted(f"{invalid} points without finite coordinates are left out.")
    if len(cloud.points) <= _MAX_EXACT:
        first = _first_of_equal(cloud.points)
        twice = len(cloud.points) - len(first)
        if twice:
            is_kept = np.zeros(len(cloud.points), np.bool_)
            is_kept[first] = True
            cloud = cloud.selected(is_kept).noted(f"{twice} points at the position of another are left out.")
    if len(cloud.points) < MIN_POINTS:
        found = f"{len(cloud.points)} points with different finite coordinates"
        raise SourceError(where, found, f"a cloud of {MIN_POINTS} or more", "Export it again.")
    return cloud


def _first_of_equal(points: Float64s) -> Int64s:
    """Return the first of all points at each position, int64."""
    rows = np.ascontiguousarray(points + 0.0).view(np.dtype((np.void, 24)))  # + 0.0: -0 is 0
    return np.asarray(np.unique(rows, return_index=True)[1], np.int64)
