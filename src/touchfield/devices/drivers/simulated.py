"""The simulated hand: a type 1 device for a user who has none, and the same forces on every machine.

Its axes are those of the field, its trajectory is in the field's metres. Two kinds:

* "follow": the hand is exactly on the trajectory and nothing can push it away, as a recorded probe is played
  again;
* "spring": a mass that a spring pulls towards a target on the trajectory, and that the force pushes back,
  m a = k (target - x) - b v + F. What the hand feels changes where it is, so that friction drags and a wall
  holds.

Where the trajectory tells how it is turned, so is the hand, of either kind; a torque does not turn it.

Time is what `advance` was told: the hand knows no clock, and two runs give the same numbers.
"""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING, Any, Final, Literal, cast

import numpy as np

from touchfield.devices.drivers.registry import Check, DeviceKind, Opener
from touchfield.errors import DeviceError, InvalidArgument, require_one_of
from touchfield.render.point_device import PointDevice, Quaternion

if TYPE_CHECKING:
    from collections.abc import Callable

    from touchfield.medium.trace import Trace


HandKind = Literal["follow", "spring"]

STIFFNESS_N_PER_M: Final = 500.0
"""Of "spring"; `touch_down` takes it, too."""

_MASS_KG: Final = 0.1
_SPRING: Final = (_MASS_KG, STIFFNESS_N_PER_M, 2.0 * math.sqrt(STIFFNESS_N_PER_M * _MASS_KG))
"""m, k and critical damping b: of the order of a hand that holds a stylus; they are a choice, not a
measurement.
"""

_KINDS: Final = ("follow", "spring")
_LONGEST_S: Final = 10.0


class SimHand(PointDevice):
    """A hand that is computed; see above.

    Parameters
    ----------
    trajectory : Trace or None
        In the field's metres, from 0 s on; before its first and after its last sample the hand (or its
        target) rests there. None: it rests at the origin.
    kind : "follow" or "spring"; InvalidArgument for another.
    """

    def __init__(self, trajectory: Trace | None = None, kind: HandKind = "follow") -> None:
        require_one_of("hand", kind, _KINDS)
        self.kind = kind
        self._constants: tuple[float, ...] = _SPRING if kind == "spring" else ()
        # copies: to the compiler a read-only array is another type
        self._times = np.zeros(1) if trajectory is None else np.array(trajectory.times_s)
        self._positions = np.zeros((1, 3)) if trajectory is None else np.array(trajectory.positions_m)
        turns = None if trajectory is None else trajectory.quaternions
        self._turns = None if turns is None else np.array(turns)
        self._turn = np.array([1.0, 0.0, 0.0, 0.0])
        self._state = np.zeros(10)
        self._move: Callable[..., Any] | None = None

    def open(self) -> None:
        """Put the hand, at rest, where its trajectory is at 0 s."""
        from touchfield.devices.drivers import kernels as hand

        self._state[:] = 0.0
        hand.follow(self._times, self._positions, self._state, 0.0)
        self._move = hand.follow if self.kind == "follow" else hand.spring
        self.orientation()
        self.advance(0.0)  # compiled now, and not in the first tick

    def position_m(self) -> tuple[float, float, float]:
        """Where the hand is, metres."""
        x, y, z = self._state[1:4].tolist()
        if self._move is None or not math.isfinite(x + y + z):
            found = "a hand that is not open" if self._move is None else f"a hand at {x:g}, {y:g}, {z:g} m"
            raise DeviceError("simulated hand", found, "finite positions", "Check trajectory and stiffness.")
        return x, y, z

    def orientation(self) -> Quaternion:
        """How the trajectory turns it."""
        if self._turns is not None:
            from touchfield.devices.drivers import kernels as hand

            hand.turned(self._times, self._turns, float(self._state[0]), self._turn)
        w, x, y, z = self._turn.tolist()
        return w, x, y, z

    def put_force_n(self, x: float, y: float, z: float) -> None:
        """Push the hand, newtons, from the next `advance` on."""
        if not math.isfinite(x + y + z):
            raise DeviceError("simulated hand", f"a force of {x:g}, {y:g}, {z:g} N", "finite newtons")
        self._state[7:] = (x, y, z)

    def close(self) -> None:
        """Nothing pushes any more."""
        self._state[7:] = 0.0
        self._move = None

    def advance(self, dt_s: float) -> None:
        """Let `dt_s` seconds pass, 0 to 10."""
        if self._move is None or not 0 <= dt_s <= _LONGEST_S:
            raise DeviceError("simulated hand", f"a step of {dt_s!r} s", f"0 to {_LONGEST_S:g} s, after open")
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
