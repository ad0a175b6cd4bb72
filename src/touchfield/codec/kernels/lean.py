"""How the coders' kernels are compiled: by who calls them, and without what counting references costs."""

from __future__ import annotations

from typing import Any, Final

from numba import njit

__all__ = ["LEAN", "entry", "inlined", "lean"]

LEAN: Final[dict[str, Any]] = {"cache": True, "nogil": True, "error_model": "numpy", "_nrt": False}
"""For functions that make no array: numba counts the references to every array at each call otherwise, which took a
quarter of the time of a pass. Division by zero is not looked for; no divisor of these kernels can be zero."""

_INNER: Final[dict[str, Any]] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}

entry = njit(**LEAN)
"""Of a kernel that Python calls."""

lean = njit(**LEAN, **_INNER)
"""Of one that only kernels call: to unpack named tuples of arrays for Python takes longer to compile than most."""

inlined = njit(**LEAN, inline="always")
"""Of one that a single kernel calls: it is never compiled by itself."""
