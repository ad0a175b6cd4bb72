"""Limits of human touch, each with its source; masks and deadbands (section 4.2)."""

from touchfield.perception.human import Figure, figure, human
from touchfield.perception.mask import SpatialMasking, mask_n, violations

__all__ = ["Figure", "SpatialMasking", "figure", "human", "mask_n", "violations"]
