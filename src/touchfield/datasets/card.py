"""Reads the cards of public haptic data sets.

A card states how its layout was verified: "read" if real files of the set were read, "documentation" if only
the publisher's description or the program of another was. `check` says which files those were.
"""

from __future__ import annotations

import difflib
import tomllib
from dataclasses import dataclass, fields
from functools import cache
from importlib import resources
from typing import Any, Final

from touchfield.errors import InvalidArgument, require_one_of

VERIFIED: Final = ("read", "documentation")


@dataclass(frozen=True)
class DataCard:
    """Description of a public data set.

    Raises `InvalidArgument` if `verified` is none of `VERIFIED`, a list is empty, or a text is.
    """

    name: str  # what ``touchfield data show`` takes
    title: str
    what: str  # one line: signals, count, rate
    purpose: str  # what the set was published for
    size: str
    licence: str
    may_redistribute: bool  # whether the licence lets others pass the files on; False also if none is stated
    origin: str  # address of the publisher
    get: str  # how a user gets the files
    cite: str
    layout: str  # files and columns, with units
    verified: str  # "read" or "documentation"
    check: str  # which files were read, or which documentation
    commands: tuple[str, ...]  # what to type, with the files there
    not_read: str  # parts of the set that touchfield does not read, and why

    def __post_init__(self) -> None:
        require_one_of(f"{self.name}: verified", self.verified, VERIFIED)
        for field in fields(self):
            value = getattr(self, field.name)
            if not isinstance(value, bool) and not value:
                raise InvalidArgument(f"{self.name}: {field.name}", repr(value), "some text")


@cache
def data_cards() -> tuple[DataCard, ...]:
    """Return all cards, sorted by name."""
    folder = resources.files("touchfield.datasets") / "cards"
    return tuple(
        _parse(file.name.removesuffix(".toml"), file.read_text(encoding="utf-8"))
        for file in sorted(folder.iterdir(), key=lambda file: file.name)
    )


def data_card(name: str) -> DataCard:
    """Return the card with a name; `InvalidArgument` if there is none."""
    by_name = {card.name: card for card in data_cards()}
    if name in by_name:
        return by_name[name]
    matches = difflib.get_close_matches(name.lower(), by_name, n=1, cutoff=0.4)
    hint = f"Did you mean {matches[0]}?" if matches else "touchfield data list"
    raise InvalidArgument("NAME", repr(name), f"one of {', '.join(by_name)}", hint)


def _parse(name: str, text: str) -> DataCard:
    table: dict[str, Any] = tomllib.loads(text)
    return DataCard(name, **{key: _value(value) for key, value in table.items()})


def _value(value: Any) -> Any:
    if isinstance(value, str):
        return value.strip()
    return tuple(value) if isinstance(value, list) else value
