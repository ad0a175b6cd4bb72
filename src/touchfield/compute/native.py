"""Imports the compiled C module `touchfield._native`, and turns the errors that it raises into those of this
package (`FormatError`, `InvalidArgument`)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from touchfield.errors import (
    CorruptFile,
    InvalidArgument,
    TouchfieldError,
    TruncatedFile,
    UnsupportedVersion,
)

try:
    from touchfield import _native as native
except ImportError as error:
    raise TouchfieldError(
        "touchfield._native, the compiled part of touchfield",
        f"that it cannot be imported ({error})",
        "a module that was compiled for this machine",
        "Install a wheel of touchfield; or first a C compiler (or `pip install ziglang`), then touchfield",
    ) from error

__all__ = ["argument_errors", "decoding_errors", "native"]

_TRUNCATED, _CORRUPT, _VERSION, _MEMORY, _ARGUMENT, _END, _TOO_MANY = range(2, 9)  # codes of touch.h
_FORMAT_ERRORS: Final = {
    _TRUNCATED: (TruncatedFile, "more bytes"),
    _CORRUPT: (CorruptFile, "bytes as docs/format describes them"),
    _VERSION: (UnsupportedVersion, "a version that this touchfield reads"),
}


@contextmanager
def decoding_errors(where: str, limit_hint: str = "") -> Iterator[None]:
    """Turn errors of the module into `FormatError`, MemoryError or InvalidArgument that names `where`.

    `limit_hint` says how to raise the limit that a function was given.
    """
    try:
        yield
    except ValueError as error:
        code, text = _code_of(error)
        if code == _TOO_MANY:
            raise InvalidArgument(where, text, hint=limit_hint) from None
        if code not in _FORMAT_ERRORS:
            raise _other_error(code, where, text) from None
        kind, expected = _FORMAT_ERRORS[code]
        raise kind(where, text, expected) from None


@contextmanager
def argument_errors(where: str) -> Iterator[None]:
    """Turn errors of the module into InvalidArgument or MemoryError.

    AssertionError for one that no argument can cause.
    """
    try:
        yield
    except ValueError as error:
        code, text = _code_of(error)
        raise _other_error(code, where, text) from None


def _code_of(error: ValueError) -> tuple[int, str]:
    """Code and text of an error of the module; raises `error` itself if it is another one."""
    match error.args:
        case (int(code), str(text)):
            return code, text
    raise error


def _other_error(code: int, where: str, text: str) -> Exception:
    if code == _MEMORY:
        return MemoryError(f"{where}: {text}")
    if code == _ARGUMENT:
        return InvalidArgument(where, text)
    return AssertionError(f"{where}: {text}")
