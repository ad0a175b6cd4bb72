"""Limits of human touch (paper section 4.2), every figure with its source; masks and deadbands."""

from touchfield.perception.human import Figure, figure, human
from touchfield.perception.mask import SpatialMasking, mask_n, violations

__all__ = ["Figure", "SpatialMasking", "figure", "human", "mask_n", "violations"]
