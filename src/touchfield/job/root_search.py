"""Where a falling curve crosses zero, from as few values of it as possible: each costs an encoding."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

__all__ = ["RootSearch"]

_LARGEST_MOVE: Final = 2.1
"""Logarithms of the control move at most so far beyond what is known: a factor of 8."""
_WITHIN: Final = 0.05
"""A guess keeps this share of a bracket away from its ends."""


@dataclass
class RootSearch:
    """Search for the x in `low` to `high` where a falling y(x) is zero.

    Attributes
    ----------
    low, high : float
    slope : float
        dy/dx where nothing better is known, negative.
    points : list of (float, float)
        x and y found so far.
    """

    low: float
    high: float
    slope: float
    points: list[tuple[float, float]] = field(default_factory=list)

    def run(self, value: Callable[[float], float], start: float, is_near: Callable[[float], bool], most: int) -> bool:
        """Evaluate from `start` on until `is_near(y)`, no guess is left or `most` values are known; if it is near.

        The last of `points` is the last that was evaluated.
        """
        x: float | None = min(max(start, self.low), self.high)
        while x is not None and len(self.points) < most:
            y = value(x)
            self.points.append((x, y))
            if is_near(y):
                return True
            x = self.guess()
        return False

    def guess(self) -> float | None:
        """The next x worth a value; None where the curve does not reach zero within the bounds."""
        above = max((p for p in self.points if p[1] > 0), default=None)
        below = min((p for p in self.points if p[1] <= 0), default=None)
        if above is not None and below is not None:
            (a, up), (b, down) = above, below
            share = min(max(up / (up - down), _WITHIN), 1 - _WITHIN)
            x = a + share * (b - a)
        else:
            near = above or below  # the last on that side, also where the curve is flat
            assert near is not None
            move = -near[1] / self.measured_slope()
            x = near[0] + min(max(move, -_LARGEST_MOVE), _LARGEST_MOVE)
        x = min(max(x, self.low), self.high)
        return None if any(abs(x - known) < 1e-6 for known, _ in self.points) else x

    def measured_slope(self) -> float:
        """dy/dx between the two points that are nearest to zero; `slope` where they tell none."""
        if len(self.points) < 2:
            return self.slope
        (a, ya), (b, yb) = sorted(self.points, key=lambda p: abs(p[1]))[:2]
        found = (yb - ya) / (b - a) if b != a else 0.0
        return found if 4 * self.slope < found < self.slope / 8 else self.slope
