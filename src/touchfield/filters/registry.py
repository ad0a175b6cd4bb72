"""Lists the haptic filters (paper section 3.2), parses their text on the command line, and applies one or
several in order.

A filter is a frozen dataclass of its options, in metres and newtons. Calling it maps a field to a field on
the same grid. It declares its properties (`Claims`), and one shared test measures every claim of every
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
from touchfield.filters.limit import limit_forces
from touchfield.medium import ForceField, HapticMedium
from touchfield.plugins import plugins

if TYPE_CHECKING:
    from touchfield.medium import Grid

_UNITS_M = {"um": 1e-6, "mm": 1e-3, "cm": 1e-2, "m": 1.0}


@dataclass(frozen=True)
class Claims:
    """The claims of a filter on a given grid; "clear" means farther than `reach` from the border.

    reach : (int, int, int); along each axis no output sample depends on an input sample farther than this.
    dc_gain : float or None; the gain of a constant field, clear of the border; None makes no claim.
    """

    reach: tuple[int, int, int]
    linear: bool = False
    dc_gain: float | None = None
    keeps_mean: bool = False  # the sum of the forces is preserved, for fields clear of the border
    max_principle: bool = False  # no |F| of the result exceeds the greatest |F| of the input
    keeps_support: bool = False  # a sample has a force only if it had one before
    keeps_direction: bool = False  # where both have a force, F' is parallel to F (or opposite)
    keeps_amplitude: bool = False  # where both have a force, |F'| = |F|


class FieldFilter(ABC):
    """A haptic filter; subclasses are frozen dataclasses that check their fields when constructed.

    name, summary : str; the name, such as "gaussian", and one line of help with examples of its text.
    example : str; a text that `parse` accepts, for a field in the workspace of a hand.
    """

    name: ClassVar[str]
    summary: ClassVar[str]
    example: ClassVar[str]

    @abstractmethod
    def claims(self, grid: Grid) -> Claims:
        """The claims of the filter for fields on `grid`."""

    @abstractmethod
    def __call__(self, field: ForceField) -> ForceField:
        """Return the filtered field, newtons, on the same grid; the bits do not depend on the threads."""

    @classmethod
    def parse(cls, text: str) -> Self:
        """Parse a filter: the first field's value alone, or "field=value,field=value", or both.

        A field that ends in ``_m`` takes a length with its unit, ``2mm``; one that ends in ``_n`` takes
        newtons. Both may be named without the ending. An empty text takes every default. Older streams may
        name fields that no longer exist; these are ignored if they have their former default.

        Raises `InvalidArgument` if a field is unknown, missing, given twice or not of its type.
        """
        rows = {f.name: f for f in fields(cls)}  # type: ignore[arg-type]
        hints = get_type_hints(cls)
        options: dict[str, Any] = {}
        for index, part in enumerate(
            p for p in text.split(",") if p.strip() and p.strip() not in _FORMER_DEFAULTS
        ):
            key, equals, value = part.partition("=")
            key, value = key.strip().replace("-", "_"), value.strip()
            if not equals:
                if index:
                    raise InvalidArgument(f"--{cls.name}", repr(part), "name=value after the first")
                key, value = next(iter(rows), ""), part.strip()
            key = next((k for k in (key, f"{key}_m", f"{key}_n") if k in rows), key)
            if key not in rows or key in options:
                names = ", ".join(_short(name) for name in rows)
                raise InvalidArgument(f"--{cls.name}", repr(part.strip()), f"each of {names} at most once")
            kind = next((k for k in get_args(hints[key]) if k is not type(None)), hints[key])
            options[key] = _value(f"--{cls.name} {_short(key)}", key, kind, value)
        missing = [n for n, f in rows.items() if n not in options and f.default is MISSING]
        if missing:
            raise InvalidArgument(f"--{cls.name}", f"no {_short(missing[0])}", cls.summary)
        return cls(**options)

    @classmethod
    def expand(cls, text: str) -> str:
        """Return the text of a user with the contents of the files that it names.

        `parse` opens no file, as it also reads the texts of untrusted streams.
        """
        return text

    @property
    def text(self) -> str:
        """The text that `parse` accepts for this filter, with every field named."""
        parts = []
        for f in fields(self):  # type: ignore[arg-type]
            value = getattr(self, f.name)
            if f.name.endswith("_m") and isinstance(value, float):
                parts.append(f"{_short(f.name)}={value!r}m")
            elif value is not None:
                parts.append(f"{_short(f.name)}={str(value).lower() if isinstance(value, bool) else value}")
        return ",".join(parts)


def length_m(text: str, where: str) -> float:
    """Parse a length such as ``2mm``; return metres.

    Raises `InvalidArgument` naming `where` if the number or its unit is missing.
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


_FORMER_DEFAULTS = (
    "boundary=zero", "region=support", "spread=false", "truncate=4.0", "conductance=exponential",
    "keep=coarse", "anchor=centred", "limit=1.0", "axes=xy",
)  # fmt: skip

_CLASSES = (
    "smoothing.GaussianFilter", "fir.FirFilter", "smoothing.ActuatorLowPass", "shading.ShadingFilter",
    "shading.DiffusionFilter", "lifting.MultiresolutionFilter", "contact.TextureFilter",
)  # fmt: skip
"""The filters of this package as "module.Class"; plug-ins add theirs by the group ``touchfield.filters``."""


@cache
def field_filters() -> Mapping[str, type[FieldFilter]]:
    """Return the classes of all filters by name."""
    entries = [entry.split(".") for entry in _CLASSES]
    classes = [getattr(import_module(f"touchfield.filters.{module}"), name) for module, name in entries]
    classes += plugins("touchfield.filters", FieldFilter).values()
    by_name: dict[str, type[FieldFilter]] = {}
    for filter_class in classes:
        by_name.setdefault(filter_class.name, filter_class)
    return MappingProxyType(by_name)


def filter_of(name: str, text: str = "") -> FieldFilter:
    """Return a filter by its name and the text of `FieldFilter.parse`.

    Raises `InvalidArgument` if there is no such filter, or its text is invalid.
    """
    require_one_of("filter", name, field_filters())
    return field_filters()[name].parse(text)


def apply_filters(field: ForceField, chain: Sequence[FieldFilter]) -> ForceField:
    """Apply the filters of a chain to a field, one after the other."""
    for step in chain:
        field = step(field)
    return field


def filter_medium(medium: HapticMedium, chain: Sequence[FieldFilter]) -> HapticMedium:
    """Return the medium with every frame filtered when it is requested; the provenance names the chain."""
    if not chain:
        return medium
    text = "; ".join(f"{step.name} {step.text}".strip() for step in chain)
    provenance = add_note(medium.provenance, "filters", text)
    return replace(medium, make_frame=lambda i: apply_filters(medium[i], chain), provenance=provenance)


def filter_by_text(medium: HapticMedium, texts: Sequence[str]) -> HapticMedium:
    """Filter a medium by filters in text form, such as "gaussian:sigma=2mm", one after the other.

    Raises `InvalidArgument` if a filter is unknown or its text is invalid.
    """
    named = (str(text).partition(":") for text in texts)
    return filter_medium(medium, [filter_of(name, text) for name, _, text in named])


def add_note(provenance: Mapping[str, str], key: str, text: str) -> dict[str, str]:
    """Return a provenance with a note appended to the entry of a key."""
    before = provenance.get(key)
    return {**provenance, key: f"{before}; {text}" if before else text}


def filter_and_limit(medium: HapticMedium, chain: Sequence[FieldFilter], force_max_n: float) -> HapticMedium:
    """Filter a medium, then clip to F_max what the filters raised above it, as the device filter does."""
    if not chain:
        return medium
    result = filter_medium(medium, chain)
    return replace(result, make_frame=lambda i: limit_forces(result[i], force_max_n))
