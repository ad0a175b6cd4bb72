"""Decodes the voxels of a frame of coder `touch` one after another: which of them have a force, and what each
force is predicted to be.
"""

from collections.abc import Hashable, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from reading import Array, Place, moved
from touch_bits import FACES, Bits, Models, marks
from touch_residual import Cell, Lattice, clipped, length_of, limited, residual, vector_of

X, Y, Z = BEFORE = FACES[:3]
MASK = [*BEFORE, (-1, 1, 0), (-1, 0, 1), (0, -1, 1)]
WIDE = [(-1, -1, 0), (-1, 0, -1), (0, -1, -1), (-2, 0, 0), (0, 0, -2)]
PAIRS = [(X, (-2, 0, 0)), (Y, (-1, -1, 0)), (Z, (-1, 0, -1)), (Z, (0, -1, -1)), (Y, (0, -1, -1))]
FEATURES = len(MASK) + len(PAIRS) + 2


class Units(NamedTuple):
    """A frame in units: its bricks, also those without force, and vectors by the places of their samples."""

    bricks: list[Place]
    vectors: dict[Place, Array]


class Memory(NamedTuple):
    """What a frame taught: chances and weights of the bits, and the weights of the blend by their kind."""

    models: Models
    weights: dict[Hashable, Array]


class Voxel(NamedTuple):
    """What is known of a voxel before its force is told; `then` is what the reference says of its support."""

    at: Place
    faces: list[Cell | None]
    chains: list[Array | None]
    old: Array | None
    then: int


class Frame:
    """A frame while it is decoded."""

    def __init__(self, code: bytes, memory: Memory, lattice: Lattice, slope: Sequence[int]) -> None:
        self.bits, self.weights = Bits(code, memory.models), memory.weights
        self.lattice, self.slope = lattice, vector_of(*slope)
        self.known: set[Place] = set()
        self.old: dict[Place, Array] = {}
        self.cells: dict[Place, Cell] = {}
        self.state, self.last = 0, vector_of(0, 0, 0)

    def mix(self, name: str, c: int, contexts: Sequence[Hashable], chosen: Hashable) -> int:
        """A bit by context n of table (name, n, c), for each n."""
        return self.bits.mix([(name, n, c, context) for n, context in enumerate(contexts)], (name, c, chosen))

    def brick(self, brick: Place, inside: list[Place]) -> None:
        """A brick, whose samples within the grid are `inside`, in order."""
        known, state = brick in self.known, 0
        if known:
            context = self.state
            state = 2 if self.bits.code(("brick", context)) else self.bits.code(("brick", 4 + context))
            self.state = state
        if state == 2:
            for at in inside:
                if at in self.old:
                    self.store(at, self.old[at], 0, 0)
            return
        blocks = self.blocks(brick, known)
        for at in inside:
            if blocks[tuple(n >> 2 & 1 for n in at)]:
                voxel = self.voxel(at, known)
                if self.support(voxel):
                    self.force(voxel, state == 1)

    def store(self, at: Place, vector: Array, along: int, across: int) -> None:
        a = length_of(vector)
        ahead = a - ((vector * ((1 << 28) // a) >> 14) * self.slope >> 14)
        self.cells[at] = Cell(vector, a, ahead, along, across)

    # -- support --------------------------------------------------------------------------------------------

    def blocks(self, brick: Place, known: bool) -> dict[Place, int]:
        """Which blocks of 4 x 4 x 4 voxels hold a force."""
        out: dict[Place, int] = {}
        for block in product((0, 1), repeat=3):
            spans = [range(8 * b + 4 * n, 8 * b + 4 * n + 4) for b, n in zip(brick, block)]
            sides = []
            for c, step in enumerate(BEFORE):
                face = [range(s[0] - 1, s[0]) if d == c else s for d, s in enumerate(spans)]
                side = out[moved(block, step)] if block[c] else any(at in self.cells for at in product(*face))
                sides.append(bool(side))
            then = known and 1 + any(at in self.old for at in product(*spans))
            out[block] = self.bits.code(("block", then, *sides))
        return out

    def voxel(self, at: Place, known: bool) -> Voxel:
        faces, then = [self.cells.get(moved(at, step)) for step in BEFORE], 0
        if known:
            around = marks(self.old, at, FACES).bit_count()
            then = 4 + (around >= 5) + (around == 6) if at in self.old else 1 + (around >= 1) + (around >= 3)
        return Voxel(at, faces, [self.chain(cell, n) for n, cell in enumerate(faces)], self.old.get(at), then)

    def support(self, v: Voxel) -> int:
        """Whether a voxel holds a force."""
        mask, wide = marks(self.cells, v.at, MASK), marks(self.cells, v.at, WIDE)
        ahead = [cell.ahead[n] for n, cell in enumerate(v.faces) if cell]
        likely = max(0, min((sum(ahead) // len(ahead) * 28 >> 16) + 3, 31)) if ahead else wide
        every = (v.then >= 4, marks(self.old, v.at, FACES)) if v.then else (False, 0)
        contexts = (likely, mask, v.then), (wide, mask, v.then), (*every, mask & 7, likely >> 3)
        return self.mix("held", 0, contexts, (len(ahead), v.then))

    # -- prediction -----------------------------------------------------------------------------------------

    def chain(self, cell: Cell | None, axis: int) -> Array | None:
        """Follow the law from a neighbour."""
        if not cell:
            return None
        length = max(cell.ahead[axis], cell.length >> 3, self.lattice.floor >> 1, 1)
        return limited(cell.vector * min((length << 14) // cell.length, 1 << 17) + 8192 >> 14)

    def is_off(self, at: Place) -> bool:
        """Whether the reference is more than a step off at a place."""
        cell, old = self.cells.get(at), self.old.get(at)
        return bool(
            cell and old is not None and sum((cell.vector - old) ** 2) > self.lattice.step(cell.length) ** 2
        )

    def base(self, v: Voxel) -> tuple[Array, int]:
        """The base of the blend, and the step there."""
        cells = [(cell, cell.ahead[n]) for n, cell in enumerate(v.faces) if cell]
        if not cells:
            return (self.last if v.old is None else v.old), 1
        total = sum(cell.length for cell, _ in cells)
        likely = sum(max(ahead, cell.length >> 3) for cell, ahead in cells)
        scale = min((likely << 16) // (total * len(cells)), 1 << 17)
        vector = sum((cell.vector for cell, _ in cells), vector_of(0, 0, 0))
        return vector * scale + 32768 >> 16, self.lattice.step(likely // len(cells))

    def features(self, v: Voxel, base: Array) -> Array:
        """What the blend may be made of, [13, 3], units."""
        out, held = np.zeros((FEATURES, 3), object), self.cells
        if not any(v.faces):
            return out
        for n, step in enumerate(MASK):
            if (at := moved(v.at, step)) in held:
                out[n] = held[at].vector - base
        for n, (one, other) in enumerate((moved(v.at, a), moved(v.at, b)) for a, b in PAIRS):
            if one in held and other in held:
                out[len(MASK) + n] = held[one].vector - held[other].vector
        if v.old is not None:
            places = [at for at in (moved(v.at, step) for step in BEFORE) if at in held and at in self.old]
            out[-2] = v.old - base
            out[-1] = sum(held[at].vector - self.old[at] for at in places) // max(1, len(places))
        return out

    def force(self, v: Voxel, trusted: bool) -> None:
        """The force of a voxel that holds one."""
        base, step = self.base(v)
        inverse = (1 << 32) // step
        features = clipped(self.features(v, base) * inverse >> 24, -4095, 4095)
        kind = (*map(bool, v.faces), v.old is None)
        weights = self.weights.get(kind, np.zeros(FEATURES, object))
        expected = blend = limited(base + ((weights @ features >> 16) * step >> 8))
        chains = [chain for chain in v.chains if chain is not None]
        followed = 1 if chains else 0
        if trusted and v.old is not None and not self.is_off(moved(v.at, X)):
            expected, followed = v.old, 2
        elif chains:
            expected = chains[0]
        vector, along, across = residual(self, v, expected, blend, followed)
        self.store(v.at, vector, along, across)
        self.last = vector
        error = clipped((vector - blend) * inverse >> 24, -1023, 1023)
        gain = error * (1 << 27) // ((1 << 15) + (features * features).sum())
        for f, g in zip(features.T, gain):
            weights = clipped(weights + (f * g >> 14), -(1 << 20), 1 << 20)
        self.weights[kind] = weights
