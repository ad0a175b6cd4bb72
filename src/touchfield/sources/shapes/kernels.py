"""Compiled inner loops that several sources share: forces that interpolate recorded contacts, and the sum of
the fields of moving bodies."""

from __future__ import annotations

import math

from touchfield.compute.jit import kernel

_CUTOFF = 50.0  # of r^2 / l^2, at which exp(-r^2 / 2 l^2) is 1e-11


@kernel(error_model="numpy")
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
