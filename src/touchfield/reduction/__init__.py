"""A medium in fewer numbers (paper section 6): what varies together, what no hand can reach, the fewest points.

modes          snapshots as a few modes, their error known beforehand
snapshots      a medium as such: frames, or bricks; degrees of freedom
reach          where a hand can get to, and where never
mode_points    the points that tell the coefficients of modes
kernel_points  points of a field without curl: where least is known, or most would be missed
"""

from touchfield.reduction.kernel_points import Kernel, best_kernel, error_points, variance_points
from touchfield.reduction.mode_points import ModePoints, mode_points
from touchfield.reduction.modes import Modes, klt, pod
from touchfield.reduction.reach import Hand, Reach, reach_of
from touchfield.reduction.snapshots import KINDS, Freedom, HeldOut, Reduced, freedom, held_out, reduced

__all__ = [
    "KINDS", "Freedom", "Hand", "HeldOut", "Kernel", "ModePoints", "Modes", "Reach", "Reduced", "best_kernel",
    "error_points", "freedom", "held_out", "klt", "mode_points", "pod", "reach_of", "reduced", "variance_points",
]  # fmt: skip
