"""The work of a field around closed loops, exact for the field that a renderer plays (theory: energy passivity).

`ForceField.sample_n` interpolates trilinearly, so that along a straight line between two lattice planes F is a cubic.
Each segment of a path is cut at the lattice planes, and Gauss's rule with two points integrates each piece exactly,
but for the rounding of the forces to float32. No step is to be chosen, and none can be too coarse.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.medium.field import ForceField, brick_keys
from touchfield.medium.grid import BRICK

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Float64s = NDArray[np.float64]

__all__ = ["best_loop", "loop_work_j"]

_CORNERS: Final = 16  # of a random loop
_CANDIDATES: Final = 8  # centres drawn for each loop; one whose own cell leaves the support is passed over
_ROUNDS: Final = 12  # times that a loop which leaves the support is halved before it is given up
_PIECES_AT_ONCE: Final = 1 << 19
_FAR: Final = 1e9  # spacings from the grid; beyond it a path could not be cut precisely at the lattice planes
_SHORTEST: Final = 1e-13  # share of a segment; less is rounding
_GAUSS: Final = (0.5 - math.sqrt(1 / 12), 0.5 + math.sqrt(1 / 12))  # two points, exact for cubics


def loop_work_j(force_field: ForceField, path_m: ArrayLike) -> float:
    """The work of a field on a hand that goes once round a closed polyline, joules, exact for `ForceField.sample_n`.

    Parameters
    ----------
    force_field : ForceField
    path_m : float [n, 3]
        Corners in metres, at least three; the last is joined to the first. Beyond the grid there is no force.

    Raises
    ------
    InvalidArgument
        If there are fewer than three corners, or one is not finite or 10^9 spacings away.
    """
    path = np.asarray(path_m, np.float64)
    if path.ndim != 2 or path.shape[1] != 3 or len(path) < 3:
        raise InvalidArgument("path_m", f"shape {path.shape}", "[n, 3] with n at least 3")
    with np.errstate(over="ignore", invalid="ignore"):
        far = ~(np.abs(force_field.grid.to_index(path)) < _FAR).all(axis=1)
    if far.any():
        raise InvalidArgument("path_m", f"corner {path[far][0].tolist()}", "finite metres, not far from the grid")
    return float(_works_j(force_field, path[None])[0])


def best_loop(force_field: ForceField, edges: bool, loops: int, seed: int) -> tuple[int, float, Float64s]:
    """How many random loops could be run, the most that one of them gains, and its corners."""
    rng = np.random.default_rng(seed)
    paths = _random_loops(force_field, edges, loops, rng)
    if not len(paths):
        return 0, math.nan, np.zeros((0, 3))
    works = _works_j(force_field, paths)
    best = int(np.argmax(np.abs(works)))
    path = paths[best] if works[best] >= 0 else paths[best][::-1].copy()
    return len(paths), float(abs(works[best])), path


def _random_loops(force_field: ForceField, edges: bool, loops: int, rng: np.random.Generator) -> Float64s:
    """Corners in metres, float64 [up to loops, 16, 3]."""
    spacing = np.asarray(force_field.grid.spacing_m)
    index, forces = _random_samples(force_field, loops if edges else loops * _CANDIDATES, rng)
    places = index + rng.uniform(-1, 1, index.shape)
    some = np.ones(len(places), np.bool_) if edges else _cells_held(force_field, places)
    centres, forces = force_field.grid.to_m(places[some][:loops]), forces[some][:loops]
    loops = len(centres)
    normals = rng.normal(size=(loops, 3))
    normals[::2] = forces[::2]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    u = np.cross(normals, rng.normal(size=(loops, 3)))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.cross(normals, u)
    turn = np.arange(_CORNERS) * (2 * np.pi / _CORNERS)
    stars = np.cos(turn)[:, None] * u[:, None] + np.sin(turn)[:, None] * v[:, None]
    stars *= rng.uniform(0.5, 1, (loops, _CORNERS, 1))
    bricks = force_field.bricks
    extent = np.minimum((np.ptp(bricks, axis=0) + 1) * BRICK, force_field.grid.shape) * spacing
    smallest, largest = spacing.min(), max(spacing.min(), np.linalg.norm(extent) / 2)
    stars *= np.exp(rng.uniform(np.log(smallest), np.log(largest), (loops, 1, 1)))
    if edges:
        return np.asarray(centres[:, None] + stars)
    fits = np.zeros(loops, np.bool_)
    for _ in range(_ROUNDS):
        left = np.flatnonzero(~fits)
        fits[left] = _fit(force_field, centres[left, None] + stars[left])
        stars[~fits] /= 2
    return np.asarray(centres[fits, None] + stars[fits])


def _random_samples(
    force_field: ForceField, count: int, rng: np.random.Generator
) -> tuple[NDArray[np.int64], Float64s]:
    """Supported samples, each as likely as any other: indices [count, 3] and newtons [count, 3]."""
    mask = force_field.mask.reshape(-1, BRICK**3)
    until = np.cumsum(np.count_nonzero(mask, axis=1))
    rank = rng.integers(0, until[-1], count)
    brick = np.searchsorted(until, rank, side="right")
    rank -= np.where(brick > 0, until[brick - 1], 0)
    local = (np.cumsum(mask[brick], axis=1, dtype=np.int16) == rank[:, None] + 1).argmax(axis=1)
    index = force_field.bricks[brick] * BRICK + np.stack(np.unravel_index(local, (BRICK,) * 3), axis=-1)
    forces = force_field.forces_n.reshape(-1, BRICK**3, 3)[brick, local]
    return index.astype(np.int64), forces.astype(np.float64)


def _fit(force_field: ForceField, paths_m: Float64s) -> NDArray[np.bool_]:
    """Whether all cells that each path [p, v, 3] crosses have their eight corners in the support, bool [p]."""
    index = force_field.grid.to_index(paths_m)
    corners = _cells_held(force_field, index.reshape(-1, 3)).reshape(index.shape[:2])
    fits = np.asarray(corners.all(axis=1))
    some = np.flatnonzero(fits)
    starts = index[some].reshape(-1, 3)
    ends = np.roll(index[some], -1, axis=1).reshape(-1, 3)
    for segment, begin, end in _pieces(starts, ends, force_field.grid.shape):
        middle = starts[segment] + (0.5 * (begin + end))[:, None] * (ends[segment] - starts[segment])
        out = segment[~_cells_held(force_field, middle)]
        fits[some[out // index.shape[1]]] = False
    return fits


def _cells_held(force_field: ForceField, index: Float64s) -> NDArray[np.bool_]:
    """Whether the eight lattice points around fractional indices [m, 3] are in the support, bool [m]."""
    grid = force_field.grid
    low = np.floor(index)
    held = np.asarray(((low >= 0) & (low + 1 < grid.shape)).all(axis=1))
    keys = brick_keys(grid, force_field.bricks)
    for corner in np.ndindex(2, 2, 2):
        there = np.flatnonzero(held)
        places = low[there].astype(np.int64) + corner
        wanted = brick_keys(grid, places // BRICK)
        slot = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
        x, y, z = (places % BRICK).T
        held[there] = (keys[slot] == wanted) & force_field.mask[slot, x, y, z]
    return held


def _works_j(force_field: ForceField, paths_m: Float64s) -> Float64s:
    """The work around closed paths [p, v, 3] in metres, joules, float64 [p]."""
    grid = force_field.grid
    index = grid.to_index(paths_m)
    starts, ends = index.reshape(-1, 3), np.roll(index, -1, axis=1).reshape(-1, 3)
    steps_m = (ends - starts) * np.asarray(grid.spacing_m)
    works = np.zeros(len(starts))
    for segment, begin, end in _pieces(starts, ends, grid.shape):
        for node in _GAUSS:
            place = starts[segment] + (begin + node * (end - begin))[:, None] * (ends[segment] - starts[segment])
            forces = force_field.sample_n(grid.to_m(place)).astype(np.float64)
            power = (forces * steps_m[segment]).sum(axis=1) * (end - begin) / 2
            works += np.bincount(segment, power, minlength=len(starts))
    total: Float64s = works.reshape(index.shape[:2]).sum(axis=1)
    return total


def _pieces(
    starts: Float64s, ends: Float64s, shape: tuple[int, int, int]
) -> Iterator[tuple[NDArray[np.int64], Float64s, Float64s]]:
    """Segments [n, 3] in samples, cut where they cross a lattice plane: segment, and from and to which share of it.

    Beyond one sample from the grid there is no force, and nothing to cut. A bounded number of pieces at a time.
    """
    low, high = np.minimum(starts, ends), np.maximum(starts, ends)
    first = np.maximum(np.floor(low) + 1, -1).astype(np.int64)
    last = np.minimum(np.ceil(high) - 1, shape).astype(np.int64)
    counts = np.maximum(last - first + 1, 0)
    turn = np.cumsum(counts.sum(axis=1) + 1) // _PIECES_AT_ONCE
    for part in np.split(np.arange(len(starts)), np.flatnonzero(np.diff(turn)) + 1):
        segments, shares = [part, part], [np.zeros(len(part)), np.ones(len(part))]
        for axis in range(3):
            n = counts[part, axis]
            owner = np.repeat(part, n)
            plane = first[owner, axis] + np.arange(len(owner)) - np.repeat(np.cumsum(n) - n, n)
            begin, end = starts[owner, axis], ends[owner, axis]
            segments.append(owner)
            shares.append(np.clip((plane - begin) / (end - begin), 0, 1))
        segment, share = np.concatenate(segments), np.concatenate(shares)
        order = np.lexsort((share, segment))
        segment, share = segment[order], share[order]
        whole = (segment[1:] == segment[:-1]) & (share[1:] - share[:-1] > _SHORTEST)
        yield segment[:-1][whole], share[:-1][whole], share[1:][whole]
