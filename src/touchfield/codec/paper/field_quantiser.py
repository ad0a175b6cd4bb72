"""Q of the measures: a force vector becomes one symbol (paper section 3.1; theory: "every entropy must state
Q").

In words such as a command line takes:

* ``AMPLITUDE:NUMBER/DIRECTIONS``: an amplitude quantiser of the coder (``weber:0.1``, the Weber fraction;
  ``uniform:0.05``, the step in newtons; ``lloyd-max:6``, bits) times a direction codebook (``ico5`` if none
  is named, ``none`` for the amplitude alone). The symbol is the pair.
* ``components:0.05``: each component in uniform steps of so many newtons (eq. 6, one Delta). The symbol is
  the triple.
* ``weber-components:0.1/31``: each signed component on a Weber ladder of k and so many levels to each side,
  the last of which ends at F_max (paper table 1: three times six bits). The symbol is the triple. Where every
  component is beyond F_min the error is within k |F|; one below becomes zero, and up to sqrt(3) F_min is
  lost.
* ``distinct``: nothing is quantised; every different vector of the fields is a symbol. For fields that were
  decoded.

Symbol 0 is "no force": where the amplitude falls into the zero bin, too.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Float32s, Int32s
from touchfield.codec.paper import quantisers
from touchfield.codec.paper.directions import DEFAULT as DEFAULT_DIRECTIONS
from touchfield.codec.paper.directions import Codebook
from touchfield.codec.paper.quantisers import AmplitudeLevels, amplitudes_n
from touchfield.errors import InvalidArgument
from touchfield.measure.field_symbols import FieldSymbols
from touchfield.medium import ForceField
from touchfield.medium.grid import BRICK
from touchfield.perception.weber import WeberLadder

DEFAULT_QUANTISER: Final = "weber:0.1"
FORMS: Final = ("weber", "uniform", "lloyd-max", "components", "weber-components", "distinct")
MOST_LEVELS: Final = 511  # of one component to each side, so that a triple stays within 2^30 symbols
MOST_DISTINCT: Final = 1 << 22

_MOST_TRAINED: Final = 1 << 22  # amplitudes a Lloyd-Max quantiser is trained on; of more, evenly spaced ones
_MOST_OF_A_FRAME: Final = 1 << 20
_SLACK: Final = 1 + 1e-6


@dataclass(frozen=True, eq=False)
class FieldQuantiser(ABC):
    """Q, resolved: fields to symbols, for forces of `top_n` newtons at most."""

    words: str
    top_n: float

    @property
    @abstractmethod
    def alphabet(self) -> int:
        """K: how many symbols there are, "no force" among them."""

    @abstractmethod
    def _symbols(self, vectors_n: Float32s) -> Int32s: ...

    @abstractmethod
    def _vectors(self, symbols: Int32s) -> Float32s: ...

    def __call__(self, field: ForceField) -> FieldSymbols:
        """The symbols of one frame; see `symbols_of`."""
        symbols = np.zeros((len(field.bricks), BRICK, BRICK, BRICK), np.int32)
        symbols[field.mask] = self.symbols_of(field.forces_n[field.mask])
        return FieldSymbols(field.grid, field.bricks, symbols, self.alphabet, self.words)

    def symbols_of(self, vectors_n: Float32s) -> Int32s:
        """The symbols of force vectors, newtons, float32 [m, 3], int32 [m].

        InvalidArgument if one is greater than the quantiser was made for.
        """
        top = float(amplitudes_n(vectors_n).max(initial=0.0))
        if top > self.top_n:
            found, allowed = f"a force of {top:.6g} N", f"up to the {self.top_n:.6g} N it was made for"
            raise InvalidArgument(f"quantiser {self.words}", found, allowed, "Fit it to this field, too.")
        return self._symbols(vectors_n)

    def vectors_of(self, symbols: Int32s) -> Float32s:
        """The codewords of symbols [m], newtons, float32 [m, 3]: the inverse of `symbols_of` but for what Q
        lost.

        InvalidArgument if the quantiser keeps no direction, or there is no such symbol.
        """
        if len(symbols) and not 0 <= symbols.min() <= symbols.max() < self.alphabet:
            raise InvalidArgument(
                "symbols", f"{symbols.min()} to {symbols.max()}", f"0 to {self.alphabet - 1}"
            )
        return self._vectors(symbols)


@dataclass(frozen=True, eq=False)
class Pairs(FieldQuantiser):
    """Amplitude level times direction, of which there are N_d; without a codebook the amplitude alone.

    Symbol s > 0 is the pair divmod(s - 1, N_d).
    """

    levels: AmplitudeLevels
    codebook: Codebook | None = None

    @property
    def _directions(self) -> int:
        return 1 if self.codebook is None else len(self.codebook)

    @property
    def _zeros(self) -> int:
        return int(self.levels.levels_n[0] == 0)

    @property
    def alphabet(self) -> int:
        return 1 + (len(self.levels) - self._zeros) * self._directions

    def _symbols(self, vectors_n: Float32s) -> Int32s:
        amplitudes = amplitudes_n(vectors_n)
        levels = self.levels.encode(amplitudes).astype(np.int64) - self._zeros
        is_told = (levels >= 0) & (amplitudes != 0)
        symbols = np.zeros(len(levels), np.int32)
        direction: Any = 0 if self.codebook is None else self.codebook.nearest(vectors_n[is_told])
        symbols[is_told] = 1 + levels[is_told] * self._directions + direction
        return symbols

    def _vectors(self, symbols: Int32s) -> Float32s:
        if self.codebook is None:
            raise InvalidArgument("quantiser", "no direction", "one with directions")
        level, direction = np.divmod(np.maximum(symbols, 1) - 1, self._directions)
        amplitude = np.where(symbols > 0, self.levels.levels_n[level + self._zeros], np.float32(0))
        return amplitude[:, None] * self.codebook.vertices_float32[direction]


@dataclass(frozen=True, eq=False)
class Components(FieldQuantiser):
    """Each signed component by the levels of its modulus, of which the first is zero."""

    levels: AmplitudeLevels

    @property
    def alphabet(self) -> int:
        return (2 * len(self.levels) - 1) ** 3

    def _symbols(self, vectors_n: Float32s) -> Int32s:
        level = self.levels.encode(np.abs(vectors_n).reshape(-1)).astype(np.int64).reshape(-1, 3)
        x, y, z = np.where(vectors_n < 0, -level, level).T
        side = 2 * len(self.levels) - 1
        symbols: Int32s = (((x * side + y) * side + z) % self.alphabet).astype(np.int32)
        return symbols

    def _vectors(self, symbols: Int32s) -> Float32s:
        side, most = 2 * len(self.levels) - 1, len(self.levels) - 1
        places = (symbols.astype(np.int64) + (self.alphabet - 1) // 2) % self.alphabet
        signed = np.stack(np.unravel_index(places, (side,) * 3), axis=-1) - most
        words: Float32s = self.levels.levels_n[np.abs(signed)] * np.sign(signed).astype(np.float32)
        return words


@dataclass(frozen=True, eq=False)
class _Distinct(FieldQuantiser):
    """Every different vector, as the twelve bytes of it, ascending."""

    known: NDArray[Any]

    @property
    def alphabet(self) -> int:
        return 1 + len(self.known)

    def _symbols(self, vectors_n: Float32s) -> Int32s:
        wanted, zero = _packed(vectors_n), ~vectors_n.any(axis=1)
        place = np.minimum(np.searchsorted(self.known, wanted), max(0, len(self.known) - 1))
        if not (zero | (self.known[place] == wanted if len(self.known) else zero)).all():
            found, mend = "a force that it has not seen", "Fit it to this field, too."
            raise InvalidArgument("quantiser distinct", found, "the fields it was made for", mend)
        return np.where(zero, 0, place + 1).astype(np.int32)

    def _vectors(self, symbols: Int32s) -> Float32s:
        vectors = np.zeros((len(symbols), 3), np.float32)
        vectors[symbols > 0] = self.known[symbols[symbols > 0] - 1].view(np.float32).reshape(-1, 3)
        return vectors


def _packed(vectors_n: Float32s) -> NDArray[Any]:
    """Each vector as one value that sorts: its twelve bytes; -0.0 is 0.0."""
    rows = np.ascontiguousarray(vectors_n + np.float32(0))
    return rows.view(np.dtype((np.void, 12))).reshape(-1)


@dataclass(frozen=True)
class FieldQuantiserSpec:
    """A quantiser as it is asked for, in the parts of its words; InvalidArgument if one is unknown or out of
    range.

    `number` is k, a step in newtons or n_q, as the form has it; `directions` a codebook or "none"; `levels`
    are those of "weber-components" to each side of zero.
    """

    form: str = "weber"
    number: float = 0.1
    directions: str = DEFAULT_DIRECTIONS
    levels: int = 31

    def __post_init__(self) -> None:
        if self.form not in FORMS:
            raise InvalidArgument("quantiser", repr(self.form), f"one of {', '.join(FORMS)}")
        if not math.isfinite(self.number):
            raise InvalidArgument(f"quantiser {self.form}", repr(self.number), "a finite number")
        if self.directions != "none":
            Codebook.get(self.directions)
        if self.form != "distinct":
            self._made(self.number if "weber" not in self.form else 1.0, np.zeros(0, np.float32))

    @classmethod
    def parse(cls, text: str) -> FieldQuantiserSpec:
        """From words such as ``weber:0.1``, ``lloyd-max:6/octa3``, ``uniform:0.05/none``,
        ``components:0.02``.
        """
        if text == "distinct":
            return cls(text, 0.0, "none")
        amplitude, slash, beside = text.partition("/")
        form, _, number = amplitude.partition(":")
        takes = {"components": not slash, "weber-components": beside.isdecimal()}.get(
            form, not slash or beside
        )
        value = math.nan
        with suppress(ValueError):
            value = float(number) if takes else math.nan
        if not math.isfinite(value):
            expected = "FORM:NUMBER, FORM:NUMBER/DIRECTIONS or weber-components:K/LEVELS, such as weber:0.1"
            raise InvalidArgument("quantiser", repr(text), expected)
        if form in ("components", "weber-components"):
            return cls(form, value, "none", int(beside or cls.levels))
        return cls(form, value, beside or DEFAULT_DIRECTIONS)

    @property
    def words(self) -> str:
        """Words that `parse` takes."""
        if self.form == "distinct":
            return self.form
        amplitude = f"{self.form}:{self.number!r}".removesuffix(".0")
        if self.form == "components":
            return amplitude
        return f"{amplitude}/{self.levels if self.form == 'weber-components' else self.directions}"

    def fit(self, fields: Iterable[ForceField], force_max_n: float | None = None) -> FieldQuantiser:
        """The quantiser for these fields, and for all up to `force_max_n` newtons where that is given."""
        if force_max_n is not None and not 0 <= force_max_n < math.inf:
            raise InvalidArgument("force_max_n", repr(force_max_n), "newtons, 0 or more")
        if self.form == "distinct":
            known = _packed(np.zeros((0, 3), np.float32))
            for field in fields:
                known = np.unique(np.concatenate([known, _packed(field.vectors_n())]))
                if len(known) > MOST_DISTINCT:
                    found, mend = (
                        f"more than {MOST_DISTINCT} different vectors",
                        "Name a quantiser such as weber:0.1.",
                    )
                    raise InvalidArgument("quantiser distinct", found, "a field of a decoder", mend)
            return _Distinct(self.words, math.inf, known)
        top, amplitudes = 0.0 if force_max_n is None else float(force_max_n), np.zeros(0, np.float32)
        for field in fields if force_max_n is None or self.form == "lloyd-max" else ():
            sizes = amplitudes_n(field.vectors_n())
            top = max(top, float(sizes.max(initial=0.0)))
            if self.form == "lloyd-max":
                amplitudes = np.concatenate([amplitudes, sizes[:: -(-len(sizes) // _MOST_OF_A_FRAME) or 1]])
                amplitudes = amplitudes[:: -(-len(amplitudes) // _MOST_TRAINED) or 1]
        return self._made(top, amplitudes)

    def _made(self, top_n: float, amplitudes: Float32s) -> FieldQuantiser:
        """The quantiser up to `top_n` newtons."""
        if self.form == "weber-components":
            if not 1 <= self.levels <= MOST_LEVELS:
                raise InvalidArgument("weber-components", f"{self.levels} levels", f"1 to {MOST_LEVELS}")
            least = (top_n or 1.0) / WeberLadder(self.number, 1.0, 1).ratio ** self.levels
            levels = quantisers.weber_levels(WeberLadder(self.number, least, self.levels))
            return Components(self.words, top_n * _SLACK, levels)
        if self.form == "weber":
            levels = quantisers.weber_levels(quantisers.weber_ladder(self.number, top_n))
        elif self.form == "lloyd-max":
            levels = quantisers.lloyd_max_levels(amplitudes, self.number)
        else:
            levels = quantisers.uniform_levels(self.number, top_n)
        if self.form == "components":
            if len(levels) - 1 > MOST_LEVELS:
                found = f"{len(levels) - 1} steps of {self.number:g} N to {top_n:.3g} N"
                raise InvalidArgument(
                    "quantiser components", found, f"up to {MOST_LEVELS}", "Take a larger step."
                )
            return Components(self.words, top_n * _SLACK, levels)
        codebook = None if self.directions == "none" else Codebook.get(self.directions)
        return Pairs(self.words, top_n * _SLACK, levels, codebook)
