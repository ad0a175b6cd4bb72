"""How a frame is predicted by the light models of coder `touch`: from one neighbour, from a blend, or from both.

Under a promise that is relative, a force that follows the law from one neighbour along a fixed axis inherits its
error and so stays within the promise for long, where a mean of neighbours draws a new one at each sample. Where the
field is noisy, some of the blend helps. The choices are the encoder's, and travel.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.codec.touch.fixed_field import TOP
from touchfield.codec.touch.light_scan import orientation

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.medium import Grid

    Int64s = NDArray[np.int64]

__all__ = ["CLEAN", "MOST", "Plan", "course_of", "law_of", "plan_of"]

CLEAN: Final = 0.2
"""Share of samples at which the chains break, below which nothing is blended in."""

_APART: Final = 40
"""By how many breaks a brick must be better off to leave the way of the frame."""

MOST: Final = 16
"""Most of a blend that is mixed in, 1/64: the residual is about it as it is."""

_NOISY: Final = 0.45
"""Share of breaks from which on any is."""


@dataclass(frozen=True)
class Plan:
    """What the frame's prediction is.

    Attributes
    ----------
    usual : int
        0: from the blend alone; 1 to 3: along that axis of the scan.
    mix : int
        How much of the blend is in it, 1/64, 0 to 63.
    ways : int64 [n]
        Of each brick in the order of the scan: 0 the reference, 1 to 3 as above.
    share : float
        Of samples at which it breaks the rule.
    """

    usual: int
    mix: int
    ways: Int64s
    share: float


def law_of(counts: Int64s, grid: Grid, axis: int) -> NDArray[np.float64]:
    """What the amplitude loses in a step along each axis of the grid, units: the median along `axis`, float64 [3]."""
    from touchfield.codec.kernels.touch_light_chain import BINS

    total = int(counts[axis].sum())
    spacing = np.asarray(grid.spacing_m, np.float64)
    if total == 0:
        even: NDArray[np.float64] = TOP / 12 * spacing / spacing.max()
        return even
    median = int(np.searchsorted(np.cumsum(counts[axis]), (total + 1) // 2))
    share = spacing / spacing[axis]
    lost: NDArray[np.float64] = np.minimum((4.0 * min(median, BINS - 1) + 2.0) * share, 2.0 * TOP - 2)
    return lost


def course_of(forces: NDArray[np.float32], scale: float, grid: Grid) -> tuple[Int64s, Int64s, int]:
    """How a frame is walked, from forces float32 [n, 8, 8, 8, 3] and the units of a newton.

    Returns
    -------
    turn : int64 [3]
        The axes of the scan.
    slope : int64 [3]
        What the amplitude loses in a step along each of them, units, below zero where it is walked downwards.
    way : int
        The byte that tells the scan.
    """
    from touchfield.codec.kernels.touch_light_chain import falls

    counts, sums = falls(forces, scale)
    turn, down = orientation(sums, grid)
    signs = np.where(down, -1, 1)[turn]
    slope = np.rint(law_of(counts, grid, int(turn[0]))[turn] * signs).astype(np.int64)
    return turn, slope, int(turn[0]) | sum(4 << n for n in range(3) if down[turn[n]])


def plan_of(
    breaks: Int64s, reference_slot: Int64s, voxels: int, *, chains: bool = True, most: int = 0,
    guessed: bool = False,
) -> Plan:  # fmt: skip
    """The plan of least breaks, from `kernels.touch_light_chain.chain_breaks`.

    Parameters
    ----------
    breaks : int64 [n, 4]
    reference_slot : int64 [n]
        Below 0 for bricks that the reference does not list.
    voxels : int
    chains : bool
        Whether anything is followed; else all is blended.
    most : int
        Most of a blend that may be mixed in, 1/64.
    guessed : bool
        Whether the reference was made for this frame: it is followed in all its bricks then, for where it is off the
        chain begins by itself.
    """
    if not chains:
        return Plan(0, 0, np.zeros(len(breaks), np.int64), 1.0)
    counts = breaks[:, 1:].sum(axis=0)
    usual = 1 + int(counts.argmin())
    ways = np.full(len(breaks), usual, np.int64)
    known = reference_slot >= 0
    if counts.min() >= CLEAN * voxels:
        own = breaks[:, 1:].argmin(axis=1) + 1
        ways = np.where(breaks[:, usual] - breaks[:, 1:].min(axis=1) > _APART, own, usual)
    rows: Any = np.arange(len(breaks))
    keeps = guessed | (breaks[:, 0] < breaks[rows, ways]) | (breaks[:, 0] == 0)
    ways[known & keeps] = 0
    share = float(breaks[rows, ways].sum()) / max(voxels, 1)
    mix = int(np.clip(round(160 * (share - CLEAN)), 0, most)) if share >= _NOISY else 0
    return Plan(usual, mix, ways, share)
