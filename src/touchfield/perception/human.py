"""Figures of human touch from the literature, such as thresholds and just noticeable differences (paper
section 4.2), each with its source.

Thresholds and just noticeable differences are in ``human.toml``; the threshold of vibration against frequency
is in ``vibration_threshold.toml``. The literature gives the displacement of the handle at this threshold. A
hand with its device is modelled as a mass, a damper and a spring: a force of amplitude F moves it by F / |k -
m w^2 + i b w|.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cache
from importlib import resources
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from touchfield.arrays import Float64s
from touchfield.errors import require_one_of

VERIFIED: Final = ("read", "secondary", "setting", "unverified")
"""How a figure was checked: read in the source or its abstract; read in a text that quotes it; chosen, so
that there is nothing to check; none of these."""


@dataclass(frozen=True)
class Figure:
    """One figure of human perception, or several."""

    name: str
    values: tuple[float, ...]
    of: tuple[str, ...]  # names of the values if there are several, else empty
    unit: str  # "1" for a ratio
    source: str
    verified: str  # one of `VERIFIED`
    year: int | None = None  # of the source
    condition: str = ""  # hand, device, stimulus and people, as far as the source was read
    criterion: str = ""  # procedure and what it estimates

    @property
    def value(self) -> float:
        """The figure, or the first of several."""
        return self.values[0]


@cache
def human() -> Mapping[str, Figure]:
    """All figures by name.

    For example ``human()["force_threshold_n"].value`` is F_0 in newtons.
    """
    text = (resources.files("touchfield.perception") / "human.toml").read_text("utf-8")
    figures = {}
    for name, entry in tomllib.loads(text).items():
        value = entry["value"]
        values = tuple(map(float, value)) if isinstance(value, list) else (float(value),)
        optional = {key: entry[key] for key in ("year", "condition", "criterion") if key in entry}
        figures[name] = Figure(
            name,
            values,
            tuple(entry.get("of", ())),
            entry["unit"],
            entry["source"],
            entry["verified"],
            **optional,
        )
    return MappingProxyType(figures)


def figure(name: str) -> float:
    """Return the value of a figure (the first of several).

    `InvalidArgument` if the name is unknown.
    """
    require_one_of("perception figure", name, human())
    return human()[name].value


DEFAULT_HAND: Final = "stylus"

THIRDS_HZ: Final = tuple(float(1000 * 10 ** (n / 10)) for n in range(-14, -3))
"""Centres of the eleven thirds of an octave from 40 to 400 Hz; a band extends from its centre by a factor 10
** 0.05 to either side."""


@dataclass(frozen=True)
class VibrationThreshold:
    """A detection threshold for vibration, and the hand and device it applies to.

    `displacement_um` are peak displacements of a sine at `frequency_hz`, each checked as `verified` says
    (`VERIFIED`). Mass, damping and stiffness are those of the hand with its device.
    """

    name: str
    title: str
    frequency_hz: tuple[float, ...]
    displacement_um: tuple[float, ...]
    mass_kg: float
    damping_n_s_per_m: float
    stiffness_n_per_m: float
    source: str
    conditions: str
    criterion: str
    year: int
    verified: tuple[str, ...]
    impedance_verified: str  # of mass, damping and stiffness, and so of the force at the threshold

    def displacement_peak_um(self, frequency_hz: ArrayLike) -> Float64s:
        """Peak displacement at the threshold, micrometres.

        float64 of the shape of `frequency_hz` (Hz, positive).
        """
        f = np.log(np.asarray(frequency_hz, np.float64))
        um: Float64s = np.exp(np.interp(f, np.log(self.frequency_hz), np.log(self.displacement_um)))
        return um

    def force_rms_mn(self, frequency_hz: ArrayLike = THIRDS_HZ) -> Float64s:
        """Force at the threshold, millinewtons rms.

        float64 of the shape of `frequency_hz` (Hz).
        """
        w = 2 * np.pi * np.asarray(frequency_hz, np.float64)
        n_per_m = np.abs(self.stiffness_n_per_m - self.mass_kg * w**2 + 1j * self.damping_n_s_per_m * w)
        rms: Float64s = 1e-3 * self.displacement_peak_um(frequency_hz) * n_per_m / np.sqrt(2)
        return rms


@cache
def vibration_thresholds() -> Mapping[str, VibrationThreshold]:
    """All profiles of hands by name."""
    text = (resources.files("touchfield.perception") / "vibration_threshold.toml").read_text("utf-8")
    profiles = {}
    for name, entry in tomllib.loads(text).items():
        profile = {"name": name} | entry | entry["impedance"]
        values = [profile[f.name] for f in fields(VibrationThreshold)]
        clean: list[Any] = [
            tuple(v) if isinstance(v, list) else v.strip() if isinstance(v, str) else v for v in values
        ]
        profiles[name] = VibrationThreshold(*clean)
    return MappingProxyType(profiles)


def vibration_threshold(name: str = DEFAULT_HAND) -> VibrationThreshold:
    """The profile of a hand; `InvalidArgument` if there is none of this name."""
    require_one_of("hand", name, vibration_thresholds())
    return vibration_thresholds()[name]
