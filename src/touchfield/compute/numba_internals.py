"""Keeps numba's cache correct, and its import short, through private parts of numba. No other module uses
such parts.

`touchfield.compute.jit` imports it, and works without it if a version of numba lacks these parts. The purpose
of each part, with measurements for numba 0.67 on two cores:

- *Cache* (`attach_cache`): numba checks only the file of a kernel and keeps using old machine code of
  functions that the kernel calls in other files (decision 20). No public interface replaces that.
- *Start* (`without_blas`): importing numba takes 0.2 s less, for which every command and the servo's process
  would otherwise wait.
- *Events* (`touchfield.compute.compilation`): a person who waits for the compiler is told so.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterable
from contextlib import suppress
from functools import cache, cached_property
from pathlib import Path
from typing import Any, Final
from zlib import crc32

import llvmlite  # type: ignore[import-untyped]
import numba
from numba.core import caching, event, types
from numba.np import linalg

from touchfield.compute.compilation import compilation_ended, compilation_started
from touchfield.compute.kernel_sources import PACKAGE, SourceState, kernel_sources, open_folder

_CACHING: Any = caching
_LINALG: Any = linalg
_EVENT: Any = event
_VERSIONS: Final = f"numba {numba.__version__}, llvmlite {llvmlite.__version__}"
_SOURCES: Final = SourceState(kernel_sources(), _VERSIONS)


# -- cache -------------------------------------------------------------------------------------------------


def attach_cache(dispatcher: Any, function: Any) -> bool:
    """Store the variants of a kernel in the folder of all kernel sources.

    Returns False if that is not possible: within an archive the package is a single file, which numba's own
    cache checks as a whole.
    """
    if not _SOURCES.files:
        return False
    dispatcher._cache = _KernelCache(function)
    return True


@cache
def kernel_folder() -> Path | None:
    """The folder of compiled kernels of these sources; None if none can be created.

    It is created when first needed, where numba would store this file's kernels: in NUMBA_CACHE_DIR, else
    beside the package, else in the user's cache.
    """
    try:
        root = _CACHING.CompileResultCacheImpl(kernel_folder.__wrapped__).locator.get_cache_path()
        return open_folder(Path(root), _SOURCES.digest)
    except (OSError, RuntimeError):  # RuntimeError: numba finds no folder it may write to
        return None


class _Locator(_CACHING.InTreeCacheLocator):  # type: ignore[misc]
    """Location of the files of one function within the folder of these sources."""

    def __init__(self, function: Any, file: str) -> None:
        super().__init__(function, file)
        parent = Path(file).parent
        if parent.is_relative_to(PACKAGE):
            name = ".".join(parent.relative_to(PACKAGE).parts)
        else:
            name = self.get_suitable_cache_subpath(file)
        self._cache_path = str((kernel_folder() or PACKAGE) / name)

    @classmethod
    def from_function(cls, function: Any, file: str) -> Any:
        """Create a locator without numba's test that the folder can be written.

        That test writes and removes a file for each function.
        """
        return cls(function, file)


class _Functions(_CACHING.CompileResultCacheImpl):  # type: ignore[misc]
    _locator_classes: Final = (_Locator,)


class KernelFiles(_CACHING.IndexDataCacheFile):  # type: ignore[misc]
    """The files of one function, one for each compiled variant."""

    def save(self, key: Any, data: Any) -> None:
        """Save a variant under a name derived from its key.

        numba numbers the variants; two processes that compile two variants at once might use one number for
        both.
        """
        self._data_name_pattern = f"{self._index_name[:-4]}.{crc32(repr(key).encode()):08x}.{{number}}.nbc"
        super().save(key, data)


class _KernelCache(_CACHING.FunctionCache):  # type: ignore[misc]
    """numba's cache of one function, in a folder that only these sources use.

    The folder is looked up when a kernel is first called, not when it is imported. A failure to read or write
    is not an error: the kernel is compiled again. Another process may remove the folder at any time.
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
        return (*super()._index_key(signature, codegen), field_names(arguments))


def field_names(arguments: Iterable[Any]) -> tuple[Any, ...]:
    """Field names of named tuples, in order.

    numba compares the types of fields, but not their names.
    """
    tuples: list[Any] = [argument for argument in arguments if isinstance(argument, types.BaseTuple)]
    return tuple((getattr(argument, "fields", ()), field_names(argument.types)) for argument in tuples)


# -- start and events --------------------------------------------------------------------------------------


def without_blas() -> None:
    """Import numba's array functions without SciPy's BLAS.

    A kernel that multiplies matrices loads it.
    """
    ensure_blas = _LINALG.ensure_blas
    _LINALG.ensure_blas = lambda: None
    try:
        importlib.import_module("numba.np.arraymath")
    finally:
        _LINALG.ensure_blas = ensure_blas


class _CompilationListener(_EVENT.Listener):  # type: ignore[misc]
    def on_start(self, event: Any) -> None:
        compilation_started()

    def on_end(self, event: Any) -> None:
        compilation_ended()


_EVENT.register("numba:compile", _CompilationListener())
without_blas()
