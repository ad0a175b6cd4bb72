"""Memory that a field may take: forces are allocated here, after a look at what the machine has.

Without it a nominal lattice of 8e9 samples, or a small file that claims a large field, would drive the
machine into swapping before any error came.
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
    """Bytes that one field may take: ``TOUCHFIELD_MEMORY_GIB``, or half of the machine's memory."""
    asked = os.environ.get("TOUCHFIELD_MEMORY_GIB", "")
    try:
        return int(float(asked) * 2**30)
    except (ValueError, OverflowError):
        return _physical_bytes() // 2


def zero_forces(count: int) -> Float32s:
    """Zero forces for `count` bricks, float32 [count, 8, 8, 8, 3].

    Raises `InvalidArgument` if they would take more than `memory_budget_bytes`.
    """
    require_memory("force field", f"{count} bricks", count * BYTES_PER_BRICK)
    return np.zeros((count, BRICK, BRICK, BRICK, 3), np.float32)


def require_memory(name: str, what: str, needed: int, mend: str = _LESS) -> None:
    """Refuse what would take more than `memory_budget_bytes`; `InvalidArgument` if `needed` bytes are more."""
    allowed = memory_budget_bytes()
    if needed > allowed:
        found, expected = (f"{size / 2**30:.1f} GiB" for size in (needed, allowed))
        raise InvalidArgument(name, f"{found} of {what}", f"at most {expected}", mend)
