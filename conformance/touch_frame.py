"""Decodes the voxels of a frame of coder `touch` one after another: which of them have a force, and what each
force is predicted to be.
"""

from collections.abc import Hashable, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from reading import Array, Place, moved
from touch_bits import FACES, Bits, Models, mask_of
from touch_residual import DecodedVoxel, StepTable, clipped, length_of, limit, residual, vector_of

DEEP, UP, LEFT = BEFORE = FACES[:3]
MASK = [*BEFORE, (-1, 1, 0), (-1, 0, 1), (0, -1, 1)]
WIDE = [(-1, -1, 0), (-1, 0, -1), (0, -1, -1), (-2, 0, 0), (0, 0, -2)]
PAIRS = [(DEEP, (-2, 0, 0)), (UP, (-1, -1, 0)), (LEFT, (-1, 0, -1)), (LEFT, (0, -1, -1)), (UP, (0, -1, -1))]
FEATURES = len(MASK) + len(PAIRS) + 2


class Units(NamedTuple):
    """A frame in units: its bricks, also those without force, and vectors by the places of their samples."""

    bricks: list[Place]
    vectors: dict[Place, Array]


class FrameModels(NamedTuple):
    """What a frame teaches the next one: contexts and weights of the bits, and the weights of the adaptive
    prediction by the neighbours that there are.
    """

    models: Models
    weights: dict[Hashable, Array]


class Voxel(NamedTuple):
    """What is known of a voxel before its force is decoded."""

    at: Place
    neighbours: list[DecodedVoxel | None]
    extrapolations: list[Array | None]
    reference: Array | None
    reference_class: int


class Frame:
    """A frame while it is decoded."""

    def __init__(self, code: bytes, models: FrameModels, steps: StepTable, slope: Sequence[int]) -> None:
        self.bits, self.weights = Bits(code, models.models), models.weights
        self.steps, self.slope = steps, vector_of(*slope)
        self.listed: set[Place] = set()
        self.reference: dict[Place, Array] = {}
        self.decoded: dict[Place, DecodedVoxel] = {}
        self.state, self.last_vector = 0, vector_of(0, 0, 0)

    def mix(self, name: str, c: int, contexts: Sequence[Hashable], chosen: Hashable) -> int:
        """A bit by context n of table (name, n, c), for each n."""
        return self.bits.mix([(name, n, c, context) for n, context in enumerate(contexts)], (name, c, chosen))

    def brick(self, brick: Place, inside: list[Place]) -> None:
        """A brick, whose samples within the grid are `inside`, in order."""
        listed, state = brick in self.listed, 0
        if listed:
            context = self.state
            state = 2 if self.bits.code(("brick", context)) else self.bits.code(("brick", 4 + context))
            self.state = state
        if state == 2:
            for at in inside:
                if at in self.reference:
                    self.store(at, self.reference[at], 0, 0)
            return
        blocks = self.blocks(brick, listed)
        for at in inside:
            if blocks[tuple(n >> 2 & 1 for n in at)]:
                voxel = self.voxel(at, listed)
                if self.support(voxel):
                    self.force(voxel, state == 1)

    def store(self, at: Place, vector: Array, along_size: int, across_size: int) -> None:
        a = length_of(vector)
        next_length = a - ((vector * ((1 << 28) // a) >> 14) * self.slope >> 14)
        self.decoded[at] = DecodedVoxel(vector, a, next_length, along_size, across_size)

    # -- support --------------------------------------------------------------------------------------------

    def blocks(self, brick: Place, listed: bool) -> dict[Place, int]:
        """Which blocks of 4 x 4 x 4 voxels have a force."""
        out: dict[Place, int] = {}
        for block in product((0, 1), repeat=3):
            spans = [range(8 * b + 4 * n, 8 * b + 4 * n + 4) for b, n in zip(brick, block)]
            sides = []
            for axis, step in enumerate(BEFORE):
                face = [range(s[0] - 1, s[0]) if d == axis else s for d, s in enumerate(spans)]
                is_set = (
                    out[moved(block, step)] if block[axis] else any(map(self.decoded.get, product(*face)))
                )
                sides.append(bool(is_set))
            block_reference = listed and 1 + any(at in self.reference for at in product(*spans))
            out[block] = self.bits.code(("block", block_reference, *sides))
        return out

    def voxel(self, at: Place, listed: bool) -> Voxel:
        neighbours, reference_class = [self.decoded.get(moved(at, step)) for step in BEFORE], 0
        if listed:
            faces = mask_of(self.reference, at, FACES).bit_count()
            reference_class = 1 + (faces >= 1) + (faces >= 3)
            if at in self.reference:
                reference_class = 4 + (faces >= 5) + (faces == 6)
        extrapolations = [self.extrapolation(neighbour, n) for n, neighbour in enumerate(neighbours)]
        return Voxel(at, neighbours, extrapolations, self.reference.get(at), reference_class)

    def support(self, v: Voxel) -> int:
        """Whether a voxel has a force."""
        neighbour_mask, wide_mask = mask_of(self.decoded, v.at, MASK), mask_of(self.decoded, v.at, WIDE)
        next_lengths = [neighbour.next_length[n] for n, neighbour in enumerate(v.neighbours) if neighbour]
        length_class = wide_mask
        if next_lengths:
            length_class = max(0, min((sum(next_lengths) // len(next_lengths) * 28 >> 16) + 3, 31))
        reference_mask = False, 0
        if v.reference_class:
            reference_mask = v.reference is not None, mask_of(self.reference, v.at, FACES)
        contexts = (
            (length_class, neighbour_mask, v.reference_class),
            (wide_mask, neighbour_mask, v.reference_class),
            (*reference_mask, neighbour_mask & 7, length_class >> 3),
        )
        return self.mix("support", 0, contexts, (len(next_lengths), v.reference_class))

    # -- prediction -----------------------------------------------------------------------------------------

    def extrapolation(self, neighbour: DecodedVoxel | None, axis: int) -> Array | None:
        """The force of a neighbour, continued by the force law."""
        if not neighbour:
            return None
        length = max(neighbour.next_length[axis], neighbour.length >> 3, self.steps.floor >> 1, 1)
        return limit(neighbour.vector * min((length << 14) // neighbour.length, 1 << 17) + 8192 >> 14)

    def is_off(self, at: Place) -> bool:
        """Whether the reference is more than a step off at a place."""
        decoded, reference = self.decoded.get(at), self.reference.get(at)
        if decoded is None or reference is None:
            return False
        return bool(sum((decoded.vector - reference) ** 2) > self.steps.step(decoded.length) ** 2)

    def mean(self, v: Voxel) -> tuple[Array, int]:
        """What the adaptive prediction corrects, and the step there."""
        neighbours = [(n, neighbour) for n, neighbour in enumerate(v.neighbours) if neighbour]
        if not neighbours:
            return (self.last_vector if v.reference is None else v.reference), 1
        length_sum = sum(neighbour.length for _, neighbour in neighbours)
        next_sum = sum(max(neighbour.next_length[n], neighbour.length >> 3) for n, neighbour in neighbours)
        scale = min((next_sum << 16) // (length_sum * len(neighbours)), 1 << 17)
        vector = sum((neighbour.vector for _, neighbour in neighbours), vector_of(0, 0, 0))
        return vector * scale + 32768 >> 16, self.steps.step(next_sum // len(neighbours))

    def differences(self, v: Voxel, mean: Array) -> Array:
        """What the mean may have to be corrected by, [13, 3], units."""
        out, decoded = np.zeros((FEATURES, 3), object), self.decoded
        if not any(v.neighbours):
            return out
        for n, step in enumerate(MASK):
            if (at := moved(v.at, step)) in decoded:
                out[n] = decoded[at].vector - mean
        for n, (to, start) in enumerate((moved(v.at, a), moved(v.at, b)) for a, b in PAIRS):
            if to in decoded and start in decoded:
                out[len(MASK) + n] = decoded[to].vector - decoded[start].vector
        if v.reference is not None:
            places = [moved(v.at, step) for step in BEFORE]
            changes = [
                decoded[at].vector - self.reference[at]
                for at in places
                if at in decoded and at in self.reference
            ]
            out[-2] = v.reference - mean
            out[-1] = sum(changes) // max(1, len(changes))
        return out

    def force(self, v: Voxel, follows: bool) -> None:
        """The force of a supported voxel."""
        mean, step = self.mean(v)
        inverse_step = (1 << 32) // step
        features = clipped(self.differences(v, mean) * inverse_step >> 24, -4095, 4095)
        kind = (*map(bool, v.neighbours), v.reference is None)
        weights = self.weights.get(kind, np.zeros(FEATURES, object))
        prediction = adaptive = limit(mean + ((weights @ features >> 16) * step >> 8))
        predictor = 0
        if follows and v.reference is not None and not self.is_off(moved(v.at, DEEP)):
            prediction, predictor = v.reference, 2
        else:
            for extrapolation in v.extrapolations:
                if extrapolation is not None:
                    prediction, predictor = extrapolation, 1
                    break
        vector, along_size, across_size = residual(self, v, prediction, adaptive, predictor)
        self.store(v.at, vector, along_size, across_size)
        self.last_vector = vector
        error = clipped((vector - adaptive) * inverse_step >> 24, -1023, 1023)
        gains = error * (1 << 27) // ((1 << 15) + (features * features).sum())
        for feature, gain in zip(features.T, gains):
            weights = clipped(weights + (feature * gain >> 14), -(1 << 20), 1 << 20)
        self.weights[kind] = weights
