"""How a force changes from a sample to its neighbour, learnt while coding; whole numbers only.

Behind a surface the force grows with the depth, F = K d n (paper section 3.2): one step against n makes it longer by
K times the step. How much, by its length and by the step's cosine to n, is read off the samples coded so far, and so
is the chance that the neighbour holds a force at all.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from touchfield.codec.kernels.lean import LEAN

__all__ = ["COSINES", "LEVELS", "Transitions", "fresh_transitions", "learn_chance", "learn_change", "look_up"]

LEVELS = 16
"""Bins of the length, each a sixteenth of 65536 units."""

COSINES = 7
"""Bins of the step's cosine times its length, each half a voxel, -1.75 to 1.75."""

_REACH = 448  # 1.75 in 1/256


class Transitions(NamedTuple):
    """What was learnt, at the corners of the bins, int64 [17, 8] each.

    The mean change and mean deviation in units, the weight seen in 1/256, and the chance of 65536 that a neighbour
    holds a force.
    """

    change: np.ndarray
    deviation: np.ndarray
    weight: np.ndarray
    chance: np.ndarray


def fresh_transitions(slope: int) -> Transitions:
    """Before anything is learnt: `slope` units a voxel along the force."""
    level = np.arange(LEVELS + 1, dtype=np.int64)[:, None] << 12
    step = (np.arange(COSINES + 1, dtype=np.int64) * 128 - _REACH)[None, :]
    change = np.clip(level + (step * slope >> 8), 0, 1 << 16) - level
    shape = change.shape
    return Transitions(
        change, np.full(shape, 6000, np.int64), np.full(shape, 768, np.int64), np.full(shape, 45875, np.int64)
    )


@njit(**LEAN, inline="always")
def _place(a, step):
    x = min(max((step + _REACH) << 1, 0), (COSINES << 8) - 1)
    y = min(a, 65535) >> 4
    return y >> 8, y & 255, x >> 8, x & 255


@njit(**LEAN)
def look_up(t, a, step, out):
    """Change, deviation and chance of a neighbour, bilinear: ``out[:3]``; `step` in 1/256 voxels along the force."""
    i, u, j, v = _place(a, step)
    w00 = (256 - u) * (256 - v)
    w01 = (256 - u) * v
    w10 = u * (256 - v)
    w11 = u * v
    c, d, p = t.change, t.deviation, t.chance
    out[0] = (c[i, j] * w00 + c[i, j + 1] * w01 + c[i + 1, j] * w10 + c[i + 1, j + 1] * w11) >> 16
    out[1] = (d[i, j] * w00 + d[i, j + 1] * w01 + d[i + 1, j] * w10 + d[i + 1, j + 1] * w11) >> 16
    out[2] = (p[i, j] * w00 + p[i, j + 1] * w01 + p[i + 1, j] * w10 + p[i + 1, j + 1] * w11) >> 16


@njit(**LEAN)
def learn_change(t, a, step, change):
    """The force went from `a` to ``a + change`` over `step`."""
    i, u, j, v = _place(a, step)
    for y in range(2):
        for x in range(2):
            w = (u if y else 256 - u) * (v if x else 256 - v) >> 8
            if w > 12:
                total = min(t.weight[i + y, j + x] + w, 102400)
                t.weight[i + y, j + x] = total
                off = change - t.change[i + y, j + x]
                t.change[i + y, j + x] += off * w // total
                t.deviation[i + y, j + x] += (abs(off) - t.deviation[i + y, j + x]) * w // total


@njit(**LEAN)
def learn_chance(t, a, step, held):
    """A neighbour at `step` of a force `a` holds one, or none."""
    i, u, j, v = _place(a, step)
    i += u >> 7
    j += v >> 7
    t.chance[i, j] += ((65535 if held else 0) - t.chance[i, j]) // 50
