"""Computes how much larger the error of coder `touch` may be at a voxel because strong forces around it hide
the error from a hand (*spatial masking*).

The bound (paper section 4.2, figure 2) is |F_dec - F| <= max(F_0, k |F|) at every voxel, including those
without force, or the rule of mode "mask-direction". With spatial masking it is max(F_0, k |F| + m), where m
is the error that surrounding forces hide; in bricks without a force they hide nothing. ``c/touch_encode.h``
keeps the bound, and checks it on its own output in float64, as `touchfield.perception.mask` does.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from touchfield.arrays import Float32s
from touchfield.codec.touch.spec import TouchSpec
from touchfield.medium import ForceField
from touchfield.perception.mask import SpatialMasking

_NO_MASKING: Final = np.empty((0, 512), np.float32)


def masked_error_n(frame: ForceField, spec: TouchSpec) -> Float32s:
    """Error that surrounding forces hide at each sample of a frame's bricks.

    Newtons, float32 [n, 512]; [0, 512] without spatial masking.
    """
    if not spec.masking:
        return _NO_MASKING
    return SpatialMasking(0.0, 0.0, spec.masking, spec.masking_radius_m).hidden_n(frame).reshape(-1, 512)
