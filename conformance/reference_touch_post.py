"""The part of the second decoder for the filter after a frame of coder `touch`. It follows docs/format.md."""

from __future__ import annotations

from itertools import product

from reference_decoder import Position, need
from reference_touch import LIMIT, Field, Vector

__all__ = ["filtered"]

OFFSETS = [o for o in product((-1, 0, 1), repeat=3) if o != (0, 0, 0)]


def group(g: int) -> list[int]:
    """The offsets of a group, by their number."""
    if g < 26:
        return [g]
    if g < 39:
        return [g - 26, 51 - g]
    if g < 46:
        return [i for i, (x, y, z) in enumerate(OFFSETS) if 4 * abs(x) + 2 * abs(y) + abs(z) == g - 38]
    if g < 49:
        return [i for i, (x, y, z) in enumerate(OFFSETS) if abs(x) + abs(y) + abs(z) == g - 45]
    if g == 49:
        return list(range(26))
    axis, side = divmod(g - 50, 2)
    return [i for i, offset in enumerate(OFFSETS) if offset[axis] == (1 if side else -1)]


def read_weights(data: bytes) -> list[list[int]]:
    """The weights of each offset by kind; the last one of the force itself."""
    need(len(data) % 2 == 0, "half a term")
    weights = [[0, 0, 0] for _ in range(27)]
    before = -1
    for number, code in zip(data[::2], data[1::2]):
        need(before < number < 169, "the number of a term")
        before = number
        weight = (8 + (code & 7)) << (code >> 3 & 15)
        kind, g = divmod(number, 56)
        for i in [26] if kind == 3 else group(g):
            weights[i][kind % 3] += -weight if code & 128 else weight
    return weights


def filtered(frame: Field, data: bytes, floor: int) -> Field:
    """The frame after its filter."""
    weights, t = read_weights(data), floor >> 1
    vectors: dict[Position, Vector] = {}
    for (x, y, z), f in frame.vectors.items():
        near = [frame.vectors.get((x + i, y + j, z + k)) for i, j, k in OFFSETS]
        made = []
        for c in range(3):
            s = 8192 + weights[26][0] * f[c]
            for g, (w0, w1, w2) in zip(near, weights):
                if g is None:
                    s -= w2 * f[c]
                else:
                    d = g[c] - f[c]
                    s += w1 * d + w0 * max(-t, min(d, t))
            made.append(max(-LIMIT, min(f[c] + (s >> 14), LIMIT)))
        vectors[x, y, z] = (made[0], made[1], made[2]) if any(made) else f
    return Field(frame.bricks, vectors)
