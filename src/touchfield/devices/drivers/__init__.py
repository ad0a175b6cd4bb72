"""Drivers: one module for each kind of device.

`registry` finds them by name, and imports a driver when it is used.
"""

from touchfield._lazy import lazy_attributes

__getattr__ = lazy_attributes(__name__)
