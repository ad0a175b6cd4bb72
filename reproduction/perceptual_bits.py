"""The "perceptual filter" of tables 1 and 2 as quantisers: 18 bits for a force vector, or 6 bits for a
magnitude.

The paper says how many bits and nothing else. Of a vector of 3 x 32 bits, six each is the simplest reading,
as 32 become six for a device of type 2; six for the amplitude and twelve for the direction is the other. Both
have their last level end at F_max, and use all codewords that the bits have.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.codec.paper.directions import Codebook
from touchfield.codec.paper.field_quantiser import Components, FieldQuantiser, Pairs
from touchfield.codec.paper.quantisers import weber_levels
from touchfield.perception.weber import WeberLadder

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = [
    "K_AMPLITUDE",
    "K_COMPONENT",
    "LEVELS",
    "PerceptualFilter",
    "six_and_twelve",
    "six_bits",
    "three_times_six",
]

K_COMPONENT: Final = 0.1
"""Weber fraction of each signed component: 31 levels span 503 : 1."""

K_AMPLITUDE: Final = 0.05
"""Weber fraction of the amplitude: 63 levels span 547 : 1."""

LEVELS: Final = 63
DIRECTIONS: Final = "ico20"
SLACK: Final = 1 + 1e-6  # what rounding to float32 adds to a force


class PerceptualFilter:
    """A quantiser of forces, and the codewords of its symbols.

    Parameters
    ----------
    quantiser : FieldQuantiser
    force_min_n : float
        Below this an amplitude, or a component, becomes zero.
    """

    def __init__(self, quantiser: FieldQuantiser, force_min_n: float) -> None:
        self.quantiser, self.force_min_n = quantiser, force_min_n
        self.text = quantiser.text
        self.symbols_of = quantiser.symbols_of

    @property
    def bits(self) -> int:
        """Of a sample, written plainly."""
        return math.ceil(math.log2(self.quantiser.alphabet))

    def vectors_of(self, symbols: NDArray[np.int32]) -> NDArray[np.float32]:
        """The codewords, newtons, float32 [m, 3]; of a magnitude alone along +z, as an actuator pushes."""
        quantiser = self.quantiser
        if not isinstance(quantiser, Pairs) or quantiser.codebook is not None:
            return quantiser.vectors_of(symbols)
        vectors = np.zeros((len(symbols), 3), np.float32)
        vectors[:, 2] = quantiser.levels.levels_n[symbols]
        return vectors

    def worst_error(self, vectors_n: NDArray[np.float32], floor_n: float) -> float:
        """The largest |Q(F) - F| / |F| of forces of `floor_n` newtons or more; 0 where there is none."""
        size = np.linalg.norm(vectors_n.astype(np.float64), axis=1)
        strong = vectors_n[size >= floor_n]
        error = np.linalg.norm(self.vectors_of(self.symbols_of(strong)).astype(np.float64) - strong, axis=1)
        return float((error / size[size >= floor_n]).max(initial=0.0))


def three_times_six(force_max_n: float) -> PerceptualFilter:
    """Three signed components of six bits: 31 levels to each side, and zero."""
    ladder = _ladder(K_COMPONENT, LEVELS // 2, force_max_n)
    words = f"weber-components:{K_COMPONENT}/{LEVELS // 2}"
    return PerceptualFilter(Components(words, force_max_n * SLACK, weber_levels(ladder)), ladder.force_min_n)


def six_and_twelve(force_max_n: float) -> PerceptualFilter:
    """Six bits of amplitude, 63 levels and zero, and twelve of direction, 4002 vertices."""
    ladder = _ladder(K_AMPLITUDE, LEVELS, force_max_n)
    words = f"weber:{K_AMPLITUDE}, {LEVELS} levels/{DIRECTIONS}"
    pairs = Pairs(words, force_max_n * SLACK, weber_levels(ladder), Codebook.get(DIRECTIONS))
    return PerceptualFilter(pairs, ladder.force_min_n)


def six_bits(force_max_n: float) -> PerceptualFilter:
    """Six bits of magnitude for an actuator: 63 levels and zero."""
    ladder = _ladder(K_AMPLITUDE, LEVELS, force_max_n)
    words = f"weber:{K_AMPLITUDE}, {LEVELS} levels"
    return PerceptualFilter(Pairs(words, force_max_n * SLACK, weber_levels(ladder)), ladder.force_min_n)


def _ladder(k: float, steps: int, force_max_n: float) -> WeberLadder:
    return WeberLadder(k, force_max_n / WeberLadder(k, 1.0, 1).ratio ** steps, steps)
