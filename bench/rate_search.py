"""The bytes of a coder at an equal error: few trials of its step, log bytes between them against dB."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

Trial = tuple[float, ...]
"""NMSE in dB, then one or more sizes."""

PAST_DB = 0.15
"""How far beyond the target a trial is aimed, so that the target lies between it and the nearest."""
NOISE = 1.08
"""Steps nearer than this are not told apart: an encoder that weighs bits is off by half a dB at times."""
USUAL_SLOPE = -math.log(2) / 6.02
"""Of log size against dB where nothing else is known: one bit of six or so a component for 6 dB."""


@dataclass
class Search:
    """Trials of a step until two of them hold the target closely between them.

    Parameters
    ----------
    code : callable
        ``code(step) -> (nmse_db, size, ...)``; a coarser step gives a larger error, about 20 dB for a factor of 10.
    target_db, start : float
        The NMSE, and the first step.
    trials : int
        At most.
    within_db : float
        So near on both sides is enough: a size is then interpolated, log size against dB. So are steps as near as
        `NOISE`.
    near_db : float
        A single trial so near is enough, too: its size is carried to the target along the slope between it and the
        next nearest trial, or along `slope` where there is no other.
    """

    code: Callable[[float], Trial]
    target_db: float
    start: float
    trials: int = 7
    within_db: float = 0.5
    near_db: float = 0.03
    slope: float = USUAL_SLOPE
    tried: dict[float, Trial] = field(default_factory=dict)

    def run(self) -> Search:
        """Try until it is near enough."""
        step = self.start
        for n in range(self.trials):
            self.tried[step] = self.code(step)
            if self._is_near_enough():
                break
            step = self._next(n)
        return self

    def _sides(self) -> tuple[float | None, float | None]:
        """The steps of the nearest trials at most at the target, and above it."""
        finer = [s for s, (db, *_) in self.tried.items() if db <= self.target_db]
        coarser = [s for s, (db, *_) in self.tried.items() if db > self.target_db]
        return (
            max(finer, key=lambda s: (self.tried[s][0], s), default=None),
            min(coarser, key=lambda s: (self.tried[s][0], s), default=None),
        )

    def _is_near_enough(self) -> bool:
        low, high = self._sides()
        if abs(self._nearest()[0][0] - self.target_db) <= self.near_db:
            return True
        if low is None or high is None:
            return False
        return self.tried[high][0] - self.tried[low][0] <= self.within_db or high / low < NOISE

    def _nearest(self) -> list[Trial]:
        return sorted(self.tried.values(), key=lambda trial: abs(trial[0] - self.target_db))

    def _next(self, n: int) -> float:
        low, high = self._sides()
        if low is not None and high is not None and n % 3 == 2:
            return math.sqrt(low * high)
        if low is not None and high is not None:
            edge = min((low, high), key=lambda s: abs(self.tried[s][0] - self.target_db))
        else:  # beyond all of them, which need not lie in order
            edge = max(self.tried) if high is None else min(self.tried)
        past = PAST_DB if self.tried[edge][0] <= self.target_db else -PAST_DB
        aimed = edge * 10 ** ((self.target_db + past - self.tried[edge][0]) / self._db_a_decade())
        if low is not None and high is not None:
            share = math.log(aimed / low) / math.log(high / low)
            aimed = low * (high / low) ** min(0.97, max(0.03, share))
        return aimed

    def _db_a_decade(self) -> float:
        """Of step, by the two trials nearest to the target."""
        steps = sorted(self.tried, key=lambda s: abs(self.tried[s][0] - self.target_db))[:2]
        if len(steps) < 2:
            return 20.0
        slope = (self.tried[steps[1]][0] - self.tried[steps[0]][0]) / math.log10(steps[1] / steps[0])
        return slope if 5 <= slope <= 60 else 20.0

    def size(self, which: int = 0) -> float:
        """One of the sizes at the target; NaN where no trial came near it."""
        return interpolated(
            [(sizes[which], db) for db, *sizes in self.tried.values()],
            self.target_db,
            near_db=max(self.near_db, 0.02),
            slope=self.slope,
        )

    def step(self) -> float:
        """The step at the target; the nearest that was tried where no trial came near it."""
        step = interpolated([(s, db) for s, (db, *_) in self.tried.items()], self.target_db, near_db=0.0)
        nearest = min(self.tried, key=lambda s: abs(self.tried[s][0] - self.target_db))
        return step if math.isfinite(step) else nearest

    def slope_found(self, which: int = 0) -> float:
        """Of log size against dB between the two nearest trials, or `slope`."""
        return _slope([(sizes[which], db) for db, *sizes in self._nearest()], self.slope)


def _slope(points: list[tuple[float, float]], usual: float) -> float:
    if len(points) < 2:
        return usual
    (a, a_db), (b, b_db) = points[:2]
    if not 0.2 <= abs(a_db - b_db) <= 8 or min(a, b) <= 0:
        return usual
    found = math.log(a / b) / (a_db - b_db)
    return found if -0.4 <= found <= -0.01 else usual


def at_error(
    code: Callable[[float], tuple[float, float]], target_db: float, start: float, *, trials: int = 7
) -> float:
    """Bytes at an NMSE of `target_db`, of ``code(step) -> (bytes, nmse_db)``; NaN if no trial comes near it."""

    def turned(step: float) -> Trial:
        size, nmse_db = code(step)
        return nmse_db, size

    return Search(turned, target_db, start, trials).run().size()


def interpolated(
    points: list[tuple[float, float]], target_db: float, *, near_db: float = 0.02, slope: float = USUAL_SLOPE
) -> float:
    """The first of (size, dB) at `target_db`.

    Log size against dB by the nearest on both sides; where all are on one side, the nearest carried along the slope
    if it is at most `near_db` away, and else NaN.
    """
    near = sorted(points, key=lambda p: abs(p[1] - target_db))
    below = next((p for p in near if p[1] <= target_db), None)
    above = next((p for p in near if p[1] > target_db), None)
    if below is not None and above is not None and min(below[0], above[0]) > 0:
        share = (target_db - below[1]) / (above[1] - below[1])
        return float(math.exp(math.log(below[0]) * (1 - share) + math.log(above[0]) * share))
    if not near or abs(near[0][1] - target_db) > near_db:
        return math.nan
    return float(near[0][0] * math.exp(_slope(near, slope) * (target_db - near[0][1])))
