"""Devices: what each haptic display can show (paper sections 3.1 and 5.1), from TOML profiles.

`touchfield.devices()` is `touchfield.devices.devices()`: the package is called by its own name.
"""

import sys
from types import ModuleType

from touchfield.devices.profile import Device, device, device_names, devices

__all__ = ["Device", "device", "device_names", "devices"]


class _Room(ModuleType):
    def __call__(self) -> tuple[Device, ...]:
        """All device profiles."""
        return tuple(devices())


sys.modules[__name__].__class__ = _Room
