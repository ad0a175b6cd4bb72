"""Energy that a field could feed to a hand: curl, and work around closed loops (theory: apart from eq. 1).

The paper calls a mapping "passive" when it creates no information (eq. 1). That says nothing of energy: a field gives
none to a hand that moves in a circle if and only if the integral of F dl vanishes around every closed loop, that is,
if its curl is zero. Penalty forces of a distance are such fields; quantising their directions, resampling them and
clipping components is not, and what a loop gains a hand can pump out of the device, again and again.

Three looks, all of the field as a renderer that interpolates trilinearly (`ForceField.sample_n`) plays it:

* the curl at lattice points, by central differences, beside the gradient;
* the work around each square of four lattice edges, by the trapezoid rule, which is exact for that interpolation;
* the work around random closed loops, by Gauss's rule on each piece between two lattice planes, where F is cubic at
  most along a line, so that the rule is exact, too (but for the float32 of the forces).

Only what lies wholly within the support is looked at. At the edge of a wall the stored field ends in a step of one
spacing, which is the lattice's doing and not the wall's, and would drown all else; `loop_work_j` counts it, as the
hand would.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from touchfield.arrays import Bools, Float64s, Int64s
from touchfield.errors import InvalidArgument
from touchfield.medium.field import ForceField, frozen, slots_around, values_at
from touchfield.medium.grid import BRICK, Grid

_MOST_LOOPS: Final = 1 << 12
_CORNERS: Final = 16  # of a random loop
_CANDIDATES: Final = 8  # centres drawn for each loop; one whose own cell leaves the support is passed over
_ROUNDS: Final = 12  # times that a loop which leaves the support is halved before it is given up
_PIECES_AT_ONCE: Final = 1 << 19
_FAR: Final = 1e9  # spacings from the grid; beyond it a path could not be cut precisely at the lattice planes
_SHORTEST: Final = 1e-13  # share of a segment; less is rounding
_GAUSS: Final = (0.5 - math.sqrt(1 / 12), 0.5 + math.sqrt(1 / 12))  # two points, exact for cubics


def loop_work_j(force_field: ForceField, path_m: ArrayLike) -> float:
    """The work of a field on a hand that goes once round a closed polyline, joules, exact for `ForceField.sample_n`.

    `path_m` float [n, 3]: corners in metres, at least three; the last is joined to the first. Beyond the grid there
    is no force. InvalidArgument if there are fewer corners, or one is not finite or 10^9 spacings away.
    """
    path = np.asarray(path_m, np.float64)
    if path.ndim != 2 or path.shape[1] != 3 or len(path) < 3:
        raise InvalidArgument("path_m", f"shape {path.shape}", "[n, 3] with n at least 3")
    with np.errstate(over="ignore", invalid="ignore"):
        far = ~(np.abs(force_field.grid.to_index(path)) < _FAR).all(axis=1)
    if far.any():
        raise InvalidArgument("path_m", f"corner {path[far][0].tolist()}", "finite metres, not far from the grid")
    return float(_works_j(force_field, path[None])[0])


def _random_loops(force_field: ForceField, loops: int, rng: np.random.Generator) -> Float64s:
    """Corners in metres, float64 [up to loops, 16, 3]."""
    spacing = np.asarray(force_field.grid.spacing_m)
    index, forces = _random_samples(force_field, loops * _CANDIDATES, rng)
    places = index + rng.uniform(-1, 1, index.shape)
    some = _cells_held(force_field, places)
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
    fits = np.zeros(loops, np.bool_)
    for _ in range(_ROUNDS):
        left = np.flatnonzero(~fits)
        fits[left] = _fit(force_field, centres[left, None] + stars[left])
        stars[~fits] /= 2
    return np.asarray(centres[fits, None] + stars[fits])


def _random_samples(force_field: ForceField, count: int, rng: np.random.Generator) -> tuple[Int64s, Float64s]:
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


def _fit(force_field: ForceField, paths_m: Float64s) -> Bools:
    """True where all cells that a path of [p, v, 3] crosses have their eight corners in the support, bool [p]."""
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


def _cells_held(force_field: ForceField, index: Float64s) -> Bools:
    """True where the eight lattice points around fractional indices [m, 3] are in the support, bool [m]."""
    low, is_held = np.floor(index).astype(np.int64), np.ones(len(index), np.bool_)
    for corner in np.ndindex(2, 2, 2):
        there = np.flatnonzero(is_held)
        is_held[there] = values_at(force_field.grid, force_field.bricks, force_field.mask, low[there] + corner)
    return is_held


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
) -> Iterator[tuple[Int64s, Float64s, Float64s]]:
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


@dataclass(frozen=True)
class Passivity:
    """How far a field is from conservative; NaN where nothing could be seen, `notes` then say why.

    `support_count`: L, samples whose force is not zero; `points`: samples at which a curl was taken; `share_seen`:
    the supported ones among them over L. `rms_curl_n_per_m`, `worst_curl_n_per_m`: of the length of the curl;
    `rms_gradient_n_per_m`: of the Frobenius norm of dF_i/dx_j; `relative_curl`: rms curl / (sqrt 2 rms gradient), the
    share of the gradient that turns: 0 conservative, 1 a pure rotation. `squares` of lattice edges, and the work
    around them, `rms_square_j`, `worst_square_j`, joules. `loops`: random loops that were run round; `worst_loop_j`:
    the greatest energy that one round of them gains (in the better of the two senses), joules; `worst_loop_m` float64
    [16, 3]: its corners in that sense, metres, [0, 3] if there is none.
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
    loops: int
    worst_loop_j: float
    worst_loop_m: Float64s = field(compare=False, repr=False)
    notes: tuple[str, ...] = ()

    def summary(self) -> dict[str, Any]:
        """Stable keys for people and programs; NaN becomes None, and the loop itself is left out."""
        table: dict[str, Any] = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "worst_loop_m"}
        table["notes"] = list(self.notes)
        return {k: None if isinstance(v, float) and math.isnan(v) else v for k, v in table.items()}


def passivity(force_field: ForceField, loops: int = 256, seed: int = 0) -> Passivity:
    """Curl, and work around closed loops, of a field; the same bits for any number of threads.

    `loops`: random loops, 0 to 4096, with `seed`. Each is a star of 16 corners around a supported sample, half of
    them in the plane across the force (where a conservative wall does no work at all), up to half the size of the
    support; one that leaves it is halved until it fits, or given up. InvalidArgument if the field is empty, or a
    number is out of range.
    """
    from touchfield.measure.kernels import curl_and_loops

    if isinstance(loops, bool) or not isinstance(loops, int) or not 0 <= loops <= _MOST_LOOPS:
        raise InvalidArgument("loops", repr(loops), f"0 to {_MOST_LOOPS}")
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise InvalidArgument("seed", repr(seed), "a whole number, 0 or more")
    if not force_field.support_count:
        raise InvalidArgument("force_field", "a field without any force", "a support of at least one sample")
    grid = force_field.grid
    bricks = force_field.bricks
    slots = slots_around(bricks, bricks, grid.brick_shape).astype(np.int32)
    rows = curl_and_loops(grid, slots, force_field.forces_n)
    points, curl2, gradient2, squares, work2 = rows[:, :5].sum(axis=0).tolist()
    curl2_max, work_max = rows[:, 5:].max(axis=0).tolist()
    paths = _random_loops(force_field, loops, np.random.default_rng(seed))
    works = _works_j(force_field, paths) if len(paths) else np.zeros(0)
    best = int(np.argmax(np.abs(works))) if len(paths) else 0
    loop = paths[best] if len(paths) else np.zeros((0, 3))
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
        loops=len(paths),
        worst_loop_j=float(abs(works[best])) if len(paths) else math.nan,
        worst_loop_m=frozen(loop[::-1].copy() if len(paths) and works[best] < 0 else loop),
        notes=_notes(force_field.grid, int(points), int(squares), len(paths), loops),
    )


def _rms(square_sum: float, count: float) -> float:
    return math.sqrt(square_sum / count) if count else math.nan


def _notes(grid: Grid, points: int, squares: int, kept: int, asked: int) -> tuple[str, ...]:
    notes = []
    if not points:
        thin = [f"{name} has {n}" for name, n in zip("xyz", grid.shape, strict=True) if n < 3]
        why = f"the lattice is too thin (axis {', '.join(thin)} samples)" if thin else "the support is too thin"
        notes.append(f"no curl: no sample has neighbours along all three axes; {why}")
    if not squares:
        notes.append("no square: no four neighbouring samples lie in the support")
    if kept < asked:
        notes.append(f"{kept} of {asked} random loops fit into the support")
    if not asked:
        notes.append("no random loop was asked for")
    return tuple(notes)
