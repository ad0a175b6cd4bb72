"""Filters: the device filter, the paper's mapping M (sections 3.1, 3.2 and 4.1), and what it is made of."""

from touchfield.filters.device_filter import DeviceFilter, DeviceFilterSpec, device_medium, limited
from touchfield.filters.lattice import NW_RANGE, device_grid
from touchfield.filters.lowpass import LOW_PASSES, LowPass, frequency_response
from touchfield.filters.placement import Placement
from touchfield.filters.resample import nyquist_per_m, resample

__all__ = [
    "LOW_PASSES",
    "NW_RANGE",
    "DeviceFilter",
    "DeviceFilterSpec",
    "LowPass",
    "Placement",
    "device_grid",
    "device_medium",
    "frequency_response",
    "limited",
    "nyquist_per_m",
    "resample",
]
