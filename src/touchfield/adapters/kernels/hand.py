"""The simulated hand's own step: where its target is, and how a spring pulls it there.

State, float64 [10]: time, position, velocity, force. `follow` and `spring` move it on by dt.
"""

from __future__ import annotations

import math

from numba import njit

__all__ = ["follow", "spring", "turned"]

_TURN = 0.1
"""Of a sub-step: the phase by which spring and mass swing on; what is stable reaches to 2."""


@njit(cache=True, nogil=True)
def _sample_after(times, t):
    """The first sample later than t."""
    low, high = 0, times.shape[0]
    while low < high:
        middle = (low + high) // 2
        if times[middle] <= t:
            low = middle + 1
        else:
            high = middle
    return low


@njit(cache=True, nogil=True)
def turned(times, quaternions, t, out):
    """The orientation at t into `out` [4]: along the shorter way, made unit, at rest at both ends as the target."""
    low = _sample_after(times, t)
    a = max(low - 1, 0)
    b = min(low, times.shape[0] - 1)
    share = (t - times[a]) / (times[b] - times[a]) if b > a and low > 0 else 0.0
    cosine = 0.0
    for n in range(4):
        cosine += quaternions[a, n] * quaternions[b, n]
    share, rest = share if cosine >= 0.0 else -share, 1.0 - share
    square = 0.0
    for n in range(4):
        out[n] = rest * quaternions[a, n] + share * quaternions[b, n]
        square += out[n] * out[n]
    for n in range(4):
        out[n] /= math.sqrt(square)


@njit(cache=True, nogil=True)
def _target(times, positions, t):
    """The trajectory at t: linear between samples, at rest at both ends; of equal times the later sample holds."""
    low = _sample_after(times, t)
    if low == 0:
        return positions[0, 0], positions[0, 1], positions[0, 2]
    a = low - 1
    if low == times.shape[0]:
        return positions[a, 0], positions[a, 1], positions[a, 2]
    share = (t - times[a]) / (times[low] - times[a])
    rest = 1.0 - share
    return (
        rest * positions[a, 0] + share * positions[low, 0],
        rest * positions[a, 1] + share * positions[low, 1],
        rest * positions[a, 2] + share * positions[low, 2],
    )


@njit(cache=True, nogil=True)
def follow(times, positions, state, dt):
    """The hand is where the trajectory is, whatever pushes it."""
    state[0] += dt
    state[1], state[2], state[3] = _target(times, positions, state[0])


@njit(cache=True, nogil=True)
def spring(times, positions, state, mass, stiffness, damping, dt):
    """m a = k (target - x) - b v + F, by semi-implicit Euler with b taken implicitly.

    So it is stable where sqrt(k/m) times the sub-step is below 2, for any b; the force holds for the whole dt.
    """
    steps = max(1, math.ceil(dt * math.sqrt(stiffness / mass) / _TURN))
    h = dt / steps
    kept = 1.0 / (1.0 + h * damping / mass)
    for _ in range(steps):
        state[0] += h
        target = _target(times, positions, state[0])
        for axis in range(3):
            pull = stiffness * (target[axis] - state[1 + axis]) + state[7 + axis]
            state[4 + axis] = (state[4 + axis] + h * pull / mass) * kept
            state[1 + axis] += h * state[4 + axis]
