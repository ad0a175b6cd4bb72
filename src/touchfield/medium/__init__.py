"""Data types of haptic media, which are force fields over time (paper section 4). All other packages use
them.

`Grid` is a lattice, `ForceField` one instant, `HapticMedium` a sequence of fields (W_t), and `HapticScene`
objects with poses.
"""

from touchfield.medium.field import ForceField, Support
from touchfield.medium.grid import BRICK, Grid
from touchfield.medium.medium import HapticMedium, HapticObject, HapticScene, Segments
from touchfield.medium.pose_track import PoseTrack

__all__ = [
    "BRICK", "ForceField", "Grid", "HapticMedium", "HapticObject", "HapticScene", "PoseTrack", "Segments",
    "Support",
]  # fmt: skip
