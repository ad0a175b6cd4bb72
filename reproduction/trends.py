"""Tests sets of figures against the trends that table 3 of the paper shows (which figure is smaller than
which), and against bounds that no coder can pass.

They are checked on any set of figures over k, m and the fineness of directions, the printed ones too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

__all__ = ["TRENDS", "Bound", "Case", "Point", "Trend", "bounds", "trends"]


class Case(NamedTuple):
    """A setting of table 3: frames m, deadband k, and whether directions are fine (258 or 252) or coarse
    (92).
    """

    m: int
    k: float
    is_high: bool

    @property
    def wording(self) -> str:
        """The setting in a few words."""
        return f"m = {self.m}, k = {self.k:g}, {'high' if self.is_high else 'low'}"


class Point(NamedTuple):
    """Its figures: compression ratio, and NMSE in decibels of any one convention."""

    cr: float
    nmse_db: float


@dataclass(frozen=True)
class Trend:
    """A trend and where it fails.

    Attributes
    ----------
    name : str
        A key of `TRENDS`.
    compared : int
        How many pairs were compared.
    failures : tuple of (Case, Case)
        The pairs that go the other way; the first should have had the larger figure.
    """

    name: str
    compared: int
    failures: tuple[tuple[Case, Case], ...]

    @property
    def holds(self) -> bool:
        """Whether every pair goes the way of the trend."""
        return not self.failures

    @property
    def verdict(self) -> str:
        """ "holds", or how often it fails."""
        return "holds" if self.holds else f"fails {len(self.failures)} of {self.compared}"


@dataclass(frozen=True)
class Bound:
    """What m frames cost at least where the first of them is sent: CR(m) >= CR(1) / m.

    Attributes
    ----------
    case : Case
    cr : float
    least_cr : float
        CR(1) / m: m frames of which all but the first cost nothing.
    """

    case: Case
    cr: float
    least_cr: float

    @property
    def is_possible(self) -> bool:
        """Whether the figure is not below the least."""
        return self.cr >= self.least_cr


Pairs = Iterator[tuple[Case, Case]]


def _over_k(cases: list[Case]) -> Pairs:
    """Neighbours in k, the smaller first."""
    for m, is_high in dict.fromkeys((c.m, c.is_high) for c in cases):
        yield from pairwise(sorted(c for c in cases if (c.m, c.is_high) == (m, is_high)))


def _over_m(cases: list[Case]) -> Pairs:
    """Neighbours in m, the smaller first."""
    for k, is_high in dict.fromkeys((c.k, c.is_high) for c in cases):
        yield from pairwise(sorted(c for c in cases if (c.k, c.is_high) == (k, is_high)))


def _worse_over_k(cases: list[Case]) -> Pairs:
    """Neighbours in k, the larger first: it should have the larger NMSE."""
    return ((b, a) for a, b in _over_k(cases))


def _low_and_high(cases: list[Case]) -> Pairs:
    """Coarse and fine directions, the coarse first: it should have the larger NMSE."""
    return ((c._replace(is_high=False), c) for c in cases if c.is_high and c._replace(is_high=False) in cases)


def _single_and_multi(cases: list[Case]) -> Pairs:
    """One frame and several, the one first."""
    return ((c._replace(m=1), c) for c in cases if c.m > 1 and c._replace(m=1) in cases)


TRENDS: Mapping[str, tuple[int, Callable[[list[Case]], Pairs]]] = {
    "CR falls with k": (0, _over_k),
    "CR falls with m": (0, _over_m),
    "multi-frame CR below single-frame": (0, _single_and_multi),
    "NMSE worsens with k": (1, _worse_over_k),
    "high directions better than low": (1, _low_and_high),
}
"""Of each: which figure of `Point`, and the pairs whose first should have the larger one."""


def trends(points: Mapping[Case, Point]) -> tuple[Trend, ...]:
    """The trends of `TRENDS` on these figures; equal figures follow no trend."""
    cases = list(points)
    found = []
    for name, (figure, pairs_of) in TRENDS.items():
        pairs = list(pairs_of(cases))
        failures = tuple((a, b) for a, b in pairs if not points[a][figure] > points[b][figure])
        found.append(Trend(name, len(pairs), failures))
    return tuple(found)


def bounds(points: Mapping[Case, Point]) -> tuple[Bound, ...]:
    """What each multi-frame figure must not be below, where there is a single-frame one beside it."""
    return tuple(
        Bound(case, point.cr, points[case._replace(m=1)].cr / case.m)
        for case, point in points.items()
        if case.m > 1 and case._replace(m=1) in points
    )
