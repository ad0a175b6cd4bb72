"""Error bound of the coder `touch`, and its check on decoded frames.

The bound (paper section 4.2, figure 2) is |F_dec - F| <= max(F_0, k |F|) at every voxel, including those
without force, or the rule of mode "mask-direction". With spatial masking it is max(F_0, k |F| + m), where m
is the error that surrounding forces hide; in bricks without a force they hide nothing. The check compares the
original with the decoder's own output in float64, as `touchfield.perception.mask` does.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from touchfield.arrays import Float32s, Int64s
from touchfield.codec.touch.kernels.encode_pass import Limits, compare
from touchfield.codec.touch.lattice import FixedField
from touchfield.codec.touch.spec import TouchSpec
from touchfield.medium import ForceField
from touchfield.medium.field import brick_keys, keys_of_both, slots_of
from touchfield.perception.mask import SpatialMasking

_NO_MASKING: Final = np.empty((0, 512), np.float32)


class Comparison(NamedTuple):
    """Result of comparing a decoded frame with its original."""

    # keys, samples: [m]; brick and sample (0 to 511) of each voxel outside the bound, ascending
    keys: Int64s
    samples: Int64s
    max_error_ratio: float  # largest error as a fraction of the bound; infinite if the bound is 0
    voxel: tuple[int, int, int]  # index of its voxel; zeros if there is no error
    within_bound: int  # voxels of the original with a force that are within the bound
    decoded: int  # decoded voxels with a force


def masked_error_n(frame: ForceField, spec: TouchSpec) -> Float32s:
    """Error that surrounding forces hide at each sample of a frame's bricks.

    Newtons, float32 [n, 512]; [0, 512] without spatial masking.
    """
    if not spec.masking:
        return _NO_MASKING
    return SpatialMasking(0.0, 0.0, spec.masking, spec.masking_radius_m).hidden_n(frame).reshape(-1, 512)


def compare_frames(
    original: ForceField,
    decoded: ForceField,
    spec: TouchSpec,
    within_step: bool = False,
    hidden_n: Float32s = _NO_MASKING,
) -> Comparison:
    """Compare a decoded frame with its original under the error bound of `spec`.

    Mode "lossless" compares every bit. Mode "nmse" has no bound; with `within_step` the bound is half a step.
    `hidden_n` is the result of `masked_error_n`.
    """
    keys, fields = keys_of_both(original, decoded), (original, decoded)
    if spec.mode == "lossless":
        bits, other = (field.forces_at(keys).reshape(-1, 512, 3).view(np.int32) for field in fields)
        brick, sample = np.nonzero((bits != other).any(axis=2))
        ratio = math.inf if len(brick) else 0.0
        return Comparison(
            keys[brick], sample, ratio, (0, 0, 0), original.support_count, decoded.support_count
        )
    sine = math.sin(math.radians(spec.direction_jnd_deg)) if spec.mode == "mask-direction" else 0.0
    rule = Limits(spec.k, spec.f0_n, sine, spec.support == "exact" and not within_step)
    if spec.mode == "nmse":  # which guarantees nothing
        rule = rule._replace(k=0.0, f0=spec.step_n / 2 if within_step else math.inf)
    reference, received = (
        (slots_of(brick_keys(f.grid, f.bricks), keys), f.forces_n.reshape(-1, 512, 3)) for f in fields
    )
    is_outside = np.zeros((len(keys), 512), np.bool_)
    ratio2, flat_index, *counts = compare(*reference, *received, rule, hidden_n, is_outside)
    voxel = (0, 0, 0)
    if flat_index >= 0:
        bricks, local = np.unravel_index(keys[flat_index >> 9], original.grid.brick_shape), flat_index & 511
        x, y, z = (int(b) << 3 | local >> shift & 7 for b, shift in zip(bricks, (6, 3, 0), strict=True))
        voxel = x, y, z
    brick, sample = np.nonzero(is_outside)
    return Comparison(keys[brick], sample, math.sqrt(ratio2), voxel, *counts)


def fraction_within_bound(
    original: ForceField, prediction: FixedField, unit_n: float, spec: TouchSpec
) -> float:
    """Fraction of voxels at which `prediction` is within the error bound.

    The voxels counted are those of the original with a force, and all others that are outside the bound; the
    fraction is 1 if none is outside. In mode "nmse" the bound is half a step.
    """
    result = compare_frames(
        original, prediction.field(original.grid, unit_n), spec, within_step=spec.mode == "nmse"
    )
    return result.within_bound / (result.within_bound + len(result.keys)) if len(result.keys) else 1.0
