"""The spline guess of the coder `touch`: a smooth field from one potential (docs/format/touch-guess.md).

Paper figure 4 lets "source models" compete with plain samples. Of a penalty field F = min(K d, F_max) n the depth d
grows against the normal n: all of it follows from the potential f = K d, which is smooth through the surface and
below zero outside. So f is told by the coefficients of a cubic B-spline on a coarse lattice of nodes, and

    F = -min(f, top) grad f / max(|grad f|, K / 2),   where f > 0.

What is guessed is smooth by construction; bricks that are not told hold no guess.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.codec.brick_list import CONTEXTS as LIST_CONTEXTS
from touchfield.codec.brick_list import SETS as LIST_SETS
from touchfield.codec.brick_list import code_bricks
from touchfield.codec.kernels.bits import PLACE, Bits, fresh, reader
from touchfield.codec.touch.fixed_field import FixedField
from touchfield.codec.touch.kernels import spline as kernels
from touchfield.codec.varint import read_varint, write_varint
from touchfield.errors import CorruptFile, TruncatedFile
from touchfield.medium.grid import BRICK
from touchfield.parallel import for_chunks

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.medium import Grid

__all__ = ["CONTEXTS", "SETS", "Head", "forces_of", "least_size", "nodes_of", "synthesise"]

CONTEXTS: Final = LIST_CONTEXTS + kernels.CONTEXTS
SETS: Final = LIST_SETS

_WHERE: Final = "spline"
_CHANGED: Final = "The file was changed or cut."
_BOXED: Final = 64
_LIMITS: Final = (27, 1 << 20, 1 << 17, 1 << 20, 1 << 20, 1 << 20)


@dataclass(frozen=True)
class Head:
    """What all nodes share.

    Attributes
    ----------
    shifts : (int, int, int)
        Nodes lie 2^shift samples apart along x, y, z; 1 to 3.
    step : int
        Units between the values that a coefficient may differ by from what is expected; 1 or more.
    top : int
        Units that no force is longer than; 1 or more.
    scales : (int, int, int)
        What a derivative is multiplied by, so that the stiffness K is 32768: 2^35 over 1152 times the growth of f, in
        units, from sample to sample of a normal along x, y, z.
    """

    shifts: tuple[int, int, int]
    step: int
    top: int
    scales: tuple[int, int, int]

    def to_bytes(self) -> bytes:
        """Six varints."""
        a, b, c = (s - 1 for s in self.shifts)
        return b"".join(write_varint(x) for x in (a + 3 * b + 9 * c, self.step, self.top, *self.scales))

    @classmethod
    def read(cls, data: bytes) -> tuple[Head, int]:
        """The head at the begin of `data`, and the offset behind it."""
        told, at = [], 0
        for n, limit in enumerate(_LIMITS):
            value, at = read_varint(data, at, f"{_WHERE}, head {n}", limit)
            told.append(value)
        lattice, step, top, a, b, c = told
        if not step or not top:
            raise CorruptFile(_WHERE, f"step {step}, top {top}", "1 or more", _CHANGED)
        return cls((lattice % 3 + 1, lattice // 3 % 3 + 1, lattice // 9 + 1), step, top, (a, b, c)), at


def least_size(bricks: NDArray[np.int32]) -> int:
    """Bytes that the code has at least: one for every 64 bricks of the box around those told, but for 64 of them."""
    if not len(bricks):
        return 0
    box = np.prod(np.ptp(bricks, axis=0).astype(np.int64) + 1)
    return max(0, -(-int(box) // _BOXED) - _BOXED)


def nodes_of(bricks: NDArray[np.int32], shifts: tuple[int, int, int]) -> tuple[kernels.Nodes, NDArray[np.int64]]:
    """Room for the nodes of bricks, int32 [n, 3] with n > 0, those wanted marked; and the first node, int64 [3]."""
    down = np.array(shifts)
    low = (bricks.min(axis=0).astype(np.int64) * BRICK >> down) - 1
    high = (bricks.max(axis=0).astype(np.int64) * BRICK + BRICK - 1 >> down) + 3
    shape = tuple((high - low + kernels.PAD).tolist())
    nodes = kernels.Nodes(np.zeros(shape, np.uint8), np.zeros(shape, np.int64), np.zeros(shape, np.int64))
    kernels.needed_nodes(bricks, low, down, nodes.wanted)
    return nodes, low


def forces_of(
    head: Head, grid: Grid, bricks: NDArray[np.int32], values: NDArray[np.int64], low: NDArray[np.int64]
) -> FixedField:
    """The forces that nodes stand for, in the bricks told."""
    vectors = np.zeros((len(bricks), BRICK, BRICK, BRICK, 3), np.int32)
    a, b, c = (kernels.weights(shift) for shift in head.shifts)
    told = (np.array(numbers, np.int64) for numbers in (head.scales, grid.shape))
    potential = kernels.Potential(values, low, np.array(head.shifts, np.int64), (a, b, c), *told)
    for_chunks(kernels.fill_bricks, len(bricks), bricks, potential, head.top, vectors, chunk=64)
    return FixedField(bricks, vectors)


def synthesise(data: bytes, grid: Grid) -> FixedField:
    """The guess from its bytes; whole numbers throughout.

    Some 170 KiB are taken for each byte at most, beside 6 MiB.

    Raises
    ------
    TruncatedFile, CorruptFile
        If the bytes are not what the encoder writes.
    """
    head, at = Head.read(data)
    bits = reader(data[at:], fresh(CONTEXTS, SETS))
    bricks = code_bricks(bits, 0, 0, grid.brick_shape, None, None)
    _check_end(bits)
    if least_size(bricks) > len(data) - at:
        raise CorruptFile(_WHERE, f"{len(data)} bytes", f"{at + least_size(bricks)} for so large a box", _CHANGED)
    if not len(bricks):
        raise CorruptFile(_WHERE, "no brick", "one at least", _CHANGED)
    nodes, low = nodes_of(bricks, head.shifts)
    kernels.code_nodes(bits, LIST_CONTEXTS, nodes, head.step)
    _check_end(bits)
    return forces_of(head, grid, bricks, nodes.values, low)


def _check_end(bits: Bits) -> None:
    if bits.state[PLACE] > len(bits.buffer) + 6:  # what is held in the interval, and left away where it is zero
        raise TruncatedFile(_WHERE, f"the end of the code after {len(bits.buffer)} bytes", "more of it", _CHANGED)
