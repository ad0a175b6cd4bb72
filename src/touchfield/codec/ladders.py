"""Amplitude quantisers with formulas for their levels: the Weber ladder and the uniform steps (paper eq. 6)."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from touchfield.codec.stage import Claim, Table, checked_amplitudes, read_only, rounded_up, unpacked
from touchfield.errors import CorruptFile, InvalidArgument
from touchfield.perception.weber import WeberLadder

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Float32s = NDArray[np.float32]

__all__ = ["UniformSpec", "UniformTable", "WeberSpec", "WeberTable"]

_SMALLEST_FORCE_N = 1e-30
_WIDEST_SPAN = 1e24  # of a ladder of so many steps: from 1 uN down, its levels are still numbers
_HAIR = 1e-9

# -- the Weber ladder as a stage ------------------------------------------------------------------------------


@dataclass(frozen=True)
class WeberSpec:
    """The corrected eq. 6: as many levels as the mask k |F| needs, and no more.

    Parameters
    ----------
    k : float
        Weber fraction.
    force_min_n : float
        F_min: what is weaker becomes zero, newtons.
    force_max_n : float or None
        F_max, newtons; None takes the largest amplitude of the data.
    criterion : str
        "error" or "neighbours", see `touchfield.perception.weber`.
    steps : int or None
        Exactly so many levels above zero: F_min is then what they leave, F_max / rho^steps, and
        `force_min_n` only serves where the data have no force. 63 at k = 0.05 span 547:1, 6 bits with the zero.
    """

    k: float = 0.1
    force_min_n: float = 0.03
    force_max_n: float | None = None
    criterion: str = "error"
    steps: int | None = None

    def __post_init__(self) -> None:
        top = self.force_min_n if self.force_max_n is None else self.force_max_n
        WeberLadder.spanning(self.k, self.force_min_n, top, self.criterion)
        if self.steps is not None:
            ratio = WeberLadder(self.k, _SMALLEST_FORCE_N, 1, self.criterion).ratio
            if not (self.steps >= 1 and self.steps * math.log(ratio) <= math.log(_WIDEST_SPAN)):
                found, expected = (
                    f"{self.steps} steps at k = {self.k:g}",
                    f"from 1 on, to a span of {_WIDEST_SPAN:g}:1",
                )
                raise InvalidArgument("Weber ladder", found, expected, "Take fewer bits (--nq) or a smaller --k.")

    def fit(self, amplitudes_n: Float32s) -> WeberTable:
        """The ladder; the data give its upper end, if that was left open."""
        top = self.force_max_n
        if self.steps is not None:
            top = top or float(checked_amplitudes(amplitudes_n).max(initial=0.0)) or self.force_min_n
            return WeberTable(_reaching(self.k, top, self.steps, self.criterion))
        if top is None:
            top = max(self.force_min_n, float(checked_amplitudes(amplitudes_n).max(initial=0.0)))
        return WeberTable(WeberLadder.spanning(self.k, self.force_min_n, top, self.criterion))


def _reaching(k: float, top_n: float, steps: int, criterion: str) -> WeberLadder:
    """The ladder of so many steps that ends at `top_n`, or a hair above: rounding must not leave the top out."""
    span = steps * math.log(WeberLadder(k, _SMALLEST_FORCE_N, 1, criterion).ratio)
    force_min_n = math.exp(math.log(top_n) - span) * (1 + _HAIR)
    return WeberLadder(k, max(_SMALLEST_FORCE_N, force_min_n), steps, criterion)


@dataclass(frozen=True)
class WeberTable(Table):
    """A Weber ladder with a zero bin: symbol 0 is zero, symbol i + 1 is r_i."""

    ladder: WeberLadder
    kind: ClassVar[int] = 1

    @cached_property
    def levels_n(self) -> Float32s:
        """0 and the levels of the ladder."""
        return self.ladder.levels_n

    @cached_property
    def thresholds_n(self) -> Float32s:
        """F_min and the borders of the ladder, rounded up to float32."""
        return read_only(rounded_up(self.ladder.thresholds_n))

    @property
    def claim(self) -> Claim:
        """Relative error within k from F_min to the end of the ladder; below, the error is |F| < F_min."""
        ladder = self.ladder
        bound = ladder.k if ladder.criterion == "error" else ladder.k / (2 + ladder.k)
        return Claim("relative", bound, ladder.force_min_n, ladder.force_max_n)

    def _payload(self) -> bytes:
        ladder = self.ladder
        return struct.pack("<ddHB", ladder.k, ladder.force_min_n, ladder.steps, ladder.criterion == "neighbours")

    @classmethod
    def _from_payload(cls, data: bytes) -> WeberTable:
        k, force_min_n, steps, neighbours = unpacked("<ddHB", data, "Weber table")
        if neighbours > 1:
            raise CorruptFile("Weber table", f"criterion {neighbours}", "0 or 1")
        try:
            return cls(WeberLadder(k, force_min_n, steps, "neighbours" if neighbours else "error"))
        except InvalidArgument as error:
            raise CorruptFile("Weber table", error.found, error.expected) from error


# -- the uniform quantiser as a stage -------------------------------------------------------------------------


@dataclass(frozen=True)
class UniformSpec:
    """Eq. 6 with one step for all amplitudes.

    Parameters
    ----------
    step_n : float
        Delta, newtons.
    """

    step_n: float

    def __post_init__(self) -> None:
        UniformTable(self.step_n, 1)

    def fit(self, amplitudes_n: Float32s) -> UniformTable:
        """As many steps as the largest amplitude of the data needs."""
        top = float(checked_amplitudes(amplitudes_n).max(initial=0.0))
        return UniformTable(self.step_n, math.floor(min(top / self.step_n, 1e9) + 0.5) + 1)


@dataclass(frozen=True)
class UniformTable(Table):
    """Levels 0, Delta, 2 Delta, ...

    Parameters
    ----------
    step_n : float
        Delta, newtons, 1e-30 to 1e30.
    count : int
        Levels, 1 to 65536.
    """

    step_n: float
    count: int
    kind: ClassVar[int] = 2

    def __post_init__(self) -> None:
        if not 1e-30 <= self.step_n <= 1e30:
            raise InvalidArgument("step_n", repr(self.step_n), "newtons, from 1e-30 to 1e30")
        if not 1 <= self.count <= 1 << 16:
            raise InvalidArgument("uniform quantiser", f"{self.count} levels", "1 to 65536", "Take a larger step_n.")

    @cached_property
    def levels_n(self) -> Float32s:
        """Multiples of the step."""
        return read_only((self.step_n * np.arange(self.count)).astype(np.float32))

    @property
    def claim(self) -> Claim:
        """Half a step, and the rounding of the top level to float32."""
        top = self.step_n * (self.count - 0.5)
        return Claim("absolute", self.step_n / 2 + top * 2.0**-23, 0.0, top)

    def _payload(self) -> bytes:
        return struct.pack("<dI", self.step_n, self.count)

    @classmethod
    def _from_payload(cls, data: bytes) -> UniformTable:
        step_n, count = unpacked("<dI", data, "uniform table")
        try:
            return cls(step_n, count)
        except InvalidArgument as error:
            raise CorruptFile("uniform table", error.found, error.expected) from error
