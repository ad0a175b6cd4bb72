"""Sources of dependent symbols, for tests of intervals."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import signal

Ints = NDArray[np.int64]


def markov(rng: np.random.Generator, n: int) -> Ints:
    """A binary chain that leaves 0 with probability .05 and 1 with .2, from its stationary state."""
    state = int(rng.random() < 0.2)
    runs = [rng.geometric((0.05, 0.2)[(state + i) % 2]) for i in range(n)]
    return np.repeat((state + np.arange(n)) % 2, runs)[:n]


def levels(rng: np.random.Generator, n: int) -> Ints:
    """An AR(1) process of correlation .8 in 64 levels."""
    x = signal.lfilter([0.6], [1, -0.8], rng.standard_normal(n + 200))[200:]
    return np.clip(np.floor(8 * x) + 32, 0, 63).astype(np.int64)
