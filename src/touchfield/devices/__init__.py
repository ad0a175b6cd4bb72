"""Haptic devices: what each can show (workspace, greatest force, resolution; paper sections 3.1 and 5.1), and
the drivers that connect to them.

The public function ``touchfield.devices()`` has the same name as this package. Importing any submodule binds
the package to ``touchfield.devices``, which hides a function of that name. So the package itself is callable:
its module object gets a class with ``__call__``.
"""

import sys
from types import ModuleType

from touchfield.devices.profile import Device, device, device_names, devices

__all__ = ["Device", "device", "device_names", "devices"]


class _CallablePackage(ModuleType):
    """The class of this package: a module that can be called, ``touchfield.devices()``."""

    def __call__(self) -> tuple[Device, ...]:
        """Return all device profiles."""
        return tuple(devices())


sys.modules[__name__].__class__ = _CallablePackage
