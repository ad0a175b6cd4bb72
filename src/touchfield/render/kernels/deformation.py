"""Compiled: where a bent medium is looked up, how that turns its force, and how it yields (`medium.deformation`).

The lattice of control points lies in the block behind the parts of a frame (`block.words`, WARP); what yields lies
apart, for the ticks alone to write. A query takes the 64 control points about it, those of two frames blended and of
what yields added, and sums them with the weights and slopes of a cubic B-spline. Nothing is allocated.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from touchfield.lean import UNCOUNTED
from touchfield.render.block import words as W
from touchfield.render.kernels.vectors import along, dot, plus, three, times


@njit(**UNCOUNTED, forceinline=True)
def warp_of(i8, frame):
    """The word of a frame's lattice; 0 where it has none."""
    offset = i8[np.uint64(frame + W.FRAME_WARP)]
    return frame + offset if offset > 0 else 0


@njit(**UNCOUNTED, forceinline=True)
def _weights(t, inverse):
    """A cubic B-spline in a cell: weights of four control points, their first and second slopes."""
    r = 1.0 - t
    slope, second = 0.5 * inverse, inverse * inverse
    w = r * r * r / 6, (3 * t * t * t - 6 * t * t + 4) / 6, (3 * r * r * r - 6 * r * r + 4) / 6, t * t * t / 6
    d = -slope * r * r, slope * (3 * t * t - 4 * t), -slope * (3 * r * r - 4 * r), slope * t * t
    return w, d, (second * r, second * (3 * t - 2), second * (3 * r - 2), second * t)


@njit(**UNCOUNTED, forceinline=True)
def _cell(f8, i8, warp, axis, x):
    """First control point about x along an axis, place in the cell, and 1 / spacing; 0 beyond, where u is flat."""
    inverse = f8[np.uint64(warp + W.WARP_INVERSE + axis)]
    cells = i8[np.uint64(warp + axis)] - 3
    s = (x - f8[np.uint64(warp + W.WARP_CORNER + axis)]) * inverse
    if not 0.0 <= s <= cells:
        inverse, s = 0.0, min(max(s, 0.0), 1.0 * cells) if s == s else 0.0
    i = min(np.int64(s), cells - 1)
    return i, s - i, inverse


@njit(**UNCOUNTED, cache=True)
def bent(i8, f8, frame_a, frame_b, blend, p):
    """Displacement u at a point, metres, and its slopes along x, y and z: four triples."""
    a, b = warp_of(i8, frame_a), warp_of(i8, frame_b)
    i, tx, hx = _cell(f8, i8, a, 0, p[0])
    j, ty, hy = _cell(f8, i8, a, 1, p[1])
    k, tz, hz = _cell(f8, i8, a, 2, p[2])
    (wx, dx, _), (wy, dy, _), (wz, dz, _) = _weights(tx, hx), _weights(ty, hy), _weights(tz, hz)
    u, gx, gy, gz = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for m in range(4):
        for n in range(4):
            # along z first: four control points that lie one behind the other
            c, g = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
            for o in range(4):
                v = _control(i8, f8, a, b, blend, i + m, j + n, k + o)
                c, g = along(c, wz[o], v), along(g, dz[o], v)
            u, gz = along(u, wx[m] * wy[n], c), along(gz, wx[m] * wy[n], g)
            gx, gy = along(gx, dx[m] * wy[n], c), along(gy, wx[m] * dy[n], c)
    return u, gx, gy, gz


@njit(**UNCOUNTED, forceinline=True)
def stored_place(i8, f8, frame_a, frame_b, blend, p):
    """Where in the medium as it is stored a point is looked up."""
    return plus(p, bent(i8, f8, frame_a, frame_b, blend, p)[0]) if warp_of(i8, frame_a) > 0 else p


@njit(**UNCOUNTED, cache=True)
def bends(i8, f8, frame_a, frame_b, blend, p, force):
    """Second slopes of force . u at a point: xx, xy, xz, yy, yz, zz."""
    a, b = warp_of(i8, frame_a), warp_of(i8, frame_b)
    i, tx, hx = _cell(f8, i8, a, 0, p[0])
    j, ty, hy = _cell(f8, i8, a, 1, p[1])
    k, tz, hz = _cell(f8, i8, a, 2, p[2])
    (wx, dx, ex), (wy, dy, ey), (wz, dz, ez) = _weights(tx, hx), _weights(ty, hy), _weights(tz, hz)
    xx = xy = xz = yy = yz = zz = 0.0
    for m in range(4):
        for n in range(4):
            for o in range(4):
                v = dot(force, _control(i8, f8, a, b, blend, i + m, j + n, k + o))
                xx += ex[m] * wy[n] * wz[o] * v
                xy += dx[m] * dy[n] * wz[o] * v
                xz += dx[m] * wy[n] * dz[o] * v
                yy += wx[m] * ey[n] * wz[o] * v
                yz += wx[m] * dy[n] * dz[o] * v
                zz += wx[m] * wy[n] * ez[o] * v
    return xx, xy, xz, yy, yz, zz


@njit(**UNCOUNTED, forceinline=True)
def _control(i8, f8, a, b, blend, i, j, k):
    """A control point of two frames, blended, and what it yields."""
    at = 3 * ((i * i8[np.uint64(a + 1)] + j) * i8[np.uint64(a + 2)] + k)
    v = three(f8, a + W.WARP_WORDS + at)
    if b != a:
        v = plus(times(1.0 - blend, v), times(blend, three(f8, b + W.WARP_WORDS + at)))
    soft = i8[np.uint64(a + W.WARP_YIELD)]
    return plus(v, three(f8, soft + at)) if soft > 0 else v


@njit(**UNCOUNTED, cache=True)
def give_way(i8, f8, frame, p, force, dt):
    """Let the control points of what yields follow a force at a point for a tick of `dt` seconds.

    Those about the point go to where u there would be the compliance times the force, all others back to rest, each
    with the same time constant, and none farther than keeps the map from folding.
    """
    warp = warp_of(i8, frame)
    soft = i8[np.uint64(warp + W.WARP_YIELD)] if warp > 0 else 0
    if soft <= 0:
        return
    stay = math.exp(-dt / f8[np.uint64(warp + W.WARP_RELAX)])
    ny, nz = i8[np.uint64(warp + 1)], i8[np.uint64(warp + 2)]
    for n in range(soft, soft + 3 * i8[np.uint64(warp)] * ny * nz):
        f8[np.uint64(n)] *= stay
    i, tx, hx = _cell(f8, i8, warp, 0, p[0])
    j, ty, hy = _cell(f8, i8, warp, 1, p[1])
    k, tz, hz = _cell(f8, i8, warp, 2, p[2])
    if hx == 0.0 or hy == 0.0 or hz == 0.0:
        return  # the point is beyond the lattice
    wx, wy, wz = _weights(tx, hx)[0], _weights(ty, hy)[0], _weights(tz, hz)[0]
    square = _square(wx) * _square(wy) * _square(wz)
    share = (1.0 - stay) * f8[np.uint64(warp + W.WARP_COMPLIANCE)] / square
    most = f8[np.uint64(warp + W.WARP_MOST)]
    for m in range(4):
        for n in range(4):
            for o in range(4):
                at = soft + 3 * (((i + m) * ny + j + n) * nz + k + o)
                w = share * wx[m] * wy[n] * wz[o]
                for c in range(3):
                    f8[at + c] = min(max(f8[at + c] + w * force[c], -most), most)


@njit(**UNCOUNTED, forceinline=True)
def _square(w):
    return w[0] * w[0] + w[1] * w[1] + w[2] * w[2] + w[3] * w[3]
