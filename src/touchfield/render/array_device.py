"""A type 2 device as the player sees it: to show so many drives at once.

A new device is one file in `touchfield.adapters` with a class of this kind (docs/devices.md).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

from touchfield.arrays import Float32s

if TYPE_CHECKING:
    from touchfield.devices import Device


class ArrayDevice(ABC):
    """A fixed array of actuators; its `profile` has columns, rows, panels and levels."""

    profile: Device

    @abstractmethod
    def open(self) -> None:
        """Find the device and make it ready; `DeviceError` if it is not there, or answers wrongly."""

    @abstractmethod
    def put_drives(self, drives: Float32s, frequencies_hz: Float32s | None, seconds: float) -> None:
        """Show drives, float32 [panels, rows, columns] from 0 to 1, for about so many seconds.

        Row 0 is the top row as one looks at the panel, column 0 the left one; panel 0 is the front. The frequencies
        of the vibration band have the same shape; None where the medium has none. `DeviceError` if it is gone.
        """

    @abstractmethod
    def close(self) -> None:
        """All actuators off, then let it go; must not raise, and may be called twice, or after a failed `open`."""
