"""Compiled step from whole units to newtons."""

from __future__ import annotations

import numpy as np

from touchfield.lean import entry

__all__ = ["newtons"]

_BRICK = 512 * 3


@entry
def newtons(vectors, unit_n, forces, held):
    """`forces`, float32, of `vectors`, int32, both flat: a float32 product each; which bricks hold any, bool [n]."""
    for n in range(held.shape[0]):
        any_set = np.int32(0)
        for at in range(n * _BRICK, (n + 1) * _BRICK):
            v = vectors[at]
            any_set |= v
            forces[at] = np.float32(v) * unit_n
        held[n] = any_set != 0
