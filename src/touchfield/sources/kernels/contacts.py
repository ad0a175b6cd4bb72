"""The compiled sum of `touchfield.sources.contact_trace`: forces at points, and none far from all that was met."""

from __future__ import annotations

import math

from touchfield.lean import entry

__all__ = ["add_forces"]

_FAR = 50.0  # of r^2 / l^2, where exp(-r^2 / 2 l^2) is 1e-11


@entry
def add_forces(begin, end, at, points, weights, reach, out):
    """Forces at `at`, float64 [n, 3], in lengths of the kernel; 0 where no point is within `reach`."""
    for i in range(begin, end):
        nearest = math.inf
        fx = fy = fz = 0.0
        for j in range(len(points)):
            dx, dy, dz = at[i, 0] - points[j, 0], at[i, 1] - points[j, 1], at[i, 2] - points[j, 2]
            squared = dx * dx + dy * dy + dz * dz
            if squared < nearest:
                nearest = squared
            if squared < _FAR:
                share = math.exp(-0.5 * squared)
                wx, wy, wz = weights[j, 0], weights[j, 1], weights[j, 2]
                along = dx * wx + dy * wy + dz * wz
                fx += share * (wx - along * dx)
                fy += share * (wy - along * dy)
                fz += share * (wz - along * dz)
        if nearest <= reach * reach:
            out[i, 0], out[i, 1], out[i, 2] = fx, fy, fz
