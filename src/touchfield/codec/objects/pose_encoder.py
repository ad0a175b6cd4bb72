"""Poses to bytes: how finely they must be told, and the code of a track.

"Source model parameter quantization can be easily omitted since the perceptual filtering already performs
quantization below the masking threshold" (paper section 4.3): here the steps are the coarsest with which no point of
the body is farther from its place than the tolerance, measured on the decoded track itself.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from touchfield.arrays import Int64s
from touchfield.codec.kernels.bits import end_of, fresh, price, writer
from touchfield.codec.kernels.whole_numbers import ROOM, code_numbers
from touchfield.codec.objects import poses
from touchfield.codec.objects.poses import MODELS, MOST_STEPS, PoseSteps, code_residuals
from touchfield.codec.objects.promise import displacement_m
from touchfield.errors import InvalidArgument
from touchfield.medium import PoseTrack

_POSITION_COST, _QUATERNION_COST = 3, 4  # numbers that a power of two makes a bit longer


class Damping(NamedTuple):
    """Bound on velocities: the force b (v + omega x r) of a surface may be off by `most_n`, newtons."""

    n_s_per_m: float
    rate_hz: float
    most_n: float

    def is_kept(self, source: PoseTrack, decoded: PoseTrack, reach_m: float) -> bool:
        """True where it is, anywhere within `reach_m` of the body's origin."""
        if not self.n_s_per_m or source.is_still:
            return True
        (v, spin), (v1, spin1) = source.velocities(self.rate_hz), decoded.velocities(self.rate_hz)
        with np.errstate(over="ignore", invalid="ignore"):
            off = np.linalg.norm(v1 - v, axis=1) + np.linalg.norm(spin1 - spin, axis=1) * reach_m
            return bool(self.n_s_per_m * off.max() <= self.most_n)


def rounded(track: PoseTrack, steps: PoseSteps) -> Int64s:
    """The nearest multiples of the steps, int64 [n, 7]; InvalidArgument if a position is beyond 2^50 of them."""
    farthest = float(np.abs(track.positions_m).max())
    if farthest > MOST_STEPS * steps.position_m:
        expected = f"{MOST_STEPS * steps.position_m:g} m at most with a step of {steps.position_m:g} m"
        raise InvalidArgument("pose track positions_m", f"{farthest:g} m from the origin", expected)
    numbers = track.positions_m / steps.position_m, track.quaternions / steps.quaternion
    return np.rint(np.concatenate(numbers, axis=1)).astype(np.int64)


def place_steps(track: PoseTrack, reach_m: float, tolerance_m: float, damping: Damping | None = None) -> PoseSteps:
    """The coarsest steps with which no point of a body leaves its place by more than a tolerance.

    The body's field reaches `reach_m` from its origin. InvalidArgument if the steps would have to be finer than there
    are any.
    """
    first = [
        min(math.ceil(math.log2(4 * tolerance_m)), poses.POSITION_POWERS[1]),
        min(math.ceil(math.log2(2 * tolerance_m / max(reach_m, tolerance_m))), poses.QUATERNION_POWERS[1]),
    ]
    spans = [max(first[0] - poses.POSITION_POWERS[0] + 1, 0), max(first[1] - poses.QUATERNION_POWERS[0] + 1, 0)]
    finer = sorted(np.ndindex(*spans), key=lambda d: _POSITION_COST * d[0] + _QUATERNION_COST * d[1])
    for less_position, less_turn in finer:
        steps = PoseSteps(2.0 ** (first[0] - less_position), 2.0 ** (first[1] - less_turn))
        if np.abs(track.positions_m).max() > MOST_STEPS * steps.position_m:
            continue
        decoded = steps.track(rounded(track, steps))
        is_near = displacement_m(track, decoded, reach_m).max() <= tolerance_m
        if is_near and (damping is None or damping.is_kept(track, decoded, reach_m)):
            return steps
    found = f"poses that keep to {1e6 * tolerance_m:g} um"
    if damping is not None and damping.n_s_per_m:
        found += f", and a damping of {damping.n_s_per_m:g} N s/m at {damping.rate_hz:g} Hz"
    mend = "Take a smaller surface damping, or a body nearer to its origin."
    raise InvalidArgument("pose track", found, "steps of 2^-40 m and 2^-30 at least", mend)


def encode_poses(track: PoseTrack, steps: PoseSteps) -> bytes:
    """The code of a track, by the multiples of `rounded`; InvalidArgument if there are too many poses."""
    if len(track) > poses.MOST_POSES:
        raise InvalidArgument("pose track", f"{len(track)} poses", f"{poses.MOST_POSES} at most", "Split it.")
    numbers = rounded(track, steps)
    moved = (numbers - numbers[0]).T
    orders = [_best_order(one) for one in moved]
    bits = writer(ROOM * (numbers.size + 14) + 64, fresh(*MODELS))
    code_numbers(bits, 0, 0, np.append(orders, numbers[0]))
    for c, order in enumerate(orders):
        if order:
            code_residuals(bits, c, _residuals(moved[c], order))
    return end_of(bits)


def _best_order(moved: Int64s) -> int:
    """The predictor with which a component, int64 [n], is shortest, coded alone."""

    def size(order: int) -> float:
        bits = writer(ROOM * len(moved) + 64, fresh(*MODELS))
        code_residuals(bits, 0, _residuals(moved, order))
        return float(price(bits))

    return min(range(1, poses.MOST_ORDER + 1), key=size) if moved.any() else 0


def _residuals(moved: Int64s, order: int) -> Int64s:
    """Differences of that order, int64 [n - 1]; before the first number all are equal to it."""
    for _ in range(order):
        moved = np.diff(moved, prepend=0)
    return moved[1:]
