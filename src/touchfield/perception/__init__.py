"""Perception: what a human can tell apart (paper section 4.2), every figure with its source."""

from touchfield.perception.human import Figure, figure, human
from touchfield.perception.mask import mask_n, violations
from touchfield.perception.masking import SpatialMasking, body_mask_n

__all__ = ["Figure", "SpatialMasking", "body_mask_n", "figure", "human", "mask_n", "violations"]
