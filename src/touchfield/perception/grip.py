"""The Weber fraction as a function of force, k(|F|), and the force bound of a grip: F_0 and k(|F|).

A constant k is generous to weak forces or strict with them, because the Weber fraction of force grows as the
force falls. `WeberCurve` is piecewise log-linear: k is linear in log |F| between its points, and constant
beyond them. The bound is then max(F_0, k(|F|) |F|), which never falls as the force grows.

The grips are in ``grip.toml``; every number there states its source, condition and criterion, and whether it
was read.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from touchfield.arrays import Float64s
from touchfield.errors import InvalidArgument, require_between, require_one_of

MAX_POINTS: Final = 64
_FORCE_LIMITS_N: Final = (1e-6, 1e6)
_K_LIMITS: Final = (0.001, 0.999)


@dataclass(frozen=True)
class WeberCurve:
    """The Weber fraction as a function of force.

    `points` are (force in newtons, k), forces ascending, k from 0.001 to 0.999. `InvalidArgument` if a number
    is out of range, the forces do not ascend, or k |F| would fall as the force grows.
    """

    points: tuple[tuple[float, float], ...]

    def __post_init__(self) -> None:
        if not 1 <= len(self.points) <= MAX_POINTS:
            raise InvalidArgument("k(|F|)", f"{len(self.points)} points", f"1 to {MAX_POINTS}")
        for force_n, k in self.points:
            require_between(*_FORCE_LIMITS_N, force_n=force_n)
            require_between(*_K_LIMITS, k=k)
        forces_n, fractions = np.array(self.points).T
        if (np.diff(forces_n) <= 0).any():
            raise InvalidArgument("k(|F|)", f"forces {forces_n.tolist()} N", "forces that ascend")
        # d(k F)/d(log F) = F (k + slope) is smallest at the upper end of each piece
        slopes = np.diff(fractions) / np.diff(np.log(forces_n))
        if (slopes < -fractions[1:]).any():
            raise InvalidArgument("k(|F|)", f"k {fractions.tolist()}", "k |F| that grows with the force")

    @classmethod
    def of(cls, points: Iterable[Iterable[float]]) -> WeberCurve:
        """A curve from pairs of force and k, such as lists read from JSON.

        `InvalidArgument` if they are no pairs of numbers.
        """
        try:
            pairs = tuple((float(force_n), float(k)) for force_n, k in points)
        except (TypeError, ValueError):
            raise InvalidArgument("k(|F|)", repr(points), "pairs of newtons and k") from None
        return cls(pairs)

    def __call__(self, amplitudes_n: ArrayLike) -> Float64s:
        """k at forces of these amplitudes, newtons [...]; float64 [...]."""
        forces_n, fractions = np.array(self.points).T
        size_n = np.clip(np.abs(np.asarray(amplitudes_n, np.float64)), forces_n[0], forces_n[-1])
        k: Float64s = np.interp(np.log(size_n), np.log(forces_n), fractions)
        return k

    @property
    def least(self) -> float:
        """The smallest k of all forces."""
        return min(k for _, k in self.points)

    @property
    def largest(self) -> float:
        """The largest k of all forces."""
        return max(k for _, k in self.points)

    @property
    def text(self) -> str:
        """The points as text: "k(|F|) = 0.15 at 0.5 N, 0.07 at 2.5 N"."""
        return "k(|F|) = " + ", ".join(f"{k:g} at {force_n:g} N" for force_n, k in self.points)


@dataclass(frozen=True)
class Sourced:
    """A number of a grip, and where it comes from."""

    name: str  # "F_0", or "k at 2.5 N"
    value: float
    source: str
    condition: str
    criterion: str
    verified: str  # one of `human.VERIFIED`; see grip.toml
    year: int | None = None


@dataclass(frozen=True)
class Grip:
    """The force bound of a grip: F_0, newtons, and k(|F|)."""

    name: str
    title: str
    f0_n: float
    weber: WeberCurve
    numbers: tuple[Sourced, ...]  # F_0, then each point of `weber`

    @property
    def note(self) -> str:
        """Which numbers were not read for this grip; empty if all were."""
        by_kind = {
            kind: [number.name for number in self.numbers if number.verified == kind]
            for kind in ("secondary", "unverified")
        }
        parts = [f"{kind}: {', '.join(names)}" for kind, names in by_kind.items() if names]
        return (
            f"thresholds of grip {self.name} that were not measured for it: {'; '.join(parts)}"
            if parts
            else ""
        )


@cache
def grips() -> Mapping[str, Grip]:
    """All grips by name."""
    text = (resources.files("touchfield.perception") / "grip.toml").read_text("utf-8")
    return MappingProxyType({name: _grip(name, entry) for name, entry in tomllib.loads(text).items()})


def grip(name: str) -> Grip:
    """The grip of this name; `InvalidArgument` if there is none."""
    require_one_of("grip", name, grips())
    return grips()[name]


def _grip(name: str, entry: Mapping[str, Any]) -> Grip:
    threshold, points = dict(entry["threshold"]), [dict(point) for point in entry["weber"]]
    f0_n = float(threshold.pop("force_n"))
    pairs = [(float(point.pop("force_n")), float(point.pop("k"))) for point in points]
    numbers = [Sourced("F_0", f0_n, **threshold)]
    numbers += [
        Sourced(f"k at {force_n:g} N", k, **point) for (force_n, k), point in zip(pairs, points, strict=True)
    ]
    return Grip(name, entry["title"], f0_n, WeberCurve(tuple(pairs)), tuple(numbers))
