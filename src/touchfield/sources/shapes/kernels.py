"""Compiled inner loops that several sources share: distance to an ellipsoid, forces that interpolate recorded
contacts, and the sum of the fields of moving bodies."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from touchfield.compute.coder_jit import entry
from touchfield.compute.jit import kernel

_MAX_STEPS: Final = 60  # of Newton's iteration; at its slowest, near the focal ellipse, it needs about ten
_CUTOFF = 50.0  # of r^2 / l^2, at which exp(-r^2 / 2 l^2) is 1e-11


@kernel
def greatest_roots(scaled, ratio):
    """Solve sum (r_i z_i / (u + r_i - 1))^2 = 1 for u >= 0, float64 [n].

    Returns 0 if the sum is always below 1.

    `scaled` float64 [n, 3]: z_i = |p_i| / e_i; `ratio` float64 [3]: r_i = (e_i / e_min)^2.
    """
    roots = np.empty(len(scaled))
    for k in range(len(scaled)):
        root = 0.0
        for i in range(3):  # no term may exceed 1 at the root
            root = max(root, ratio[i] * scaled[k, i] - (ratio[i] - 1.0))
        for _ in range(_MAX_STEPS):
            square = fall = 0.0
            for i in range(3):
                denominator = root + (ratio[i] - 1.0)
                if denominator > 0.0:
                    term = (ratio[i] * scaled[k, i] / denominator) ** 2
                    square += term
                    fall += term / denominator
            if square <= 1.0:
                break
            after = root + square * (math.sqrt(square) - 1.0) / fall
            if after <= root * (1.0 + 4e-16):
                break
            root = after
        roots[k] = root
    return roots


@entry
def add_forces(start, stop, positions, points, weights, reach, out):
    """Add forces at `positions`, float64 [n, 3], in kernel lengths.

    Forces are 0 if no point is within `reach`.
    """
    for i in range(start, stop):
        nearest = math.inf
        fx = fy = fz = 0.0
        for j in range(len(points)):
            dx, dy, dz = (
                positions[i, 0] - points[j, 0],
                positions[i, 1] - points[j, 1],
                positions[i, 2] - points[j, 2],
            )
            squared = dx * dx + dy * dy + dz * dz
            if squared < nearest:
                nearest = squared
            if squared < _CUTOFF:
                weight = math.exp(-0.5 * squared)
                wx, wy, wz = weights[j, 0], weights[j, 1], weights[j, 2]
                along = dx * wx + dy * wy + dz * wz
                fx += weight * (wx - along * dx)
                fy += weight * (wy - along * dy)
                fz += weight * (wz - along * dz)
        if nearest <= reach * reach:
            out[i, 0], out[i, 1], out[i, 2] = fx, fy, fz


@kernel
def add_body(start, stop, bricks, forces, slots, lattice, motion, total):
    """Add a body's forces, on a lattice of origin and spacing, to the bricks `slots` of a sum.

    Where there is a force, b (v + omega x r) is added: `motion` is the origin, metres; b v, newtons; b omega,
    N/m.
    """
    ox, oy, oz, vx, vy, vz, wx, wy, wz = motion
    for s in range(start, stop):
        for i in range(8):
            dx = lattice[0] + (8 * bricks[s, 0] + i) * lattice[3] - ox
            for j in range(8):
                dy = lattice[1] + (8 * bricks[s, 1] + j) * lattice[4] - oy
                for k in range(8):
                    f, t = forces[s, i, j, k], total[slots[s], i, j, k]
                    if f[0] != 0 or f[1] != 0 or f[2] != 0:
                        dz = lattice[2] + (8 * bricks[s, 2] + k) * lattice[5] - oz
                        t[0] += f[0] + (vx + wy * dz - wz * dy)
                        t[1] += f[1] + (vy + wz * dx - wx * dz)
                        t[2] += f[2] + (vz + wx * dy - wy * dx)
