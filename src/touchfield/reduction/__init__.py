"""Represents a medium by fewer numbers (paper section 6): by a few modes, by few sample points, or without
the samples that no hand can reach.

modes          snapshots as a few modes, with a known error; points that determine their coefficients
snapshots      a medium as snapshots: frames, or bricks; degrees of freedom
reach          the samples that a hand can reach
kernel_points  points of a curl-free field, by the variance or the error that they leave
"""

from touchfield.reduction.kernel_points import Kernel, best_kernels, error_points, variance_points
from touchfield.reduction.modes import ModePoints, Modes, klt, mode_points, pod
from touchfield.reduction.reach import Hand, Reach, reach_of
from touchfield.reduction.snapshots import (
    KINDS,
    Freedom,
    HeldOut,
    ReducedMedium,
    freedom,
    held_out,
    reduce_to_modes,
)

__all__ = [
    "KINDS", "Freedom", "Hand", "HeldOut", "Kernel", "ModePoints", "Modes", "Reach", "ReducedMedium",
    "best_kernels", "error_points", "freedom", "held_out", "klt", "mode_points", "pod", "reach_of",
    "reduce_to_modes", "variance_points",
]  # fmt: skip
