"""Compiled loop of the support: a bit for each sample of the bricks that there are."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from touchfield.codec.kernels.bits import PLACE, READING, TASK, mix
from touchfield.lean import entry

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["CONTEXTS", "SETS", "Samples", "code_samples"]

_OLD: Final = 4096
CONTEXTS: Final = _OLD + 1024
SETS: Final = 8

_NEAR: Final = (-144, -12, -1, -143, -13, -11, -156, -288, -24, -132, -131, -2)
_LATE: Final = (0, -1, 1, -12, 12, -144, 144)
"""Steps in a window of 12 x 12 x 12 samples: to those told before, and to those of the support before."""


class Samples(NamedTuple):
    """The samples of n bricks, beside m that both sides know.

    Attributes
    ----------
    held : uint8 [n + 1, 512]
        1 where a sample is set, as far as it is told; the last brick, of all that are not listed, is 0.
    before : uint8 [m + 1, 512]
        The same of the support before.
    around, around_before : int64 [n, 27]
        Places in both of each brick and of those around it, x slowest; -1 of those not listed.
    inside : int64 [n, 3]
        Samples of a brick within the grid.
    window, old : uint8 [1728]
        Room for a brick of both, whose first sample is at (2, 2, 2), and what is around it.
    """

    held: NDArray[np.uint8]
    before: NDArray[np.uint8]
    around: NDArray[np.int64]
    around_before: NDArray[np.int64]
    inside: NDArray[np.int64]
    window: NDArray[np.uint8]
    old: NDArray[np.uint8]


@entry
def code_samples(bits, contexts_at, sets_at, samples, wanted):
    """Tell which samples are set, when writing those `wanted`, uint8 [n, 512]; returns whether the code held them."""
    held, window, old = samples.held, samples.window, samples.old
    for brick in range(wanted.shape[0]):
        if bits.state[TASK] == READING and bits.state[PLACE] > bits.buffer.shape[0] + 6:
            return False
        for n in range(1728):
            x, y, z = n // 144 + 6, n // 12 % 12 + 6, n % 12 + 6
            near, place = (x >> 3) * 9 + (y >> 3) * 3 + (z >> 3), (x & 7) << 6 | (y & 7) << 3 | (z & 7)
            window[n] = held[samples.around[brick, near], place]
            old[n] = samples.before[samples.around_before[brick, near], place]
        for x in range(samples.inside[brick, 0]):
            for y in range(samples.inside[brick, 1]):
                for z in range(samples.inside[brick, 2]):
                    here, place = ((x + 2) * 12 + y + 2) * 12 + z + 2, x << 6 | y << 3 | z
                    mask, late = np.int64(0), np.int64(0)
                    for k in range(12):
                        mask |= np.int64(window[here + _NEAR[k]]) << k
                    for k in range(7):
                        late |= np.int64(old[here + _LATE[k]]) << k
                    bits.inputs[0] = contexts_at + mask
                    bits.inputs[1] = contexts_at + _OLD + (late << 3 | mask & 7)
                    window[here] = mix(bits, 2, sets_at + (mask & 7), np.int64(wanted[brick, place]))
                    held[brick, place] = window[here]
    return True
