"""Sizes and distances of readable tactile graphics, from the cited table ``guidelines.toml``, and what they
come to on the pins of a display.

Every figure of the table has its source, and states whether it was read there. The distance between two
symbols is that between the edges of their pins: with a gap of 3.2 mm and pins of 1.4 mm, centres are at least
4.6 mm apart, which on a pitch of 2.5 mm leaves one pin down between any two symbols.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from types import MappingProxyType
from typing import Final

import numpy as np

from touchfield.arrays import Bools
from touchfield.errors import InvalidArgument

MAX_PITCH_MM: Final = 3.0
MIN_PITCH_MM: Final = 1.0
"""Beyond these a symbol of some pins is neither a line nor a texture."""


@dataclass(frozen=True)
class Guideline:
    """A figure of the table with its unit and source.

    `verified` is "read", "secondary" or "unverified"; `read_in` names the text in which a secondary figure
    was read.
    """

    value: float
    unit: str
    source: str
    where: str
    verified: str
    read_in: str = ""
    note: str = ""


@cache
def guidelines() -> Mapping[str, Guideline]:
    """Return the whole table by name."""
    text = (resources.files("touchfield.maps") / "guidelines.toml").read_text("utf-8")
    return MappingProxyType({name: Guideline(**row) for name, row in tomllib.loads(text).items()})


def _value(name: str) -> float:
    return float(guidelines()[name].value)


@dataclass(frozen=True)
class PinRules:
    """The guidelines on pins of one pitch, millimetres.

    Raises `InvalidArgument` for a pitch on which no symbol of this package can be read.
    """

    pitch_mm: float

    def __post_init__(self) -> None:
        if not MIN_PITCH_MM <= self.pitch_mm <= MAX_PITCH_MM:
            expected = f"a pitch of {MIN_PITCH_MM:g} to {MAX_PITCH_MM:g} mm"
            raise InvalidArgument("device", f"pins {self.pitch_mm:g} mm apart", expected)

    @property
    def min_centre_mm(self) -> float:
        """Least distance between the centres of two pins of different symbols, millimetres."""
        return _value("gap_mm") + _value("dot_mm")

    @property
    def too_close(self) -> Bools:
        """Offsets of pins that are closer than allowed, bool [2 r + 1, 2 r + 1] around the pin itself."""
        reach = math.floor(self.min_centre_mm / self.pitch_mm)
        offset = self.pitch_mm * np.arange(-reach, reach + 1)
        return np.asarray(np.hypot.outer(offset, offset) < self.min_centre_mm)

    @property
    def symbol_pins(self) -> int:
        """Fewest pins along a side of a point symbol or an area."""
        return self._pins_of("min_symbol_mm")

    @property
    def line_pins(self) -> int:
        """Fewest pins of a line."""
        return self._pins_of("min_line_mm")

    @property
    def displacement_pins(self) -> int:
        """Pins by which a point symbol or a label may be beside its place."""
        return int(_value("max_displacement_mm") / self.pitch_mm)

    @property
    def cell_pins(self) -> int:
        """Pins from one Braille cell to the next: two columns, and at least one that is down."""
        return max(3, round(_value("cell_spacing_mm") / self.pitch_mm))

    @property
    def braille_line_pins(self) -> int:
        """Pins from one line of Braille to the next."""
        return max(4, round(_value("line_spacing_mm") / self.pitch_mm))

    @property
    def can_write_braille(self) -> bool:
        """True if dots of this pitch are within the sizes of Braille."""
        return _value("dot_spacing_mm") - 0.1 <= self.pitch_mm <= _value("dot_spacing_large_mm") + 0.1

    def _pins_of(self, name: str) -> int:
        """Pins whose outer edges are at least the length of a guideline apart."""
        return 1 + math.ceil((_value(name) - _value("dot_mm")) / self.pitch_mm - 1e-9)
