"""Reads untrusted JSON and TOML: checks the type and range of each value, and names the location of what is
wrong.

A location is written as in ``$.perceptions[0].channels[3].gain``.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Self

from touchfield.errors import SourceError
from touchfield.files import read_bytes

_MAX_SHOWN: Final = 60
_MISSING: Final = object()


@dataclass(frozen=True)
class JsonValue:
    """A value of a document, as `json` or `tomllib` reads it, with its location.

    Every method raises SourceError, naming file and location, if the value has another type or is out of
    range.
    """

    value: Any
    file: str
    location: str = "$"
    owner: Any = field(default=None, repr=False, compare=False)  # of a whole document, for who reads on in it

    def wrong(self, found: str, expected: str, hint: str = "") -> SourceError:
        """Return the error for this value."""
        return SourceError(f"{self.file}: {self.location}", found, expected, hint)

    def refused(self, expected: str) -> SourceError:
        """Return the error that quotes the value itself."""
        kinds = {dict: "an object", list: "an array", type(None): "null"}
        is_huge = isinstance(self.value, int) and abs(self.value) >= 10**300  # Python may not write it out
        text = "a number of over 300 digits" if is_huge else kinds.get(type(self.value))
        text = text or json.dumps(self.value, default=str)
        return self.wrong(text if len(text) <= _MAX_SHOWN else text[:_MAX_SHOWN] + "...", expected)

    def members(self) -> dict[str, Any]:
        """The members of an object."""
        if not isinstance(self.value, dict):
            raise self.refused("an object")
        return self.value

    def only(self, names: Iterable[str]) -> None:
        """Raise SourceError for a member whose key is not among `names`."""
        names = tuple(names)
        for key in self.members():
            if key not in names:
                raise self.at(key).wrong("a key that is not known", f"one of {', '.join(names)}")

    def _inner(self, value: Any, suffix: str) -> Self:
        return type(self)(value, self.file, self.location + suffix, self.owner)

    def get(self, key: str) -> Self | None:
        """Return a member of an object, or None."""
        members = self.members()
        return self._inner(members[key], f".{key}") if key in members else None

    def at(self, key: str, default: Any = _MISSING) -> Self:
        """Return a member or its default; without a default the member is required."""
        value = self.members().get(key, default)
        if value is _MISSING:
            raise self.wrong(f"no {key!r}", "an object that has it")
        return self._inner(value, f".{key}")

    def items(self, min_count: int = 0) -> list[Any]:
        """Return the plain values of an array."""
        if not isinstance(self.value, list):
            raise self.refused("an array")
        if len(self.value) < min_count:
            raise self.wrong(f"an array of {len(self.value)}", f"at least {min_count}")
        return self.value

    def elements(self, min_count: int = 0) -> Iterator[Self]:
        """Iterate over the elements of an array."""
        return (self._inner(item, f"[{i}]") for i, item in enumerate(self.items(min_count)))

    def text(self, choices: tuple[str, ...] | None = None) -> str:
        """Return a string, one of `choices` if given."""
        if not isinstance(self.value, str) or (choices is not None and self.value not in choices):
            raise self.refused("a string" if choices is None else "one of " + ", ".join(choices))
        return self.value

    def bounded_integer(self, low: int, high: int) -> int:
        """Return an integer from `low` to `high`; JSON does not distinguish 1 from 1.0."""
        value = self.value
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if not (is_number and low <= value <= high and value == int(value)):
            raise self.refused(f"an integer from {low} to {high}")
        return int(value)

    def number(self, low: float = -math.inf, high: float = math.inf) -> float:
        """Return a finite number from `low` to `high`."""
        if isinstance(self.value, bool) or not isinstance(self.value, int | float):
            raise self.refused("a number")
        if not (low <= self.value <= high and abs(self.value) < 1e300):
            bounds = f"from {low:g} to {high:g}" if math.isfinite(high) else f"of at least {low:g}"
            raise self.refused(f"a number {bounds}" if math.isfinite(low) else "a finite number")
        return float(self.value)


def read_json(path: str | Path, max_bytes: int, expected: str) -> JsonValue:
    """Read the JSON document in a file; SourceError as `read_bytes`, or if it is not valid JSON."""
    return JsonValue(parsed(read_bytes(path, max_bytes, expected), str(path), expected), str(path))


def parsed(data: bytes, where: str, expected: str) -> Any:
    """Parse JSON; SourceError if it is invalid."""
    try:
        return json.loads(data.decode("utf-8-sig"), parse_constant=_no_constant)
    except RecursionError:
        raise SourceError(where, "JSON nested too deeply", expected) from None
    except ValueError as error:  # also UnicodeDecodeError, and integers of thousands of digits
        mend = "Copy the file again, or export it again."
        raise SourceError(where, f"no JSON ({error})", expected, mend) from None


def _no_constant(name: str) -> float:
    raise ValueError(f"the constant {name}")
