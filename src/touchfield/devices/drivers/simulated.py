"""A simulated hand that takes the place of a device, for playback, tests and comparisons without hardware.
The same input always gives the same forces.

Its axes are those of the field, and its trajectory is in metres of the field. There are two kinds:

* "follow": the hand is exactly on the trajectory and no force moves it, as when a recorded probe is replayed;
* "spring": a mass that a spring pulls towards a target on the trajectory and that the force pushes,
  m a = k (target - x) - b v + F. The force changes the position, so that friction drags and a wall stops it.

If the trajectory has orientations, both kinds of hand have them; a torque does not change them.

Time passes only by `advance`: the hand has no clock, and two runs give the same numbers.
"""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING, Final, Literal, cast

import numpy as np

from touchfield.compute.native import native
from touchfield.devices.drivers.registry import Check, DeviceKind, Opener
from touchfield.errors import DeviceError, InvalidArgument, require_one_of
from touchfield.render.point_device import PointDevice, Quaternion

if TYPE_CHECKING:
    from collections.abc import Callable

    from touchfield.medium.trace import Trace


HandKind = Literal["follow", "spring"]

STIFFNESS_N_PER_M: Final = 500.0
"""Stiffness of the kind "spring"; `touch_down` uses it too."""

_MASS_KG: Final = 0.1
_SPRING: Final = (_MASS_KG, STIFFNESS_N_PER_M, 2.0 * math.sqrt(STIFFNESS_N_PER_M * _MASS_KG))
"""m, k and critical damping b.

They are a choice, not a measurement, of the order of a hand that holds a stylus.
"""

_KINDS: Final = ("follow", "spring")
_MAX_STEP_S: Final = 10.0


class SimHand(PointDevice):
    """A simulated hand.

    Parameters
    ----------
    trajectory : Trace or None
        In metres of the field, from 0 s on. Before its first and after its last sample the hand (or its
        target) rests there. None: it rests at the origin.
    kind : "follow" or "spring"
        InvalidArgument for others.
    """

    def __init__(self, trajectory: Trace | None = None, kind: HandKind = "follow") -> None:
        require_one_of("hand", kind, _KINDS)
        self.kind = kind
        self._constants: tuple[float, ...] = _SPRING if kind == "spring" else ()
        self._times = np.zeros(1) if trajectory is None else trajectory.times_s
        self._positions = np.zeros((1, 3)) if trajectory is None else trajectory.positions_m
        self._quaternions = None if trajectory is None else trajectory.quaternions
        self._quaternion = np.array([1.0, 0.0, 0.0, 0.0])
        self._state = np.zeros(10)
        self._move: Callable[..., None] | None = None

    def open(self) -> None:
        """Put the hand at rest at the trajectory's position at 0 s."""
        self._state[:] = 0.0
        native.follow(self._times, self._positions, self._state, 0.0)
        self._move = native.follow if self.kind == "follow" else native.spring

    def position_m(self) -> tuple[float, float, float]:
        """Return the position of the hand, metres."""
        x, y, z = self._state[1:4].tolist()
        if self._move is None or not math.isfinite(x + y + z):
            found = "a hand that is not open" if self._move is None else f"a hand at {x:g}, {y:g}, {z:g} m"
            raise DeviceError("simulated hand", found, "finite positions", "Check trajectory and stiffness.")
        return x, y, z

    def orientation(self) -> Quaternion:
        """Orientation of the trajectory."""
        if self._quaternions is not None:
            native.interpolate_orientation(
                self._times, self._quaternions, self._quaternion, float(self._state[0])
            )
        w, x, y, z = self._quaternion.tolist()
        return w, x, y, z

    def put_force_n(self, x: float, y: float, z: float) -> None:
        """Push the hand, newtons, from the next `advance` on."""
        if not math.isfinite(x + y + z):
            raise DeviceError("simulated hand", f"a force of {x:g}, {y:g}, {z:g} N", "finite newtons")
        self._state[7:] = (x, y, z)

    def close(self) -> None:
        """Remove the force."""
        self._state[7:] = 0.0
        self._move = None

    def advance(self, dt_s: float) -> None:
        """Let `dt_s` seconds pass, 0 to 10."""
        if self._move is None or not 0 <= dt_s <= _MAX_STEP_S:
            raise DeviceError(
                "simulated hand", f"a step of {dt_s!r} s", f"0 to {_MAX_STEP_S:g} s, after open"
            )
        self._move(self._times, self._positions, self._state, *self._constants, float(dt_s))


def _opener(rest: str, trajectory: Trace | None) -> Opener:
    kind = rest or "follow"
    if kind not in _KINDS:
        raise InvalidArgument("device", f"'sim:{rest[:40]}'", "sim, sim:follow or sim:spring")
    return partial(SimHand, trajectory, cast(HandKind, kind))


_CHECK: Final = Check("simulated hand", True, "built in")
KIND = DeviceKind(
    "sim", "sim[:spring]", "a simulated hand", None, _opener, lambda: [_CHECK], is_simulated=True
)
