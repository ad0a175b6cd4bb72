"""All errors that touchfield raises, as one tree::

    TouchfieldError            exit code 1
    ├── InvalidArgument        exit code 2: the request cannot be met (also a ValueError)
    │   └── MissingExtra       an optional library is not installed
    ├── SourceError            a scene, picture, mesh or stored field cannot be used as it is
    ├── DeviceError            a device or its profile is unknown or unusable
    │   └── DeviceAbsent       no such device is connected
    └── FormatError            a ``.touch`` file cannot be read
        ├── ForeignFile        it is not a .touch file
        ├── TruncatedFile      it ends too early
        ├── CorruptFile        its contents are inconsistent
        └── UnsupportedVersion it needs another version of the format, or an unknown extension

A message is one line: where, what was found, what was expected, and a hint how to fix it. If nothing in a
source can be felt, the notes on how it was read go with the error (`with_notes`).
"""

from __future__ import annotations

import copyreg
import math
import unicodedata
import warnings
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import fields
from importlib import import_module
from numbers import Integral, Real
from pathlib import Path
from typing import Any, Final, TypeVar


class TouchfieldError(Exception):
    """Base class of all errors that touchfield raises on purpose.

    `where` is the file, field or option at fault, or a whole sentence if nothing else is given. `found` and
    `expected` describe the actual and the required value. `hint` is one sentence on how to fix it.
    """

    exit_code = 1

    def __init__(self, where: str, found: str = "", expected: str = "", hint: str = "") -> None:
        self.where, self.found, self.expected, self.hint = where, found, expected, hint
        text = f"{where}: found {found}" if found else where
        if expected:
            text += f"; expected {expected}"
        if hint:
            text += f". {hint}"
        super().__init__(_line(text))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the error by its text and attributes, whatever the signature of its class."""
        return copyreg.__newobj__, (type(self), str(self)), self.__dict__  # type: ignore[attr-defined]


_JOINERS: Final = "\u200c\u200d"  # of letters in Persian and Hindi, and of emoji


def printable(text: str) -> str:
    """Return a text with escapes for the characters that change what a terminal shows around them.

    These are control characters, marks of direction and line separators: a name in a file could otherwise
    rewrite the screen, or show another name than it is. Line feed and tab remain.

    >>> printable("a\\u202eb")
    'a\\\\u202eb'
    """
    if text.isprintable():
        return text
    return "".join(
        c if c.isprintable() or c in f"\n\t{_JOINERS}" or unicodedata.category(c) == "Zs" else ascii(c)[1:-1]
        for c in text
    )


def _line(text: str) -> str:
    """Return a printable text on one line."""
    return printable(" ".join(text.split()))


class InvalidArgument(TouchfieldError, ValueError):
    """A request that cannot be met."""

    exit_code = 2


class MissingExtra(InvalidArgument):
    """An optional library is needed and not installed."""

    def __init__(self, purpose: str, library: str, extra: str) -> None:
        super().__init__(
            purpose,
            f"that the library {library} is not installed",
            hint=f'Install it with: pip install "touchfield[{extra}]"',
        )


class SourceError(TouchfieldError):
    """A scene, picture, mesh or stored field cannot be used as it is."""


class DeviceError(TouchfieldError):
    """A device or its profile is unknown or unusable."""


class DeviceAbsent(DeviceError):
    """No such device is connected; it may be later."""


class FormatError(TouchfieldError):
    """A ``.touch`` file cannot be read."""


class ForeignFile(FormatError):
    """The file is not a ``.touch`` file."""


class TruncatedFile(FormatError):
    """The file ends too early."""


class CorruptFile(FormatError):
    """The contents of the file are inconsistent."""


class UnsupportedVersion(FormatError):
    """The file has another version of the format, or needs an extension that is not available."""


_Error = TypeVar("_Error", bound=TouchfieldError)


def with_notes(error: _Error, notes: Iterable[str]) -> _Error:
    """Add the notes on a source to an error (`BaseException.add_note`), each once; returns the error."""
    for note in dict.fromkeys(notes):
        error.add_note(_line(note))
    return error


@contextmanager
def naming_file(name: str) -> Iterator[None]:
    """Within the block, add the name of a file to a `FormatError` that names only a part of the file.

    A decoder gets the bytes of a part, such as ``SEGM.body``, and does not know from which file they are.
    """
    try:
        yield
    except FormatError as error:
        if error.where.startswith(name):
            raise
        named = type(error)(f"{name}: {error.where}", error.found, error.expected, error.hint)
        raise with_notes(named, getattr(error, "__notes__", ())) from error


class UnboundedError(UserWarning):
    """Warning that no error bound is guaranteed for a file or an array."""


def warn_unbounded(note: str | None) -> None:
    """Issue `UnboundedError` if there is a note on a bound that is not guaranteed."""
    if note:
        warnings.warn(note, UnboundedError, stacklevel=3)


def import_extra(module: str, purpose: str, library: str, extra: str) -> Any:
    """Import a module of an optional library; raises `MissingExtra` if it is not installed."""
    try:
        return import_module(module)
    except ImportError as error:
        raise MissingExtra(purpose, library, extra) from error


def reason(error: BaseException) -> str:
    """Return the reason of an error on one line of at most 120 characters, as the system reports it."""
    if isinstance(error, TimeoutError):
        return "no answer in time"
    text = getattr(error, "strerror", None) or str(error) or type(error).__name__
    return " ".join(str(text).split())[:120]


def is_finite(value: Any) -> bool:
    """Return True for a finite number; False for infinity, NaN and anything that is not a number."""
    try:
        return math.isfinite(value)
    except (TypeError, ValueError, OverflowError):
        return False


def _require(expected: str, values: dict[str, float], fits: Callable[[float], bool]) -> None:
    for name, value in values.items():
        if not (is_finite(value) and fits(value)):
            raise InvalidArgument(name, repr(value), expected)


def require_positive(**values: float) -> None:
    """Raise `InvalidArgument` for a keyword whose value is not a finite number above 0."""
    _require("a positive number", values, lambda value: value > 0)


def require_not_negative(**values: float) -> None:
    """Raise `InvalidArgument` for a keyword whose value is not a finite number of at least 0."""
    _require("a finite number, 0 or more", values, lambda value: value >= 0)


def require_between(low: float, high: float, **values: float) -> None:
    """Raise `InvalidArgument` for a keyword whose value is not a number from `low` to `high`."""
    _require(f"{low:.9g} to {high:.9g}", values, lambda value: low <= value <= high)


def require_up_to(high: float, **values: float) -> None:
    """Raise `InvalidArgument` for a keyword whose value is not above 0 and at most `high`."""
    _require(f"above 0, up to {high:.9g}", values, lambda value: 0 < value <= high)


def require_ending(path: str | Path, *names: str, hint: str = "") -> None:
    """Raise `InvalidArgument` unless `path` has the suffix of one of `names`, such as ``OUT.touch``."""
    ending = Path(path).suffix
    if ending.lower() not in ("." + name.rpartition(".")[2] for name in names):
        raise InvalidArgument(str(path), f"the ending {ending!r}", " or ".join(names), hint)


def require_one_of(where: str, value: object, choices: Collection[str]) -> None:
    """Raise `InvalidArgument` that names `where` if a value is not among the choices."""
    if value not in choices:
        expected = " or ".join(choices) if len(choices) == 2 else f"one of {', '.join(choices)}"
        raise InvalidArgument(where, repr(value), expected)


KINDS: Final[dict[str, tuple[Any, Any, str]]] = {
    "bool": (bool, bool, "True or False"), "int": (int, Integral, "a whole number"),
    "float": (float, Real, "a number"), "str": (str, (str, Path), "text"),
    "Path": (Path, (str, Path), "a path"),
}  # fmt: skip
"""For each annotation of a field: type on the command line, accepted types, and their description."""


def require_kinds(spec: Any, **choices: Collection[str]) -> None:
    """Raise `InvalidArgument` for a field of a dataclass whose value has the wrong type.

    The type follows from the annotation (see `KINDS`) or the default factory. `choices` gives, by field
    name, the accepted words of a field.
    """
    for field in fields(spec):
        value, default_factory, (name, optional, _) = (
            getattr(spec, field.name),
            field.default_factory,
            str(field.type).partition(" | None"),
        )
        if isinstance(default_factory, type):
            kind, expected = default_factory, f"{default_factory.__name__}(...)"
        elif name in KINDS:
            _, kind, expected = KINDS[name]
        else:
            continue
        fits = isinstance(value, kind) and (name == "bool" or not isinstance(value, bool))
        if not (fits or (optional and value is None)):
            raise InvalidArgument(field.name, repr(value), expected)
        if field.name in choices:
            require_one_of(field.name, value, choices[field.name])


@contextmanager
def as_source_error(where: str) -> Iterator[None]:
    """Within the block, convert an `InvalidArgument` to a `SourceError` that names the file at `where`."""
    try:
        yield
    except InvalidArgument as error:
        raise SourceError(f"{where}{error.where}", error.found, error.expected, error.hint) from error
