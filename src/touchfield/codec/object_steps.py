"""How coarse the poses of one object may be: neither its forces nor the velocity of its surface leave the mask."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.codec.pose_track import PoseSteps, pose_steps
from touchfield.errors import InvalidArgument

if TYPE_CHECKING:
    from touchfield.medium import ForceField, PoseTrack

__all__ = ["object_steps"]

_SHARE: Final = 0.5
"""Of F_0, for the poses of one object: two that overlap keep to F_0 together."""

_STILL_STEPS: Final = (2.0**-10, 2.0**-10)
"""Of a body that stays unturned at its origin, which any powers of two up to 1/4 keep exactly."""


def object_steps(
    track: PoseTrack, fields: Iterable[ForceField], f0_n: float, damping_n_s_per_m: float, rate_hz: float
) -> PoseSteps:
    """The steps with which the force of an object in motion, b (v + omega x r) with it, is off by F_0 / 2 at most.

    That holds wherever the exact and the quantised object both have a force, and without surface damping everywhere
    (`pose_steps`): the damping begins at once where the force begins, and that edge moves with the poses.

    Parameters
    ----------
    track : PoseTrack
    fields : iterable of ForceField
        The field of a rigid object, or all of one that deforms; looked at once, one after another.
    f0_n : float
        F_0, newtons.
    damping_n_s_per_m : float
        b of a moving surface.
    rate_hz : float

    Raises
    ------
    InvalidArgument
        If the steps would have to be finer than there are any.
    """
    if (track.quaternions == [1.0, 0.0, 0.0, 0.0]).all() and not track.positions_m.any():
        return PoseSteps(*_STILL_STEPS)
    if damping_n_s_per_m == 0 or track.is_still:
        return pose_steps(fields, f0_n=f0_n, share=_SHARE)
    reach_m = 0.0

    def passing() -> Iterator[ForceField]:
        nonlocal reach_m
        for field in fields:
            reach_m = max(reach_m, _reach_m(field))
            yield field

    steps = pose_steps(passing(), f0_n=f0_n, share=_SHARE / 2)
    try:
        return _damped(steps, track, rate_hz, reach_m, 0.5 * _SHARE * f0_n / damping_n_s_per_m)
    except InvalidArgument as error:
        found = f"{error.found}, as a damping of {damping_n_s_per_m:g} N s/m at {rate_hz:g} Hz asks for"
        raise InvalidArgument(error.where, found, error.expected, "Take a smaller surface damping.") from error


def _damped(steps: PoseSteps, track: PoseTrack, rate_hz: float, reach_m: float, budget_m_s: float) -> PoseSteps:
    """Steps, no coarser, with which the velocity v + omega x r of a surface is off by no more than `budget_m_s`.

    A position is off by sqrt(3) s / 2 at most, a rotation by an angle of little more than 2 u; a velocity is the
    difference of two poses that are one frame apart at least. So v is off by sqrt(3) s / T, omega by 4 u / T, and r
    by as much as t.
    """
    spin = float(np.sqrt((track.velocities(rate_hz)[1] ** 2).sum(axis=1)).max())
    per_metre = math.sqrt(3) * (rate_hz + spin / 2)
    per_turn = 4.01 * rate_hz * reach_m
    finest = [steps.position_m, steps.quaternion]
    for n, slope in enumerate((per_metre, per_turn)):
        if slope * finest[n] > budget_m_s / 2:
            finest[n] = 2.0 ** math.floor(math.log2(budget_m_s / 2 / slope))
    return PoseSteps(*finest)


def _reach_m(field: ForceField) -> float:
    """How far a field reaches from its origin, one cell beyond its support, metres."""
    index = field.positions()
    if not len(index):
        return 0.0
    spacing = np.asarray(field.grid.spacing_m)
    far = np.abs(field.grid.to_m(index)) + spacing
    return float(np.sqrt((far * far).sum(axis=1).max()))
