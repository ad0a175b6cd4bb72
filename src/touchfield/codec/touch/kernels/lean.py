"""Compilation of the coder's kernels: without what counting references costs them."""

from __future__ import annotations

from typing import Any, Final

from numba import njit

__all__ = ["LEAN", "lean"]

LEAN: Final[dict[str, Any]] = {"cache": True, "nogil": True, "error_model": "numpy", "_nrt": False}
"""For functions that make no array: numba counts the references to every array at each call otherwise, which took a
quarter of the time of a pass. Division by zero is not looked for; no divisor of these kernels can be zero."""

lean = njit(**LEAN)
