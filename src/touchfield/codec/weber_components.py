"""Each signed component of a force on a Weber ladder of its own (paper table 1, "perceptual filter: 18 bits").

The simplest reading of the paper's 18 bits for a vector of 96: three times six bits, as 32 become six for a device
of type 2. Six bits take 31 levels to each side and zero, 63 codewords. Where every component is beyond F_min the
error of each is within k of it, and so |e| <= k |F|; a component below F_min becomes zero, and up to sqrt(3) F_min
is lost.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.codec.ladders import WeberTable
from touchfield.errors import InvalidArgument
from touchfield.perception.weber import WeberLadder

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["MOST_LEVELS", "WeberComponents"]

MOST_LEVELS: Final = 511
"""To each side, so that a triple stays within 2^30 symbols."""


@dataclass(frozen=True)
class WeberComponents:
    """Q of three signed components; symbol 0 is "no force".

    Parameters
    ----------
    ladder : WeberLadder
        Of the modulus of each component, at most `MOST_LEVELS` steps.

    Raises
    ------
    InvalidArgument
        If the ladder has more steps.
    """

    ladder: WeberLadder

    def __post_init__(self) -> None:
        if self.ladder.steps > MOST_LEVELS:
            raise InvalidArgument("weber-components", f"{self.ladder.steps} levels", f"1 to {MOST_LEVELS}")

    @classmethod
    def below(cls, k: float, steps: int, force_max_n: float) -> WeberComponents:
        """With as many steps as asked for, the last of which ends at `force_max_n` newtons."""
        ratio = WeberLadder(k, 1.0, 1).ratio
        if not 1 <= steps <= MOST_LEVELS:
            raise InvalidArgument("weber-components", f"{steps} levels", f"1 to {MOST_LEVELS}")
        return cls(WeberLadder(k, force_max_n / ratio**steps, steps))

    @property
    def side(self) -> int:
        """Codewords of one component."""
        return 2 * self.ladder.steps + 1

    @property
    def alphabet(self) -> int:
        """K, "no force" among them."""
        return self.side**3

    def symbols_of(self, vectors_n: NDArray[np.float32]) -> NDArray[np.int32]:
        """The symbols of force vectors, newtons, float32 [m, 3], int32 [m]."""
        size = np.ascontiguousarray(np.abs(vectors_n).reshape(-1))
        level = self._table.encode(size).astype(np.int64).reshape(-1, 3)
        signed = np.where(vectors_n < 0, -level, level) + self.ladder.steps
        index = (signed[:, 0] * self.side + signed[:, 1]) * self.side + signed[:, 2]
        symbols: NDArray[np.int32] = ((index - self._centre) % self.alphabet).astype(np.int32)
        return symbols

    def vectors_of(self, symbols: NDArray[np.int32]) -> NDArray[np.float32]:
        """The codewords of symbols [m], newtons, float32 [m, 3]."""
        index = (symbols.astype(np.int64) + self._centre) % self.alphabet
        places = np.unravel_index(index, (self.side,) * 3)
        signed = np.stack(places, axis=-1) - self.ladder.steps
        words: NDArray[np.float32] = self.ladder.levels_n[np.abs(signed)] * np.sign(signed).astype(np.float32)
        return words

    @cached_property
    def _table(self) -> WeberTable:
        return WeberTable(self.ladder)

    @property
    def _centre(self) -> int:
        return (self.alphabet - 1) // 2
