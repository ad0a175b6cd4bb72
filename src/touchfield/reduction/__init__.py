"""A medium in fewer numbers (paper section 6): what varies together, what no hand can reach, the fewest points.

modes          snapshots as a few modes, their error known beforehand
mode_points    the points that tell the coefficients of modes
kernel_points  points of a field without curl: where least is known, or most would be missed
"""

from touchfield.reduction.kernel_points import Kernel, best_kernel, error_points, variance_points
from touchfield.reduction.mode_points import ModePoints, mode_points
from touchfield.reduction.modes import Modes, klt, pod

__all__ = [
    "Kernel",
    "ModePoints",
    "Modes",
    "best_kernel",
    "error_points",
    "klt",
    "mode_points",
    "pod",
    "variance_points",
]
