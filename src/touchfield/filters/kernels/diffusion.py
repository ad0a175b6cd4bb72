"""The compiled step of `touchfield.filters.diffusion`, over bricks and over dense arrays.

Each brick is taken with the samples around it into a tile of 10 x 10 x 10, one row for each component, so that every
loop over it is a long run that the compiler turns into vector instructions. The flux of an edge between two bricks is
computed in both from the same numbers by the same operations: what leaves one enters the other to the last bit, and
the result does not depend on the number of threads. Imported only when first needed, because it imports numba.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from touchfield.parallel import for_chunks

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Float32s = NDArray[np.float32]


@dataclass(frozen=True)
class Law:
    """The numbers of a step.

    weights : (float, float, float); lambda along each axis.
    kappa : float; in the unit of the values, at least 1e-30; inf for a conductance of 1.
    rational : bool; 1/(1 + s) in place of exp(-s), with s = (|difference| / kappa)^2.
    """

    weights: tuple[float, float, float]
    kappa: float
    rational: bool = False

    @property
    def float32s(self) -> tuple[tuple[np.float32, np.float32, np.float32], np.float32, bool]:
        """The weights, 1 / kappa and `rational`, as the loops take them."""
        x, y, z = self.weights
        return (np.float32(x), np.float32(y), np.float32(z)), np.float32(1 / self.kappa), self.rational


_STRIDES = (100, 10, 1)
_TILE = 1000
_FIRST, _END = 111, 889  # places in the tile of sample (0, 0, 0) of the brick, and one beyond (7, 7, 7)

_FACES = (
    (4, 448, 11, (8, 1, 10, 1)),
    (22, 0, 911, (8, 1, 10, 1)),
    (10, 56, 101, (64, 1, 100, 1)),
    (16, 0, 191, (64, 1, 100, 1)),
    (12, 7, 110, (64, 8, 100, 10)),
    (14, 0, 119, (64, 8, 100, 10)),
)
"""The six bricks beside a brick: the place in `neighbour_slots`, the first sample of the face in that brick and in
the tile, and how far it is to the next sample along both edges of the face, in that brick and in the tile."""

_FAR = np.float32(16)
_SERIES = tuple(np.float32((-1) ** n / math.factorial(n)) for n in range(10))
"""Taylor's for exp(-r), 0 <= r <= 1."""


@njit(cache=True, nogil=True)
def _exponential(s):
    """Take each s >= 0 to exp(-s), within 1e-6, as the 16th power of exp(-s/16); from 16 on to 0.

    `math.exp` does not become vector instructions, and takes twenty times as long.
    """
    c0, c1, c2, c3, c4, c5, c6, c7, c8, c9 = _SERIES
    for e in range(s.shape[0]):
        r = min(s[e], _FAR) * np.float32(1 / 16)
        p = c0 + r * (c1 + r * (c2 + r * (c3 + r * (c4 + r * (c5 + r * (c6 + r * (c7 + r * (c8 + r * c9))))))))
        p *= p
        p *= p
        p *= p
        p *= p
        s[e] = p if s[e] < _FAR else np.float32(0)


@njit(cache=True, nogil=True)
def _rational(s):
    """Take each s >= 0 to 1 / (1 + s)."""
    for e in range(s.shape[0]):
        s[e] = np.float32(1) / (np.float32(1) + s[e])


@njit(cache=True, nogil=True)
def _edges(values, mask, stride, law, s, flux):
    """The flux along each edge of one axis that touches the brick, into `flux` from its first place on.

    `law` is (weight, 1 / kappa, rational); an edge with a side outside the mask has none.
    """
    weight, per_kappa, rational = law
    begin = _FIRST - stride
    count = _END - begin
    near, far = mask[begin:_END], mask[begin + stride : _END + stride]
    for c in range(values.shape[0]):
        a, b = values[c, begin:_END], values[c, begin + stride : _END + stride]
        d = flux[c]
        for e in range(count):
            d[e] = b[e] - a[e]
            x = d[e] * per_kappa
            s[e] = x * x + (s[e] if c else np.float32(0))
    g = s[:count]
    if rational:
        _rational(g)
    else:
        _exponential(g)
    for e in range(count):
        g[e] *= near[e] * far[e] * weight
    for c in range(values.shape[0]):
        d = flux[c]
        for e in range(count):
            d[e] *= g[e]


@njit(cache=True, nogil=True)
def _step(values, mask, weights, per_kappa, rational, s, flux):
    """One step of the brick in the middle of a tile, in place; `weights` holds lambda of each axis."""
    total = flux[values.shape[0] :]
    total[:] = 0
    for axis in range(3):
        stride = _STRIDES[axis]
        _edges(values, mask, stride, (weights[axis], per_kappa, rational), s, flux)
        for c in range(values.shape[0]):
            enters, leaves, sums = flux[c, stride:], flux[c], total[c]
            for e in range(_END - _FIRST):
                sums[e] += enters[e] - leaves[e]
    for c in range(values.shape[0]):
        own, sums = values[c, _FIRST:_END], total[c]
        for e in range(_END - _FIRST):
            own[e] += sums[e]


@njit(cache=True, nogil=True)
def _over_bricks(begin, end, slots, support, forces, weights, per_kappa, rational, out):
    values, mask = np.zeros((3, _TILE), np.float32), np.zeros(_TILE, np.float32)
    s, flux = np.zeros(_TILE, np.float32), np.zeros((6, _TILE), np.float32)
    for n in range(begin, end):
        for neighbour, source, target, (source_a, source_b, target_a, target_b) in _FACES:
            slot = slots[n, neighbour]
            for a in range(8):
                for b in range(8):
                    place = target + a * target_a + b * target_b
                    if slot < 0:
                        mask[place] = 0
                    else:
                        local = source + a * source_a + b * source_b
                        mask[place] = support[slot, local]
                        for c in range(3):
                            values[c, place] = forces[slot, local, c]
        for i in range(8):
            for j in range(8):
                local, place = i * 64 + j * 8, _FIRST + i * 100 + j * 10
                for k in range(8):
                    mask[place + k] = support[n, local + k]
                    for c in range(3):
                        values[c, place + k] = forces[n, local + k, c]
        _step(values, mask, weights, per_kappa, rational, s, flux)
        for i in range(8):
            for j in range(8):
                local, place = i * 64 + j * 8, _FIRST + i * 100 + j * 10
                for k in range(8):
                    for c in range(3):
                        out[n, local + k, c] = values[c, place + k]


def stepped_bricks(
    slots: NDArray[np.int32], support: NDArray[np.bool_], forces: Float32s, law: Law, out: Float32s
) -> None:
    """One explicit step from `forces` into `out`, both float32 [n, 8, 8, 8, 3]; `law` is taken as it is.

    slots : int32 [n, 27]; see `touchfield.medium.neighbours.neighbour_slots`.
    support : bool [n, 8, 8, 8]; the samples that take part; the others stay as they are.
    """
    n = len(slots)
    arrays = (slots, support.reshape(n, 512), forces.reshape(n, 512, 3))
    for_chunks(_over_bricks, n, *arrays, *law.float32s, out.reshape(n, 512, 3), chunk=32)


@njit(cache=True, nogil=True)
def _over_dense(begin, end, blocks, where, dense, weights, per_kappa, rational, out):
    (nx, ny, nz), components = where.shape, dense.shape[3]
    values, mask = np.zeros((components, _TILE), np.float32), np.zeros(_TILE, np.float32)
    s, flux = np.zeros(_TILE, np.float32), np.zeros((2 * components, _TILE), np.float32)
    for n in range(begin, end):
        x, y, z = 8 * (n // (blocks[1] * blocks[2])), 8 * (n // blocks[2] % blocks[1]), 8 * (n % blocks[2])
        mask[:] = 0
        for i in range(max(0, x - 1), min(nx, x + 9)):
            for j in range(max(0, y - 1), min(ny, y + 9)):
                place = _FIRST + (i - x) * 100 + (j - y) * 10 - z
                for k in range(max(0, z - 1), min(nz, z + 9)):
                    mask[place + k] = where[i, j, k]
                for c in range(components):
                    for k in range(max(0, z - 1), min(nz, z + 9)):
                        values[c, place + k] = dense[i, j, k, c]
        _step(values, mask, weights, per_kappa, rational, s, flux)
        for i in range(x, min(nx, x + 8)):
            for j in range(y, min(ny, y + 8)):
                place = _FIRST + (i - x) * 100 + (j - y) * 10 - z
                for c in range(components):
                    for k in range(z, min(nz, z + 8)):
                        out[i, j, k, c] = values[c, place + k]


def stepped_dense(where: NDArray[np.bool_], dense: Float32s, law: Law, out: Float32s) -> None:
    """As `stepped_bricks`, from `dense` into `out`, both float32 [nx, ny, nz, components]."""
    x, y, z = (-(-n // 8) for n in where.shape)
    for_chunks(_over_dense, x * y * z, (x, y, z), where, dense, *law.float32s, out, chunk=32)
