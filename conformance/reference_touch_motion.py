"""The part of the second decoder for coder `touch` that moves blocks of the previous frame."""

from __future__ import annotations

from itertools import product

from reference_decoder import Coder, Models, Position, need
from reference_touch import Field, Lattice, Vector

__all__ = ["moved"]

BESIDE = ((0, 0, 1), (0, 1, 0), (1, 0, 0))
"""Distances to the neighbours of a block, along z, y, x."""


def moved(data: bytes, shape: Position, lattice: Lattice, previous: Field | None) -> Field:
    """The guess that `data` makes of the previous frame."""
    need(data and previous is not None and previous.bricks, "motion from nothing")
    assert previous is not None
    reach, shift = divmod(data[0], 16)
    need(shift in (2, 3) and reach <= 2, "the shape of blocks")
    counts = [-(-n >> shift) for n in shape]
    held = {(x >> shift, y >> shift, z >> shift) for x, y, z in previous.vectors}
    near = {
        (x + a, y + b, z + c)
        for x, y, z in held
        for a, b, c in product(range(-reach, reach + 1), repeat=3)
        if 0 <= x + a < counts[0] and 0 <= y + b < counts[1] and 0 <= z + c < counts[2]
    }
    moves = displacements(data[1:], sorted(near), held)
    bricks = set(previous.bricks)
    goals = {(x << shift >> 3, y << shift >> 3, z << shift >> 3) for x, y, z in moves}
    need(len(bricks | goals) <= 4 * len(bricks) + 64, "too many bricks")
    vectors = dict(previous.vectors)
    for (i, j, k), d in moves.items():
        for offset in product(range(1 << shift), repeat=3):
            x, y, z = ((b << shift) + o for b, o in zip((i, j, k), offset))
            vectors.pop((x, y, z), None)
            if x < shape[0] and y < shape[1] and z < shape[2]:
                force = fetched(previous.vectors, (4 * x + d[0], 4 * y + d[1], 4 * z + d[2]), lattice.floor >> 2)
                if force is not None:
                    bricks.add((x >> 3, y >> 3, z >> 3))
                    if any(force):
                        vectors[x, y, z] = force
    return Field(sorted(bricks), vectors)


def fetched(vectors: dict[Position, Vector], at: Position, least: int) -> Vector | None:
    """The force at a place in quarters of a voxel; None where there is none."""
    weight, sums = 0, [0, 0, 0]
    for corner in product((0, 1), repeat=3):
        x, y, z = ((a >> 2) + c for a, c in zip(at, corner))
        w = 1
        for a, c in zip(at, corner):
            w *= a & 3 if c else 4 - (a & 3)
        if (x, y, z) in vectors:
            weight += w
            sums = [s + w * v for s, v in zip(sums, vectors[x, y, z])]
    if weight < 32:
        return None
    a, b, c = ((s + weight // 2) // weight for s in sums)
    return None if a * a + b * b + c * c < least * least else (a, b, c)


def displacements(data: bytes, candidates: list[Position], held: set[Position]) -> dict[Position, list[int]]:
    """How far the blocks that move do."""
    coder = Coder(data)
    models = Models(coder)
    there = set(candidates)
    moves: dict[Position, list[int]] = {}
    last: list[int] | None = None
    for block in candidates:
        beside = [tuple(b - o for b, o in zip(block, offset)) for offset in BESIDE]
        moving = [moves[b] for b in beside if b in moves]
        pattern = 0
        for b in beside:
            pattern = 3 * pattern + (2 if b in moves else int(b in there))
        n, inside = len(moving), int(block in held)
        if not models.mixed(16 * (2 * n + inside), 16 * (2 * pattern + inside), 0):
            continue
        d, longest = [], 0
        for c in range(3):
            if n == 3:
                expected = sorted(move[c] for move in moving)[1]
            else:
                expected = moving[0][c] if n else (last[c] if last else 0)
            r = residual(coder, models, 8 + 4 * c + n, 54 + 5 * c + min(longest, 4))
            longest = max(longest, abs(r).bit_length())
            d.append(expected + r)
        need(any(d) and max(map(abs, d)) <= 64, "a displacement of nothing or too far")
        moves[block] = last = d
    need(moves and data[coder.used :] == coder.ending(), "no block that moves, or bytes behind the code")
    return moves


def residual(coder: Coder, models: Models, a: int, b: int) -> int:
    """What a displacement differs by from the expected one."""

    def bit(j: int) -> int:
        return models.mixed(16 * a + j, 16 * b + j, j)

    if not bit(0):
        return 0
    negative = bit(1)
    length = 1
    while length < 8 and bit(1 + length):
        length += 1
    value = 1
    if length > 1:
        value = 2 + bit(7 + length)
        for _ in range(length - 2):
            value = 2 * value + coder.bit(32768)
    return -value if negative else value
