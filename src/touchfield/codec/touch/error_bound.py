"""Computes how much larger the error of coder `touch` may be at a voxel than with one k for every force:
because k depends on the force, or because strong forces around the voxel raise the bound (*spatial masking*).

The bound (paper section 4.2, figure 2) is |F_dec - F| <= max(F_0, k |F|) at every voxel, including those
without force, or the rule of mode "mask-direction". The C code of the coder takes one k and an allowance m
for each voxel: max(F_0, k |F| + m). If k is a function of the force, its smallest value is that k, and m
contains (k(|F|) - k) |F|, rounded down. With spatial masking m contains the term of the surrounding forces,
too; in bricks without a force it is zero. ``c/touch_encode.h`` keeps the bound, and checks it on its own
output in float64, as `touchfield.perception.mask` does.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from touchfield.arrays import Float32s, lengths_of
from touchfield.codec.touch.spec import TouchSpec
from touchfield.medium import ForceField
from touchfield.perception.grip import WeberCurve
from touchfield.perception.mask import SpatialMasking, excess_n

_NO_ALLOWANCE: Final = np.empty((0, 512), np.float32)


def has_allowance(spec: TouchSpec) -> bool:
    """Whether the bound of some voxel is larger than max(F_0, k |F|)."""
    return bool(spec.masking or spec.k_by_force)


def allowed_error_n(frame: ForceField, spec: TouchSpec) -> Float32s:
    """Allowance m at each sample of a frame's bricks.

    Newtons, float32 [n, 512]; [0, 512] if there is none.
    """
    if not has_allowance(spec):
        return _NO_ALLOWANCE
    allowed_n = np.zeros((len(frame.bricks), 512), np.float32)
    if isinstance(spec.weber, WeberCurve):
        allowed_n += excess_n(lengths_of(frame.forces_n.astype(np.float64)), spec.weber).reshape(-1, 512)
    if spec.masking:
        masking = SpatialMasking(0.0, 0.0, spec.masking, spec.masking_radius_m)
        allowed_n += masking.hidden_n(frame).reshape(-1, 512)
    return allowed_n
