"""Kernels on a GPU (extra ``cuda``): the processor's own functions, compiled once more for it by numba-cuda.

A kernel is a loop ``kernel(begin, end, *arguments)`` over items that do not touch each other
(`parallel.for_chunks`). Here each item gets a thread of its own, which runs the same loop from i to i + 1, so
that there is one source for both. Such a kernel makes no array and takes its functions from `math`. No other
module knows the library.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from types import FunctionType, ModuleType
from typing import Any, Final

import numpy as np

from touchfield.errors import InvalidArgument, import_extra

COMPUTE: Final = ("cpu", "cuda", "auto")
"""Where kernels of sources run: the processor (the default), a GPU, or a GPU where there is one."""

_VARIABLE: Final = "TOUCHFIELD_COMPUTE"
_THREADS: Final = 128
"""Of a block."""


@contextmanager
def computing(where: str) -> Iterator[None]:
    """Within it, kernels of sources run there: one of `COMPUTE`; also in processes begun meanwhile.

    Raises `InvalidArgument` for another word, and if "cuda" finds no GPU; `MissingExtra` without the library.
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
    """True if kernels of sources run on a GPU (`computing`, or ``TOUCHFIELD_COMPUTE``)."""
    return needs_gpu() or (os.environ.get(_VARIABLE) == "auto" and _is_there())


@cache
def _cuda() -> Any:
    return import_extra("numba.cuda", "kernels on a GPU", "numba-cuda", "cuda")


@cache
def _is_there() -> bool:
    try:
        return bool(_cuda().is_available())
    except Exception:  # a driver that is broken is no GPU
        return False


def for_each(kernel: Callable[..., Any], count: int, *arguments: Any) -> None:
    """Call ``kernel(i, i + 1, *arguments)`` for each i of 0..count, each by a thread of the GPU.

    kernel : function compiled by numba for the processor, that makes no array.
    arguments : numbers; arrays, or named tuples of them, that lie on the device: `on_device`, `empty`, or
        whatever another library has there (``__dlpack__``, ``__cuda_array_interface__``), which is taken as
        it lies.
    """
    if count > 0:
        blocks = -(-count // _THREADS)
        _launched(kernel)[blocks, _THREADS](np.int64(count), arguments)


def on_device(array: Any) -> Any:
    """A copy on the device of an array, or of those of a (named) tuple; what is neither stays as it is."""
    if isinstance(array, tuple):
        copies = [on_device(one) for one in array]
        return type(array)(*copies) if hasattr(array, "_fields") else tuple(copies)
    return _cuda().to_device(np.ascontiguousarray(array)) if isinstance(array, np.ndarray) else array


def empty(shape: int | tuple[int, ...], dtype: Any) -> Any:
    """An array on the device, of whatever lies there."""
    return _cuda().device_array(shape, dtype)


def filled(kernel: Callable[..., Any], count: int, arguments: tuple[Any, ...], shape: Any, dtype: Any) -> Any:
    """An array on the device, all of which a kernel writes: its last argument. Those before it are copied
    there.
    """
    out = empty(shape, dtype)
    for_each(kernel, count, *on_device(arguments), out)
    return out


def on_host(array: Any) -> np.ndarray[Any, Any]:
    """A copy for the processor of an array on the device."""
    host: np.ndarray[Any, Any] = array.copy_to_host()
    return host


# -- one source
# ----------------------------------------------------------------------------------------------------
def _each(count, arguments):  # type: ignore[no-untyped-def]
    """The kernel of the GPU: `body` for the item whose turn this thread is."""
    i = cuda.grid(1)  # type: ignore[name-defined]  # noqa: F821
    if i < count:
        body(i, i + 1, *arguments)  # type: ignore[name-defined]  # noqa: F821


@cache
def _launched(kernel: Any) -> Any:
    """A kernel of the GPU that runs one item of `kernel` a thread."""
    return _cuda().jit(
        FunctionType(_each.__code__, {"cuda": _cuda(), "body": _for_device(kernel)}, kernel.__name__)
    )


@cache
def _for_device(kernel: Any) -> Any:
    """The function of a kernel for the GPU: the same code, its globals those functions' own for the GPU."""
    function = kernel.py_func
    own = {**function.__globals__, **_named(function.__globals__, function.__code__.co_names)}
    copy = FunctionType(
        function.__code__, own, function.__name__, function.__defaults__, function.__closure__
    )
    return _cuda().jit(copy, device=True)


def _named(place: dict[str, Any], names: tuple[str, ...]) -> dict[str, Any]:
    """The compiled functions among these names for the GPU, and the modules of kernels with theirs."""
    out: dict[str, Any] = {}
    for name in names:
        value = place.get(name)
        if hasattr(value, "py_func"):
            out[name] = _for_device(value)
        elif isinstance(value, ModuleType) and value.__name__.startswith("touchfield."):
            out[name] = ModuleType(value.__name__)
            vars(out[name]).update({n: v for n, v in vars(value).items() if n in names})
            vars(out[name]).update(_named(vars(value), names))
    return out
