"""The type 1 devices: which there are, and how what a user wrote becomes one.

    sim   sim:spring   haply   haply:HOST:PORT   openhaptics   openhaptics:NAME   forcedimension

A new device is one new module that ends in ``KIND = PointKind(...)`` and one line in `MODULES`. The modules must be
cheap to import: libraries and drivers are looked for when the device is opened.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING

from touchfield.adapters.check import Check
from touchfield.errors import InvalidArgument
from touchfield.render.point_device import PointDevice

if TYPE_CHECKING:
    from touchfield.medium.trace import Trace

__all__ = ["Opener", "PointChoice", "PointKind", "point_device", "point_kinds"]

MODULES = ("sim", "haply", "openhaptics", "forcedimension")

Opener = Callable[[], PointDevice]
"""Makes the device, in the servo's process: it can be pickled. `PointDevice.open` then finds it."""


@dataclass(frozen=True)
class PointKind:
    """One kind of type 1 device.

    Parameters
    ----------
    name : str
        What ``--device`` takes, before the colon.
    form : str
        The same as a user may write it, such as "haply[:HOST:PORT]".
    summary : str
        One line for the user.
    profile : str or None
        Name of the profile in `touchfield.devices` whose limits hold unless another is named; None for that of the
        stream.
    opener : callable
        ``opener(rest, trajectory) -> Opener``, `rest` what stands behind the colon, or ""; raises `InvalidArgument`.
    checks : callable
        ``checks() -> list[Check]``: what is there of what it needs; quick, and never raises.
    is_simulated : bool
        Whether it takes a trajectory, and its axes and metres are the field's.
    """

    name: str
    form: str
    summary: str
    profile: str | None
    opener: Callable[[str, Trace | None], Opener]
    checks: Callable[[], list[Check]]
    is_simulated: bool = False


@dataclass(frozen=True)
class PointChoice:
    """The device that a user named.

    Attributes
    ----------
    name : str
        Of its kind.
    opener : Opener
    profile : str or None
        As of `PointKind`.
    is_simulated : bool
        As of `PointKind`: position and force then are in the field's axes and metres, whatever the profile says.
    """

    name: str
    opener: Opener
    profile: str | None
    is_simulated: bool


@cache
def point_kinds() -> tuple[PointKind, ...]:
    """All kinds of type 1 devices."""
    return tuple(import_module(f"touchfield.adapters.{name}").KIND for name in MODULES)


def point_device(words: str, trajectory: Trace | None = None) -> PointChoice:
    """The device that `words` name, such as "sim", "haply:127.0.0.1:10001"; nothing is opened.

    Parameters
    ----------
    words : str
        A kind, and behind a colon what it takes.
    trajectory : Trace, optional
        Of a simulated hand.

    Raises
    ------
    InvalidArgument
        If there is no such kind, what stands behind the colon is wrong, or a device that a hand moves was given a
        trajectory.
    """
    name, _, rest = words.strip().partition(":")
    known = {kind.name: kind for kind in point_kinds()}
    kind = known.get(name.lower())
    if kind is None:
        forms = ", ".join(kind.form for kind in known.values())
        near = difflib.get_close_matches(name.lower(), known, n=1)
        mend = f"Did you mean {near[0]}?" if near else ""
        raise InvalidArgument("device", repr(words[:80]), f"one of {forms}", mend)
    if trajectory is not None and not kind.is_simulated:
        raise InvalidArgument("trajectory", f"one for {kind.name}", "none: there a hand moves", "Take --device sim.")
    return PointChoice(kind.name, kind.opener(rest, trajectory), kind.profile, kind.is_simulated)
