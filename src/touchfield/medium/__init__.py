"""Data types: `Grid`, `ForceField` (one instant), `HapticMedium` (W_t, paper section 4), `HapticScene`."""

from touchfield.medium.field import ForceField, Support
from touchfield.medium.grid import BRICK, Grid
from touchfield.medium.medium import HapticMedium, HapticObject, HapticScene, Segments
from touchfield.medium.pose_track import PoseTrack

__all__ = [
    "BRICK", "ForceField", "Grid", "HapticMedium", "HapticObject", "HapticScene", "PoseTrack", "Segments",
    "Support",
]  # fmt: skip
