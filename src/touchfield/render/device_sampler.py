"""F(x, t) at many points at once on a GPU: what `FieldSampler.force_n` tells, where the points are there already."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from touchfield.cuda import empty, for_each, on_device
from touchfield.errors import InvalidArgument
from touchfield.render.kernels.points import forces_at_points
from touchfield.render.sampler import FieldSampler

if TYPE_CHECKING:
    from touchfield.medium import HapticMedium
    from touchfield.medium.medium import HapticScene


class DeviceSampler:
    """Forces of a medium or a scene of objects at points in the memory of a GPU (extra ``cuda``).

    The frames about an instant are made by the processor and copied once; points and forces are not copied.

    Parameters
    ----------
    medium : HapticMedium or HapticScene
    memory_bytes : int
        For frames, as of `FieldSampler`.
    """

    def __init__(self, medium: HapticMedium | HapticScene, memory_bytes: int = 256 << 20) -> None:
        self._sampler = FieldSampler(medium, memory_bytes)
        self._places: tuple[int, int] | None = None
        self._views: tuple[Any, ...] = ()

    def force_n(self, time_s: float, points_m: Any, loop: bool = False) -> Any:
        """Force, newtons, float32 [n, 3], on the device.

        points_m : float64 [n, 3], metres: an array on a GPU of any library (``__dlpack__`` or
            ``__cuda_array_interface__``), or one of NumPy, which is copied there.

        The result has a ``__cuda_array_interface__``. Raises `InvalidArgument` for another shape or type.
        """
        if len(points_m.shape) != 2 or points_m.shape[1] != 3 or points_m.dtype != np.float64:
            found = f"{points_m.dtype}, shape {tuple(points_m.shape)}"
            raise InvalidArgument("points_m", found, "float64 [n, 3], metres")
        memory, first, second, blend = self._sampler.frames_at(time_s, loop)
        if self._places != (first, second):
            self._views, self._places = on_device(tuple(memory.views)), (first, second)
        out = empty((points_m.shape[0], 3), np.float32)
        blends = on_device(np.array([blend]))
        points = on_device(points_m)
        for_each(forces_at_points, len(out), points, blends, *self._views, first, second, out)
        return out
