"""Everything touchfield raises, as one tree::

    TouchfieldError            exit code 1
    ├── InvalidArgument        exit code 2: what was asked for is not possible (also a ValueError)
    │   └── MissingExtra       an optional library is not installed
    ├── SourceError            a scene, picture, mesh or stored field cannot be used as it is
    ├── DeviceError            a device profile is unknown or unusable
    └── FormatError            a ``.touch`` file cannot be read
        ├── ForeignFile        it is something else
        ├── TruncatedFile      it ends too early
        ├── CorruptFile        its bytes contradict themselves
        └── UnsupportedVersion another version of the format, or one of its parts, is needed

A message is one line: where, what was found, what was expected, how to mend it.
"""

from __future__ import annotations

import copyreg
import math
import warnings
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import fields
from importlib import import_module
from numbers import Integral, Real
from pathlib import Path
from typing import Any, Final


class TouchfieldError(Exception):
    """The root of all errors that touchfield raises on purpose.

    `where`: the file, field or option at fault, or alone a sentence; `found` and `expected`: what was there
    and what should have been; `mend`: one sentence that tells how to mend it.
    """

    exit_code = 1

    def __init__(self, where: str, found: str = "", expected: str = "", mend: str = "") -> None:
        self.where, self.found, self.expected, self.mend = where, found, expected, mend
        text = f"{where}: found {found}" if found else where
        if expected:
            text += f"; expected {expected}"
        if mend:
            text += f". {mend}"
        # what a server or a name says could otherwise rewrite the screen of a terminal
        super().__init__("".join(c if c.isprintable() else ascii(c)[1:-1] for c in " ".join(text.split())))

    def __reduce__(self) -> tuple[Any, ...]:
        """As it travels from a process to another: its text, whatever made it."""
        return copyreg.__newobj__, (type(self), str(self)), self.__dict__  # type: ignore[attr-defined]


class InvalidArgument(TouchfieldError, ValueError):
    """A request that cannot be met."""

    exit_code = 2


class MissingExtra(InvalidArgument):
    """An optional library is needed and not installed."""

    def __init__(self, purpose: str, library: str, extra: str) -> None:
        super().__init__(
            purpose,
            f"that the library {library} is not installed",
            mend=f'Install it with: pip install "touchfield[{extra}]"',
        )


class SourceError(TouchfieldError):
    """A scene, picture, mesh or stored field cannot be used as it is."""


class DeviceError(TouchfieldError):
    """A device profile is unknown or unusable."""


class FormatError(TouchfieldError):
    """A ``.touch`` file cannot be read."""


class ForeignFile(FormatError):
    """The file is not a ``.touch`` file."""


class TruncatedFile(FormatError):
    """The file ends too early."""


class CorruptFile(FormatError):
    """The bytes of the file contradict themselves."""


class UnsupportedVersion(FormatError):
    """The file is of another version of the format, or needs a part that this one has not."""


class UnboundedError(UserWarning):
    """Warning of a file or an array whose error no bound is proved of."""


def warn_unbounded(note: str | None) -> None:
    """Warn with `UnboundedError` if there is a note on a bound that is not proved."""
    if note:
        warnings.warn(note, UnboundedError, stacklevel=3)


def import_extra(module: str, purpose: str, library: str, extra: str) -> Any:
    """A module of an optional library; `MissingExtra` if that is not installed."""
    try:
        return import_module(module)
    except ImportError as error:
        raise MissingExtra(purpose, library, extra) from error


def reason(error: BaseException) -> str:
    """An error's reason in a few words, on one line: why the system refused, in its own words."""
    if isinstance(error, TimeoutError):
        return "no answer in time"
    text = getattr(error, "strerror", None) or str(error) or type(error).__name__
    return " ".join(str(text).split())[:120]


def is_finite(value: Any) -> bool:
    """True for a finite number; False for one that is not, and for what is no number."""
    try:
        return math.isfinite(value)
    except (TypeError, ValueError, OverflowError):
        return False


def _require(expected: str, values: dict[str, float], fits: Callable[[float], bool]) -> None:
    for name, value in values.items():
        if not (is_finite(value) and fits(value)):
            raise InvalidArgument(name, repr(value), expected)


def require_positive(**values: float) -> None:
    """`InvalidArgument` for a value, by its name, that is not a finite number above 0."""
    _require("a positive number", values, lambda value: value > 0)


def require_not_negative(**values: float) -> None:
    """`InvalidArgument` for a value, by its name, that is not a finite number of at least 0."""
    _require("a finite number, 0 or more", values, lambda value: value >= 0)


def require_between(low: float, high: float, **values: float) -> None:
    """`InvalidArgument` for a value, by its name, that is not a number from `low` to `high`."""
    _require(f"{low:.9g} to {high:.9g}", values, lambda value: low <= value <= high)


def require_up_to(high: float, **values: float) -> None:
    """`InvalidArgument` for a value, by its name, that is not a number above 0, at most `high`."""
    _require(f"above 0, up to {high:.9g}", values, lambda value: 0 < value <= high)


def require_ending(path: str | Path, *names: str, mend: str = "") -> None:
    """`InvalidArgument` for a file whose name does not end as one of these, ``OUT.touch`` or ``.touch``,
    does.
    """
    ending = Path(path).suffix
    if ending.lower() not in ("." + name.rpartition(".")[2] for name in names):
        raise InvalidArgument(str(path), f"the ending {ending!r}", " or ".join(names), mend)


def require_one_of(where: str, value: object, choices: Collection[str]) -> None:
    """`InvalidArgument` naming `where` for a value that is not among the choices."""
    if value not in choices:
        expected = " or ".join(choices) if len(choices) == 2 else f"one of {', '.join(choices)}"
        raise InvalidArgument(where, repr(value), expected)


KINDS: Final[dict[str, tuple[Any, Any, str]]] = {
    "bool": (bool, bool, "True or False"), "int": (int, Integral, "a whole number"),
    "float": (float, Real, "a number"), "str": (str, (str, Path), "text"), "Path": (Path, (str, Path), "a path"),
}  # fmt: skip
"""By the annotation of a field what the command line makes for it, what it may be, and the words for that."""


def require_kinds(spec: Any, **choices: Collection[str]) -> None:
    """`InvalidArgument` for a field of a dataclass that is not what its annotation, of `KINDS`, or its
    default is.

    Of fields that are one of some words these are the `choices`.
    """
    for one in fields(spec):
        value, own, (name, none, _) = (
            getattr(spec, one.name),
            one.default_factory,
            str(one.type).partition(" | None"),
        )
        if isinstance(own, type):
            kind, expected = own, f"{own.__name__}(...)"
        elif name in KINDS:
            _, kind, expected = KINDS[name]
        else:
            continue
        fits = isinstance(value, kind) and (name == "bool" or not isinstance(value, bool))
        if not (fits or (none and value is None)):
            raise InvalidArgument(one.name, repr(value), expected)
        if one.name in choices:
            require_one_of(one.name, value, choices[one.name])


@contextmanager
def blamed_on(where: str) -> Iterator[None]:
    """Within it an `InvalidArgument` is a `SourceError` of the file, or place in a file, that gave the
    argument.
    """
    try:
        yield
    except InvalidArgument as error:
        raise SourceError(f"{where}{error.where}", error.found, error.expected, error.mend) from error
