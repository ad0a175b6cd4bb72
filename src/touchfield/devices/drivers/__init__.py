"""Drivers: one file for each kind of device, imported when it is used; `registry` finds them by name."""

from touchfield._lazy import lazy_attributes

__getattr__ = lazy_attributes(__name__)
