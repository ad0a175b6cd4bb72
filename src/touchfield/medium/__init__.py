"""The values: `Grid`, `ForceField` (one instant), `HapticMedium` (W_t, paper section 4), `HapticScene` (objects)."""

from touchfield.medium.field import ForceField, Support
from touchfield.medium.grid import BRICK, Grid
from touchfield.medium.haptic_scene import HapticObject, HapticScene
from touchfield.medium.medium import HapticMedium
from touchfield.medium.pose_track import PoseTrack
from touchfield.medium.segments import Segments

__all__ = [
    "BRICK",
    "ForceField",
    "Grid",
    "HapticMedium",
    "HapticObject",
    "HapticScene",
    "PoseTrack",
    "Segments",
    "Support",
]
