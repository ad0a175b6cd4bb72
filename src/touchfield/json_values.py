"""JSON and TOML from strangers: each value is taken with its type and range, an error names its place in the
file.

A place is written as in ``$.perceptions[0].channels[3].gain``.
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

_SHOWN: Final = 60
_MISSING: Final = object()


@dataclass(frozen=True)
class JsonValue:
    """A value of a document, as `json` or `tomllib` reads it, and where it stands.

    Every method raises SourceError, naming file and place, if the value is of another type or out of range.
    """

    value: Any
    file: str
    place: str = "$"
    owner: Any = field(default=None, repr=False, compare=False)  # of a whole document, for who reads on in it

    def wrong(self, found: str, expected: str, mend: str = "") -> SourceError:
        """The error that this value is not what it should be."""
        return SourceError(f"{self.file}: {self.place}", found, expected, mend)

    def refused(self, expected: str) -> SourceError:
        """The error that shows the value itself."""
        kinds = {dict: "an object", list: "an array", type(None): "null"}
        is_endless = isinstance(self.value, int) and abs(self.value) >= 10**300  # Python may not write it out
        shown = "a number of over 300 digits" if is_endless else kinds.get(type(self.value))
        shown = shown or json.dumps(self.value, default=str)
        return self.wrong(shown if len(shown) <= _SHOWN else shown[:_SHOWN] + "...", expected)

    def members(self) -> dict[str, Any]:
        """The members of an object."""
        if not isinstance(self.value, dict):
            raise self.refused("an object")
        return self.value

    def only(self, names: Iterable[str]) -> None:
        """SourceError for a member that is none of these."""
        names = tuple(names)
        for key in self.members():
            if key not in names:
                raise self.at(key).wrong("a key that is not known", f"one of {', '.join(names)}")

    def _inner(self, value: Any, place: str) -> Self:
        return type(self)(value, self.file, self.place + place, self.owner)

    def get(self, key: str) -> Self | None:
        """A member of an object; None if it is not there."""
        members = self.members()
        return self._inner(members[key], f".{key}") if key in members else None

    def at(self, key: str, default: Any = _MISSING) -> Self:
        """A member, or its default; one without default must be there."""
        value = self.members().get(key, default)
        if value is _MISSING:
            raise self.wrong(f"no {key!r}", "an object that has it")
        return self._inner(value, f".{key}")

    def items(self, least: int = 0) -> list[Any]:
        """The bare items of an array."""
        if not isinstance(self.value, list):
            raise self.refused("an array")
        if len(self.value) < least:
            raise self.wrong(f"an array of {len(self.value)}", f"at least {least}")
        return self.value

    def each(self, least: int = 0) -> Iterator[Self]:
        """The items of an array."""
        return (self._inner(item, f"[{i}]") for i, item in enumerate(self.items(least)))

    def text(self, choices: tuple[str, ...] | None = None) -> str:
        """A string, one of `choices` where they are given."""
        if not isinstance(self.value, str) or (choices is not None and self.value not in choices):
            raise self.refused("a string" if choices is None else "one of " + ", ".join(choices))
        return self.value

    def whole(self, low: int, high: int) -> int:
        """An integer from `low` to `high`; JSON does not tell 1 from 1.0."""
        value, is_number = (
            self.value,
            isinstance(self.value, int | float) and not isinstance(self.value, bool),
        )
        if not (is_number and low <= value <= high and value == int(value)):
            raise self.refused(f"an integer from {low} to {high}")
        return int(value)

    def number(self, low: float = -math.inf, high: float = math.inf) -> float:
        """A finite number from `low` to `high`."""
        if isinstance(self.value, bool) or not isinstance(self.value, int | float):
            raise self.refused("a number")
        if not (low <= self.value <= high and abs(self.value) < 1e300):
            bounds = f"from {low:g} to {high:g}" if math.isfinite(high) else f"of at least {low:g}"
            raise self.refused(f"a number {bounds}" if math.isfinite(low) else "a finite number")
        return float(self.value)


def read_json(path: str | Path, most_bytes: int, what: str) -> JsonValue:
    """The JSON document in a file; SourceError as `read_bytes`, or if it holds no JSON."""
    return JsonValue(parsed(read_bytes(path, most_bytes, what), str(path), what), str(path))


def parsed(data: bytes, where: str, what: str) -> Any:
    """The value of JSON; SourceError if it is none."""
    try:
        return json.loads(data.decode("utf-8-sig"), parse_constant=_no_constant)
    except RecursionError:
        raise SourceError(where, "JSON nested too deeply", what) from None
    except ValueError as error:  # also UnicodeDecodeError, and integers of thousands of digits
        raise SourceError(where, f"no JSON ({error})", what) from None


def _no_constant(name: str) -> float:
    raise ValueError(f"the constant {name}")
