"""Decorators that compile a *kernel*, an inner loop over arrays, with numba, and store the machine code on
disk so that later runs start without compiling.

`kernel` decorates functions that Python calls, `inner` those that only kernels call. Importing this module
raises `MissingExtra` if numba is not installed (extra ``sources``): import modules of kernels where they are
used.

Constants stay constants: numba compiles a function again for each literal whole number that a caller passes,
such as the stride of a loop. The compiler needs these constants to vectorise loops (decision 20).

Machine code is stored in a folder that belongs to all kernel sources (`touchfield.compute.numba_internals`).
With a version of numba whose private parts differ from those known here, numba's own cache is used. It is
correct for an installed package, but after editing kernels ``__pycache__`` must be removed.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

from touchfield.errors import import_extra

njit = import_extra("numba", "compiled kernels of sources, filters and measures", "numba", "sources").njit

try:
    from touchfield.compute import numba_internals as numba_internals
except (ImportError, AttributeError, TypeError):  # another numba has other private parts
    numba_internals = None  # type: ignore[assignment]


def kernel(function: Any = None, **options: Any) -> Any:
    """Decorate a function that Python calls.

    It runs without the GIL, and its machine code is stored on disk. Options are those of `numba.njit`.
    """
    if function is None:
        return partial(kernel, **options)
    compiled = njit(function, **{"nogil": True, "no_cfunc_wrapper": True, **options})
    is_interpreted = compiled is function  # NUMBA_DISABLE_JIT
    if not (is_interpreted or (numba_internals and numba_internals.attach_cache(compiled, function))):
        compiled.enable_caching()
    return compiled


def inner(function: Any = None, **options: Any) -> Any:
    """Decorate a function that only kernels call.

    It is compiled and stored as part of them. It has no wrapper for Python, which for most such functions
    would take as long to compile as the function itself.
    """
    if function is None:
        return partial(inner, **options)
    return njit(function, **{"no_cpython_wrapper": True, "no_cfunc_wrapper": True, **options})


def kernel_folder() -> Path | None:
    """The folder of compiled kernels.

    None if there is no such folder, or numba's own cache is used.
    """
    return numba_internals.kernel_folder() if numba_internals else None
