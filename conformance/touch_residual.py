"""Decodes the difference between a voxel's force and its prediction in coder `touch`: the cells into which
forces are rounded, and their numbers.

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

CLASS, SIDE, UNARY = (1, 2, 4, 7, 11, 16, 24), (1, 2, 3, 5, 8, 12, 20), 14
NEXT, LAST = [1, 2, 0], [2, 0, 1]


class Lattice(NamedTuple):
    """Steps of a segment; `border` are the lengths at each sixteenth of a step, 1/256 units."""

    unit_n: float
    floor: int
    rate: int
    cross_floor: int
    cross_rate: int
    border: list[int]

    def step(self, length: int) -> int:
        return max(self.floor, length * self.rate >> 16)

    def level(self, length: int) -> int:
        """The warped length, 1/256 steps."""
        x = min(length, (1 << 18) - 1) << 8
        n = bisect_right(self.border, x) - 1
        return 16 * n + (x - self.border[n]) * 16 // (self.border[n + 1] - self.border[n])

    def length(self, level: int) -> int:
        """The inverse; below zero it is a force the other way."""
        size = min(abs(level), 16 * (len(self.border) - 1) - 1)
        low, high = self.border[size >> 4], self.border[(size >> 4) + 1]
        length = low + ((high - low) * (size & 15) >> 4) + 128 >> 8
        return length if level >= 0 else -length


def borders(floor: int, rate: int) -> list[int]:
    out = [0]
    while out[-1] <= 1 << 26:
        out.append(out[-1] + max(1, max(floor << 8, out[-1] * rate >> 16) >> 4))
    return out


class Cell(NamedTuple):
    """A voxel that is decoded: its force, what the law makes of its length one step on, and its residual's
    sizes.
    """

    vector: Array
    length: int
    ahead: Array
    along: int
    across: int


def vector_of(*components: int) -> Array:
    return np.array(components, object)


def length_of(v: Array) -> int:
    return max(1, isqrt(v @ v))


def limited(v: Array) -> Array:
    """A vector within the limit of components."""
    return clipped(v, 1 - (1 << 17), (1 << 17) - 1)


def clipped(v: Array, low: int, high: int) -> Array:
    """As np.clip, which is slow for numbers of Python."""
    return np.asarray(np.minimum(np.maximum(v, low), high))


def digits(length: int, step: int) -> int:
    """Class of a distance."""
    return min(((length << 3) // step).bit_length(), 7)


def residual(frame: Frame, v: Voxel, expected: Array, blend: Array, followed: int) -> tuple[Array, int, int]:
    """The force of a voxel, and the sizes of its residual; `followed`: 0 nothing, 1 a neighbour, 2 the
    reference.
    """
    cells, lattice = [cell for cell in v.faces if cell], frame.lattice
    m, other = len(cells), expected - blend
    along, across = sum(cell.along for cell in cells), sum(cell.across for cell in cells)
    own, cross, both = (
        bisect_right(CLASS, n // m) if m else 7 for n in (4 * along, 2 * across, 3 * (along + across))
    )
    length = length_of(expected)
    step = lattice.step(length)
    apart = digits(length_of(other), step)
    far = 7 if v.old is None or followed == 2 else digits(length_of(v.old - expected), step)
    quiet = [min(1 + cell.along + cell.across, 3) if cell else 0 for cell in v.faces]
    contexts = (*quiet, apart), (apart, min(length >> 12, 15), m), (far, v.then, apart, both)
    if frame.mix("still", 0, contexts, (both, far < 7)):
        return expected, 0, 0
    centre = blend if any(blend) else vector_of(0, 0, 1)
    length = length_of(centre)
    step, axes = lattice.step(length), axes_along(centre, length)
    r: list[int] = []
    for c, axis in enumerate(axes):
        sides = [
            15 if one is None else side(((one - centre) @ axis >> 12) // step) for one in (*v.chains, v.old)
        ]
        d = other @ axis >> 14
        toward, certain = digits(abs(d), step), c == 2 and not followed and not any(r)
        r.append(
            component(frame, c, certain, cross if c else own, (toward, apart), (toward, d < 0, m), sides)
        )
    size = lattice.length(lattice.level(length) + 256 * r[0])
    across = max(lattice.cross_floor, abs(size) * lattice.cross_rate >> 16)
    vector = limited(vector_of(size, across * r[1], across * r[2]) @ axes + 8192 >> 14)
    return vector, min(abs(r[0]), 15), min(abs(r[1]) + abs(r[2]), 31)


def side(d: int) -> int:
    """Class of a distance along an axis, 7 is none."""
    size = bisect_right(SIDE, abs(d))
    return 7 - size if d < 0 else 7 + size


def component(
    frame: Frame,
    c: int,
    certain: bool,
    group: int,
    apart: tuple[int, ...],
    lies: tuple[int, ...],
    sides: list[int],
) -> int:
    """Component c of a residual; a `certain` one is not 0."""
    pairs = tuple(sides[:2]), tuple(sides[2:])
    if not certain and not frame.mix("zero", c, (*((*pair, group > 3) for pair in pairs), apart), group):
        return 0
    negative, size = frame.mix("sign", c, (*pairs, lies), 0), 1
    while size <= UNARY and frame.mix("size", c, ((group, size), (*apart, size)), size):
        size += 1
    if size > UNARY:
        size = UNARY + frame.bits.gamma(17)
    return -size if negative else size


def axes_along(p: Array, length: int) -> Array:
    """Unit vectors [3, 3], 1/16384, along a vector and across it."""
    e = p * ((1 << 44) // length) + (1 << 29) >> 30
    h = vector_of(-e[1], e[0], 0) if abs(e[2]) < 14746 else vector_of(0, -e[2], e[1])
    h = h * ((1 << 44) // length_of(h)) + (1 << 29) >> 30
    return np.array([e, h, e[NEXT] * h[LAST] - e[LAST] * h[NEXT] >> 14], object)
