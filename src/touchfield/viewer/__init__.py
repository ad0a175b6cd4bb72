"""Draws fields, coding errors and measurements as pictures, and makes the page for browsers."""

from touchfield._lazy import lazy_attributes

__getattr__ = lazy_attributes(__name__)
