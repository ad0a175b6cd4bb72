"""Compiled loops of DPCM and ADPCM: whole numbers only, one loop for both directions."""

from __future__ import annotations

import numpy as np
from numba import njit

__all__ = ["ADPCM_STEPS", "GRAIN", "TAPS", "adpcm", "dpcm_decoded"]

GRAIN = 16
"""Parts of the finest step that ADPCM counts in."""

TAPS = 2
_ONE = 1 << 16  # of the weights
_NUDGE = 48
_FAR = 1 << 40

ADPCM_STEPS = np.rint(GRAIN * 2.0 ** (np.arange(9) / 4)).astype(np.int64)
"""Steps that ADPCM goes up and down: a factor 2^(1/4) each, four times the finest at most."""


@njit(cache=True, nogil=True)
def dpcm_decoded(residuals, leak):
    """Running values of residuals int64 [n]: each is ``leak / 256`` of the one before, rounded, and the residual."""
    out = np.empty_like(residuals)
    value = np.int64(0)
    for i in range(residuals.shape[0]):
        value = ((leak * value + 128) >> 8) + residuals[i]
        value = min(max(value, np.int64(-_FAR)), np.int64(_FAR))  # only bytes of strangers reach it
        out[i] = value
    return out


@njit(cache=True, nogil=True)
def adpcm(values, residuals, steps, decoding):
    """ADPCM of one component, int64 [n], in grains: reads `values` and writes `residuals`, or the other way round.

    Two weights follow the signal by the sign of what they miss (as in G.726), and the step goes up after a
    residual of 2 or more and down after a 0. Returns nothing; ``values`` holds the decoded signal in both cases.
    """
    w0, w1 = np.int64(_ONE), np.int64(0)
    last = before = np.int64(0)
    rung = np.int64(0)
    last_rung = np.int64(steps.shape[0] - 1)
    for i in range(values.shape[0]):
        predicted = (w0 * last + w1 * (last - before) + (_ONE >> 1)) >> 16
        step = steps[rung]
        if decoding:
            q = residuals[i]
        else:
            miss = values[i] - predicted
            q = (2 * abs(miss) + step) // (2 * step)
            q = -q if miss < 0 else q
            residuals[i] = q
        value = predicted + q * step
        value = min(max(value, np.int64(-_FAR)), np.int64(_FAR))
        values[i] = value
        sign = np.int64(q > 0) - np.int64(q < 0)
        slope = last - before
        w0 += _NUDGE * sign * (np.int64(last > 0) - np.int64(last < 0))
        w1 += _NUDGE * sign * (np.int64(slope > 0) - np.int64(slope < 0))
        w0 = min(max(w0, np.int64(_ONE * 7 // 8)), np.int64(_ONE * 9 // 8))
        w1 = min(max(w1, np.int64(-_ONE // 4)), np.int64(_ONE))
        if abs(q) >= 2:
            rung = min(rung + 1, last_rung)
        elif q == 0:
            rung = max(rung - 1, np.int64(0))
        before, last = last, value
