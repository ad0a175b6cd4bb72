"""A medium in fewer numbers (paper section 6): what varies together, what no hand can reach, the fewest
points.

modes          snapshots as a few modes, their error known beforehand; points that tell their coefficients
snapshots      a medium as such: frames, or bricks; degrees of freedom
reach          where a hand can get to, and where never
kernel_points  points of a field without curl: where least is known, or most would be missed
"""

from touchfield.reduction.kernel_points import Kernel, best_kernel, error_points, variance_points
from touchfield.reduction.modes import ModePoints, Modes, klt, mode_points, pod
from touchfield.reduction.reach import Hand, Reach, reach_of
from touchfield.reduction.snapshots import KINDS, Freedom, HeldOut, Reduced, freedom, held_out, reduced

__all__ = [
    "KINDS", "Freedom", "Hand", "HeldOut", "Kernel", "ModePoints", "Modes", "Reach", "Reduced", "best_kernel",
    "error_points", "freedom", "held_out", "klt", "mode_points", "pod", "reach_of", "reduced", "variance_points",
]  # fmt: skip
