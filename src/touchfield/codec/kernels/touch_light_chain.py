"""How the light models of coder `touch` are to predict: the law of the field, and how often each chain breaks.

Floats, for the decoder follows none of it: what it needs travels in the frame.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from touchfield.codec.kernels.touch_light_choice import F0, FREE, kept, tolerance, units
from touchfield.codec.kernels.touch_light_coder import lean
from touchfield.codec.kernels.touch_light_predict import SATURATED

__all__ = ["BINS", "chain_breaks", "falls"]

BINS = 1 << 14
"""Classes of a loss of amplitude, 4 units each."""

_CLOSE = 0.3  # squared error, in squared steps, that is let stand where every error has its price
_STEEP = 0.19  # of a force, that must point along an axis to tell of the law


@njit(cache=True, nogil=True, error_model="numpy")
def falls(forces, scale):
    """How many units the amplitude loses in a step along each axis where the force points along it.

    Forces are float32 [n, 8, 8, 8, 3]; pairs of neighbours in a brick are counted but for those at the top.

    Returns
    -------
    counts : int64 [3, BINS]
        Pairs by what is lost, for each axis.
    sums : float64 [2, 3]
        Of |F_c| and of F_c, units.
    """
    counts = np.zeros((3, BINS), np.int64)
    sums = np.zeros((2, 3))
    sizes = np.zeros((8, 8, 8))
    for n in range(forces.shape[0]):
        for x in range(8):
            for y in range(8):
                for z in range(8):
                    square = 0.0
                    for c in range(3):
                        v = np.float64(forces[n, x, y, z, c]) * scale
                        square += v * v
                        sums[0, c] += abs(v)
                        sums[1, c] += v
                    sizes[x, y, z] = np.sqrt(square)
        for x in range(8):
            for y in range(8):
                for z in range(8):
                    a = sizes[x, y, z]
                    if a < 1 or a > 63500:
                        continue
                    for c in range(3):
                        u, v, w = x + (c == 0), y + (c == 1), z + (c == 2)
                        if u == 8 or v == 8 or w == 8:
                            continue
                        b = sizes[u, v, w]
                        along = forces[n, x, y, z, c] * scale
                        if 1 <= b <= 63500 and abs(along) > _STEEP * a:
                            lost = int((a - b) * a / along) >> 2
                            counts[c, min(max(lost, 0), BINS - 1)] += 1
    return counts, sums


@lean
def _follow(w, at, step, component, fall, b, q):
    """What the law makes of the sample before this one; whether that holds any."""
    a = w[at - step, 3]
    if a == 0:
        return False
    length = a
    if a < SATURATED:
        length = max(a - w[at - step, component] / a * fall, a / 8)
    elif b < SATURATED:
        length = b
    for k in range(3):
        q[k] = w[at - step, k] * length / a
    return True


@lean
def _close(q0, q1, q2, f0, f1, f2, b, rule, floor):
    """Whether a sample would be let stand."""
    if rule[FREE] > 0:
        return (q0 - f0) ** 2 + (q1 - f1) ** 2 + (q2 - f2) ** 2 <= _CLOSE * floor**2
    return kept(q0, q1, q2, f0, f1, f2, b, tolerance(b, rule), rule)


@njit(cache=True, nogil=True, error_model="numpy")
def chain_breaks(forces, scale, rule, where, stride, law, floor, rate, reference, reference_slot, stays=False):
    """How often each way to predict breaks the rule in each brick, int64 [n, 4]: 0 from the reference, 1 to 3 from
    the sample before along that axis of the scan.

    Each is tried on the originals: a sample is followed from the one before, as what that was decoded as, until the
    rule is broken. A single chain keeps its error, and so stays within a rule that is relative, where a mean of
    neighbours with errors of their own does not. See `touch_light.code_frame` for the parameters.
    With `stays` the reference is kept where it is off, as in the quick model, and in bricks that keep the rule from
    it no chain is tried: no break is told of them.
    """
    out = np.zeros((where.shape[0], 4), np.int64)
    f = np.zeros((512, 4))
    w = np.zeros((512, 4))
    q = np.zeros(3)
    g = np.zeros((512, 3))
    least = 0.0 if rule[FREE] > 0 else rule[F0]
    for n in range(where.shape[0]):
        at = 0
        for i in range(8):
            for j in range(8):
                for k in range(8):
                    offset = i * stride[0] + j * stride[1] + k * stride[2]
                    f[at, 3] = units(forces, where[n] + offset, scale, q)
                    f[at, 0], f[at, 1], f[at, 2] = q[0], q[1], q[2]
                    if reference_slot[n] >= 0:
                        for c in range(3):
                            g[at, c] = np.float64(reference[reference_slot[n] + offset, c])
                    at += 1
        if reference_slot[n] >= 0 and stays:
            for at in range(512):
                if f[at, 3] > least:
                    b = f[at, 3]
                    tol = tolerance(b, rule)
                    out[n, 0] += not kept(g[at, 0], g[at, 1], g[at, 2], f[at, 0], f[at, 1], f[at, 2], b, tol, rule)
            if out[n, 0] == 0:
                continue
        elif reference_slot[n] >= 0:
            for at in range(512):
                b = f[at, 3]
                w[at, 3] = 0
                if b <= least:
                    continue
                there = g[at, 0] != 0 or g[at, 1] != 0 or g[at, 2] != 0
                if there and at >= 64 and w[at - 64, 3] > 0:  # is it off already?
                    square = most = 0.0
                    for c in range(3):
                        square += (g[at - 64, c] - w[at - 64, c]) ** 2
                        most = max(most, abs(g[at - 64, c]))
                    there = most == 0 or square <= max(floor, w[at - 64, 3] * rate / 65536) ** 2
                if there:
                    q[0], q[1], q[2] = g[at, 0], g[at, 1], g[at, 2]
                elif at < 64 or not _follow(w, at, 64, law[3], np.float64(law[0]), b, q):
                    q[0] = q[1] = q[2] = 0.0
                if _close(q[0], q[1], q[2], f[at, 0], f[at, 1], f[at, 2], b, rule, floor):
                    w[at, 0], w[at, 1], w[at, 2] = q[0], q[1], q[2]
                    w[at, 3] = np.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2])
                    continue
                w[at, 0], w[at, 1], w[at, 2], w[at, 3] = f[at, 0], f[at, 1], f[at, 2], b
                out[n, 0] += there or at >= 64
        for axis in range(3):
            step = 64 >> (3 * axis)
            component, fall = law[3 + axis], np.float64(law[axis])
            for at in range(512):
                b = f[at, 3]
                w[at, 3] = 0
                if b <= least:
                    continue
                inside = (at // step) & 7 > 0
                if (
                    inside
                    and _follow(w, at, step, component, fall, b, q)
                    and _close(q[0], q[1], q[2], f[at, 0], f[at, 1], f[at, 2], b, rule, floor)
                ):
                    w[at, 0], w[at, 1], w[at, 2] = q[0], q[1], q[2]
                    w[at, 3] = np.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2])
                    continue
                w[at, 0], w[at, 1], w[at, 2], w[at, 3] = f[at, 0], f[at, 1], f[at, 2], b
                out[n, 1 + axis] += inside
    return out
