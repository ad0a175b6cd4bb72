"""Compiled loops of the values. Import only when first needed: this imports numba."""

from touchfield.medium.kernels.bricks import first_at_least, raster_slots, sample

__all__ = ["first_at_least", "raster_slots", "sample"]
