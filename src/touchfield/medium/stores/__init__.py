"""Reads and writes media in general formats: NumPy archives, Zarr stores and VTK images."""

from touchfield._lazy import lazy_attributes

__getattr__ = lazy_attributes(__name__)
