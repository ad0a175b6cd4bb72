"""Filters of force fields: the device filter, which adapts a field to what a device can show (the mapping M
of paper sections 3.1 and 4.1), and haptic filters such as smoothing (section 3.2).

==================  ==========================================================================================
M of a device       `DeviceFilter`, `device_medium`, `resample`, `LOW_PASSES`, `device_grid`, `Placement`
on arrays           `fir_filter`, `gaussian`, `perona_malik`, `quincunx_forward`, `fcc_forward`, inverses
on fields           `field_filters` names them all; `filter_of`, `apply_filters`, `filter_medium`
eq. 5               `frequency_response`
editing             `edit_field`, `edit_medium`; regions `Box`, `Ball`, `HalfSpace`, `Voxels`, `ForceRange`;
                    operators `Gain`, `Erase`, `Compose`, `Move`, `Limit` or any filter; `RigidMotion`
in time             `cross_fade`
level of detail     `pyramid`, `rebuild_level`, `interpolate`
==================  ==========================================================================================
"""

from touchfield.filters.device_filter import device_medium
from touchfield.filters.device_spec import NW_RANGE, DeviceFilter, DeviceFilterSpec, device_grid
from touchfield.filters.edit import (
    COMPOSITIONS,
    Compose,
    EditOperator,
    Erase,
    Gain,
    Limit,
    Move,
    cross_fade,
    edit_field,
    edit_medium,
)
from touchfield.filters.fir import fir_filter, frequency_response
from touchfield.filters.lifting import (
    fcc_forward,
    fcc_inverse,
    quincunx_forward,
    quincunx_inverse,
)
from touchfield.filters.limit import limit_forces
from touchfield.filters.region import (
    Ball,
    Box,
    Everywhere,
    ForceRange,
    HalfSpace,
    Region,
    RigidMotion,
    Voxels,
)
from touchfield.filters.registry import (
    Claims,
    FieldFilter,
    apply_filters,
    field_filters,
    filter_medium,
    filter_of,
)
from touchfield.filters.resample import (
    LOW_PASSES,
    LowPass,
    half_grid,
    interpolate,
    max_levels,
    pyramid,
    rebuild_level,
    resample,
)
from touchfield.filters.shading import perona_malik
from touchfield.filters.smoothing import actuator_taps, cutoff_per_m, gaussian
from touchfield.medium.grid import Placement

__all__ = [
    "COMPOSITIONS",
    "LOW_PASSES",
    "NW_RANGE",
    "Ball",
    "Box",
    "Claims",
    "Compose",
    "DeviceFilter",
    "DeviceFilterSpec",
    "EditOperator",
    "Erase",
    "Everywhere",
    "FieldFilter",
    "ForceRange",
    "Gain",
    "HalfSpace",
    "Limit",
    "LowPass",
    "Move",
    "Placement",
    "Region",
    "RigidMotion",
    "Voxels",
    "actuator_taps",
    "apply_filters",
    "cross_fade",
    "cutoff_per_m",
    "device_grid",
    "device_medium",
    "edit_field",
    "edit_medium",
    "fcc_forward",
    "fcc_inverse",
    "field_filters",
    "filter_medium",
    "filter_of",
    "fir_filter",
    "frequency_response",
    "gaussian",
    "half_grid",
    "interpolate",
    "limit_forces",
    "max_levels",
    "perona_malik",
    "pyramid",
    "quincunx_forward",
    "quincunx_inverse",
    "rebuild_level",
    "resample",
]  # fmt: skip
