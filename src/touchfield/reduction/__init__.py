"""A medium in fewer numbers (paper section 6.1): what varies together, and what no hand can reach.

modes        snapshots as a few modes, their error known beforehand
snapshots    a medium as such: frames, or bricks; degrees of freedom
reach        where a hand can get to, and where never
"""

from touchfield.reduction.modes import Modes, klt, pod
from touchfield.reduction.reach import Hand, Reach, reach_of
from touchfield.reduction.snapshots import KINDS, Freedom, HeldOut, Reduced, freedom, held_out, reduced

__all__ = ["KINDS", "Freedom", "Hand", "HeldOut", "Modes", "Reach", "Reduced", "freedom", "held_out", "klt", "pod",
           "reach_of", "reduced"]  # fmt: skip
