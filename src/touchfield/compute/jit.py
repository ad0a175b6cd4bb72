"""How kernels are compiled: `kernel` for functions that Python calls, `inner` for those that kernels call.

Constants stay constants: numba compiles a function once more for each whole number that a caller writes out,
such as the stride of a loop. The compiler needs them to turn loops into vector code (decision 20).

Machine code is stored in a folder that belongs to all kernel sources (`touchfield.compute.numba_internals`).
With a version of numba whose private parts are not those known here, it is stored as numba does by itself:
correct for an installed package, while someone who edits kernels must remove ``__pycache__``.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from pathlib import Path
from typing import Any

from numba import njit

try:
    from touchfield.compute import numba_internals as numba_internals
except (ImportError, AttributeError, TypeError):  # another numba has other private parts
    numba_internals = None  # type: ignore[assignment]


def kernel(function: Any = None, **options: Any) -> Any:
    """Decorate a function that Python calls: it runs without the interpreter lock, and is stored on disk.

    Options are those of `numba.njit`.
    """
    if function is None:
        return partial(kernel, **options)
    compiled = njit(function, **{"nogil": True, "no_cfunc_wrapper": True, **options})
    is_interpreted = compiled is function  # NUMBA_DISABLE_JIT
    if not (is_interpreted or (numba_internals and numba_internals.attach_cache(compiled, function))):
        compiled.enable_caching()
    return compiled


def inner(function: Any = None, **options: Any) -> Any:
    """Decorate a function that only kernels call: it is compiled and stored within them.

    Without a wrapper for Python, which takes as long to compile as most such functions do themselves.
    """
    if function is None:
        return partial(inner, **options)
    return njit(function, **{"no_cpython_wrapper": True, "no_cfunc_wrapper": True, **options})


def kernel_folder() -> Path | None:
    """The folder of compiled kernels; None where there is none, or numba keeps them by itself."""
    return numba_internals.kernel_folder() if numba_internals else None


def compilation_events(
    on_start: Callable[[], None], on_end: Callable[[], None]
) -> AbstractContextManager[None]:
    """Call `on_start` and `on_end` around each compilation in the block, if numba is a known version."""
    return numba_internals.compilation_events(on_start, on_end) if numba_internals else nullcontext()
