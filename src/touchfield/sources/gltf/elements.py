"""A JSON object with its place in its document: what is read from it is checked, or one error says where."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final, overload

from touchfield.errors import SourceError

__all__ = ["Element"]

_LARGEST: Final = 1 << 53
"""Beyond this a JSON number need not be a whole one any more."""


@dataclass(frozen=True)
class Element:
    """A JSON object and where it stands.

    Parameters
    ----------
    where : str; The file, and the place in it: "Fox.glb, accessors[3]".
    """

    where: str
    members: dict[str, Any]

    def __contains__(self, key: str) -> bool:
        return key in self.members

    def fault(self, found: str, expected: str, mend: str = "") -> SourceError:
        """The error to raise about this object."""
        return SourceError(self.where, found, expected, mend)

    @overload
    def integer(self, key: str, default: int, *, least: int = 0) -> int: ...
    @overload
    def integer(self, key: str, default: None = None, *, least: int = 0) -> int | None: ...
    def integer(self, key: str, default: int | None = None, *, least: int = 0) -> int | None:
        """A whole number of at least `least`; `default` where there is none."""
        if key not in self.members:
            return default
        number = _whole(self.members[key])
        if number is None or number < least:
            raise self.fault(f"{key} {_shown(self.members[key])}", f"a whole number of at least {least}")
        return number

    def count(self, key: str, *, least: int = 0) -> int:
        """A whole number that must be there."""
        number = self.integer(key, least=least)
        if number is None:
            raise self.fault(f"no {key}", f"a whole number of at least {least}")
        return number

    def index(self, key: str, of: int) -> int | None:
        """The number of one of `of` things; None where there is none."""
        return None if key not in self.members else self._within(key, self.members[key], of)

    def indices(self, key: str, of: int) -> list[int]:
        """Numbers of things of which there are `of`; none where there is no list."""
        return [self._within(f"{key}[{i}]", value, of) for i, value in enumerate(self._list(key))]

    def _within(self, place: str, value: Any, of: int) -> int:
        number = _whole(value)
        if number is None or not 0 <= number < of:
            raise self.fault(
                f"{place} {_shown(value)}", f"0 to {of - 1}" if of else "none, as there are no such things"
            )
        return number

    def numbers(self, key: str, count: int) -> list[float] | None:
        """`count` finite numbers; None where there is no list."""
        if key not in self.members:
            return None
        values = self._list(key)
        if len(values) != count or not all(_is_finite(value) for value in values):
            raise self.fault(f"{key} {_shown(values)}", f"{count} finite numbers")
        return [float(value) for value in values]

    def text(self, key: str) -> str | None:
        """A string; None where there is none."""
        value = self.members.get(key)
        if value is not None and not isinstance(value, str):
            raise self.fault(f"{key} {_shown(value)}", "a string")
        return value

    def child(self, key: str) -> Element | None:
        """An object within this one; None where there is none."""
        return None if key not in self.members else self._object(key, self.members[key])

    def children(self, key: str) -> list[Element]:
        """A list of objects within this one; none where there is no list."""
        return [self._object(f"{key}[{i}]", value) for i, value in enumerate(self._list(key))]

    def texts(self, key: str) -> list[str]:
        """A list of strings; none where there is no list."""
        values = self._list(key)
        if not all(isinstance(value, str) for value in values):
            raise self.fault(f"{key} {_shown(values)}", "a list of strings")
        return values

    def _list(self, key: str) -> list[Any]:
        values = self.members.get(key, [])
        if not isinstance(values, list):
            raise self.fault(f"{key} {_shown(values)}", "a list")
        return values

    def _object(self, place: str, value: Any) -> Element:
        if not isinstance(value, dict):
            raise self.fault(f"{place} {_shown(value)}", "a JSON object")
        return Element(f"{self.where}, {place}", value)


def _whole(value: Any) -> int | None:
    """The whole number that a JSON number is; JSON does not tell 1 from 1.0."""
    if not _is_finite(value) or value != int(value) or abs(value) > _LARGEST:
        return None
    return int(value)


def _is_finite(value: Any) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return math.isfinite(value) if isinstance(value, float) else abs(value) < 1 << 1000


def _shown(value: Any) -> str:
    if isinstance(value, list | dict):
        return f"of {len(value)} entries"
    text = ascii(value) if not isinstance(value, int) or abs(value) <= _LARGEST else "an enormous number"
    return text if len(text) <= 40 else text[:40] + "..."
