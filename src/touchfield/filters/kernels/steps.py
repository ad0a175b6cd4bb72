"""Compiled steps of Perona-Malik diffusion, which smooths a field but keeps its edges. `shading` calls them.

Each brick is copied with the samples around it into a tile of 10 x 10 x 10, one row for each component, so
that every loop over it is long enough for vector instructions. The flux of an edge between two bricks is
computed in both from the same numbers by the same operations, so that the two values are equal to the last
bit. The result does not depend on the number of threads. Imported only when first needed.
"""

from __future__ import annotations

import math

import numpy as np

from touchfield.compute.jit import inner, kernel

_STRIDES = (100, 10, 1)
_TILE = 1000
_FIRST, _END = 111, 889  # tile indices of sample (0, 0, 0) of the brick, and one beyond (7, 7, 7)

_FACES = (
    (4, 448, 11, (8, 1, 10, 1)),
    (22, 0, 911, (8, 1, 10, 1)),
    (10, 56, 101, (64, 1, 100, 1)),
    (16, 0, 191, (64, 1, 100, 1)),
    (12, 7, 110, (64, 8, 100, 10)),
    (14, 0, 119, (64, 8, 100, 10)),
)
"""The six neighbours of a brick: index in `neighbour_slots`, first sample of the face in that brick and in
the tile, and the strides along both edges of the face, in that brick and in the tile."""

_MAX_EXPONENT = np.float32(16)
_SERIES = tuple(
    np.float32((-1) ** n / math.factorial(n)) for n in range(10)
)  # Taylor's for exp(-r), 0 <= r <= 1


@inner
def _exponential(s):
    """Replace each s >= 0 by exp(-s), within 1e-6, as the 16th power of exp(-s/16); from 16 on by 0.

    `math.exp` is not vectorised and takes twenty times as long.
    """
    c0, c1, c2, c3, c4, c5, c6, c7, c8, c9 = _SERIES
    for e in range(s.shape[0]):
        r = min(s[e], _MAX_EXPONENT) * np.float32(1 / 16)
        p = c0 + r * (
            c1 + r * (c2 + r * (c3 + r * (c4 + r * (c5 + r * (c6 + r * (c7 + r * (c8 + r * c9)))))))
        )
        p *= p
        p *= p
        p *= p
        p *= p
        s[e] = p if s[e] < _MAX_EXPONENT else np.float32(0)


@inner
def _edges(values, mask, stride, conductance, s, flux):
    """Write the flux along each edge of one axis that touches the brick to the start of `flux`.

    `conductance` is (weight, 1 / kappa); an edge with an end outside the mask has no flux.
    """
    weight, per_kappa = conductance
    start = _FIRST - stride
    count = _END - start
    mask_a, mask_b = mask[start:_END], mask[start + stride : _END + stride]
    for c in range(values.shape[0]):
        a, b = values[c, start:_END], values[c, start + stride : _END + stride]
        d = flux[c]
        for e in range(count):
            d[e] = b[e] - a[e]
            x = d[e] * per_kappa
            s[e] = x * x + (s[e] if c else np.float32(0))
    g = s[:count]
    _exponential(g)
    for e in range(count):
        g[e] *= mask_a[e] * mask_b[e] * weight
    for c in range(values.shape[0]):
        d = flux[c]
        for e in range(count):
            d[e] *= g[e]


@inner
def _step(values, mask, weights, per_kappa, s, flux):
    """Advance the brick in the middle of a tile by one step, in place; `weights` is lambda of each axis."""
    total = flux[values.shape[0] :]
    total[:] = 0
    for axis in range(3):
        stride = _STRIDES[axis]
        _edges(values, mask, stride, (weights[axis], per_kappa), s, flux)
        for c in range(values.shape[0]):
            enters, leaves, sums = flux[c, stride:], flux[c], total[c]
            for e in range(_END - _FIRST):
                sums[e] += enters[e] - leaves[e]
    for c in range(values.shape[0]):
        middle, sums = values[c, _FIRST:_END], total[c]
        for e in range(_END - _FIRST):
            middle[e] += sums[e]


@kernel
def diffuse_bricks(start, stop, slots, support, forces, weights, per_kappa, out):
    """One explicit step of the samples in `support`, from `forces` to `out`, both float32 [n, 512, 3].

    `slots` are `touchfield.medium.field.neighbour_slots`; `weights` float32 (x, y, z) are lambda, `per_kappa`
    is 1/kappa, 0 for a conductance of 1.
    """
    values, mask = np.zeros((3, _TILE), np.float32), np.zeros(_TILE, np.float32)
    s, flux = np.zeros(_TILE, np.float32), np.zeros((6, _TILE), np.float32)
    for n in range(start, stop):
        for neighbour, source, target, (source_a, source_b, target_a, target_b) in _FACES:
            slot = slots[n, neighbour]
            for a in range(8):
                for b in range(8):
                    index = target + a * target_a + b * target_b
                    if slot < 0:
                        mask[index] = 0
                    else:
                        local = source + a * source_a + b * source_b
                        mask[index] = support[slot, local]
                        for c in range(3):
                            values[c, index] = forces[slot, local, c]
        for i in range(8):
            for j in range(8):
                local, index = i * 64 + j * 8, _FIRST + i * 100 + j * 10
                for k in range(8):
                    mask[index + k] = support[n, local + k]
                    for c in range(3):
                        values[c, index + k] = forces[n, local + k, c]
        _step(values, mask, weights, per_kappa, s, flux)
        for i in range(8):
            for j in range(8):
                local, index = i * 64 + j * 8, _FIRST + i * 100 + j * 10
                for k in range(8):
                    for c in range(3):
                        out[n, local + k, c] = values[c, index + k]
