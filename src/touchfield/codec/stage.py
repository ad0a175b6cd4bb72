"""What a coding stage is (paper figure 4, "quantisation" and its inverse), and the amplitude stages there are.

A *spec* says what was asked for. ``spec.fit(data)`` gives what was resolved, a *fitted stage*: it encodes values to
symbols and symbols back to values, travels in the stream as its own bytes, and makes a `Claim` about its error that
one shared test measures on everything registered (after numcodecs' battery and diffrax' declared orders).

Two kinds are registered: amplitude quantisers (`amplitude_quantisers`; each gives a `Table`), and direction
codebooks (`touchfield.codec.directions`). A new amplitude quantiser is a spec, a table with a kind of its own, and
a line in each of the two functions at the end.
"""

from __future__ import annotations

import math
import struct
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

import numpy as np

from touchfield.errors import CorruptFile, InvalidArgument, TruncatedFile
from touchfield.perception.weber import WeberLadder

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Float32s = NDArray[np.float32]
    Symbols = NDArray[np.uint16]

__all__ = [
    "CLAIMS",
    "AmplitudeSpec",
    "Claim",
    "FittedStage",
    "Table",
    "UniformSpec",
    "UniformTable",
    "WeberSpec",
    "WeberTable",
    "amplitude_quantisers",
    "checked_amplitudes",
    "read_only",
    "rounded_up",
    "table_from_bytes",
    "unpacked",
]

CLAIMS = ("lossless", "absolute", "relative", "angle")


@dataclass(frozen=True)
class Claim:
    """What a fitted stage promises about its error.

    Attributes
    ----------
    kind : str
        "lossless"; "absolute": |x - y| <= bound (newtons); "relative": |x - y| <= bound |x|;
        "angle": the angle between x and y is at most `bound` (radians).
    bound : float
        0 for lossless.
    low, high : float
        The promise is for values in low <= |x| <= high.
    """

    kind: str
    bound: float = 0.0
    low: float = 0.0
    high: float = math.inf

    def __post_init__(self) -> None:
        if self.kind not in CLAIMS:
            raise InvalidArgument("claim", repr(self.kind), f"one of {', '.join(CLAIMS)}")

    def worst(self, values: NDArray[Any], decoded: NDArray[Any]) -> float:
        """The largest error of `decoded`, in the measure of the claim, over the values it is made for.

        Amplitudes [m], or vectors [m, 3] for an angle; 0 where no value is within low and high.
        """
        x, y = np.asarray(values, np.float64), np.asarray(decoded, np.float64)
        size = np.abs(x) if x.ndim == 1 else np.linalg.norm(x, axis=1)
        held = (size >= self.low) & (size <= self.high)
        x, y, size = x[held], y[held], size[held]
        if self.kind == "angle":
            # by the cross product: the arc cosine of the dot product loses half the digits near zero
            across = np.linalg.norm(np.cross(x, y), axis=1)
            errors = np.arctan2(across, (x * y).sum(axis=1))
        elif self.kind == "relative":
            errors = np.abs(x - y) / size
        else:
            errors = np.abs(x - y)
        return float(errors.max(initial=0.0))


class FittedStage(Protocol):
    """What every resolved stage can do; amplitude tables and direction codebooks alike."""

    @property
    def claim(self) -> Claim:
        """The promise about the error."""

    def encode(self, values: Float32s) -> Symbols:
        """Values to symbols, uint16 [m]."""

    def decode(self, symbols: Symbols) -> Float32s:
        """Symbols to values; `CorruptFile` for a symbol that there is not."""

    def to_bytes(self) -> bytes:
        """All that the decoder needs."""


class AmplitudeSpec(Protocol):
    """What was asked of an amplitude quantiser."""

    def fit(self, amplitudes_n: Float32s) -> Table:
        """The quantiser for amplitudes like these, float32 [m], newtons; none at all is allowed."""


class Table(ABC):
    """A resolved amplitude quantiser: ascending levels, and the thresholds between them.

    An amplitude equal to a threshold takes the level above it. Beyond the ends the nearest level is taken.
    """

    kind: ClassVar[int]
    """The first byte of `to_bytes`."""

    @cached_property
    @abstractmethod
    def levels_n(self) -> Float32s:
        """Reconstruction levels, newtons, float32 [n], strictly ascending, not negative, 1 to 65536."""

    @cached_property
    def thresholds_n(self) -> Float32s:
        """Borders of the cells, newtons, float32 [n - 1]: midpoints, rounded up to float32.

        For a float32 amplitude, x >= t and x >= (t rounded up to float32) are the same.
        """
        levels = self.levels_n.astype(np.float64)
        return read_only(rounded_up((levels[1:] + levels[:-1]) / 2))

    @property
    @abstractmethod
    def claim(self) -> Claim:
        """The promise about the error."""

    @abstractmethod
    def _payload(self) -> bytes:
        """What follows the kind byte."""

    @classmethod
    @abstractmethod
    def _from_payload(cls, data: bytes) -> Table:
        """The inverse of `_payload`; raises `TruncatedFile` or `CorruptFile`."""

    def to_bytes(self) -> bytes:
        """The kind byte, and what this kind needs; `table_from_bytes` is the inverse."""
        return bytes([self.kind]) + self._payload()

    @staticmethod
    def from_bytes(data: bytes) -> Table:
        """See `table_from_bytes`."""
        return table_from_bytes(data)

    @cached_property
    def _lookup(self) -> Any:
        from touchfield.codec.kernels.quantise import LevelLookup

        return LevelLookup(self.thresholds_n)

    def encode(self, values: Float32s) -> Symbols:
        """Levels of amplitudes [m] in newtons, uint16 [m].

        Raises
        ------
        InvalidArgument
            If an amplitude is negative or not finite.
        """
        amplitudes = checked_amplitudes(values, whole=False)
        symbols: Symbols
        symbols, good = self._lookup(amplitudes)
        if not good:
            checked_amplitudes(amplitudes)  # -0.0 is good, and only looks negative
        return symbols

    def decode(self, symbols: Symbols) -> Float32s:
        """Amplitudes of levels, newtons, float32 [m].

        Raises
        ------
        CorruptFile
            If there is no such level.
        """
        if len(symbols) and int(symbols.max()) >= len(self.levels_n):
            raise CorruptFile("amplitude level", str(int(symbols.max())), f"below {len(self.levels_n)}")
        return self.levels_n[symbols]


def read_only(array: Float32s) -> Float32s:
    """`array` itself, no longer to be written."""
    array.flags.writeable = False
    return array


def rounded_up(thresholds: NDArray[np.float64]) -> Float32s:
    """The smallest float32 at or above each float64."""
    nearest = thresholds.astype(np.float32)
    return np.where(nearest < thresholds, np.nextafter(nearest, np.float32(np.inf)), nearest)


def checked_amplitudes(values: NDArray[Any], whole: bool = True) -> Float32s:
    """`values` as contiguous float32 [m]; with `whole` also looked through for what is no amplitude.

    Raises
    ------
    InvalidArgument
        If the shape is another, or an amplitude is negative or not finite.
    """
    amplitudes = np.ascontiguousarray(values, np.float32)
    if amplitudes.ndim != 1:
        raise InvalidArgument("amplitudes", f"shape {amplitudes.shape}", "one axis")
    if whole and not (np.isfinite(amplitudes).all() and amplitudes.min(initial=0.0) >= 0):
        raise InvalidArgument("amplitudes", "one that is negative or not finite", "0 newtons or more")
    return amplitudes


def unpacked(layout: str, data: bytes, where: str) -> tuple[Any, ...]:
    """`struct.unpack` of all of `data`, with this package's errors."""
    size = struct.calcsize(layout)
    if len(data) < size:
        raise TruncatedFile(where, f"{len(data)} bytes", f"{size}")
    if len(data) > size:
        raise CorruptFile(where, f"{len(data)} bytes", f"{size}")
    return struct.unpack(layout, data)


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
    """

    k: float = 0.1
    force_min_n: float = 0.03
    force_max_n: float | None = None
    criterion: str = "error"

    def __post_init__(self) -> None:
        top = self.force_min_n if self.force_max_n is None else self.force_max_n
        WeberLadder.spanning(self.k, self.force_min_n, top, self.criterion)

    def fit(self, amplitudes_n: Float32s) -> WeberTable:
        """The ladder; the data give its upper end, if that was left open."""
        top = self.force_max_n
        if top is None:
            top = max(self.force_min_n, float(checked_amplitudes(amplitudes_n).max(initial=0.0)))
        return WeberTable(WeberLadder.spanning(self.k, self.force_min_n, top, self.criterion))


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


# -- what is registered ---------------------------------------------------------------------------------------


@cache
def amplitude_quantisers() -> Mapping[str, type[AmplitudeSpec]]:
    """The specs of all amplitude quantisers by name."""
    from touchfield.codec.lloyd_max import LloydMaxSpec

    return MappingProxyType({"lloyd-max": LloydMaxSpec, "weber": WeberSpec, "uniform": UniformSpec})


def table_from_bytes(data: bytes) -> Table:
    """The amplitude table that `Table.to_bytes` wrote; it must fill `data`.

    Raises
    ------
    TruncatedFile, CorruptFile
        If the bytes end too early, or make no table.
    """
    from touchfield.codec.lloyd_max import LevelTable

    if not data:
        raise TruncatedFile("amplitude table", "no byte", "at least 1")
    for table in (LevelTable, WeberTable, UniformTable):
        if table.kind == data[0]:
            return table._from_payload(data[1:])
    raise CorruptFile("amplitude table", f"kind {data[0]}", "0 (levels), 1 (Weber) or 2 (uniform)")
