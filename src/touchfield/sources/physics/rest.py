"""Puts bodies to sleep that have come to rest, so that their poses, and with them their fields, stay the same
bit for bit.

The contacts of a simulation are springs and dampers, on which a body at rest creeps: the seven bodies of
``sample:falling-7`` by some 0.1 mm/s, for ever. A coder has to follow that. MuJoCo stops the bodies of an
island that have been slow for ten steps; that is too short for a body that turns back, such as one that rocks
or is thrown upwards. Here a body may sleep only after it has been slow, and has touched something, for
`REST_S`.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

REST_SPEED_M_S: Final = 1e-3
"""Below this speed a body counts as slow. Rotations count as MuJoCo weighs them (``dof_length``)."""

REST_S: Final = 0.1
"""How long a body is slow before it sleeps: one that accelerates by 0.02 m/s^2 or more is not that long."""

_MIN_FRAMES: Final = 8
"""Frames in which it is slow, since only they are looked at."""


class RestWatch:
    """Decides which bodies of a model may sleep; sets the model's options for sleep.

    model : mujoco.MjModel
        Without moving bodies other than those that it simulates: nothing wakes the others.
    rate_hz : float
        Frames, i.e. calls of `update`, a second.
    """

    def __init__(self, mujoco: Any, model: Any, rate_hz: float) -> None:
        self._model = model
        self._policies = mujoco.mjtSleepPolicy.mjSLEEP_NEVER, mujoco.mjtSleepPolicy.mjSLEEP_ALLOWED
        self._frames = max(math.ceil(REST_S * rate_hz), _MIN_FRAMES)
        self._slow_frames = np.zeros(model.ntree, np.int64)
        model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_SLEEP)
        model.opt.sleep_tolerance = REST_SPEED_M_S
        model.tree_sleep_policy[:] = int(self._policies[False])

    def update(self, data: Any) -> None:
        """Look at the state after the steps of a frame."""
        model = self._model
        if not model.ntree:
            return
        speeds_m_s = np.maximum.reduceat(np.abs(data.qvel) * model.dof_length, model.tree_dofadr)
        is_asleep = data.tree_asleep >= 0
        is_slow = (speeds_m_s < REST_SPEED_M_S) & (is_asleep | (data.tree_island >= 0))
        self._slow_frames = np.where(is_slow, self._slow_frames + 1, 0)
        never, allowed = map(int, self._policies)
        model.tree_sleep_policy[:] = np.where(self._slow_frames >= self._frames, allowed, never)
