"""Selects frames of a medium: those at given indices, or some that are evenly spaced."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from touchfield.medium.medium import HapticMedium


def evenly_spaced(count: int, maximum: int) -> list[int]:
    """Return at most `maximum` indices below `count`, evenly spaced.

    The first and the last index are included.
    """
    indices: list[int] = np.unique(
        np.linspace(0, count - 1, min(maximum, count)).round().astype(int)
    ).tolist()
    return indices


def select_frames(medium: HapticMedium, indices: Sequence[int]) -> HapticMedium:
    """Return the medium of the frames at `indices`, in that order."""
    vibration = medium.vibration
    if vibration is not None:
        vibration = [vibration(i) for i in indices].__getitem__
    return replace(
        medium,
        frame_count=len(indices),
        make_frame=lambda i: medium[indices[i]],
        vibration=vibration,
        segments=None,
    )
