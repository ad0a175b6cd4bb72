"""A type 1 device as the servo sees it: where it is, and to push; of some also how it is turned, and to twist.

A new device is one file in `touchfield.adapters` with a class of this kind (docs/devices.md). Forces that arrive here
have passed every limit; an adapter changes none of them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

Point = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]  # w, x, y, z


class PointDevice(ABC):
    """A point that a hand moves, in the device's own axes.

    Used by one thread, within the servo's process: it is made there, by a callable that can be pickled.

    Attributes
    ----------
    is_paced : bool
        Whether `position_m` waits for the device and so sets the rate of the loop.
    is_driven : bool
        Whether the vendor's driver calls us: then `drive` is used, and neither `position_m` nor `put_force_n`.
    """

    is_paced: ClassVar[bool] = False
    is_driven: ClassVar[bool] = False

    @abstractmethod
    def open(self) -> None:
        """Find the device and make it ready; no force yet.

        `DeviceError` if it is not there, its driver is not installed, or it answers wrongly.
        """

    @abstractmethod
    def position_m(self) -> Point:
        """Where it is, metres, in its own axes; `DeviceError` if it is late, or says what cannot be."""

    @abstractmethod
    def put_force_n(self, x: float, y: float, z: float) -> None:
        """Push with a force in newtons, in its own axes, until told otherwise; `DeviceError` if it is gone."""

    def orientation(self) -> Quaternion:
        """Turn of the grip at the latest `position_m`, a unit quaternion: device's axes from the grip's.

        `DeviceError` if it cannot tell.
        """
        return 1.0, 0.0, 0.0, 0.0

    def buttons(self) -> int:
        """Those that are pressed at the latest `position_m`: bit n is button n."""
        return 0

    def gripper_m(self) -> float:
        """Opening of the gripper at the latest `position_m`, metres."""
        return 0.0

    def put_wrench(self, fx: float, fy: float, fz: float, tx: float, ty: float, tz: float) -> None:
        """Push as `put_force_n`, and twist with a torque in newton metres, in its own axes, about its point.

        A device that shows no torque leaves it out; its profile states none, so that there is none. `DeviceError` if
        it is gone.
        """
        self.put_force_n(fx, fy, fz)

    @abstractmethod
    def close(self) -> None:
        """Let it go, without force; must not raise, and may be called twice, or after a failed `open`."""

    def advance(self, dt_s: float) -> None:
        """Time that passed, for a device that is simulated; nothing for one that is there."""
        return

    def drive(self, address: int, words: int) -> None:
        """Hand the compiled callback over the memory block at `address` to the driver; returns at once.

        From then on the driver calls `kernels.cycle` at its own rate, until `close`.
        """
        raise NotImplementedError

    def watch(self) -> None:
        """Asked now and then while the driver calls us, in place of `position_m`.

        `DeviceError` if the driver reports a fault, or has stopped calling.
        """
        return
