"""Decorators that compile inner loops by numba without reference counting.

They use an undocumented option of numba, ``_nrt=False``. These functions create no arrays, yet numba would
count the references to every array at each call; this counting took a quarter of the time of a coding pass.
Division by zero is not checked, because no divisor of the coder can
be zero.
"""

from __future__ import annotations

from functools import partial
from typing import Any, Final

from touchfield.compute.jit import inner, kernel, numba_internals

_OPTIONS: Final[dict[str, Any]] = {"error_model": "numpy", "_nrt": False}
if numba_internals is not None:
    _OPTIONS["pipeline_class"] = numba_internals.CoderCompiler

entry: Any = partial(kernel, **_OPTIONS)
"""Decorate a function of the coder that Python calls."""

lean: Any = partial(kernel, **_OPTIONS, nogil=False, no_cpython_wrapper=True)
"""Decorate a function of the coder that only kernels call, and whose machine code is stored by itself."""

inlined: Any = partial(inner, **_OPTIONS, inline="always")
"""Decorate a function of the coder that is inlined into its kernel and never compiled by itself."""
