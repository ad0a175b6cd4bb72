"""Promise of the coder `touch`, and how well a decoded frame keeps it (paper section 4.2, figure 2).

|F_dec - F| <= max(F_0, k |F|) for every voxel, those without force too, or the rule of mode "mask-direction". With
spatial masking it is max(F_0, k |F| + what forces around hide); in bricks without a force they hide nothing.
Held against the decoder's own output in float64, as `touchfield.perception.mask` does.
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

_NOTHING: Final = np.empty((0, 512), np.float32)


class Compared(NamedTuple):
    """Result of a comparison."""

    # keys, places: [m]; brick and sample (0 to 511) of each voxel that breaks the rule, ascending
    keys: Int64s
    places: Int64s
    worst: float  # the largest error as a share of what is allowed; infinite where nothing is
    voxel: tuple[int, int, int]  # where it is; zeros where there is no error
    within: int  # voxels of the original with a force that keep the rule
    decoded: int  # decoded voxels with a force


def hidden_of(frame: ForceField, spec: TouchSpec) -> Float32s:
    """Error that forces around hide at each sample of a frame's bricks, newtons, float32 [n, 512]; [0, 512]:
    none.
    """
    if not spec.masking:
        return _NOTHING
    return SpatialMasking(0.0, 0.0, spec.masking, spec.masking_radius_m).hidden_n(frame).reshape(-1, 512)


def compared(
    original: ForceField,
    decoded: ForceField,
    spec: TouchSpec,
    within_step: bool = False,
    hidden_n: Float32s = _NOTHING,
) -> Compared:
    """How a decoded frame keeps what was asked for, or in mode "nmse" half a step; "lossless" is every bit."""
    keys, fields = keys_of_both(original, decoded), (original, decoded)
    if spec.mode == "lossless":
        bits, other = (field.forces_at(keys).reshape(-1, 512, 3).view(np.int32) for field in fields)
        brick, place = np.nonzero((bits != other).any(axis=2))
        worst = math.inf if len(brick) else 0.0
        return Compared(keys[brick], place, worst, (0, 0, 0), original.support_count, decoded.support_count)
    sine = math.sin(math.radians(spec.direction_jnd_deg)) if spec.mode == "mask-direction" else 0.0
    rule = Limits(spec.k, spec.f0_n, sine, spec.support == "exact" and not within_step)
    if spec.mode == "nmse":  # which promises nothing
        rule = rule._replace(k=0.0, f0=spec.step_n / 2 if within_step else math.inf)
    mine, theirs = (
        (slots_of(brick_keys(f.grid, f.bricks), keys), f.forces_n.reshape(-1, 512, 3)) for f in fields
    )
    beyond = np.zeros((len(keys), 512), np.bool_)
    worst2, where, *counts = compare(*mine, *theirs, rule, hidden_n, beyond)
    voxel = (0, 0, 0)
    if where >= 0:
        bricks, local = np.unravel_index(keys[where >> 9], original.grid.brick_shape), where & 511
        x, y, z = (int(b) << 3 | local >> shift & 7 for b, shift in zip(bricks, (6, 3, 0), strict=True))
        voxel = x, y, z
    brick, place = np.nonzero(beyond)
    return Compared(keys[brick], place, math.sqrt(worst2), voxel, *counts)


def agreement(original: ForceField, guess: FixedField, unit_n: float, spec: TouchSpec) -> float:
    """The share of voxels with a force in either at which `guess` keeps the rule, or half a step; 1 without
    any.
    """
    result = compared(original, guess.field(original.grid, unit_n), spec, within_step=spec.mode == "nmse")
    return result.within / (result.within + len(result.keys)) if len(result.keys) else 1.0
