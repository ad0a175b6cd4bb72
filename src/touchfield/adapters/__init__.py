"""Devices and formats at the edge: one file for each, imported when it is asked for."""

from touchfield.rooms import modules_of

__getattr__ = modules_of(__name__)
