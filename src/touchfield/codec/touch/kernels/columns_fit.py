"""Compiled fits of the column guess: which surface, or two, a column of forces speaks for (floats)."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from touchfield.codec.kernels.lean import entry, inlined, lean
from touchfield.codec.touch.kernels.columns import RAMP, TOP

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = [
    "FIRST", "FIT", "FIT_X", "FIT_Y", "FLAT", "HAS_PLATEAU", "PLATEAU", "STOP", "Source", "fit_columns",
    "ramp_samples", "start_of", "two_surfaces",
]  # fmt: skip

FIT = 8
"""Numbers that the fit of a column has, in the order of the following names."""
FIRST, STOP, FLAT, FIT_X, FIT_Y, PLATEAU, HAS_PLATEAU, _OUTWARD = range(FIT)


class Source(NamedTuple):
    """The bricks of a frame, tile after tile.

    Attributes
    ----------
    starts : int64 [tiles + 1]
        The first brick of each tile.
    lows : int64 [bricks]
        Their first samples along the main axis.
    forces : float32 [bricks, 8, 8, 8, 3]
        Newtons; axes across, across, and the main one.
    depth : int
    inverted : bool
    scale : float
        Units of a newton.
    mask : float64 [2]
        k, and F_0 in units.
    """

    starts: NDArray[np.int64]
    lows: NDArray[np.int64]
    forces: NDArray[np.float32]
    depth: int
    inverted: bool
    scale: float
    mask: NDArray[np.float64]


@entry
def fit_columns(begin, end, source, dense, fits, held):
    """Lay the bricks of tiles begin to end - 1 out as columns, and find the solid run and the direction of each.

    Column c of tile n goes to ``dense[64 (n - begin) + c]``, float32 [depth, 4]: the force across, across, outward
    and its length, in units, from outside to inside. `held` tells whether its run reaches the inner border.
    """
    lows, forces, depth, inverted, scale = source.lows, source.forces, source.depth, source.inverted, source.scale
    for tile in range(begin, end):
        at = (tile - begin) * 64
        for s in range(source.starts[tile], source.starts[tile + 1]):
            for c in range(64):
                for q in range(min(8, depth - lows[s])):
                    t = depth - 1 - lows[s] - q if inverted else lows[s] + q
                    a = forces[s, c >> 3, c & 7, q, 0] * scale
                    b = forces[s, c >> 3, c & 7, q, 1] * scale
                    o = forces[s, c >> 3, c & 7, q, 2] * (scale if inverted else -scale)
                    dense[at + c, t, 0] = a
                    dense[at + c, t, 1] = b
                    dense[at + c, t, 2] = o
                    dense[at + c, t, 3] = np.sqrt(a * a + b * b + o * o)
        for c in range(64):
            held[at + c] = _fit_column(dense[at + c], depth, source.mask[0], source.mask[1], fits[at + c])


@inlined
def _fit_column(d, depth, k, f0, fit):
    a = b = o = 0.0
    first = depth
    while first > 0 and d[first - 1, 3] > 0.0:
        first -= 1
        tol = max(f0, k * d[first, 3])
        w = 1.0 / (tol * tol + 1.0)
        a += w * d[first, 0]
        b += w * d[first, 1]
        o += w * d[first, 2]
    length = np.sqrt(a * a + b * b + o * o)
    if first == depth or o <= 0.05 * length:
        return False
    o /= length
    spread = 16384.0 * np.sqrt(2.0 / (1.0 + o)) / length
    deep = d[depth - 1, 3]
    flat = depth - 1
    while flat > first:
        x, y = d[flat - 1, 0] - d[depth - 1, 0], d[flat - 1, 1] - d[depth - 1, 1]
        z = d[flat - 1, 2] - d[depth - 1, 2]
        if x * x + y * y + z * z > 1e-4 * deep * deep:
            break
        flat -= 1
    fit[FIRST], fit[STOP], fit[FLAT], fit[FIT_X], fit[FIT_Y] = first, depth, flat, a * spread, b * spread
    fit[PLATEAU] = deep
    fit[HAS_PLATEAU] = 1.0 if depth - flat >= 2 else 0.0
    fit[_OUTWARD] = o
    return True


@entry
def ramp_samples(dense, fits, held, out):
    """Growth a sample of the share of the plateau, over the outward cosine, in columns that have a plateau."""
    n = 0
    for c in range(held.shape[0]):
        if held[c] and fits[c, HAS_PLATEAU] and fits[c, _OUTWARD] > 0.3:
            for t in range(int(fits[c, FIRST]), int(fits[c, FLAT]) - 1):
                low = dense[c, t, 3] / fits[c, PLATEAU]
                high = dense[c, t + 1, 3] / fits[c, PLATEAU]
                if 0.2 < low < high < 0.9 and n < out.shape[0]:
                    out[n] = (high - low) / fits[c, _OUTWARD]
                    n += 1
    return n


@lean
def start_of(d, fit, amplitude, slope, k, f0):
    """The start, 1/256 samples, that the ramp of a column speaks for."""
    total = weight = 0.0
    stop = int(fit[FLAT]) if fit[HAS_PLATEAU] else int(fit[STOP])
    for t in range(int(fit[FIRST]), stop):
        share = d[t, 3] / amplitude
        if share > 0.97 and weight > 0.0:
            break
        if t + 1 < stop and d[t + 1, 3] < d[t, 3]:
            break
        tol = max(f0, k * d[t, 3])
        w = 1.0 / (tol * tol)
        total += w * (t * 256.0 - share * 65536.0 * 256.0 / slope)
        weight += w
    if weight == 0.0:
        return fit[FIRST] * 256.0 - 128.0
    return total / weight


@inlined
def _rise_of(d, begin, end, a, b, o, out):
    """Slope a sample and start of the force along (a, b, o) over samples begin to end - 1; False if it falls."""
    n = sx = sy = sxx = sxy = 0.0
    for t in range(begin, end):
        y = d[t, 0] * a + d[t, 1] * b + d[t, 2] * o
        w = 1.0 / max(1.0, y)
        n += w
        sx += w * t
        sy += w * y
        sxx += w * t * t
        sxy += w * t * y
    spread = n * sxx - sx * sx
    if spread <= 1e-9 * n * n:
        return False
    out[0] = (n * sxy - sx * sy) / spread
    if out[0] <= 0.0:
        return False
    out[1] = (sx - sy * n / (n * out[0])) / n
    return True


@lean
def two_surfaces(d, fit, heads, k, f0, out, line):
    """Two surfaces one behind the other: (z, x, y, amplitude) of each, where they miss least."""
    first, stop = int(fit[FIRST]), int(fit[STOP])
    flat = int(fit[FLAT]) if fit[HAS_PLATEAU] else stop
    ramp = heads[RAMP] / 65536.0
    best = 1e18
    step = max(1, (flat - first) // 24)
    for cut in range(first + 3, flat, step):
        a = b = o = 0.0
        for t in range(first, cut):
            length = d[t, 3]
            tol = max(f0, k * length)
            a += d[t, 0] / (tol * tol)
            b += d[t, 1] / (tol * tol)
            o += d[t, 2] / (tol * tol)
        if o <= 0.0:
            continue
        n = np.sqrt(a * a + b * b + o * o)
        a, b, o = a / n, b / n, o / n
        if o < 0.06:
            continue
        knee = cut
        while knee > first + 2 and d[knee - 1, 3] < d[knee - 2, 3] * 1.005 + 0.02 * d[first, 3]:
            knee -= 1
        if not _rise_of(d, first, knee, a, b, o, line):
            continue
        amplitude = line[0] / (ramp * o) if knee == cut else d[cut - 1, 3]
        z1 = line[1]
        slope1 = ramp * o
        x, y, w = d[stop - 1, 0] - amplitude * a, d[stop - 1, 1] - amplitude * b, d[stop - 1, 2] - amplitude * o
        if not fit[HAS_PLATEAU]:
            x = y = w = 0.0
            for t in range(cut, stop):
                s = min(1.0, max(0.0, (t - z1) * slope1)) * amplitude
                x, y, w = x + d[t, 0] - s * a, y + d[t, 1] - s * b, w + d[t, 2] - s * o
        n = np.sqrt(x * x + y * y + w * w)
        if w < 0.06 * n or n < f0:
            continue
        x, y, w = x / n, y / n, w / n
        slope2 = ramp * w
        if not fit[HAS_PLATEAU]:
            n = float(heads[TOP]) - amplitude
            if n < f0:
                continue
        z2 = weight = 0.0
        for t in range(cut, flat):
            s = min(1.0, max(0.0, (t - z1) * slope1)) * amplitude
            rest = ((d[t, 0] - s * a) * x + (d[t, 1] - s * b) * y + (d[t, 2] - s * o) * w) / n
            if 0.05 < rest < 0.9:
                z2 += t - rest / slope2
                weight += 1.0
        z2 = z2 / weight if weight > 0.0 else float(cut)
        cost = 0.0
        for t in range(first, flat):
            s = min(1.0, max(0.0, (t - z1) * slope1)) * amplitude
            r = min(1.0, max(0.0, (t - z2) * slope2)) * n
            tol = max(f0, k * d[t, 3])
            p, q, v = s * a + r * x - d[t, 0], s * b + r * y - d[t, 1], s * o + r * w - d[t, 2]
            error = (p * p + q * q + v * v) / (tol * tol)
            cost += min(error, 4.0)
        if cost < best:
            best = cost
            scale, behind = 16384.0 * np.sqrt(2.0 / (1.0 + o)), 16384.0 * np.sqrt(2.0 / (1.0 + w))
            out[0], out[1], out[2], out[3] = z1 * 256.0, a * scale, b * scale, amplitude
            out[4], out[5], out[6], out[7] = z2 * 256.0, x * behind, y * behind, n
    return best < 1e18
