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


# -- what is registered ---------------------------------------------------------------------------------------


@cache
def amplitude_quantisers() -> Mapping[str, type[AmplitudeSpec]]:
    """The specs of all amplitude quantisers by name."""
    from touchfield.codec.ladders import UniformSpec, WeberSpec
    from touchfield.codec.lloyd_max import LloydMaxSpec

    return MappingProxyType({"lloyd-max": LloydMaxSpec, "weber": WeberSpec, "uniform": UniformSpec})


def table_from_bytes(data: bytes) -> Table:
    """The amplitude table that `Table.to_bytes` wrote; it must fill `data`.

    Raises
    ------
    TruncatedFile, CorruptFile
        If the bytes end too early, or make no table.
    """
    from touchfield.codec.ladders import UniformTable, WeberTable
    from touchfield.codec.lloyd_max import LevelTable

    if not data:
        raise TruncatedFile("amplitude table", "no byte", "at least 1")
    for table in (LevelTable, WeberTable, UniformTable):
        if table.kind == data[0]:
            return table._from_payload(data[1:])
    raise CorruptFile("amplitude table", f"kind {data[0]}", "0 (levels), 1 (Weber) or 2 (uniform)")
