"""Noise at the rate of a vibration, and decibels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

RATE_HZ = 2500.0

Float64s = NDArray[np.float64]


def noise(*shape: int, seed: int = 0) -> Float64s:
    return np.random.default_rng(seed).normal(size=shape)


def db(ratio: Any) -> Any:
    return 20 * np.log10(ratio)
