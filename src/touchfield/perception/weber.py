"""The corrected perceptual quantiser of amplitudes: a ladder whose steps grow with the force (paper eq. 6).

Eq. 6 as printed, with Delta = k |x|, is a gain and no quantiser (`touchfield.perception.jnd_quantiser`). What
figure 2 asks for, an error that never leaves the mask k |x|, is met with the fewest levels by cells whose
borders grow by a constant ratio::

    t_i = F_min rho^i     rho = (1 + kappa) / (1 - kappa)     r_i = (1 + kappa) t_i

The relative error in a cell is at most kappa, reached at both of its ends; (r_i + r_{i+1}) / 2 = t_{i+1}, so that
the ladder is also a nearest-neighbour quantiser. (Geometric midpoints as borders break the mask: 0.1055 at 0.1.)
Below F_min is a zero bin; the sign belongs to the direction.

The paper has two criteria. "error" (figure 2, default): the error stays within the mask, kappa = k. "neighbours"
(text of section 4.2): two neighbouring levels lie within the mask of each other, rho = 1 + k, which takes about
twice the levels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from touchfield.errors import InvalidArgument

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["CRITERIA", "MAX_STEPS", "WeberLadder"]

CRITERIA = ("error", "neighbours")

MAX_STEPS = 65535
"""Steps above the zero bin: with it they fill 16-bit symbols."""

_NARROWING = 2.0**-22
"""Taken off kappa, so that rounding levels to float32 cannot lift the error above it."""

_SMALLEST_K = 1e-5
_SMALLEST_FORCE_N = 1e-30
_LARGEST_FORCE_N = 1e30


@dataclass(frozen=True)
class WeberLadder:
    """Levels and borders that keep the relative error within k.

    k : float; weber fraction, 1e-5 or more and less than 1.
    force_min_n : float; F_min, newtons: what is weaker becomes zero.
    steps : int; N, the levels above the zero bin, 1 to 65535.
    criterion : str; "error" or "neighbours".
    Raises `InvalidArgument` if a number is out of range, or the ladder passes 1e30 N.
    """

    k: float
    force_min_n: float
    steps: int
    criterion: str = "error"

    def __post_init__(self) -> None:
        if self.criterion not in CRITERIA:
            raise InvalidArgument("criterion", repr(self.criterion), " or ".join(CRITERIA))
        if not _SMALLEST_K <= self.k < 1:
            raise InvalidArgument("k", repr(self.k), f"a Weber fraction from {_SMALLEST_K} to 1, such as 0.1")
        if not _SMALLEST_FORCE_N <= self.force_min_n <= _LARGEST_FORCE_N:
            raise InvalidArgument("force_min_n", repr(self.force_min_n), "newtons, from 1e-30 to 1e30")
        if not 1 <= self.steps <= MAX_STEPS:
            raise InvalidArgument(
                "Weber ladder", f"{self.steps} steps", f"1 to {MAX_STEPS}", "Raise k or force_min_n."
            )
        if math.log(self.force_min_n) + self.steps * math.log(self.ratio) > math.log(2 * _LARGEST_FORCE_N):
            raise InvalidArgument("Weber ladder", f"{self.steps} steps", "levels below 1e30 N")

    @classmethod
    def spanning(cls, k: float, force_min_n: float, force_max_n: float, criterion: str = "error") -> WeberLadder:
        """The ladder with the fewest levels from `force_min_n` to `force_max_n`, newtons.

        N = ceil(ln(F_max / F_min) / ln rho), at least 1.
        """
        ratio = cls(k, force_min_n, 1, criterion).ratio
        if not 0 < force_max_n <= _LARGEST_FORCE_N:
            raise InvalidArgument("force_max_n", repr(force_max_n), "newtons, above 0 and up to 1e30")
        octaves = (math.log(force_max_n) - math.log(force_min_n)) / math.log(ratio)
        return cls(k, force_min_n, max(1, math.ceil(octaves)), criterion)

    @property
    def kappa(self) -> float:
        """The largest relative error within the ladder, before float32 rounding."""
        kappa = self.k if self.criterion == "error" else self.k / (2 + self.k)
        return kappa - _NARROWING

    @property
    def ratio(self) -> float:
        """rho: the ratio of neighbouring borders, and of neighbouring levels."""
        return (1 + self.kappa) / (1 - self.kappa)

    @cached_property
    def thresholds_n(self) -> NDArray[np.float64]:
        """t_0 .. t_{N-1}, newtons, float64 [N]: an amplitude of t_i or more and less than t_{i+1} takes level i + 1.

        By multiplication one after the other, so that every machine has the same bits.
        """
        thresholds = np.cumprod(np.concatenate([[self.force_min_n], np.full(self.steps - 1, self.ratio)]))
        thresholds.flags.writeable = False
        return thresholds

    @cached_property
    def levels_n(self) -> NDArray[np.float32]:
        """0, r_0 .. r_{N-1}, newtons, float32 [N + 1]."""
        levels = np.concatenate([[0.0], (1 + self.kappa) * self.thresholds_n]).astype(np.float32)
        levels.flags.writeable = False
        return levels

    @property
    def force_max_n(self) -> float:
        """t_N, newtons: up to here the relative error is kept."""
        return float(self.thresholds_n[-1]) * self.ratio
