"""How kernels are compiled: by who calls them, and without what they do not need; kept where processes that compile
at once do not get in each other's way.
"""

from __future__ import annotations

import importlib
from functools import partial
from typing import Any, Final
from zlib import crc32

import numba
from numba import int64, njit
from numba.core import caching, compiler
from numba.core.types import IntegerLiteral
from numba.np import linalg

_CONFIG: Any = numba.config
_COMPILER: Any = compiler.CompilerBase
_PASSES: Any = compiler.DefaultPassBuilder
_FILES: Any = caching.IndexDataCacheFile
_save: Any = _FILES.save


def _save_named(files: Any, key: Any, data: Any) -> None:
    """Save a variant by its own name: two processes that compile two at once might take one number for both."""
    files._data_name_pattern = f"{files._index_name[:-4]}.{crc32(repr(key).encode()):08x}.{{number}}.nbc"
    _save(files, key, data)


_FILES.save = _save_named

_LINALG: Any = linalg
_ensure_blas = _LINALG.ensure_blas
_LINALG.ensure_blas = lambda: None  # numba loads SciPy's when a kernel runs; one that multiplies matrices still does
importlib.import_module("numba.np.arraymath")
_LINALG.ensure_blas = _ensure_blas


class _Quick(_COMPILER):  # type: ignore[misc]
    """The compiler without searches for what no kernel has, and with the first level of LLVM's optimiser.

    The higher levels take a tenth of all the time, and make none of the coder's passes faster.
    """

    _NEEDLESS: Final = ("inline_closure_likes", "nopython_rewrites", "inline_overloads", "literal_unroll")

    def define_pipelines(self) -> list[Any]:
        made = _PASSES.define_nopython_pipeline(self.state)
        made.passes = [one for one in made.passes if one[0].name() not in self._NEEDLESS]
        made.finalize()
        return [made]

    def compile_extra(self, function: Any) -> Any:
        level, _CONFIG.OPT = _CONFIG.OPT, min(_CONFIG.OPT, 1)
        try:
            return super().compile_extra(function)
        finally:
            _CONFIG.OPT = level


kernel: Any = partial(njit, cache=True, nogil=True, no_cfunc_wrapper=True)
"""Of a function that Python calls."""


def _numbers_alike(function: Any = None, **options: Any) -> Any:
    """Compile a function once for all whole numbers: numba makes a variant of it for each constant otherwise."""
    if function is None:
        return partial(_numbers_alike, **options)
    made = njit(function, **options)
    template = made.get_call_template

    def by_type(types: Any, names: Any) -> Any:
        return template(tuple(int64 if isinstance(one, IntegerLiteral) else one for one in types), names)

    made.get_call_template = by_type
    return made


inner: Any = partial(_numbers_alike, no_cpython_wrapper=True, no_cfunc_wrapper=True)
"""Of one that only kernels call: to unpack its arguments for Python takes as long to compile as most do themselves.
It is kept within those who call it, not by itself."""

uncounted: Any = partial(inner, _nrt=False)
"""The same of a tick, where no array is made: numba counts the references to every array at each call otherwise. A
query of the field takes a fifth of the time."""

_LEAN: Final[dict[str, Any]] = {"error_model": "numpy", "_nrt": False, "pipeline_class": _Quick}
"""For the coder's functions, that make no array: a quarter of the time of a pass was to count references. Division by
zero is not looked for; no divisor of these kernels can be zero."""

entry: Any = partial(kernel, **_LEAN)
"""Of one that Python calls."""

lean: Any = partial(inner, **_LEAN, cache=True)
"""Of one that only kernels call."""

inlined: Any = partial(inner, **_LEAN, inline="always")
"""Of one that a single kernel calls: it is never compiled by itself."""
