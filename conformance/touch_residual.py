"""Decodes the residual of a voxel in coder `touch`: its quantisation steps, and its three components.

Vectors are arrays of Python's whole numbers, [3], units.
"""

from __future__ import annotations

from bisect import bisect_right
from math import isqrt
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from reading import Array

if TYPE_CHECKING:
    from touch_frame import Frame, Voxel

SIZE_THRESHOLDS, ALTERNATIVE_THRESHOLDS, UNARY = (1, 2, 4, 7, 11, 16, 24), (1, 2, 3, 5, 8, 12, 20), 14
NEXT, LAST = [1, 2, 0], [2, 0, 1]


class StepTable(NamedTuple):
    """Steps of a segment; `border` are the lengths at each sixteenth of a step, 1/256 units."""

    unit_n: float
    floor: int
    rate: int
    cross_floor: int
    cross_rate: int
    border: list[int]

    def step(self, length: int) -> int:
        return max(self.floor, length * self.rate >> 16)

    def position(self, length: int) -> int:
        """The position of a length on the scale of steps, 1/256 steps."""
        x = min(length, (1 << 18) - 1) << 8
        n = bisect_right(self.border, x) - 1
        return 16 * n + (x - self.border[n]) * 16 // (self.border[n + 1] - self.border[n])

    def length_at(self, position: int) -> int:
        """The inverse; below zero it is a force the disagreement way."""
        size = min(abs(position), 16 * (len(self.border) - 1) - 1)
        low, high = self.border[size >> 4], self.border[(size >> 4) + 1]
        length = low + ((high - low) * (size & 15) >> 4) + 128 >> 8
        return length if position >= 0 else -length


def borders(floor: int, rate: int) -> list[int]:
    out = [0]
    while out[-1] <= 1 << 26:
        out.append(out[-1] + max(1, max(floor << 8, out[-1] * rate >> 16) >> 4))
    return out


class DecodedVoxel(NamedTuple):
    """A voxel that is decoded: its force, the length that the force law predicts one sample further, and the
    magnitudes of its residual.
    """

    vector: Array
    length: int
    next_length: Array
    along_size: int
    across_size: int


def vector_of(*components: int) -> Array:
    return np.array(components, object)


def length_of(v: Array) -> int:
    return max(1, isqrt(v @ v))


def limit(v: Array) -> Array:
    """A vector within the limit of components."""
    return clipped(v, 1 - (1 << 17), (1 << 17) - 1)


def clipped(v: Array, low: int, high: int) -> Array:
    """As np.clip, which is slow for numbers of Python."""
    return np.asarray(np.minimum(np.maximum(v, low), high))


def distance_class(length: int, step: int) -> int:
    """Class of a distance."""
    return min(((length << 3) // step).bit_length(), 7)


def residual(
    frame: Frame, v: Voxel, prediction: Array, adaptive: Array, predictor: int
) -> tuple[Array, int, int]:
    """The force of a voxel, and the sizes of its residual along the centre and across it.

    `predictor`: 0 NONE, 1 NEIGHBOUR, 2 REFERENCE.
    """
    neighbours, steps = [neighbour for neighbour in v.neighbours if neighbour], frame.steps
    count, disagreement = len(neighbours), prediction - adaptive
    along, across = sum(n.along_size for n in neighbours), sum(n.across_size for n in neighbours)
    along_class, across_class, total_class = (
        bisect_right(SIZE_THRESHOLDS, n // count) if count else 7
        for n in (4 * along, 2 * across, 3 * (along + across))
    )
    length = length_of(prediction)
    step, reference_distance = steps.step(length), 7
    disagreement_class = distance_class(length_of(disagreement), step)
    if v.reference is not None and predictor != 2:
        reference_distance = distance_class(length_of(v.reference - prediction), step)
    activity = [min(1 + n.along_size + n.across_size, 3) if n else 0 for n in v.neighbours]
    contexts = (
        (*activity, disagreement_class),
        (disagreement_class, min(length >> 12, 15), count),
        (reference_distance, v.reference_class, disagreement_class, total_class),
    )
    if frame.mix("skip", 0, contexts, (total_class, reference_distance < 7)):
        return prediction, 0, 0
    centre = adaptive if any(adaptive) else vector_of(0, 0, 1)
    length = length_of(centre)
    step, basis = steps.step(length), basis_along(centre, length)
    out: list[int] = []
    for k, axis in enumerate(basis):
        alternatives = [
            15 if vector is None else alternative_class(((vector - centre) @ axis >> 12) // step)
            for vector in (*v.extrapolations, v.reference)
        ]
        distance = disagreement @ axis >> 14
        toward = distance_class(abs(distance), step)
        contexts = (toward, disagreement_class), (toward, distance < 0, count)
        is_certain = k == 2 and not predictor and not any(out)
        out.append(
            component(frame, k, is_certain, across_class if k else along_class, *contexts, alternatives)
        )
    length = steps.length_at(steps.position(length) + 256 * out[0])
    cross_step = max(steps.cross_floor, abs(length) * steps.cross_rate >> 16)
    vector = limit(vector_of(length, cross_step * out[1], cross_step * out[2]) @ basis + 8192 >> 14)
    return vector, min(abs(out[0]), 15), min(abs(out[1]) + abs(out[2]), 31)


def alternative_class(quarters: int) -> int:
    """Class of a distance along an axis, in quarters of a step; 7 is none."""
    size = bisect_right(ALTERNATIVE_THRESHOLDS, abs(quarters))
    return 7 - size if quarters < 0 else 7 + size


def component(
    frame: Frame,
    k: int,
    is_certain: bool,
    residual_class: int,
    disagreement: tuple[int, ...],
    sign_context: tuple[int, ...],
    alternatives: list[int],
) -> int:
    """Component k of a residual; it is not 0 if `is_certain`."""
    pairs = tuple(alternatives[:2]), tuple(alternatives[2:])
    zero_contexts = (*((*pair, residual_class > 3) for pair in pairs), disagreement)
    if not is_certain and not frame.mix("zero", k, zero_contexts, residual_class):
        return 0
    is_negative, size = frame.mix("sign", k, (*pairs, sign_context), 0), 1
    while size <= UNARY and frame.mix("size", k, ((residual_class, size), (*disagreement, size)), size):
        size += 1
    if size > UNARY:
        size = UNARY + frame.bits.gamma(17)
    return -size if is_negative else size


def basis_along(centre: Array, length: int) -> Array:
    """Unit vectors [3, 3], 1/16384, along a vector and across it."""
    first = centre * ((1 << 44) // length) + (1 << 29) >> 30
    normal = vector_of(-first[1], first[0], 0) if abs(first[2]) < 14746 else vector_of(0, -first[2], first[1])
    second = normal * ((1 << 44) // length_of(normal)) + (1 << 29) >> 30
    third = first[NEXT] * second[LAST] - first[LAST] * second[NEXT] >> 14
    return np.array([first, second, third], object)
