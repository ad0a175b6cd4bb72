"""Promise of the coder `touch`, and how well a decoded frame keeps it (paper section 4.2, figure 2).

|F_dec - F| <= max(F_0, k |F|) for every voxel, those without force too, or the rule of mode "mask-direction". With
spatial masking it is max(F_0, k |F| + what forces around hide); in bricks without a force they hide nothing. Held
against the decoder's own output in float64, as `touchfield.perception.mask` does.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from touchfield.arrays import Float32s, Int64s
from touchfield.codec.touch.lattice import FixedField
from touchfield.codec.touch.spec import TouchSpec
from touchfield.lean import entry, inlined
from touchfield.medium import ForceField
from touchfield.medium.field import brick_keys
from touchfield.perception.mask import SpatialMasking

MASK, DIRECTION, FREE = 0, 1, 2  # the last: anything goes

_BEHIND = np.iinfo(np.int64).max


@inlined
def _ratio2(x, y, z, u, v, w, rule, k, f0, sine, angle, hidden):
    """The square of |error| / allowed, of an original (x, y, z) and a decoded (u, v, w)."""
    if rule == FREE:
        return 0.0
    size2 = x * x + y * y + z * z
    error2 = (u - x) ** 2 + (v - y) ** 2 + (w - z) ** 2
    if error2 == 0.0:
        return 0.0
    allowed2 = max(f0 * f0, k * k * size2)
    if hidden > 0.0:
        allowed2 = max(allowed2, (k * math.sqrt(size2) + hidden) ** 2)
    if rule == DIRECTION:
        size = math.sqrt(size2)
        if size * sine > f0:
            radial = abs(math.sqrt(u * u + v * v + w * w) - size) / math.sqrt(allowed2)
            a, b, c = y * w - z * v, z * u - x * w, x * v - y * u
            turn = math.atan2(math.sqrt(a * a + b * b + c * c), x * u + y * v + z * w) / angle
            return max(radial, turn) ** 2
        allowed2 = f0 * f0
    return error2 / allowed2 if allowed2 > 0.0 else np.inf


@entry
def compare(keys, forces, other_keys, other, rule, exact, limits, hidden, found):
    """Compare voxel by voxel; `found`, int64 [2, n], takes the first n that are beyond, of which all are counted.

    `hidden`: what forces around hide, newtons, float32 [bricks of the original, 512], or [0, 512].
    """
    k, f0, sine, angle = limits
    worst, worst_key, worst_place = 0.0, -1, 0
    supported, within, decoded, beyond = 0, 0, 0, 0
    i, j = 0, 0
    while i < keys.shape[0] or j < other_keys.shape[0]:
        mine = keys[i] if i < keys.shape[0] else _BEHIND
        theirs = other_keys[j] if j < other_keys.shape[0] else _BEHIND
        key = min(mine, theirs)
        for place in range(512):
            x, y, z, u, v, w = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            if mine == key:
                x, y, z = 1.0 * forces[i, place, 0], 1.0 * forces[i, place, 1], 1.0 * forces[i, place, 2]
            if theirs == key:
                u, v, w = 1.0 * other[j, place, 0], 1.0 * other[j, place, 1], 1.0 * other[j, place, 2]
            held = x != 0.0 or y != 0.0 or z != 0.0
            sent = u != 0.0 or v != 0.0 or w != 0.0
            if not held and not sent:
                continue
            around = 1.0 * hidden[i, place] if mine == key and hidden.shape[0] else 0.0
            ratio2 = _ratio2(x, y, z, u, v, w, rule, k, f0, sine, angle, around)
            if exact and held != sent:
                ratio2 = np.inf
            supported += held
            decoded += sent
            within += held and ratio2 <= 1.0
            if ratio2 > worst:
                worst, worst_key, worst_place = ratio2, key, place
            if ratio2 > 1.0:
                if beyond < found.shape[1]:
                    found[0, beyond], found[1, beyond] = key, place
                beyond += 1
        i += mine == key
        j += theirs == key
    return beyond, worst, worst_key, worst_place, supported, within, decoded


@entry
def largest(forces):
    """The longest |F| of float32 [n, 3]; infinite where one is not a finite number."""
    most = 0.0
    for i in range(forces.shape[0]):
        x, y, z = np.float64(forces[i, 0]), np.float64(forces[i, 1]), np.float64(forces[i, 2])
        size2 = x * x + y * y + z * z
        if not size2 < np.inf:
            return np.inf
        most = max(most, size2)
    return math.sqrt(most)


_RULES: Final = {"mask": MASK, "mask-direction": DIRECTION, "nmse": FREE}
_NOTHING: Final = np.empty((0, 512), np.float32)


class Compared(NamedTuple):
    """Result of a comparison."""

    # keys, places: [m]; brick and sample (0 to 511) of each voxel that breaks the rule, ascending
    keys: Int64s
    places: Int64s
    worst: float  # the largest error as a share of what is allowed; infinite where nothing is
    worst_key: int  # worst_key, worst_place: where it is
    worst_place: int
    # supported, within, decoded: voxels of the original with a force, how many of them keep the rule, and decoded
    # voxels with a force
    supported: int
    within: int
    decoded: int


def hidden_of(frame: ForceField, spec: TouchSpec) -> Float32s:
    """Error that forces around hide at each sample of a frame's bricks, newtons, float32 [n, 512]; [0, 512]: none."""
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
    mine, theirs = ((brick_keys(f.grid, f.bricks), f.forces_n.reshape(-1, 512, 3)) for f in (original, decoded))
    if spec.mode == "lossless":
        keys = np.union1d(mine[0], theirs[0])
        bits, other = (f.forces_at(keys).reshape(-1, 512, 3).view(np.int32) for f in (original, decoded))
        brick, place = np.nonzero((bits != other).any(axis=2))
        supported, sent = (int(np.count_nonzero(forces.any(axis=2))) for _, forces in (mine, theirs))
        return Compared(keys[brick], place, math.inf if len(brick) else 0.0, -1, 0, supported, supported, sent)
    angle, exact = math.radians(spec.direction_jnd_deg), spec.support == "exact" and not within_step
    rule, k, f0_n = (MASK, 0.0, spec.step_n / 2) if within_step else (_RULES[spec.mode], spec.k, spec.f0_n)
    room = 64
    while True:
        beyond = np.empty((2, room), np.int64)
        limits = k, f0_n, math.sin(angle), angle
        count, worst, *rest = compare(*mine, *theirs, rule, exact, limits, hidden_n, beyond)
        if count <= room:
            return Compared(beyond[0, :count], beyond[1, :count], math.sqrt(worst), *rest)
        room = count


def agreement(original: ForceField, guess: FixedField, unit_n: float, spec: TouchSpec) -> float:
    """The share of voxels with a force in either at which `guess` keeps the rule, or half a step; 1 without any."""
    result = compared(original, guess.field(original.grid, unit_n), spec, within_step=spec.mode == "nmse")
    spurious = len(result.keys) - (result.supported - result.within)
    return result.within / (result.supported + spurious) if result.supported + spurious else 1.0
