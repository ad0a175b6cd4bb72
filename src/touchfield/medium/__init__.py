"""The values: `Grid`, `ForceField` (one instant) and `HapticMedium` (W_t, paper section 4)."""

from touchfield.medium.field import ForceField, Support
from touchfield.medium.grid import BRICK, Grid
from touchfield.medium.medium import HapticMedium

__all__ = ["BRICK", "ForceField", "Grid", "HapticMedium", "Support"]
