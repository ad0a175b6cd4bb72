"""Checks that an array of forces fits into memory before it is allocated.

Without the check, a nominal lattice of 8e9 samples, or a small file that claims a large field, would make the
machine swap before any error was raised.
"""

from __future__ import annotations

import os
from functools import cache

import numpy as np

from touchfield.arrays import Float32s
from touchfield.errors import InvalidArgument
from touchfield.medium.grid import BRICK

BYTES_PER_BRICK = BRICK**3 * 3 * 4
_UNKNOWN_MACHINE_BYTES = 4 << 30
_LESS = (
    "Set TOUCHFIELD_MEMORY_GIB; what is encoded takes less with a smaller --nw or a thinner --thickness-m."
)


@cache
def _physical_bytes() -> int:
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError, OSError):
        return _UNKNOWN_MACHINE_BYTES


def memory_budget_bytes() -> int:
    """Return the bytes that one field may take.

    The budget is ``TOUCHFIELD_MEMORY_GIB`` if that is set, else half of the physical memory.
    """
    setting = os.environ.get("TOUCHFIELD_MEMORY_GIB", "")
    try:
        return int(float(setting) * 2**30)
    except (ValueError, OverflowError):
        return _physical_bytes() // 2


def zero_forces(count: int) -> Float32s:
    """Allocate zero forces for `count` bricks, float32 [count, 8, 8, 8, 3].

    Raises `InvalidArgument` if they would take more than `memory_budget_bytes`.
    """
    require_memory("force field", f"{count} bricks", count * BYTES_PER_BRICK)
    return np.zeros((count, BRICK, BRICK, BRICK, 3), np.float32)


def require_memory(name: str, contents: str, needed: int, hint: str = _LESS) -> None:
    """Raise `InvalidArgument` if `needed` bytes exceed `memory_budget_bytes`."""
    allowed = memory_budget_bytes()
    if needed > allowed:
        found, expected = (f"{size / 2**30:.1f} GiB" for size in (needed, allowed))
        raise InvalidArgument(name, f"{found} of {contents}", f"at most {expected}", hint)
