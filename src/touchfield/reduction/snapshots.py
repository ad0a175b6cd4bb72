"""Cuts a medium into vectors (*snapshots*), whole frames or single bricks of 8x8x8 samples, and represents
them by the modes of `modes`.

Whole frames, on the union of their bricks, suit bodies that deform in place. A moving body is elsewhere in
each frame, so that no few frames span it, but its bricks are similar wherever it is. Counts of numbers are
reported with and without the modes themselves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from touchfield.arrays import Float32s, Float64s, Int64s
from touchfield.errors import InvalidArgument, require_one_of
from touchfield.medium import ForceField
from touchfield.medium.budget import require_memory
from touchfield.medium.field import brick_keys, bricks_of
from touchfield.medium.grid import BRICK
from touchfield.reduction.modes import Modes, klt, pod

if TYPE_CHECKING:
    from touchfield.medium import HapticMedium


KINDS: Final = ("global", "bricks")
BRICK_VALUES: Final = 3 * BRICK**3


@dataclass(frozen=True)
class ReducedMedium:
    """A medium and its modes.

    `keys` int64: for kind "global" the `brick_keys` of the union of bricks; empty for "bricks".
    """

    medium: HapticMedium
    kind: str
    modes: Modes
    keys: Int64s

    def coefficients(self, frame: int) -> Float64s:
        """Coefficients of the snapshots of a frame, float64 [n, r].

        Forces outside the union of bricks are omitted.
        """
        field = self.medium[frame]
        rows = field.forces_at(self.keys).reshape(1, -1) if len(self.keys) else _bricks(field)
        return self.modes.coefficients(rows)

    def field(self, frame: int) -> ForceField:
        """A frame as the modes reconstruct it."""
        grid = self.medium.grid
        rows = self.modes.rebuild(self.coefficients(frame)).astype(np.float32)
        bricks = bricks_of(grid, self.keys) if len(self.keys) else self.medium[frame].bricks
        return ForceField.from_bricks(grid, bricks, rows.reshape(-1, BRICK, BRICK, BRICK, 3))


def _bricks(field: ForceField) -> Float32s:
    return field.forces_n.reshape(-1, BRICK_VALUES)


def reduce_to_modes(
    medium: HapticMedium, kind: str = "global", rank: int | None = None, step: int = 1
) -> ReducedMedium:
    """Compute the modes of every `step`-th frame of a medium.

    `rank`: number of modes, all by default. `kind`: one of `KINDS`.
    """
    require_one_of("modes", kind, KINDS)
    indices = range(0, len(medium), step)
    if kind == "bricks":
        return ReducedMedium(
            medium, kind, klt((_bricks(medium[i]) for i in indices), rank), np.zeros(0, np.int64)
        )
    keys = np.unique(np.concatenate([brick_keys(medium.grid, medium[i].bricks) for i in indices]))
    if not len(keys):
        raise InvalidArgument("medium", "no frame with a force", "a force somewhere")
    max_rank = min(rank or len(indices), len(indices))
    require_memory(
        "frames and modes",
        f"{len(keys)} bricks",
        4 * BRICK_VALUES * len(keys) * (len(indices) + 2 * max_rank),
    )
    frames = np.stack([medium[i].forces_at(keys).ravel() for i in indices])
    return ReducedMedium(medium, kind, pod(frames, rank), keys)


class HeldOut(NamedTuple):
    """Frames that the modes were not computed from, represented by these modes.

    `modes`: number of modes used. `numbers`: mean number of coefficients per snapshot. `nmse_db`: error over
    energy, decibels. `share`: numbers a receiver needs (coefficients, their indices at their entropy in
    numbers of 32 bits, and the modes) relative to the numbers of the medium itself; `share_of_coefficients`
    is without the modes. `min_n`: for kind "bricks", the smallest coefficient that is kept; 0 for "global".
    """

    modes: int
    numbers: float
    nmse_db: float
    share: float
    share_of_coefficients: float
    min_n: float


def held_out(medium: HapticMedium, kind: str, decibels: float = -30.0) -> HeldOut:
    """Compute modes of the even frames; count the numbers that odd frames need.

    `decibels`: error to reach; all modes together may not reach it. For kind "global" the first modes are
    used, for "bricks" the largest coefficients of all bricks, those above one bound. Raises `InvalidArgument`
    as `reduce_to_modes` does, or for a medium of one frame.
    """
    if len(medium) < 2:
        raise InvalidArgument("medium", "one frame", "frames to learn from and others")
    is_global, odd = kind == "global", range(1, len(medium), 2)
    count = len(medium) if is_global else sum(len(field.bricks) for field in medium)
    max_rank = count // 4 if is_global else min(BRICK_VALUES, count // 20)  # few compared with the snapshots
    learnt = reduce_to_modes(medium, kind, max(1, max_rank), step=2)
    energy = sum(float((medium[i].forces_n.astype(np.float64) ** 2).sum()) for i in odd)
    if not energy:
        raise InvalidArgument("medium", "no force in its odd frames", "forces to try the modes on")
    squares = np.concatenate([learnt.coefficients(i) ** 2 for i in odd])
    caught = squares.sum(axis=0) if is_global else np.sort(squares.ravel())[::-1]
    residual = np.maximum(energy - np.cumsum(caught), 1e-30) / energy
    used = min(int(np.count_nonzero(residual > 10 ** (decibels / 10))), len(residual) - 1) + 1
    length, modes = len(learnt.modes.basis), used if is_global else learnt.modes.rank
    numbers = used if is_global else used / len(squares)
    density = numbers / modes
    index_bits = (
        0.0
        if is_global or density >= 1
        else (-density * math.log2(density) - (1 - density) * math.log2(1 - density))
    )
    of_coefficients = (numbers + index_bits * modes / 32) / length
    min_n = 0.0 if is_global else math.sqrt(float(caught[used - 1]))
    nmse = 10 * math.log10(float(residual[used - 1]))
    return HeldOut(modes, numbers, nmse, of_coefficients + modes / count, of_coefficients, min_n)


class Freedom(NamedTuple):
    """Effective degrees of freedom of a snapshot, and the bits of each.

    `effective`: exp of the entropy of the normalised squared singular values. `step_n`: step of the
    coefficients, newtons. `bits`: bits per coefficient, the mean over the `modes` with a coefficient that is
    not rounded to 0.
    """

    effective: float
    step_n: float
    bits: float
    modes: int


def freedom(found: ReducedMedium, f0_n: float) -> Freedom:
    """Return the effective degrees of freedom of a snapshot, and the bits of each.

    The step is chosen so that rounding causes an rms error of F_0 at each supported sample; rounding causes a
    squared error of rank step^2 / 12 in a snapshot. Bits are the plug-in entropy of each mode's rounded
    coefficients.
    """
    modes = found.modes
    weights = modes.values**2 / max(float((modes.values**2).sum()), 1e-300)
    effective = math.exp(float(-(weights[weights > 0] * np.log(weights[weights > 0])).sum()))
    frames = range(len(found.medium))
    support_count = sum(found.medium[i].support_count for i in frames)
    coefficients = np.concatenate([found.coefficients(i) for i in frames])
    step = f0_n * math.sqrt(12 * max(1, support_count) / (len(coefficients) * max(1, modes.rank)))
    rounded = np.rint(coefficients / step)
    bits = []
    for column in rounded.T[np.any(rounded != 0, axis=0)]:
        counts = np.unique(column, return_counts=True)[1] / len(column)
        bits.append(float(-(counts * np.log2(counts)).sum()))
    return Freedom(effective, step, float(np.mean(bits)) if bits else 0.0, len(bits))
