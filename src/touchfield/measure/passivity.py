"""Measures whether a field can give energy to a hand: its curl, and the work around closed loops. A field
without curl gives none.

The paper calls a mapping "passive" when it creates no information (eq. 1). This does not concern energy: a
field gives none to a hand that moves in a closed loop if and only if the integral of F dl vanishes around
every loop, that is, if its curl is zero. Penalty forces of a distance are conservative, but quantising their
directions, resampling them or clipping components makes them non-conservative, and the hand can then extract
the work of a loop from the device again and again.

Two measures, both of the field as rendered by trilinear interpolation (`ForceField.sample_n`):

* the curl at lattice points, by central differences, relative to the gradient;
* the work around each square of four lattice edges, by the trapezoid rule, which is exact for that
  interpolation. The work around a loop of lattice edges is the sum over the squares within it.

Only loops and stencils entirely within the support count. At the edge of a wall the stored field ends in a
step of one spacing, an artefact of the lattice that would dominate the result. `loop_work_j` includes this
step, as a hand would, for any closed path. It uses Gauss's rule on each piece between two lattice planes,
where F is at most cubic along a line, so that the rule is exact, too (up to the float32 of the forces).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from touchfield.arrays import Float64s, Int64s
from touchfield.compute.threads import for_chunks
from touchfield.errors import InvalidArgument
from touchfield.measure.quantity import Report
from touchfield.medium.field import ForceField, neighbour_slots
from touchfield.medium.grid import Grid

_PIECES_AT_ONCE: Final = 1 << 19
_MAX_SPACINGS: Final = (
    1e9  # spacings from the grid; farther away a path could not be cut precisely at the lattice planes
)
_SHORTEST: Final = 1e-13  # fraction of a segment; smaller pieces are rounding
_GAUSS: Final = (0.5 - math.sqrt(1 / 12), 0.5 + math.sqrt(1 / 12))  # two points, exact for cubics


def loop_work_j(force_field: ForceField, path_m: ArrayLike) -> float:
    """Return the work of a field around a closed polyline, joules.

    It is exact for `ForceField.sample_n`. `path_m` float [n, 3]: corners in metres, at least three; the last
    is joined to the first. There is no force beyond the grid. InvalidArgument if there are fewer corners, or
    one is not finite or 10^9 spacings away.
    """
    path = np.asarray(path_m, np.float64)
    if path.ndim != 2 or path.shape[1] != 3 or len(path) < 3:
        raise InvalidArgument("path_m", f"shape {path.shape}", "[n, 3] with n at least 3")
    with np.errstate(over="ignore", invalid="ignore"):
        is_far = ~(np.abs(force_field.grid.to_index(path)) < _MAX_SPACINGS).all(axis=1)
    if is_far.any():
        raise InvalidArgument(
            "path_m", f"corner {path[is_far][0].tolist()}", "finite metres, not far from the grid"
        )
    grid = force_field.grid
    starts = grid.to_index(path)
    stops = np.roll(starts, -1, axis=0)
    steps_m = (stops - starts) * np.asarray(grid.spacing_m)
    works = np.zeros(len(starts))
    for segment, low, high in _pieces(starts, stops, grid.shape):
        for node in _GAUSS:
            position = starts[segment] + (low + node * (high - low))[:, None] * (
                stops[segment] - starts[segment]
            )
            forces = force_field.sample_n(grid.to_m(position)).astype(np.float64)
            power = (forces * steps_m[segment]).sum(axis=1) * (high - low) / 2
            works += np.bincount(segment, power, minlength=len(starts))
    return float(works.sum())


def _pieces(
    starts: Float64s, stops: Float64s, shape: tuple[int, int, int]
) -> Iterator[tuple[Int64s, Float64s, Float64s]]:
    """Cut segments [n, 3] at lattice planes.

    Yields for each piece its segment, and its start and stop as fractions of it. Beyond one sample from the
    grid there is no force, and segments are not cut. The number of pieces at a time is bounded.
    """
    low, high = np.minimum(starts, stops), np.maximum(starts, stops)
    first = np.maximum(np.floor(low) + 1, -1).astype(np.int64)
    last = np.minimum(np.ceil(high) - 1, shape).astype(np.int64)
    counts = np.maximum(last - first + 1, 0)
    turn = np.cumsum(counts.sum(axis=1) + 1) // _PIECES_AT_ONCE
    for part in np.split(np.arange(len(starts)), np.flatnonzero(np.diff(turn)) + 1):
        segments, fractions = [part, part], [np.zeros(len(part)), np.ones(len(part))]
        for axis in range(3):
            n = counts[part, axis]
            owner = np.repeat(part, n)
            plane = first[owner, axis] + np.arange(len(owner)) - np.repeat(np.cumsum(n) - n, n)
            start, stop = starts[owner, axis], stops[owner, axis]
            segments.append(owner)
            fractions.append(np.clip((plane - start) / (stop - start), 0, 1))
        segment, fraction = np.concatenate(segments), np.concatenate(fractions)
        order = np.lexsort((fraction, segment))
        segment, fraction = segment[order], fraction[order]
        is_piece = (segment[1:] == segment[:-1]) & (fraction[1:] - fraction[:-1] > _SHORTEST)
        yield segment[:-1][is_piece], fraction[:-1][is_piece], fraction[1:][is_piece]


@dataclass(frozen=True)
class Passivity(Report):
    """Deviation of a field from a conservative one.

    Values are NaN without a stencil, for a reason given in `notes`. `support_count`: L, samples whose force
    is not zero. `points`: samples with a curl; `share_seen`: `points` over L. `rms_curl_n_per_m`,
    `worst_curl_n_per_m`: of the length of the curl. `rms_gradient_n_per_m`: of the Frobenius norm of
    dF_i/dx_j. `relative_curl`: rms curl / (sqrt 2 rms gradient), the rotational fraction of the gradient: 0
    for a conservative field, 1 for a pure rotation. `squares`: number of squares of lattice edges;
    `rms_square_j`, `worst_square_j`: the work around them (in the better of the two senses), joules.
    """

    support_count: int
    points: int
    share_seen: float
    rms_curl_n_per_m: float
    worst_curl_n_per_m: float
    rms_gradient_n_per_m: float
    relative_curl: float
    squares: int
    rms_square_j: float
    worst_square_j: float
    notes: tuple[str, ...] = ()


def passivity(force_field: ForceField) -> Passivity:
    """Measure the curl of a field, and the work around lattice squares.

    The result has the same bits for any number of threads. InvalidArgument if the field is empty.
    """
    from touchfield.measure.kernels import curl_and_squares

    if not force_field.support_count:
        raise InvalidArgument("force_field", "a field without any force", "a support of at least one sample")
    grid = force_field.grid
    bricks = force_field.bricks
    slots = neighbour_slots(bricks, bricks, grid.brick_shape).astype(np.int32)
    rows = np.zeros((len(bricks), 7))
    spacing_m = np.array(grid.spacing_m)
    for_chunks(curl_and_squares, len(bricks), slots, spacing_m, force_field.forces_n, rows, chunk=32)
    points, curl2, gradient2, squares, work2 = rows[:, :5].sum(axis=0).tolist()
    curl2_max, work_max = rows[:, 5:].max(axis=0).tolist()
    rms_curl, rms_gradient = _rms(curl2, points), _rms(gradient2, points)
    return Passivity(
        support_count=force_field.support_count,
        points=int(points),
        share_seen=points / force_field.support_count,
        rms_curl_n_per_m=rms_curl,
        worst_curl_n_per_m=math.sqrt(curl2_max) if points else math.nan,
        rms_gradient_n_per_m=rms_gradient,
        relative_curl=rms_curl / (math.sqrt(2) * rms_gradient) if rms_gradient else 0.0,
        squares=int(squares),
        rms_square_j=_rms(work2, squares),
        worst_square_j=work_max if squares else math.nan,
        notes=_notes(force_field.grid, int(points), int(squares)),
    )


def _rms(square_sum: float, count: float) -> float:
    return math.sqrt(square_sum / count) if count else math.nan


def _notes(grid: Grid, points: int, squares: int) -> tuple[str, ...]:
    notes = []
    if not points:
        thin = [f"{name} has {n}" for name, n in zip("xyz", grid.shape, strict=True) if n < 3]
        why = (
            f"the lattice is too thin (axis {', '.join(thin)} samples)" if thin else "the support is too thin"
        )
        notes.append(f"no curl: no sample has neighbours along all three axes; {why}")
    if not squares:
        notes.append("no square: no four neighbouring samples lie in the support")
    return tuple(notes)
