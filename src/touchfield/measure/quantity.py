"""A measured quantity: never a bare number (paper section 3.1, which names neither Q nor the random variable).

Every measure of this room returns a `Quantity`, which says what the number is an estimate of: the unit, the
quantiser Q, the weighting mu of the samples, the estimator, how many samples and symbols it saw, and an interval.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from touchfield.errors import InvalidArgument
from touchfield.measure.bootstrap import Interval

WEIGHTINGS = ("samples", "voxel", "object", "interaction")
"""mu: each sample of an array as often as it is there; each voxel of the lattice; each voxel whose quantised force
is not zero; each voxel as often as a probe was there."""


class FewSamplesWarning(UserWarning):
    """There are fewer than ten samples to a symbol: the estimate is more bias than data."""


@dataclass(frozen=True)
class Quantity:
    """A number with what it means.

    Attributes
    ----------
    name : str
        The usual notation: "H(S)", "I(X;Y)", "WMR".
    value : float
        NaN where the quantity does not exist; `notes` then says why.
    unit : str
        "bit/sample", "bit/supported voxel", "bit/frame", "bit", "1", "sqrt(bit)".
    quantiser : str
        Q; "as given" where symbols were given.
    weighting : str
        mu, one of `WEIGHTINGS`.
    estimator : str
        Its registered name; "exact" for a quantity of given probabilities.
    samples : int
        n, how many samples were seen; 0 for given probabilities.
    symbols : int
        K, how many different symbols were seen (of pairs for a joint quantity).
    interval : Interval or None
    notes : tuple of str
        What a reader must know: few samples, why a value is NaN, which guard acted.
    """

    name: str
    value: float
    unit: str
    quantiser: str = "as given"
    weighting: str = "samples"
    estimator: str = "plug-in"
    samples: int = 0
    symbols: int = 0
    interval: Interval | None = None
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.weighting not in WEIGHTINGS:
            raise InvalidArgument("weighting", repr(self.weighting), f"one of {', '.join(WEIGHTINGS)}")
        if math.isnan(self.value) and not self.notes:
            raise InvalidArgument(self.name, "NaN without a reason", "a note that says why")

    def __float__(self) -> float:
        return float(self.value)

    def of(self, **changes: Any) -> Quantity:
        """The same quantity with other fields, such as the quantiser and the weighting that only the caller knows."""
        return replace(self, **changes)

    def times(self, factor: float, unit: str, name: str | None = None) -> Quantity:
        """The quantity and its interval in another unit: bits a sample times samples a frame are bits a frame."""
        i = self.interval
        scaled = None if i is None else Interval(i.low * factor, i.high * factor, i.level, i.method)
        return replace(self, name=name or self.name, value=self.value * factor, unit=unit, interval=scaled)

    def summary(self) -> dict[str, Any]:
        """Stable keys for people and programs; NaN becomes None, which JSON can hold."""
        i = self.interval
        return {
            "name": self.name,
            "value": None if math.isnan(self.value) else self.value,
            "unit": self.unit,
            "interval": None
            if i is None
            else {
                "low": i.low,
                "high": i.high,
                "level": i.level,
                "method": i.method,
                "population": i.population,
            },
            "quantiser": self.quantiser,
            "weighting": self.weighting,
            "estimator": self.estimator,
            "samples": self.samples,
            "symbols": self.symbols,
            "notes": list(self.notes),
        }

    def __str__(self) -> str:
        """One line: value, interval, unit, and what it is of."""
        i = self.interval
        spread = "" if i is None else f" [{i.low:.6g}, {i.high:.6g}]"
        return f"{self.name} = {self.value:.6g}{spread} {self.unit} (Q {self.quantiser}, mu {self.weighting})"
