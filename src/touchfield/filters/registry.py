"""Haptic filters (paper section 3.2): what one is and declares, how it is asked for in words, and chains of
them.

A filter is a frozen dataclass of what was asked, in metres and newtons, and a call that takes a field to a
field on the same grid. It declares what it does (`Claims`), and one shared test measures every claim on every
filter.
"""

from __future__ import annotations

import math
import re
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, replace
from functools import cache
from importlib import import_module
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Self, get_args, get_type_hints

from touchfield.errors import InvalidArgument, require_one_of
from touchfield.filters.device_filter import limited
from touchfield.medium import ForceField, HapticMedium
from touchfield.plugins import plugins

if TYPE_CHECKING:
    from touchfield.medium import Grid

_UNITS_M = {"um": 1e-6, "mm": 1e-3, "cm": 1e-2, "m": 1.0}


@dataclass(frozen=True)
class Claims:
    """The claims of a filter on a given grid; "clear" means farther than `reach` from the border.

    reach : (int, int, int); along each axis no output sample depends on an input sample farther than this.
    dc_gain : float or None; what a constant field is multiplied by, clear of the border; None makes no claim.
    """

    reach: tuple[int, int, int]
    linear: bool = False
    dc_gain: float | None = None
    keeps_mean: bool = False  # the sum of the forces stays, for fields clear of the border
    max_principle: bool = False  # no |F| of the result is greater than the greatest |F| of the input
    keeps_support: bool = False  # a sample has a force only if it had one before
    keeps_direction: bool = False  # where both have a force, F' is parallel to F (or opposite)
    keeps_amplitude: bool = False  # where both have a force, |F'| = |F|


class FieldFilter(ABC):
    """A haptic filter; subclasses are frozen dataclasses that check their fields at birth.

    name, summary : str; how it is called, "gaussian", and one line of help, with examples of its text.
    example : str; words that `parse` takes, for a field in the workspace of a hand.
    """

    name: ClassVar[str]
    summary: ClassVar[str]
    example: ClassVar[str]

    @abstractmethod
    def claims(self, grid: Grid) -> Claims:
        """The claims of the filter for fields on `grid`."""

    @abstractmethod
    def __call__(self, field: ForceField) -> ForceField:
        """The filtered field, newtons, on the same grid; the same bits for any number of threads."""

    @classmethod
    def parse(cls, text: str) -> Self:
        """A filter of words: the first field's value alone, or "field=value,field=value", or both.

        A field that ends in ``_m`` takes a length with its unit, ``2mm``, one in ``_n`` newtons; both may be
        named without the ending. An empty text takes every default. Of the words of older streams those that
        were the default of a field no longer there are passed over.

        Raises `InvalidArgument` if a field is unknown, missing, there twice or not of its type.
        """
        rows = {f.name: f for f in fields(cls)}  # type: ignore[arg-type]
        hints = get_type_hints(cls)
        given: dict[str, Any] = {}
        for place, part in enumerate(p for p in text.split(",") if p.strip() and p.strip() not in _OF_OLD):
            key, equals, value = part.partition("=")
            key, value = key.strip().replace("-", "_"), value.strip()
            if not equals:
                if place:
                    raise InvalidArgument(f"--{cls.name}", repr(part), "name=value after the first")
                key, value = next(iter(rows), ""), part.strip()
            key = next((k for k in (key, f"{key}_m", f"{key}_n") if k in rows), key)
            if key not in rows or key in given:
                names = ", ".join(_short(name) for name in rows)
                raise InvalidArgument(f"--{cls.name}", repr(part.strip()), f"each of {names} at most once")
            kind = next((k for k in get_args(hints[key]) if k is not type(None)), hints[key])
            given[key] = _value(f"--{cls.name} {_short(key)}", key, kind, value)
        missing = [n for n, f in rows.items() if n not in given and f.default is MISSING]
        if missing:
            raise InvalidArgument(f"--{cls.name}", f"no {_short(missing[0])}", cls.summary)
        return cls(**given)

    @property
    def words(self) -> str:
        """The text that `parse` takes for this filter, every field named."""
        parts = []
        for f in fields(self):  # type: ignore[arg-type]
            value = getattr(self, f.name)
            if f.name.endswith("_m") and isinstance(value, float):
                parts.append(f"{_short(f.name)}={value!r}m")
            elif value is not None:
                parts.append(f"{_short(f.name)}={str(value).lower() if isinstance(value, bool) else value}")
        return ",".join(parts)


def length_m(text: str, where: str) -> float:
    """A length such as ``2mm`` in metres; `InvalidArgument` naming `where` if the number or its unit is
    missing.
    """
    match = re.fullmatch(r"\s*([-+0-9.eE]+?)\s*(um|mm|cm|m)\s*", text)
    try:
        value = float(match[1]) * _UNITS_M[match[2]] if match else math.nan
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InvalidArgument(where, repr(text), "a length with its unit, such as 2mm")
    return value


def _short(name: str) -> str:
    return name.removesuffix("_m").removesuffix("_n")


def _value(where: str, name: str, kind: Any, text: str) -> Any:
    if name.endswith("_m") and kind is float:
        return length_m(text, where)
    try:
        if kind is bool:
            return {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}[
                text.lower()
            ]
        return kind(text)
    except (ValueError, KeyError):
        expected = {int: "a whole number", float: "a number", bool: "true or false"}.get(
            kind, "another value"
        )
        raise InvalidArgument(where, repr(text), expected) from None


_OF_OLD = (
    "boundary=zero", "region=support", "spread=false", "truncate=4.0", "conductance=exponential", "keep=coarse",
    "anchor=centred", "limit=1.0", "axes=xy",
)  # fmt: skip

_CLASSES = (
    "smoothing.GaussianFilter", "fir.FirFilter", "smoothing.ActuatorLowPass", "shading.ShadingFilter",
    "shading.DiffusionFilter", "lifting.MultiresolutionFilter", "contact.TextureFilter",
)  # fmt: skip
"""The filters of this package, each a class of a module; plug-ins add theirs by the group
``touchfield.filters``.
"""


@cache
def field_filters() -> Mapping[str, type[FieldFilter]]:
    """The classes of all filters by name."""
    entries = [entry.split(".") for entry in _CLASSES]
    classes = [getattr(import_module(f"touchfield.filters.{module}"), name) for module, name in entries]
    classes += plugins("touchfield.filters", FieldFilter).values()
    by_name: dict[str, type[FieldFilter]] = {}
    for each in classes:
        by_name.setdefault(each.name, each)
    return MappingProxyType(by_name)


def filter_of(name: str, text: str = "") -> FieldFilter:
    """A filter by its name and the words of `FieldFilter.parse`.

    Raises `InvalidArgument` if there is no such filter, or its words make no sense.
    """
    require_one_of("filter", name, field_filters())
    return field_filters()[name].parse(text)


def filtered(field: ForceField, chain: Sequence[FieldFilter]) -> ForceField:
    """The field through one filter after the other."""
    for step in chain:
        field = step(field)
    return field


def filtered_medium(medium: HapticMedium, chain: Sequence[FieldFilter]) -> HapticMedium:
    """The medium with every frame filtered when it is asked for; the provenance names the chain."""
    if not chain:
        return medium
    words = "; ".join(f"{step.name} {step.words}".strip() for step in chain)
    provenance = noted(medium.provenance, "filters", words)
    return replace(medium, make_frame=lambda i: filtered(medium[i], chain), provenance=provenance)


def filter_by_text(medium: HapticMedium, texts: Sequence[str]) -> HapticMedium:
    """The medium through filters as a user writes them, such as "gaussian:sigma=2mm", one after the other.

    Raises `InvalidArgument` if a filter is unknown or its text makes no sense.
    """
    named = (str(text).partition(":") for text in texts)
    return filtered_medium(medium, [filter_of(name, text) for name, _, text in named])


def noted(provenance: Mapping[str, str], key: str, words: str) -> dict[str, str]:
    """A provenance with some words more under a key."""
    before = provenance.get(key)
    return {**provenance, key: f"{before}; {words}" if before else words}


def felt_medium(medium: HapticMedium, chain: Sequence[FieldFilter], force_max_n: float) -> HapticMedium:
    """The medium through the haptic filters; what they add beyond F_max is clipped, as the device filter
    clips.
    """
    if not chain:
        return medium
    result = filtered_medium(medium, chain)
    return replace(result, make_frame=lambda i: limited(result[i], force_max_n))
