"""How kernels are compiled: kept where processes that compile at once do not get in each other's way; those that make
no array by who calls them, and without what they do not need.
"""

from __future__ import annotations

from typing import Any, Final
from zlib import crc32

import numba
from numba import njit as njit
from numba.core import caching, compiler

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


LEAN: Final[dict[str, Any]] = {
    "cache": True, "nogil": True, "error_model": "numpy", "_nrt": False, "pipeline_class": _Quick
}  # fmt: skip
"""For functions that make no array: numba counts the references to every array at each call otherwise, which took a
quarter of the time of a pass. Division by zero is not looked for; no divisor of these kernels can be zero."""

UNCOUNTED: Final[dict[str, Any]] = {"nogil": True, "_nrt": False}
"""For kernels of a tick: the same, compiled as others are. A query of the field takes a fifth of the time."""

_INNER: Final[dict[str, Any]] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}

entry = njit(**LEAN)
"""Of a kernel that Python calls."""

lean = njit(**LEAN, **_INNER)
"""Of one that only kernels call: to unpack named tuples of arrays for Python takes longer to compile than most."""

inlined = njit(**LEAN, inline="always")
"""Of one that a single kernel calls: it is never compiled by itself."""
