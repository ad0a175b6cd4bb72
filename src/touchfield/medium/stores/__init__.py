"""Media in files: NumPy archives, Zarr stores, and VTK images."""

from touchfield._lazy import lazy_attributes

__getattr__ = lazy_attributes(__name__)
