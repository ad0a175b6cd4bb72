"""The haptic filters there are, by name, and chains of them (paper section 3.2)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from importlib import import_module
from types import MappingProxyType

from touchfield.errors import InvalidArgument
from touchfield.filters.device_filter import limited
from touchfield.filters.field_filter import FieldFilter
from touchfield.medium import ForceField, HapticMedium

__all__ = ["MODULES", "felt_medium", "field_filters", "filter_of", "filtered", "filtered_medium"]

MODULES = ("gaussian", "fir", "actuator", "shading", "diffusion", "multiresolution", "texture")
"""Modules of this room whose ``FILTER`` is a `FieldFilter` class; a new filter is one more line."""


@cache
def field_filters() -> Mapping[str, type[FieldFilter]]:
    """The classes of all filters by name, in the order of `MODULES`."""
    found = [import_module(f"touchfield.filters.{module}").FILTER for module in MODULES]
    return MappingProxyType({f.name: f for f in found})


def filter_of(name: str, text: str = "") -> FieldFilter:
    """A filter by its name and the words of `FieldFilter.parse`.

    Raises `InvalidArgument` if there is no such filter, or its words make no sense.
    """
    if name not in field_filters():
        raise InvalidArgument("filter", repr(name), f"one of {', '.join(field_filters())}")
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
    before = medium.provenance.get("filters")
    return replace(
        medium,
        make_frame=lambda i: filtered(medium[i], chain),
        provenance={**medium.provenance, "filters": f"{before}; {words}" if before else words},
    )


def felt_medium(medium: HapticMedium, chain: Sequence[FieldFilter], force_max_n: float) -> HapticMedium:
    """The medium through the haptic filters; what they add beyond F_max is clipped, as the device filter clips."""
    if not chain:
        return medium
    made = filtered_medium(medium, chain)
    return replace(made, make_frame=lambda i: limited(made[i], force_max_n))
