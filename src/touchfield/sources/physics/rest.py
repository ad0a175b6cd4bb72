"""Puts bodies to sleep that have come to rest, so that their poses, and with them their fields, stay the same
bit for bit.

The contacts of a simulation are springs and dampers that only push. On them a body at rest hops by what it
falls in a step or two, and creeps: the seven bodies of ``sample:falling-7`` by some 0.1 mm/s, for ever. A
coder has to follow that. MuJoCo stops the bodies of an island that have been slow for ten steps, which is too
short for a body that turns back, such as one that rocks or is thrown upwards. Here a body may sleep only
after it has stayed within `REST_M` for `REST_S`, and has touched something meanwhile.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

REST_M: Final = 1e-4
REST_FRACTION: Final = 3e-3
"""A body at rest moves less than this, and than this fraction of its length (MuJoCo's ``dof_length``).

Rotations count at that length.
"""

REST_S: Final = 0.1
"""How long it does so: a body that starts with 0.02 m/s^2 or more moves further."""

_MIN_FRAMES: Final = 8
"""Frames of that time at least, since only they are looked at."""

_MIN_SPEED_M_S: Final = 1e-3
_FALL_STEPS: Final = 2.0
"""Speed of a body at rest, at most: that after a free fall of so many steps, and at least the one above."""


class RestWatch:
    """Decides which bodies of a model may sleep; sets the model's options for sleep.

    model : mujoco.MjModel
        No body has prescribed poses: it would not wake what it carries.
    rate_hz : float
        Frames, i.e. calls of `update`, a second.
    """

    def __init__(self, mujoco: Any, model: Any, rate_hz: float) -> None:
        self._mujoco, self._model = mujoco, model
        self._frames = max(math.ceil(REST_S * rate_hz), _MIN_FRAMES)
        self._anchor: Any = None  # positions of all joints, each since its tree of bodies last moved
        sizes = np.diff(np.append(model.jnt_qposadr, model.nq))
        self._tree_of_position = np.repeat(model.dof_treeid[model.jnt_dofadr], sizes)
        self._still_frames = np.zeros(model.ntree, np.int64)
        self._has_touched = np.zeros(model.ntree, np.bool_)
        self._moves = np.zeros(model.nv)
        if model.ntree:
            self._rest_m = np.minimum(
                REST_M, REST_FRACTION * np.minimum.reduceat(model.dof_length, model.tree_dofadr)
            )
        fall_m_s = _FALL_STEPS * model.opt.timestep * float(np.linalg.norm(model.opt.gravity))
        model.opt.sleep_tolerance = max(fall_m_s, _MIN_SPEED_M_S)
        model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_SLEEP)
        model.tree_sleep_policy[:] = int(mujoco.mjtSleepPolicy.mjSLEEP_NEVER)

    def update(self, data: Any) -> None:
        """Look at the state after the steps of a frame."""
        model, policy = self._model, self._mujoco.mjtSleepPolicy
        if not model.ntree:
            return
        if self._anchor is None:
            self._anchor = data.qpos.copy()
        self._mujoco.mj_differentiatePos(model, self._moves, 1.0, self._anchor, data.qpos)
        moves_m = np.maximum.reduceat(np.abs(self._moves) * model.dof_length, model.tree_dofadr)
        is_still = moves_m < self._rest_m
        self._still_frames = np.where(is_still, self._still_frames + 1, 0)
        self._has_touched = np.where(is_still, self._has_touched | (data.tree_island >= 0), False)
        self._anchor = np.where(is_still[self._tree_of_position], self._anchor, data.qpos)
        may_sleep = (self._still_frames >= self._frames) & self._has_touched
        allowed, never = int(policy.mjSLEEP_ALLOWED), int(policy.mjSLEEP_NEVER)
        model.tree_sleep_policy[:] = np.where(may_sleep, allowed, never)

    def is_over(self, data: Any) -> bool:
        """Return True if every body that can move sleeps.

        Nothing can wake one then: forces and controls do not change, and no pose is prescribed.
        """
        return bool(self._model.ntree) and int(data.ntree_awake) == 0
