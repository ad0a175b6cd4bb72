"""Perception: what a human can tell apart (paper section 4.2), every figure with its source."""

from touchfield.perception.human import Figure, figure, human
from touchfield.perception.mask import SpatialMasking, body_mask_n, mask_n, violations

__all__ = ["Figure", "SpatialMasking", "body_mask_n", "figure", "human", "mask_n", "violations"]
