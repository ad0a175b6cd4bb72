"""Whether a field could feed a hand with energy: curl, and work around closed loops (theory: apart from eq. 1).

The paper calls a mapping "passive" when it creates no information (eq. 1). That says nothing of energy: a field gives
none to a hand that moves in a circle if and only if the integral of F dl vanishes around every closed loop, that is,
if its curl is zero. Penalty forces of a distance are such fields; quantising their directions, resampling them and
clipping components is not, and what a loop gains a hand can pump out of the device, again and again.

Three looks, all of the field as a renderer that interpolates trilinearly (`ForceField.sample_n`) plays it:

* the curl at lattice points, by central differences, beside the gradient;
* the work around each square of four lattice edges, by the trapezoid rule, which is exact for that interpolation;
* the work around random closed loops, by Gauss's rule on each piece between two lattice planes, where F is cubic at
  most along a line, so that the rule is exact, too (but for the float32 of the forces).

By default only what lies wholly within the support is looked at. At the edge of a wall the stored field ends in a
step of one spacing, which is the lattice's doing and not the wall's, and would drown all else; ``edges=True`` counts
it, as the hand would.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.measure.loop_work import best_loop, loop_work_j
from touchfield.medium.budget import zero_forces
from touchfield.medium.field import ForceField, brick_keys, frozen
from touchfield.medium.grid import BRICK, Grid
from touchfield.medium.neighbours import dilated, neighbour_slots

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Float64s = NDArray[np.float64]

__all__ = ["Passivity", "curl_n_per_m", "loop_work_j", "passivity"]

_MOST_LOOPS: Final = 1 << 12


@dataclass(frozen=True)
class Passivity:
    """How far a field is from conservative; NaN where nothing could be seen, `notes` then say why.

    Attributes
    ----------
    support_count : int
        L, samples whose force is not zero.
    points : int
        Samples at which a curl was taken.
    share_seen : float
        The supported samples among them over L: 1 unless edges hide some.
    rms_curl_n_per_m, worst_curl_n_per_m : float
        Of the length of the curl.
    rms_gradient_n_per_m : float
        Of the Frobenius norm of the gradient dF_i/dx_j.
    relative_curl : float
        rms curl / (sqrt 2 rms gradient), the share of the gradient that turns: 0 conservative, 1 a pure rotation.
    squares : int
        Squares of lattice edges.
    rms_square_j, worst_square_j : float
        Of the work around them, joules.
    loops : int
        Random loops that were run round.
    worst_loop_j : float
        The greatest energy that one round of them gains (in the better of the two senses), joules.
    worst_loop_m : float64 [16, 3]
        The corners of that loop in the sense that gains, metres; [0, 3] if there is none.
    edges : bool
        Whether the edges of the support were counted.
    notes : tuple of str
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
    edges: bool
    notes: tuple[str, ...] = ()

    def summary(self) -> dict[str, Any]:
        """Stable keys for people and programs; NaN becomes None, and the loop itself is left out."""
        table: dict[str, Any] = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "worst_loop_m"}
        return {k: None if isinstance(v, float) and math.isnan(v) else v for k, v in table.items()} | {
            "notes": list(self.notes)
        }


def passivity(force_field: ForceField, edges: bool = False, loops: int = 256, seed: int = 0) -> Passivity:
    """Curl, and work around closed loops, of a field.

    Parameters
    ----------
    force_field : ForceField
    edges : bool
        Count what lies half outside the support, too, with no force outside.
    loops : int
        Random loops, 0 to 4096. Each is a star of 16 corners around a supported sample, half of them in the plane
        across the force (where a conservative wall does no work at all), up to half the size of the support; one
        that leaves the support is halved until it fits, or given up.
    seed : int
        Of the loops.

    Returns
    -------
    Passivity
        The same bits for any number of threads.

    Raises
    ------
    InvalidArgument
        If the field is empty, or `loops` or `seed` is out of range.
    """
    if isinstance(loops, bool) or not isinstance(loops, int) or not 0 <= loops <= _MOST_LOOPS:
        raise InvalidArgument("loops", repr(loops), f"0 to {_MOST_LOOPS}")
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise InvalidArgument("seed", repr(seed), "a whole number, 0 or more")
    if not force_field.support_count:
        raise InvalidArgument("force_field", "a field without any force", "a support of at least one sample")
    rows, _, _ = _looked_at(force_field, edges, keep=False)
    points, held, curl2, gradient2, squares, work2 = rows[:, :6].sum(axis=0).tolist()
    curl2_max, work_max = rows[:, 6:].max(axis=0).tolist()
    found = best_loop(force_field, edges, loops, seed)
    rms_curl, rms_gradient = _rms(curl2, points), _rms(gradient2, points)
    return Passivity(
        support_count=force_field.support_count,
        points=int(points),
        share_seen=held / force_field.support_count,
        rms_curl_n_per_m=rms_curl,
        worst_curl_n_per_m=math.sqrt(curl2_max) if points else math.nan,
        rms_gradient_n_per_m=rms_gradient,
        relative_curl=rms_curl / (math.sqrt(2) * rms_gradient) if rms_gradient else 0.0,
        squares=int(squares),
        rms_square_j=_rms(work2, squares),
        worst_square_j=work_max if squares else math.nan,
        loops=found[0],
        worst_loop_j=found[1],
        worst_loop_m=frozen(found[2]),
        edges=edges,
        notes=_notes(force_field.grid, int(points), int(squares), found[0], loops),
    )


def curl_n_per_m(force_field: ForceField, edges: bool = False) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """The curl at lattice points by central differences.

    Returns
    -------
    positions : int32 [m, 3]
        Indices into the grid, in raster order: the supported samples whose six neighbours are supported; with
        `edges`, all samples that are supported or beside one that is, and whose six neighbours are in the grid.
    curls : float32 [m, 3]
        N/m.
    """
    from touchfield.medium import kernels

    _, bricks, curls = _looked_at(force_field, edges, keep=True)
    seen = ~np.isnan(curls[..., 0])
    slots = kernels.raster_slots(bricks, seen.reshape(-1, BRICK, BRICK, BRICK))
    brick, local = np.divmod(slots, BRICK**3)
    offset = np.stack(np.unravel_index(local, (BRICK,) * 3), axis=-1)
    return (bricks[brick] * BRICK + offset).astype(np.int32), curls.reshape(-1, 3)[slots]


def _looked_at(
    force_field: ForceField, edges: bool, keep: bool
) -> tuple[Float64s, NDArray[np.int32], NDArray[np.float32]]:
    """Rows of `kernels.passivity.COLUMNS`, the bricks they are of, and their curls [m, 512, 3], NaN where unseen."""
    from touchfield.measure.kernels.passivity import curl_and_loops

    grid, bricks = force_field.grid, force_field.bricks
    if not edges:
        slots = neighbour_slots(grid, bricks)
    else:
        bricks = dilated(grid, bricks, (1, 1, 1))
        own, stored = brick_keys(grid, bricks), brick_keys(grid, force_field.bricks)
        stored_at = np.full(len(bricks) + 1, -1, np.int32)  # the last for "no neighbour", which has the number -1
        stored_at[np.searchsorted(own, stored)] = np.arange(len(stored))
        slots = stored_at[neighbour_slots(grid, bricks)]
    curls = zero_forces(len(bricks) if keep else 0).reshape(-1, BRICK**3, 3)
    curls.fill(np.nan)
    return curl_and_loops(grid, bricks, slots, force_field.forces_n, edges, curls), bricks, curls


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
