"""Filters: the device filter, the paper's mapping M (sections 3.1 and 4.1), and the haptic filters of section
3.2.

==================  ===========================================================================================
M of a device       `DeviceFilter`, `device_medium`, `resample`, `LOW_PASSES`, `device_grid`, `Placement`
on arrays           `fir_filter`, `gaussian`, `perona_malik`, `quincunx_forward`, `fcc_forward` and their inverses
on fields           `field_filters` names them all; `filter_of`, `filtered`, `filtered_medium`
eq. 5               `frequency_response`
editing             `edited`, `edited_medium`; regions `Box`, `Ball`, `HalfSpace`, `Voxels`, `ForceRange`; operators
                    `Gain`, `Erased`, `Composed`, `Moved`, `Limited` or any filter; `RigidMotion`
in time             `cross_faded`
level of detail     `pyramid`, `rebuilt`, `interpolated`
==================  ===========================================================================================
"""

from touchfield.filters.device_filter import (
    NW_RANGE,
    DeviceFilter,
    DeviceFilterSpec,
    device_grid,
    device_medium,
    limited,
)
from touchfield.filters.edit import (
    COMPOSITIONS,
    Composed,
    EditOperator,
    Erased,
    Gain,
    Limited,
    Moved,
    cross_faded,
    edited,
    edited_medium,
)
from touchfield.filters.fir import fir_filter, frequency_response
from touchfield.filters.lifting import (
    fcc_forward,
    fcc_inverse,
    quincunx_forward,
    quincunx_inverse,
)
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
    field_filters,
    filter_of,
    filtered,
    filtered_medium,
)
from touchfield.filters.resample import (
    LOW_PASSES,
    LowPass,
    halved,
    interpolated,
    most_levels,
    pyramid,
    rebuilt,
    resample,
)
from touchfield.filters.shading import perona_malik
from touchfield.filters.smoothing import actuator_taps, cutoff_per_m, gaussian
from touchfield.medium.grid import Placement

__all__ = [
    "COMPOSITIONS", "LOW_PASSES", "NW_RANGE", "Ball", "Box", "Claims", "Composed", "DeviceFilter", "DeviceFilterSpec",
    "EditOperator", "Erased", "Everywhere", "FieldFilter", "ForceRange", "Gain", "HalfSpace",
    "Limited", "LowPass", "Moved", "Placement", "Region", "RigidMotion", "Voxels", "actuator_taps",
    "cross_faded", "cutoff_per_m", "device_grid", "device_medium", "edited", "edited_medium",
    "fcc_forward", "fcc_inverse", "field_filters", "filter_of", "filtered", "filtered_medium", "fir_filter",
    "frequency_response", "gaussian", "halved", "interpolated", "limited", "most_levels",
    "perona_malik", "pyramid", "quincunx_forward", "quincunx_inverse", "rebuilt", "resample",
]  # fmt: skip
