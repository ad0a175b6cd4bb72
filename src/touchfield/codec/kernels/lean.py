"""How the coders' kernels are compiled: by who calls them, and without what counting references costs."""

from __future__ import annotations

from typing import Any, Final

from numba import config, njit
from numba.core.compiler import CompilerBase, DefaultPassBuilder

__all__ = ["LEAN", "entry", "inlined", "lean"]


class _Quick(CompilerBase):  # type: ignore[misc]
    """The compiler without searches for what no kernel has, and with the first level of LLVM's optimiser.

    What the higher levels add takes a seventh of the time, and makes none of these kernels faster.
    """

    _NEEDLESS: Final = ("inline_closure_likes", "nopython_rewrites", "inline_overloads", "literal_unroll")

    def define_pipelines(self) -> list[Any]:
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.passes = [one for one in passes.passes if one[0].name() not in self._NEEDLESS]
        passes.finalize()
        return [passes]

    def compile_extra(self, function: Any) -> Any:
        level, config.OPT = config.OPT, min(config.OPT, 1)
        try:
            return super().compile_extra(function)
        finally:
            config.OPT = level


LEAN: Final[dict[str, Any]] = {
    "cache": True, "nogil": True, "error_model": "numpy", "_nrt": False, "pipeline_class": _Quick
}  # fmt: skip
"""For functions that make no array: numba counts the references to every array at each call otherwise, which took a
quarter of the time of a pass. Division by zero is not looked for; no divisor of these kernels can be zero."""

_INNER: Final[dict[str, Any]] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}

entry = njit(**LEAN)
"""Of a kernel that Python calls."""

lean = njit(**LEAN, **_INNER)
"""Of one that only kernels call: to unpack named tuples of arrays for Python takes longer to compile than most."""

inlined = njit(**LEAN, inline="always")
"""Of one that a single kernel calls: it is never compiled by itself."""
