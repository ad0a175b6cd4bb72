"""What passes between a device and the block beside place and force: orientation, buttons, gripper, and torque.

A device that does not tell these is not asked, and gets its force alone.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from touchfield.render import places
from touchfield.render.point_device import Point, PointDevice
from touchfield.render.wrench_places import BUTTONS, GRIPPER_M, ORIENTATION, TORQUE, TORQUE_SLEW

if TYPE_CHECKING:
    from touchfield.render.memory import Memory

__all__ = ["Grip"]


class Grip:
    """The hold on one device, within the servo."""

    def __init__(self, memory: Memory, device: PointDevice) -> None:
        self._f8, self._i8, self._device = memory.f8, memory.i8, device

        def has(name: str) -> bool:
            return getattr(type(device), name) is not getattr(PointDevice, name)

        self._is_turning, self._has_buttons, self._has_gripper, self._is_twisting = map(
            has, ("orientation", "buttons", "gripper_m", "put_wrench")
        )

    def read(self) -> None:
        """Keep what the device tells beside its place."""
        if self._is_turning:
            self._f8[ORIENTATION : ORIENTATION + 4] = self._device.orientation()
        if self._has_buttons:
            self._i8[BUTTONS] = self._device.buttons()
        if self._has_gripper:
            self._f8[GRIPPER_M] = self._device.gripper_m()

    def put(self, force_n: Point) -> None:
        """Put a force, and the torque that the latest tick left."""
        if self._is_twisting:
            self._device.put_wrench(*force_n, *self._f8[TORQUE : TORQUE + 3].tolist())
        else:
            self._device.put_force_n(*force_n)

    def put_nothing(self) -> None:
        """Put neither force nor torque."""
        if self._is_twisting:
            self._device.put_wrench(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        else:
            self._device.put_force_n(0.0, 0.0, 0.0)

    @property
    def held_s(self) -> float:
        """The time in which what is held may go to zero, seconds."""
        f8 = self._f8
        force_s = math.hypot(*f8[places.FORCE : places.FORCE + 3]) / float(f8[places.SLEW])
        torque = math.hypot(*f8[TORQUE : TORQUE + 3])
        return max(force_s, torque / float(f8[TORQUE_SLEW])) if torque > 0 else force_s
