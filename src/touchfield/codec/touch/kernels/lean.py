"""Compilation of the coder's kernels, by who calls them."""

from __future__ import annotations

from typing import Any, Final

from numba import njit

from touchfield.codec.kernels.lean import LEAN

__all__ = ["entry", "inlined", "lean"]

_INNER: Final[dict[str, Any]] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}

entry = njit(**LEAN)
"""Of a kernel that Python calls."""

lean = njit(**LEAN, **_INNER)
"""Of one that only kernels call: to unpack named tuples of arrays for Python takes longer to compile than most."""

inlined = njit(**LEAN, inline="always")
"""Of one that a single kernel calls: it is never compiled by itself."""
