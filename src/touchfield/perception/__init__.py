"""What a human hand can feel: thresholds, each with its source, and the masks and deadbands that follow from
them (paper section 4.2)."""

from touchfield.perception.human import Figure, figure, human
from touchfield.perception.mask import SpatialMasking, mask_n, violations

__all__ = ["Figure", "SpatialMasking", "figure", "human", "mask_n", "violations"]
