"""Drives as the whole steps that an actuator has."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from touchfield.errors import InvalidArgument

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.devices import Device

__all__ = ["drives_of", "steps_of"]


def drives_of(profile: Device, drives: NDArray[np.float32]) -> NDArray[np.float64]:
    """Drives from 0 to 1, float64 [panels, rows, columns]; one that is no number is 0.

    Raises
    ------
    InvalidArgument
        If there are not as many as the profile has actuators.
    """
    columns, rows, _ = profile.lattice
    shape = (profile.panels, rows, columns)
    if np.shape(drives) != shape:
        raise InvalidArgument(f"drives of {profile.name}", f"shape {np.shape(drives)}", f"{shape}")
    return np.clip(np.nan_to_num(np.asarray(drives, np.float64), nan=0.0), 0.0, 1.0)


def steps_of(profile: Device, drives: NDArray[np.float32], levels: int) -> NDArray[np.int64]:
    """The nearest of so many levels, 0 to levels - 1, int64 [panels, rows, columns]; halves go up."""
    return np.floor(drives_of(profile, drives) * (levels - 1) + 0.5).astype(np.int64)
