"""Compiled inner loops of force fields, which other kernels call.

Import this package only where it is used, since it imports numba.
"""

from __future__ import annotations

from touchfield.compute.jit import inner


@inner
def lower_bound(keys, key):
    """Return what `numpy.searchsorted` does, which takes longer to compile."""
    low, high = 0, keys.shape[0]
    while low < high:
        middle = (low + high) >> 1
        if keys[middle] < key:
            low = middle + 1
        else:
            high = middle
    return low
