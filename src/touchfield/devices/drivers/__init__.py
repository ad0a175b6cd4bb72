"""Drivers of haptic devices: one module for each kind, which connects to it, reads where the hand is, and
sends forces or the drives of actuators.

`registry` finds them by name, and imports a driver when it is used.
"""

from touchfield._lazy import lazy_attributes

__getattr__ = lazy_attributes(__name__)
