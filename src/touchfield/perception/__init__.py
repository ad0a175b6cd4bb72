"""What people can tell apart: thresholds, each with its source, and the masks and deadbands that follow from
them (paper section 4.2)."""

from touchfield.perception.grip import Grip, WeberCurve, grip
from touchfield.perception.human import Figure, figure, human
from touchfield.perception.mask import SpatialMasking, mask_n, violations

__all__ = [
    "Figure", "Grip", "SpatialMasking", "WeberCurve", "figure", "grip", "human", "mask_n", "violations",
]  # fmt: skip
