"""Values of a TOML file that describes a scene: read and checked, each error with the file and the key."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

from touchfield.errors import SourceError
from touchfield.files import plain_size

_MAX_BYTES: Final = 1 << 24


def read_toml(path: Path, expected: str) -> dict[str, Any]:
    """The table of a TOML file of up to 16 MiB; `SourceError` if it cannot be read, is longer, or is no TOML."""
    try:
        size = plain_size(path, expected)
        if size > _MAX_BYTES:
            raise SourceError(str(path), f"{size} bytes", f"{expected} of up to {_MAX_BYTES} bytes")
        return tomllib.loads(path.read_text("utf-8"))
    except OSError as error:
        raise SourceError(str(path), f"that it cannot be read: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise SourceError(str(path), f"no TOML ({error})", expected) from error


def known(where: str, table: dict[str, Any], names: Iterable[str]) -> None:
    """`SourceError` for a key that is not one of `names`."""
    names = tuple(names)
    for key in table:
        if key not in names:
            raise SourceError(f"{where}: {key}", "a key that is not known", f"one of {', '.join(names)}")


def number(where: str, value: Any) -> float:
    """A number of TOML as float; `SourceError` for anything else, true and false among it."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise SourceError(where, repr(value)[:60], "a number")
    try:
        return float(value)
    except OverflowError as error:
        raise SourceError(where, "a number beyond all bounds", "a number") from error


def number_or_list(where: str, value: Any) -> float | tuple[float, ...]:
    """A number, or a list of numbers."""
    if isinstance(value, list):
        return tuple(number(where, item) for item in value)
    return number(where, value)


def text(where: str, value: Any) -> str:
    """A text; `SourceError` for anything else."""
    if not isinstance(value, str):
        raise SourceError(where, repr(value)[:60], "a text")
    return value


def tables(where: str, value: Any, name: str) -> list[dict[str, Any]]:
    """At least one table of ``[[name]]``; `SourceError` for anything else."""
    if not isinstance(value, list) or not value or not all(isinstance(entry, dict) for entry in value):
        raise SourceError(f"{where}: {name}", "no list of tables", f"at least one [[{name}]] table")
    return value
