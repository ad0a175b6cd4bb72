"""Steps a model of MuJoCo frame by frame, as long as anyone asks for frames."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from touchfield.arrays import Float64s
from touchfield.errors import SourceError
from touchfield.sources.physics.rest import RestWatch
from touchfield.sources.physics.simulation import (
    check_state,
    collect_warnings,
    load_mujoco,
    start_state,
    steps_per_frame,
)

Control = Callable[[Any, Any], None]
"""``control(model, data)``, called before each frame: sets controls, applied forces or mocap poses."""


class LiveSimulation:
    """A simulation that starts as that of a file does, and does not end.

    Frame 0 is the initial state. The same model and controls give the poses of `simulation.simulate`.

    Parameters
    ----------
    model : mujoco.MjModel
        Its time step must be one of `simulation.simulate`, which has set it.
    body_ids : sequence of int
        Bodies whose poses are returned; a number may repeat.
    rate_hz : float
        Frames a second.
    where : str
        Name of the model in messages.
    can_rest : bool
        As in `simulation.simulate`. A force that `control` applies wakes a body.

    Attributes
    ----------
    notes : list of str
        MuJoCo's warnings; the caller may clear it.
    """

    def __init__(
        self, model: Any, body_ids: Sequence[int], rate_hz: float, where: str, can_rest: bool = False
    ) -> None:
        self._mujoco, self._model, self._where = load_mujoco(), model, where
        self._ids, self._rate_hz = np.asarray(body_ids, np.intp), rate_hz
        self._steps, self._can_rest = steps_per_frame(model, rate_hz)[0], can_rest
        self.control: Control | None = None
        self.notes = list[str]()
        self.restart()

    def restart(self) -> None:
        """Return to frame 0."""
        self._rest = RestWatch(self._mujoco, self._model, self._rate_hz) if self._can_rest else None
        self._data, self._frame = self._mujoco.MjData(self._model), 0
        start_state(self._mujoco, self._model, self._data)

    def next_poses(self) -> tuple[Float64s, Float64s]:
        """Return quaternions (w, x, y, z), float64 [n, 4], and positions, metres [n, 3], of the next frame.

        Raises SourceError if the simulation diverges, or MuJoCo fails.
        """
        mujoco, model, data = self._mujoco, self._model, self._data
        where = f"{self._where}, {self._frame / self._rate_hz:g} s"
        with collect_warnings(self._where, "a simulation that stops", "a model that can be stepped") as found:
            if self._frame:
                mujoco.mj_step(model, data, self._steps)
                if self._rest is not None:
                    self._rest.update(data)
            mujoco.mj_kinematics(model, data)
            if self.control is not None:
                self.control(model, data)
            if found:
                self.notes += check_state(mujoco, data, found, where)
        self._frame += 1
        poses = data.xquat[self._ids], data.xpos[self._ids]
        if not all(np.isfinite(values).all() for values in poses):
            raise SourceError(where, "poses that are not finite", "a stable simulation")
        return poses
