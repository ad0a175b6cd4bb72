"""Finds the sources, coders, drivers, filters and executors that other installed Python packages provide as
plug-ins, by their entry points.

A distribution declares them in its ``pyproject.toml``; each refers to an object like that of a built-in
module::

    [project.entry-points."touchfield.sources"]
    las = "touchfield_las:KIND"

A plug-in that cannot be imported is skipped, with a warning that names it.
"""

from __future__ import annotations

import warnings
from functools import cache
from importlib.metadata import EntryPoints, entry_points
from typing import Any, Final, Protocol

GROUPS: Final = (
    *("touchfield.sources", "touchfield.coders", "touchfield.drivers", "touchfield.filters"),
    "touchfield.executors",
)


class PluginWarning(UserWarning):
    """Warning that a plug-in is skipped."""


class Selectable(Protocol):
    """What Python 3.11 and later versions have in common of their types of all entry points."""

    def select(self, *, group: str) -> EntryPoints: ...


@cache
def installed_entry_points() -> Selectable:
    """The entry points of all installed distributions; reading them takes milliseconds."""
    return entry_points()


@cache
def plugins(group: str, kind: type) -> dict[str, Any]:
    """Load the objects that the entry points of a group provide, by the name of the entry point.

    Parameters
    ----------
    group : str
        One of `GROUPS`.
    kind : type
        Type of the objects, or base class if the objects are classes. Other objects are skipped.
    """
    found: dict[str, Any] = {}
    for entry in installed_entry_points().select(group=group):
        source = f"plug-in {entry.name!r} ({entry.value}) of {group}"
        try:
            loaded = entry.load()
        except Exception as error:  # a stranger's module may raise anything
            warnings.warn(
                f"{source} is left out: {type(error).__name__}: {error}", PluginWarning, stacklevel=2
            )
            continue
        is_of_kind = isinstance(loaded, kind) or (isinstance(loaded, type) and issubclass(loaded, kind))
        if is_of_kind:
            found[entry.name] = loaded
        else:
            warnings.warn(f"{source} is left out: it is no {kind.__name__}", PluginWarning, stacklevel=2)
    return found
