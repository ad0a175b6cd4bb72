"""JSON from strangers: each value is taken with its type and range, and an error names its place in the file.

A place is written as in ``$.perceptions[0].channels[3].gain``.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from touchfield.errors import SourceError
from touchfield.files import require_plain

__all__ = ["JsonValue", "read_json"]

_SHOWN: Final = 60
_MISSING: Final = object()


@dataclass(frozen=True)
class JsonValue:
    """A value of a JSON document, and where it stands.

    Every method raises SourceError, naming file and place, if the value is of another type or out of range.

    Attributes
    ----------
    value : object
        As `json` reads it.
    file : str
    place : str
    """

    value: Any
    file: str
    place: str = "$"

    def wrong(self, found: str, expected: str, mend: str = "") -> SourceError:
        """The error that this value is not what it should be."""
        return SourceError(f"{self.file}: {self.place}", found, expected, mend)

    def refused(self, expected: str) -> SourceError:
        """The error that shows the value itself."""
        found = (
            json.dumps(self.value, default=str) if isinstance(self.value, str | int | float) else _kind(self.value)
        )
        return self.wrong(found if len(found) <= _SHOWN else found[:_SHOWN] + "...", expected)

    def members(self) -> dict[str, Any]:
        """The members of an object."""
        if not isinstance(self.value, dict):
            raise self.refused("an object")
        return self.value

    def get(self, key: str) -> JsonValue | None:
        """A member of an object; None if it is not there."""
        found = self.members().get(key, _MISSING)
        return None if found is _MISSING else JsonValue(found, self.file, f"{self.place}.{key}")

    def at(self, key: str) -> JsonValue:
        """A member that must be there."""
        found = self.get(key)
        if found is None:
            raise self.wrong(f"no {key!r}", "an object that has it")
        return found

    def items(self, least: int = 0) -> list[Any]:
        """The bare items of an array."""
        if not isinstance(self.value, list):
            raise self.refused("an array")
        if len(self.value) < least:
            raise self.wrong(f"an array of {len(self.value)}", f"at least {least}")
        return self.value

    def each(self, least: int = 0) -> Iterator[JsonValue]:
        """The items of an array."""
        return (JsonValue(item, self.file, f"{self.place}[{i}]") for i, item in enumerate(self.items(least)))

    def item(self, index: int) -> JsonValue:
        """One item of an array."""
        return JsonValue(self.items(index + 1)[index], self.file, f"{self.place}[{index}]")

    def text(self, choices: tuple[str, ...] | None = None) -> str:
        """A string, one of `choices` where they are given."""
        if not isinstance(self.value, str) or (choices is not None and self.value not in choices):
            raise self.refused("a string" if choices is None else "one of " + ", ".join(choices))
        return self.value

    def whole(self, low: int, high: int) -> int:
        """An integer from `low` to `high`."""
        if isinstance(self.value, bool) or not isinstance(self.value, int) or not low <= self.value <= high:
            raise self.refused(f"an integer from {low} to {high}")
        return self.value

    def number(self, low: float = -math.inf, high: float = math.inf) -> float:
        """A finite number from `low` to `high`."""
        if isinstance(self.value, bool) or not isinstance(self.value, int | float):
            raise self.refused("a number")
        if not (low <= self.value <= high and abs(self.value) < 1e300):
            bounds = f"from {low:g} to {high:g}" if math.isfinite(high) else f"of at least {low:g}"
            raise self.refused(f"a number {bounds}" if math.isfinite(low) else "a finite number")
        return float(self.value)


def read_json(path: str | Path, most_bytes: int, what: str) -> JsonValue:
    """The JSON document in a file.

    Parameters
    ----------
    path : Path
    most_bytes : int
        A longer file is refused before it is read.
    what : str
        What the file should be, for messages.

    Raises
    ------
    SourceError
        If it cannot be read, is too long, or holds no JSON.
    """
    require_plain(path, what)
    try:
        with Path(path).open("rb") as file:
            data = file.read(most_bytes + 1)
    except (OSError, ValueError) as error:  # ValueError: a path with a NUL in it
        reason = error.strerror if isinstance(error, OSError) else None
        raise SourceError(str(path), reason or str(error), what, "Check path and rights.") from error
    if len(data) > most_bytes:
        raise SourceError(str(path), f"more than {most_bytes} bytes", f"{what} up to that")
    try:
        value = json.loads(data.decode("utf-8-sig"), parse_constant=_no_constant)
    except RecursionError:
        raise SourceError(str(path), "JSON nested too deeply", what) from None
    except ValueError as error:  # also UnicodeDecodeError, and integers of thousands of digits
        raise SourceError(str(path), f"no JSON ({error})", what) from None
    return JsonValue(value, str(path))


def _no_constant(name: str) -> float:
    raise ValueError(f"the constant {name}")


def _kind(value: object) -> str:
    kinds = {dict: "an object", list: "an array", type(None): "null"}
    return kinds.get(type(value), type(value).__name__)
