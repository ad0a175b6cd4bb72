"""What a human can tell apart (paper section 4.2): thresholds and just noticeable differences, with sources.

The figures stand in ``human.toml``. The paper takes k = 0.01, 0.1 and 0.25 for its deadband; the just
noticeable difference of force itself is about 7 %, so that k = 0.25 is coarser than the hand.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from types import MappingProxyType

from touchfield.errors import InvalidArgument

__all__ = ["Figure", "figure", "human"]


@dataclass(frozen=True)
class Figure:
    """One figure of human perception.

    values : tuple of float; one figure, or several.
    of : tuple of str; what each of several figures belongs to; empty for one.
    unit : str; "1" for a ratio.
    source : str; where it comes from; begins with "unverified" where the source was not seen.
    """

    name: str
    values: tuple[float, ...]
    of: tuple[str, ...]
    unit: str
    source: str

    @property
    def value(self) -> float:
        """The figure, or the first of several."""
        return self.values[0]


@cache
def human() -> Mapping[str, Figure]:
    """All figures by name, for example ``human()["force_threshold_n"].value`` (F_0, newtons)."""
    text = (resources.files("touchfield.perception") / "human.toml").read_text("utf-8")
    figures = {}
    for name, entry in tomllib.loads(text).items():
        value = entry["value"]
        values = tuple(map(float, value)) if isinstance(value, list) else (float(value),)
        figures[name] = Figure(name, values, tuple(entry.get("of", ())), entry["unit"], entry["source"])
    return MappingProxyType(figures)


def figure(name: str) -> float:
    """The value of one figure (the first of several).

    Raises `InvalidArgument` if there is no figure of that name.
    """
    if name not in human():
        raise InvalidArgument("perception figure", repr(name), f"one of {', '.join(human())}")
    return human()[name].value
