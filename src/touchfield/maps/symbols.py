"""Classes of map features, the symbol of each, and the class of a feature by its tags or by words.

The table is ``symbols.toml``. Classes of one `look` are not drawn on the same map.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from touchfield.arrays import Bools

SHAPES: Final = ("line", "area", "point")
FALLBACK_LANGUAGE: Final = "en"
RELIEF: Final = "contour"
"""Name of the symbol of relief, which is no class of features."""
FILLS: Final = ("fill1", "fill2", "fill3", "fill4", "fill5")
"""Classes of the colours of a drawing."""


@dataclass(frozen=True)
class Symbol:
    """A class of features and how it is drawn.

    A line is one pin wide and has `on` pins up and `off` down; one that `widens` is drawn as an area of that
    class. An area has a `texture`, or is drawn as the line of the class `outline`. A point has a `picture`,
    or `opens` a gap in the lines of a class. Rows of a texture or a picture are from the top; a texture
    repeats.
    """

    name: str
    shape: str
    priority: int
    tags: tuple[str, ...]
    words: tuple[str, ...]
    title: Mapping[str, str] = field(hash=False)
    on: int = 1
    off: int = 0
    joins: str = "node"
    texture: tuple[str, ...] = ()
    picture: tuple[str, ...] = ()
    outline: str = ""
    opens: str = ""
    widens: str = ""

    @property
    def is_drawn(self) -> bool:
        """True if the class has a symbol of its own."""
        return not (self.outline or self.opens or self.widens)

    @property
    def is_solid(self) -> bool:
        """True for an area whose pins are all up."""
        return self.texture == ("1",)

    @property
    def is_dotted(self) -> bool:
        """True for a line of single pins with gaps."""
        return self.shape == "line" and self.on == 1 and self.off > 0

    @property
    def look(self) -> tuple[object, ...]:
        """What a finger tells the symbol by."""
        return (self.on, self.off) if self.shape == "line" else (*self.texture, *self.picture)

    def pattern(self, shape: tuple[int, int]) -> Bools:
        """Return the texture or the picture over [rows, columns] of pins."""
        tile = _bits(self.texture or self.picture)
        repeats = [-(-n // t) for n, t in zip(shape, tile.shape)]
        return np.tile(tile, repeats)[: shape[0], : shape[1]]

    def titled(self, language: str) -> str:
        """Return the name of the class in a language, or in English."""
        return self.title.get(language, self.title[FALLBACK_LANGUAGE])


def _bits(rows: tuple[str, ...]) -> Bools:
    return np.array([[digit == "1" for digit in row] for row in rows])


@cache
def _table() -> Mapping[str, Symbol]:
    text = (resources.files("touchfield.maps") / "symbols.toml").read_text("utf-8")
    found = []
    for name, row in tomllib.loads(text).items():
        values: dict[str, Any] = {
            key: tuple(value) if isinstance(value, list) else value for key, value in row.items()
        }
        found.append(Symbol(name=name, **values))
    return MappingProxyType({symbol.name: symbol for symbol in sorted(found, key=lambda s: s.priority)})


@cache
def symbols() -> Mapping[str, Symbol]:
    """Return all classes of features by name, the most important first."""
    return MappingProxyType({name: symbol for name, symbol in _table().items() if name != RELIEF})


def symbol_of(kind: str) -> Symbol | None:
    """Return the symbol of a class of features, or of relief; None if there is none of this name."""
    return _table().get(kind)


def relief_symbol() -> Symbol:
    """Return the symbol of relief; its title has the field ``interval_m``."""
    return _table()[RELIEF]


@cache
def _by_tag(shape: str) -> Mapping[str, str]:
    table: dict[str, str] = {}
    for symbol in sorted(symbols().values(), key=lambda s: (not s.opens and not s.outline, s.priority)):
        if symbol.shape == shape:
            for tag in symbol.tags:
                table.setdefault(tag, symbol.name)
    return table


@cache
def _by_word() -> Mapping[str, str]:
    return {word: symbol.name for symbol in symbols().values() for word in (*symbol.words, symbol.name)}


def class_of_tags(tags: Mapping[str, str], shape: str) -> str | None:
    """Return the class of a feature of a shape by its tags, as in OpenStreetMap; None if there is none.

    A tag ``class`` or ``kind`` that names a class is taken before others.
    """
    for key in ("class", "kind"):
        name = _by_word().get(str(tags.get(key, "")).lower())
        if name is not None and symbols()[name].shape == shape:
            return name
    names = [
        table_name
        for key, value in tags.items()
        if value != "no"
        for tag in (f"{key}={value}", key)
        if (table_name := _by_tag(shape).get(tag)) is not None
    ]
    return min(names, key=lambda name: symbols()[name].priority, default=None)


def class_of_words(texts: Iterable[str], shape: str) -> str | None:
    """Return the class of a shape that the names of a drawing's element or of its layers state, or None."""
    for text in texts:
        for word in re.split(r"[^a-zäöüß]+", text.lower()):
            name = _by_word().get(word)
            if name is not None and symbols()[name].shape == shape:
                return name
    return None
