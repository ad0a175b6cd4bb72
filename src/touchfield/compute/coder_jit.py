"""Decorators of the coder's and the servo's kernels, until both are native code.

They use an undocumented option of numba, ``_nrt=False``: no array is made in these functions, and numba
would count the references to every array at each call. A quarter of the time of a coding pass and four fifths
of a query of the field were that count. Division by zero is not looked for: no divisor of the coder can be
zero.
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
"""Decorate a function of the coder that only kernels call, and that is stored by itself."""

inlined: Any = partial(inner, **_OPTIONS, inline="always")
"""Decorate a function of the coder that a single kernel calls: it is never compiled by itself."""

uncounted: Any = partial(inner, _nrt=False)
"""Decorate a function of the servo that only kernels call."""
