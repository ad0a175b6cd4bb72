"""The psychometric function, the probability of a correct answer against the level of a difference, and a
simulated observer who answers by it.

The function is Weibull's: p(x) = g + (1 - g - l) (1 - exp(-(x / t)^b)), with the chance level g of the task,
the rate l of lapses, the threshold t and the slope b. At the threshold p is 63 % of the way from chance to
the highest rate: 82 % correct of two alternatives, 75 % of three, without lapses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from touchfield.arrays import Float64s
from touchfield.errors import InvalidArgument, require_between, require_positive


@dataclass(frozen=True)
class Psychometric:
    """A psychometric function; `InvalidArgument` if a number is out of range.

    `threshold` is in the unit of the levels, positive. `slope` is 0.1 to 100, `chance` 0 to below 1, `lapse`
    0 to 0.5 and below 1 - `chance`.
    """

    threshold: float
    slope: float = 3.0
    chance: float = 0.5
    lapse: float = 0.0

    def __post_init__(self) -> None:
        require_positive(threshold=self.threshold)
        require_between(0.1, 100, slope=self.slope)
        require_between(0, 0.999, chance=self.chance)
        require_between(0, min(0.5, 0.999 - self.chance), lapse=self.lapse)

    def __call__(self, levels: ArrayLike) -> Float64s:
        """Probability of a correct answer at levels of 0 or more; float64 [...]."""
        ratio = np.asarray(levels, np.float64) / self.threshold
        with np.errstate(over="ignore"):  # far above the threshold the power is infinite, and p is 1 - lapse
            rise = -np.expm1(-(ratio**self.slope))
        p: Float64s = self.chance + (1 - self.chance - self.lapse) * rise
        return p


@dataclass(frozen=True)
class SimulatedObserver:
    """An observer with a known psychometric function.

    The answer to a trial depends on its level, its number and `seed`.
    """

    function: Psychometric
    seed: int = 0

    def is_correct(self, level: float, trial: int) -> bool:
        """Whether the observer answers trial number `trial`, at this level, correctly."""
        drawn = np.random.default_rng([self.seed, trial, 1]).random()
        return bool(drawn < self.function(level))

    @classmethod
    def parse(cls, text: str, chance: float, seed: int) -> SimulatedObserver:
        """An observer from "threshold=0.1,slope=3,lapse=0.02"; `InvalidArgument` for anything else."""
        values: dict[str, float] = {}
        for part in text.split(","):
            name, _, number = part.partition("=")
            name, is_new = name.strip(), name.strip() not in values
            try:
                values[name] = float(number)
            except ValueError:
                is_new = False
            if not is_new or name not in ("threshold", "slope", "lapse"):
                expected = "threshold=NUMBER,slope=NUMBER,lapse=NUMBER, each once, the last two optional"
                raise InvalidArgument("observer", repr(text), expected)
        if "threshold" not in values:
            raise InvalidArgument("observer", repr(text), "threshold=NUMBER, in the unit of the levels")
        try:
            return cls(Psychometric(chance=chance, **values), seed)
        except InvalidArgument as error:
            found, expected = f"{error.where} {error.found}", f"{error.where}: {error.expected}"
            raise InvalidArgument("observer", found, expected, error.hint) from None
