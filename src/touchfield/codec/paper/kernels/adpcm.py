"""Compiled loop of ADPCM: whole numbers only, one loop for both directions."""

from __future__ import annotations

import numpy as np
from numba import njit

__all__ = ["STEPS", "adpcm"]

STEPS = np.array([16, 19, 23, 27, 32, 38, 45, 54, 64], np.int64)
"""Steps in sixteenths of the finest: a factor 2^(1/4) each."""

_ONE = 1 << 16  # of the weights
_NUDGE = 48
_FAR = 1 << 40


@njit(cache=True, nogil=True)
def adpcm(values, residuals, decoding):
    """ADPCM of one component, int64 [n], in sixteenths: reads `values` and writes `residuals`, or the reverse.

    Two weights follow the signal by the sign of what they miss (as in G.726), and the step goes up after a residual
    of 2 or more and down after a 0. ``values`` holds the decoded signal in both cases.
    """
    w0, w1 = np.int64(_ONE), np.int64(0)
    last = before = rung = np.int64(0)
    for i in range(values.shape[0]):
        slope = last - before
        predicted = (w0 * last + w1 * slope + (_ONE >> 1)) >> 16
        step = STEPS[rung]
        if decoding:
            q = residuals[i]
        else:
            miss = values[i] - predicted
            q = (2 * abs(miss) + step) // (2 * step)
            q = -q if miss < 0 else q
            residuals[i] = q
        value = min(max(predicted + q * step, np.int64(-_FAR)), np.int64(_FAR))  # only strangers' bytes reach it
        values[i] = value
        sign = np.int64(q > 0) - np.int64(q < 0)
        w0 += _NUDGE * sign * (np.int64(last > 0) - np.int64(last < 0))
        w1 += _NUDGE * sign * (np.int64(slope > 0) - np.int64(slope < 0))
        w0 = min(max(w0, np.int64(_ONE * 7 // 8)), np.int64(_ONE * 9 // 8))
        w1 = min(max(w1, np.int64(-_ONE // 4)), np.int64(_ONE))
        if abs(q) >= 2:
            rung = min(rung + 1, STEPS.shape[0] - 1)
        elif q == 0:
            rung = max(rung - 1, np.int64(0))
        before, last = last, value
