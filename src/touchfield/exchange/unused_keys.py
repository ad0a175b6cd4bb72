"""Reports the members of a JSON document that an import does not use."""

from __future__ import annotations

import re
from collections import Counter
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from touchfield.json_values import JsonValue

_MAX_NAMES: Final = 8
_MAX_CHARACTERS: Final = 60


class UnusedKeys:
    """Collects the keys that an import does not use, by their location without array indices."""

    def __init__(self) -> None:
        self._counts: Counter[str] = Counter()

    def check(self, value: JsonValue, *used: str) -> None:
        """Collect the keys of an object that are not among `used`.

        Raises SourceError if the value is not an object.
        """
        for key in value.members():
            if key not in used:
                self.add(value.at(key).location)

    def add(self, location: str) -> None:
        """Collect one location, such as ``$.Pattern[0].Event.Name``."""
        name = re.sub(r"\[\d+\]", "[]", location).removeprefix("$.")
        printable = "".join(c if c.isprintable() else "?" for c in name)
        self._counts[printable[:_MAX_CHARACTERS]] += 1

    def notes(self) -> tuple[str, ...]:
        """Return one note, or none if every key was used."""
        if not self._counts:
            return ()
        names = [
            name if count == 1 else f"{name} ({count} times)"
            for name, count in list(self._counts.items())[:_MAX_NAMES]
        ]
        more = len(self._counts) - len(names)
        return (f"Not used: {', '.join(names)}{f', and {more} more' if more else ''}.",)
