"""How kernels are compiled: by who calls them, and without what they do not need; and where they are stored.

Constants stay constants: numba compiles a function once more for each whole number that a caller writes out,
such as the stride of a loop. The compiler needs them to turn loops into vector code (see decision 20).
"""

from __future__ import annotations

import importlib
from collections.abc import Iterable
from contextlib import suppress
from functools import cache, cached_property, partial
from pathlib import Path
from typing import Any, Final
from zlib import crc32

import llvmlite  # type: ignore[import-untyped]
import numba
from numba import njit
from numba.core import caching, compiler, types
from numba.np import linalg

from touchfield.compute.kernel_sources import PACKAGE, SourceState, kernel_sources, open_folder

_CONFIG: Any = numba.config
_COMPILER: Any = compiler.CompilerBase
_PASSES: Any = compiler.DefaultPassBuilder
_CACHING: Any = caching
_VERSIONS: Final = f"numba {numba.__version__}, llvmlite {llvmlite.__version__}"
_SOURCES: Final = SourceState(kernel_sources(), _VERSIONS)


@cache
def kernel_folder() -> Path | None:
    """The folder of compiled kernels of these sources, created when first needed; None where none can be.

    It lies where numba would keep this file's kernels: in NUMBA_CACHE_DIR, else beside the package, else in
    the user's cache.
    """
    try:
        root = _CACHING.CompileResultCacheImpl(kernel_folder.__wrapped__).locator.get_cache_path()
        return open_folder(Path(root), _SOURCES.digest)
    except (OSError, RuntimeError):  # RuntimeError: numba finds no folder it may write to
        return None


class _Locator(_CACHING.InTreeCacheLocator):  # type: ignore[misc]
    """The place of one function's files in the folder of these sources."""

    def __init__(self, function: Any, file: str) -> None:
        super().__init__(function, file)
        parent = Path(file).parent
        is_ours = parent.is_relative_to(PACKAGE)
        name = (
            ".".join(parent.relative_to(PACKAGE).parts) if is_ours else self.get_suitable_cache_subpath(file)
        )
        self._cache_path = str((kernel_folder() or PACKAGE) / name)

    @classmethod
    def from_function(cls, function: Any, file: str) -> Any:
        """numba writes and removes a file here, for each function that is imported."""
        return cls(function, file)


class _Functions(_CACHING.CompileResultCacheImpl):  # type: ignore[misc]
    _locator_classes: Final = (_Locator,)


class KernelFiles(_CACHING.IndexDataCacheFile):  # type: ignore[misc]
    """The files of one function, one for each variant that is compiled."""

    def save(self, key: Any, data: Any) -> None:
        """Save a variant by its own name: two processes that compile two at once might take one number for
        both.
        """
        self._data_name_pattern = f"{self._index_name[:-4]}.{crc32(repr(key).encode()):08x}.{{number}}.nbc"
        super().save(key, data)


class _KernelCache(_CACHING.FunctionCache):  # type: ignore[misc]
    """numba's cache of one function, in a folder that only these sources have.

    It looks for the folder when a kernel is first called, not when it is imported. A failure to read or write
    is no failure of the kernel, which is compiled again: another process may remove the folder at any time.
    """

    def __init__(self, function: Any) -> None:
        self._py_func, self._name = function, repr(function)
        self.enable()

    @cached_property
    def _impl(self) -> Any:
        return _Functions(self._py_func)

    @cached_property
    def _cache_path(self) -> str:
        return str(self._impl.locator.get_cache_path())

    @cached_property
    def _cache_file(self) -> KernelFiles:
        return KernelFiles(self._cache_path, self._impl.filename_base, self._impl.locator.get_source_stamp())

    def _is_usable(self) -> bool:
        return kernel_folder() is not None and _SOURCES.is_current()

    def load_overload(self, signature: Any, context: Any) -> Any:
        """The compiled variant, or None."""
        with suppress(OSError):
            return super().load_overload(signature, context) if self._is_usable() else None
        return None

    def save_overload(self, signature: Any, result: Any) -> None:
        """Store a compiled variant, if that is possible."""
        with suppress(OSError):
            if self._is_usable():
                super().save_overload(signature, result)

    def _index_key(self, signature: Any, codegen: Any) -> Any:
        arguments = signature if isinstance(signature, tuple) else signature.args
        return (*super()._index_key(signature, codegen), _fields_of(arguments))


def _fields_of(arguments: Iterable[Any]) -> tuple[Any, ...]:
    """Names of the fields of named tuples, in order: numba compares the types of fields, but not their names."""
    tuples: list[Any] = [argument for argument in arguments if isinstance(argument, types.BaseTuple)]
    return tuple((getattr(argument, "fields", ()), _fields_of(argument.types)) for argument in tuples)


def _cached(function: Any = None, **options: Any) -> Any:
    """Compile a function, and store the machine code on disk."""
    if function is None:
        return partial(_cached, **options)
    compiled = njit(function, **options)
    if not hasattr(compiled, "_cache"):  # NUMBA_DISABLE_JIT
        return compiled
    if _SOURCES.files:
        compiled._cache = _KernelCache(function)
    else:  # within an archive, as a whole a single file that numba compares
        compiled.enable_caching()
    return compiled


_LINALG: Any = linalg
_ensure_blas = _LINALG.ensure_blas
_LINALG.ensure_blas = lambda: (
    None
)  # numba loads SciPy's when a kernel runs; one that multiplies matrices still does
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


kernel: Any = partial(_cached, nogil=True, no_cfunc_wrapper=True)
"""Of a function that Python calls."""

inner: Any = partial(njit, no_cpython_wrapper=True, no_cfunc_wrapper=True)
"""Of one that only kernels call: to unpack its arguments for Python takes as long to compile as most do
themselves. It is kept within those who call it, not by itself."""

uncounted: Any = partial(inner, _nrt=False)
"""The same of a tick, where no array is made: numba counts the references to every array at each call
otherwise. A query of the field takes a fifth of the time."""

_LEAN: Final[dict[str, Any]] = {"error_model": "numpy", "_nrt": False, "pipeline_class": _Quick}
"""For the coder's functions, that make no array: a quarter of the time of a pass was to count references.
Division by zero is not looked for; no divisor of these kernels can be zero."""

entry: Any = partial(kernel, **_LEAN)
"""Of one that Python calls."""

lean: Any = partial(_cached, no_cpython_wrapper=True, no_cfunc_wrapper=True, **_LEAN)
"""Of one that only kernels call."""

inlined: Any = partial(inner, **_LEAN, inline="always")
"""Of one that a single kernel calls: it is never compiled by itself."""
