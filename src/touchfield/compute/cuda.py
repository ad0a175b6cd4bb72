"""Runs the package's compiled loops on an NVIDIA GPU (extra ``cuda``): numba-cuda compiles the same functions
that numba compiles for the CPU.

A kernel is a loop ``kernel(start, stop, *arguments)`` over independent items (`compute.threads.for_chunks`).
On the GPU each item gets its own thread, which runs the same loop from i to i + 1, so that CPU and GPU share
one source. Such a kernel allocates no array and takes its functions from `math`. No other module imports
numba-cuda.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from types import FunctionType, ModuleType
from typing import Any, Final

import numpy as np

from touchfield.errors import InvalidArgument, import_extra, reason

COMPUTE: Final = ("cpu", "cuda", "auto")
"""Where kernels of sources run: on the CPU (the default), on a GPU, or on a GPU if there is one."""

_VARIABLE: Final = "TOUCHFIELD_COMPUTE"
_THREADS: Final = 128
"""Number of threads in a block."""


@contextmanager
def computing(where: str) -> Iterator[None]:
    """Select where the kernels of sources run within the block.

    `where` is one of `COMPUTE`; it also applies to processes started within the block. Raises
    `InvalidArgument` for another value, or if "cuda" finds no GPU; `MissingExtra` without the library.
    """
    if where not in COMPUTE:
        raise InvalidArgument("device compute", repr(where), f"one of {', '.join(COMPUTE)}")
    if where == "cuda" and not _cuda().is_available():
        raise InvalidArgument(
            "device compute", "cuda, and no GPU", "a GPU with its driver", "Take cpu, or auto."
        )
    before = os.environ.get(_VARIABLE)
    os.environ[_VARIABLE] = where
    try:
        yield
    finally:
        if before is None:
            del os.environ[_VARIABLE]
        else:
            os.environ[_VARIABLE] = before


def needs_gpu() -> bool:
    """True if kernels of sources must run on a GPU."""
    return os.environ.get(_VARIABLE) == "cuda"


def uses_gpu() -> bool:
    """True if kernels of sources run on a GPU.

    `computing` or ``TOUCHFIELD_COMPUTE`` selects it.
    """
    return needs_gpu() or (os.environ.get(_VARIABLE) == "auto" and _is_available())


@cache
def _cuda() -> Any:
    return import_extra("numba.cuda", "kernels on a GPU", "numba-cuda", "cuda")


@cache
def _is_available() -> bool:
    try:
        return bool(_cuda().is_available())
    except Exception:  # a broken driver counts as no GPU
        return False


def for_each(kernel: Callable[..., Any], count: int, *arguments: Any) -> None:
    """Call ``kernel(i, i + 1, *arguments)`` for each i of 0..count in a GPU thread.

    kernel : function compiled by numba for the CPU, which creates no array.
    arguments : numbers; arrays, or named tuples of them, in device memory: from `on_device`, `empty`, or
        another library (``__dlpack__``, ``__cuda_array_interface__``), used without a copy.

    Raises `InvalidArgument` if numba-cuda does not work with this NumPy.
    """
    if count <= 0:
        return
    blocks = -(-count // _THREADS)
    try:
        _launched(kernel)[blocks, _THREADS](np.int64(count), arguments)
    except AttributeError as error:  # numba-cuda 0.30 compiles with names that NumPy 2.5 has no more
        if "numpy" not in str(error):
            raise
        found = f"NumPy {np.__version__}, with which numba-cuda does not work ({reason(error)})"
        hint = 'pip install "numpy<2.5"'
        raise InvalidArgument("device compute", found, "a NumPy that it knows", hint) from error


def on_device(array: Any) -> Any:
    """Copy an array, or the arrays of a (named) tuple, to the device.

    Other values are returned unchanged.
    """
    if isinstance(array, tuple):
        copies = [on_device(item) for item in array]
        return type(array)(*copies) if hasattr(array, "_fields") else tuple(copies)
    return _cuda().to_device(np.ascontiguousarray(array)) if isinstance(array, np.ndarray) else array


def empty(shape: int | tuple[int, ...], dtype: Any) -> Any:
    """Return an uninitialised array on the device."""
    return _cuda().device_array(shape, dtype)


def filled(kernel: Callable[..., Any], count: int, arguments: tuple[Any, ...], shape: Any, dtype: Any) -> Any:
    """Return a device array that a kernel fills as its last argument.

    The other arguments are copied to the device.
    """
    out = empty(shape, dtype)
    for_each(kernel, count, *on_device(arguments), out)
    return out


def on_host(array: Any) -> np.ndarray[Any, Any]:
    """Copy an array from the device."""
    host: np.ndarray[Any, Any] = array.copy_to_host()
    return host


# -- one source --------------------------------------------------------------------------------------------
def _each(count, arguments):  # type: ignore[no-untyped-def]
    """GPU kernel that runs `body` for the item of this thread."""
    i = cuda.grid(1)  # type: ignore[name-defined]  # noqa: F821
    if i < count:
        body(i, i + 1, *arguments)  # type: ignore[name-defined]  # noqa: F821


@cache
def _launched(kernel: Any) -> Any:
    """Return the GPU kernel that runs one item of `kernel` in each thread."""
    return _cuda().jit(
        FunctionType(_each.__code__, {"cuda": _cuda(), "body": _for_device(kernel)}, kernel.__name__)
    )


@cache
def _for_device(kernel: Any) -> Any:
    """Compile a kernel for the GPU.

    The code is the same; compiled functions among its globals are replaced by GPU versions.
    """
    function = kernel.py_func
    device_globals = {**function.__globals__, **_named(function.__globals__, function.__code__.co_names)}
    copy = FunctionType(
        function.__code__, device_globals, function.__name__, function.__defaults__, function.__closure__
    )
    return _cuda().jit(copy, device=True)


def _named(namespace: dict[str, Any], names: tuple[str, ...]) -> dict[str, Any]:
    """Return GPU versions of the compiled functions with these names.

    Functions in modules of kernels are included.
    """
    out: dict[str, Any] = {}
    for name in names:
        value = namespace.get(name)
        if hasattr(value, "py_func"):
            out[name] = _for_device(value)
        elif isinstance(value, ModuleType) and value.__name__.startswith("touchfield."):
            out[name] = ModuleType(value.__name__)
            vars(out[name]).update({n: v for n, v in vars(value).items() if n in names})
            vars(out[name]).update(_named(vars(value), names))
    return out
