"""The compiled core of `touchfield.filters.texture`: impulses by counter, and the high-pass of both kinds.

Each brick is made alone and each impulse is a hash of where it lies, so that the result depends neither on the
number of threads nor on which bricks there are. Imported only when first needed, because it imports numba.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from touchfield.medium.budget import zero_forces
from touchfield.parallel import for_chunks

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Float32s = NDArray[np.float32]
    Triple = tuple[int, int, int]

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_FIRST, _SECOND = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_INSIDE = 1 - 2.0**-22  # so that rounding to float32 never lifts a clipped force above the limit


@njit(cache=True, nogil=True)
def mixed(z):
    """The output function of splitmix64 (Steele, Lea and Flood 2014), uint64 to uint64, one to one."""
    z = (z ^ (z >> np.uint64(30))) * _FIRST
    z = (z ^ (z >> np.uint64(27))) * _SECOND
    return z ^ (z >> np.uint64(31))


@njit(cache=True, nogil=True)
def _impulse(x, y, z, key, density):
    """-1, 0 or 1 at a grain, whose coordinates are -1 to 2^20: the splitmix64 stream of `key`, jumped into."""
    place = np.uint64(x + 1) | (np.uint64(y + 1) << np.uint64(21)) | (np.uint64(z + 1) << np.uint64(42))
    bits = mixed(key + (place + np.uint64(1)) * _GOLDEN)
    if np.float64(bits >> np.uint64(11)) * 2.0**-53 >= density:
        return 0
    return 1 if bits & np.uint64(1) else -1


@njit(cache=True, nogil=True)
def _drawn(first, grains, half, key, density, impulses):
    """The impulses of the grains of a brick and of `half` grains around them."""
    for p in range(grains[0, 7] + 2 * half[0] + 1):
        for q in range(grains[1, 7] + 2 * half[1] + 1):
            for r in range(grains[2, 7] + 2 * half[2] + 1):
                x, y, z = first[0] + p - half[0], first[1] + q - half[1], first[2] + r - half[2]
                impulses[p, q, r] = _impulse(x, y, z, key, density)


@njit(cache=True, nogil=True)
def _limited(x, y, z, ceiling, target):
    square = x * x + y * y + z * z
    if square > ceiling * ceiling:
        factor = ceiling * _INSIDE / np.sqrt(square)
        x, y, z = x * factor, y * factor, z * factor
    target[0], target[1], target[2] = x, y, z
    return target[0] != 0 or target[1] != 0 or target[2] != 0


@njit(cache=True, nogil=True)
def _textured(begin, end, bricks, forces, grain, half, key, density, gain, limit, ceiling, out, held):
    impulses = np.zeros((10, 10, 10), np.int64)
    first, grains = np.zeros(3, np.int64), np.zeros((3, 8), np.int64)  # the grain of each sample, from `first`
    taps = (2 * half[0] + 1) * (2 * half[1] + 1) * (2 * half[2] + 1)
    for n in range(begin, end):
        for a in range(3):
            first[a] = bricks[n, a] * 8 // grain[a]
            for i in range(8):
                grains[a, i] = (bricks[n, a] * 8 + i) // grain[a] - first[a]
        _drawn(first, grains, half, key, density, impulses)
        some = False
        for i in range(8):
            p = grains[0, i]
            for j in range(8):
                q = grains[1, j]
                for k in range(8):
                    x = np.float64(forces[n, i, j, k, 0])
                    y = np.float64(forces[n, i, j, k, 1])
                    z = np.float64(forces[n, i, j, k, 2])
                    if x == 0 and y == 0 and z == 0:
                        continue
                    r = grains[2, k]
                    total = 0
                    for a in range(p, p + 2 * half[0] + 1):
                        for b in range(q, q + 2 * half[1] + 1):
                            for c in range(r, r + 2 * half[2] + 1):
                                total += impulses[a, b, c]
                    share = gain * (impulses[p + half[0], q + half[1], r + half[2]] * taps - total)
                    factor = 1 + min(max(share, -limit), limit)
                    some |= _limited(x * factor, y * factor, z * factor, ceiling, out[n, i, j, k])
        held[n] = some


def textured(
    bricks: NDArray[np.int32],
    forces_n: Float32s,
    grain: Triple,
    half: Triple,
    law: tuple[int, float, float, float, float],
) -> tuple[Float32s, NDArray[np.bool_]]:
    """Forces [n, 8, 8, 8, 3] times 1 + share, and which bricks hold any.

    `grain` is samples to a grain and `half` grains on each side of the high-pass (0 or 1), for each axis; `law` is
    the seed, the density, the gain of one impulse before the division by the taps, the limit of the share, and the
    greatest |F|.
    """
    out = zero_forces(len(bricks))
    held = np.zeros(len(bricks), np.bool_)
    seed, density, gain, limit, ceiling = law
    with np.errstate(over="ignore"):  # the sum is meant to wrap round
        key = np.uint64(mixed(np.uint64(seed) + _GOLDEN))
    for_chunks(
        _textured, len(bricks), bricks, forces_n, grain, half, key, density, gain, limit, ceiling, out, held, chunk=16
    )
    return out, held


@njit(cache=True, nogil=True)
def _gathered(slots, forces, half, halo):
    """A brick with `half` samples around it, zero where `slots` has no brick."""
    for i in range(8 + 2 * half[0]):
        x = i - half[0] + 8
        for j in range(8 + 2 * half[1]):
            y = j - half[1] + 8
            for k in range(8 + 2 * half[2]):
                z = k - half[2] + 8
                slot = slots[(x >> 3) * 9 + (y >> 3) * 3 + (z >> 3)]
                for c in range(3):
                    halo[i, j, k * 3 + c] = forces[slot, x & 7, y & 7, z & 7, c] if slot >= 0 else 0.0


@njit(cache=True, nogil=True)
def _high_passed(begin, end, slots, forces, half, ceiling, out):
    rx, ry, rz = half
    taps = (2 * rx + 1) * (2 * ry + 1) * (2 * rz + 1)
    run = (8 + 2 * rz) * 3
    halo, along_x = np.zeros((8 + 2 * rx, 8 + 2 * ry, run)), np.zeros((8 + 2 * ry, run))
    along_xy, high = np.zeros(run), np.zeros(3)
    for n in range(begin, end):
        _gathered(slots[n], forces, half, halo)
        for i in range(8):
            for j in range(8 + 2 * ry):
                for r in range(run):
                    along_x[j, r] = halo[i, j, r]
                    for t in range(i + 1, i + 2 * rx + 1):
                        along_x[j, r] += halo[t, j, r]
            for j in range(8):
                for r in range(run):
                    along_xy[r] = along_x[j, r]
                    for t in range(j + 1, j + 2 * ry + 1):
                        along_xy[r] += along_x[t, r]
                for k in range(8):
                    for c in range(3):
                        total = 0.0
                        for t in range(k, k + 2 * rz + 1):
                            total += along_xy[t * 3 + c]
                        # a constant is exact here: whole multiples of float32 below 2^13 in float64
                        high[c] = (taps * halo[i + rx, j + ry, (k + rz) * 3 + c] - total) / taps
                    _limited(high[0], high[1], high[2], ceiling, out[n, i, j, k])


def high_passed(slots: NDArray[np.int32], forces_n: Float32s, half: Triple, ceiling_n: float) -> Float32s:
    """The impulse minus the box of 2 half + 1 samples, over each component, float32 [n, 8, 8, 8, 3].

    `slots` int32 [n, 27] says where in `forces_n` the bricks around each output brick are, -1 for none, in the
    order of `touchfield.medium.neighbours.neighbour_slots`; `half` is 0 to 8 for each axis.
    """
    out = zero_forces(len(slots))
    for_chunks(_high_passed, len(slots), slots, forces_n, half, ceiling_n, out, chunk=16)
    return out
