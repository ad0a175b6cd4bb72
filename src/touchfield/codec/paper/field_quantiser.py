"""Maps each force vector to one symbol (the quantiser Q of paper section 3.1), so that `touchfield measure`
can compute entropies in bits. The user chooses Q by a text such as ``weber:0.1/ico5``.

Every entropy must state its Q (decision 0006). The forms of its text, as on the command line:

* ``AMPLITUDE:NUMBER/DIRECTIONS``: an amplitude quantiser of the coder (``weber:0.1`` with the Weber fraction,
  ``uniform:0.05`` with the step in newtons, ``lloyd-max:6`` with the bits) combined with a direction codebook
  (``ico5`` if none is named; ``none`` for the amplitude alone). The symbol is the pair.
* ``components:0.05``: each component in uniform steps of this many newtons (eq. 6, one Delta). The symbol is
  the triple.
* ``weber-components:0.1/31``: each signed component on a Weber ladder with this k and this many levels on
  each side of zero; the last level ends at F_max (paper table 1: three times six bits). The symbol is the
  triple. The error is within k |F| where every component exceeds F_min; a component below F_min becomes zero,
  so that an error of up to sqrt(3) F_min remains.
* ``distinct``: nothing is quantised; every distinct vector of the fields is a symbol. For decoded fields.

Symbol 0 is "no force", including amplitudes in the zero bin.
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
from touchfield.codec.paper.directions import DEFAULT as DEFAULT_DIRECTIONS, Codebook
from touchfield.codec.paper.quantisers import AmplitudeLevels, amplitudes_n
from touchfield.errors import InvalidArgument
from touchfield.measure.field_symbols import FieldSymbols
from touchfield.medium import ForceField
from touchfield.medium.grid import BRICK
from touchfield.perception.weber import WeberLadder

DEFAULT_QUANTISER: Final = "weber:0.1"
FORMS: Final = ("weber", "uniform", "lloyd-max", "components", "weber-components", "distinct")
# levels of a component on each side of zero, so that triples stay within 2^30 symbols
MAX_LEVELS: Final = 511
MAX_DISTINCT: Final = 1 << 22

# maximum number of amplitudes that a Lloyd-Max quantiser is trained on; more are thinned evenly
_MAX_TRAINING: Final = 1 << 22
_MAX_PER_FRAME: Final = 1 << 20
_SLACK: Final = 1 + 1e-6


@dataclass(frozen=True, eq=False)
class FieldQuantiser(ABC):
    """A fitted quantiser from fields to symbols, for forces up to `top_n` newtons."""

    text: str
    top_n: float

    @property
    @abstractmethod
    def alphabet(self) -> int:
        """K: the number of symbols, "no force" included."""

    @abstractmethod
    def _symbols(self, vectors_n: Float32s) -> Int32s: ...

    @abstractmethod
    def _vectors(self, symbols: Int32s) -> Float32s: ...

    def __call__(self, field: ForceField) -> FieldSymbols:
        """The symbols of one frame; see `symbols_of`."""
        symbols = np.zeros((len(field.bricks), BRICK, BRICK, BRICK), np.int32)
        symbols[field.mask] = self.symbols_of(field.forces_n[field.mask])
        return FieldSymbols(field.grid, field.bricks, symbols, self.alphabet, self.text)

    def symbols_of(self, vectors_n: Float32s) -> Int32s:
        """The symbols, int32 [m], of force vectors in newtons, float32 [m, 3].

        InvalidArgument if a force exceeds the largest one that the quantiser was fitted for.
        """
        top = float(amplitudes_n(vectors_n).max(initial=0.0))
        if top > self.top_n:
            found, allowed = f"a force of {top:.6g} N", f"up to the {self.top_n:.6g} N it was made for"
            raise InvalidArgument(f"quantiser {self.text}", found, allowed, "Fit it to this field, too.")
        return self._symbols(vectors_n)

    def vectors_of(self, symbols: Int32s) -> Float32s:
        """The codewords, newtons, float32 [m, 3], of symbols [m].

        The inverse of `symbols_of` up to quantisation. InvalidArgument if the quantiser has no directions, or
        a symbol does not exist.
        """
        if len(symbols) and not 0 <= symbols.min() <= symbols.max() < self.alphabet:
            raise InvalidArgument(
                "symbols", f"{symbols.min()} to {symbols.max()}", f"0 to {self.alphabet - 1}"
            )
        return self._vectors(symbols)


@dataclass(frozen=True, eq=False)
class Pairs(FieldQuantiser):
    """Pairs of an amplitude level and one of N_d directions.

    Symbol s > 0 is the pair divmod(s - 1, N_d). Without a codebook the symbol is the amplitude level alone.
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
        is_sent = (levels >= 0) & (amplitudes != 0)
        symbols = np.zeros(len(levels), np.int32)
        direction: Any = 0 if self.codebook is None else self.codebook.nearest(vectors_n[is_sent])
        symbols[is_sent] = 1 + levels[is_sent] * self._directions + direction
        return symbols

    def _vectors(self, symbols: Int32s) -> Float32s:
        if self.codebook is None:
            raise InvalidArgument("quantiser", "no direction", "one with directions")
        level, direction = np.divmod(np.maximum(symbols, 1) - 1, self._directions)
        amplitude = np.where(symbols > 0, self.levels.levels_n[level + self._zeros], np.float32(0))
        return amplitude[:, None] * self.codebook.vertices_float32[direction]


@dataclass(frozen=True, eq=False)
class Components(FieldQuantiser):
    """Triples of signed components, each quantised by the levels of its modulus.

    The first level is zero.
    """

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
        side, highest = 2 * len(self.levels) - 1, len(self.levels) - 1
        indices = (symbols.astype(np.int64) + (self.alphabet - 1) // 2) % self.alphabet
        signed = np.stack(np.unravel_index(indices, (side,) * 3), axis=-1) - highest
        vectors: Float32s = self.levels.levels_n[np.abs(signed)] * np.sign(signed).astype(np.float32)
        return vectors


@dataclass(frozen=True, eq=False)
class _Distinct(FieldQuantiser):
    """Quantiser whose symbols are the distinct vectors of the fields.

    `vectors` holds the twelve bytes of each vector, in ascending order.
    """

    vectors: NDArray[Any]

    @property
    def alphabet(self) -> int:
        return 1 + len(self.vectors)

    def _symbols(self, vectors_n: Float32s) -> Int32s:
        packed, zero = _pack(vectors_n), ~vectors_n.any(axis=1)
        index = np.minimum(np.searchsorted(self.vectors, packed), max(0, len(self.vectors) - 1))
        if not (zero | (self.vectors[index] == packed if len(self.vectors) else zero)).all():
            found, mend = "a force that it has not seen", "Fit it to this field, too."
            raise InvalidArgument("quantiser distinct", found, "the fields it was made for", mend)
        return np.where(zero, 0, index + 1).astype(np.int32)

    def _vectors(self, symbols: Int32s) -> Float32s:
        vectors = np.zeros((len(symbols), 3), np.float32)
        vectors[symbols > 0] = self.vectors[symbols[symbols > 0] - 1].view(np.float32).reshape(-1, 3)
        return vectors


def _pack(vectors_n: Float32s) -> NDArray[Any]:
    """Each vector as one sortable value, its twelve bytes; -0.0 becomes 0.0."""
    rows = np.ascontiguousarray(vectors_n + np.float32(0))
    return rows.view(np.dtype((np.void, 12))).reshape(-1)


@dataclass(frozen=True)
class FieldQuantiserSpec:
    """Parts of the text of a quantiser.

    `number` is k, a step in newtons, or n_q, depending on the form. `directions` is a codebook or "none".
    `levels` is the number of levels of "weber-components" on each side of zero. InvalidArgument if a part is
    unknown or out of range.
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
            self._build(self.number if "weber" not in self.form else 1.0, np.zeros(0, np.float32))

    @classmethod
    def parse(cls, text: str) -> FieldQuantiserSpec:
        """Parse text such as ``weber:0.1``, ``lloyd-max:6/octa3``, ``uniform:0.05/none``."""
        if text == "distinct":
            return cls(text, 0.0, "none")
        amplitude, slash, suffix = text.partition("/")
        form, _, number = amplitude.partition(":")
        is_complete = {"components": not slash, "weber-components": suffix.isdecimal()}.get(
            form, not slash or suffix
        )
        value = math.nan
        with suppress(ValueError):
            value = float(number) if is_complete else math.nan
        if not math.isfinite(value):
            expected = "FORM:NUMBER, FORM:NUMBER/DIRECTIONS or weber-components:K/LEVELS, such as weber:0.1"
            raise InvalidArgument("quantiser", repr(text), expected)
        if form in ("components", "weber-components"):
            return cls(form, value, "none", int(suffix or cls.levels))
        return cls(form, value, suffix or DEFAULT_DIRECTIONS)

    @property
    def text(self) -> str:
        """The text that `parse` accepts."""
        if self.form == "distinct":
            return self.form
        amplitude = f"{self.form}:{self.number!r}".removesuffix(".0")
        if self.form == "components":
            return amplitude
        return f"{amplitude}/{self.levels if self.form == 'weber-components' else self.directions}"

    def fit(self, fields: Iterable[ForceField], force_max_n: float | None = None) -> FieldQuantiser:
        """The quantiser fitted to fields and, if given, to all forces up to `force_max_n`."""
        if force_max_n is not None and not 0 <= force_max_n < math.inf:
            raise InvalidArgument("force_max_n", repr(force_max_n), "newtons, 0 or more")
        if self.form == "distinct":
            distinct = _pack(np.zeros((0, 3), np.float32))
            for field in fields:
                distinct = np.unique(np.concatenate([distinct, _pack(field.vectors_n())]))
                if len(distinct) > MAX_DISTINCT:
                    found, mend = (
                        f"more than {MAX_DISTINCT} different vectors",
                        "Name a quantiser such as weber:0.1.",
                    )
                    raise InvalidArgument("quantiser distinct", found, "a field of a decoder", mend)
            return _Distinct(self.text, math.inf, distinct)
        top, amplitudes = 0.0 if force_max_n is None else float(force_max_n), np.zeros(0, np.float32)
        for field in fields if force_max_n is None or self.form == "lloyd-max" else ():
            sizes = amplitudes_n(field.vectors_n())
            top = max(top, float(sizes.max(initial=0.0)))
            if self.form == "lloyd-max":
                amplitudes = np.concatenate([amplitudes, sizes[:: -(-len(sizes) // _MAX_PER_FRAME) or 1]])
                amplitudes = amplitudes[:: -(-len(amplitudes) // _MAX_TRAINING) or 1]
        return self._build(top, amplitudes)

    def _build(self, top_n: float, amplitudes: Float32s) -> FieldQuantiser:
        """The quantiser up to `top_n` newtons."""
        if self.form == "weber-components":
            if not 1 <= self.levels <= MAX_LEVELS:
                raise InvalidArgument("weber-components", f"{self.levels} levels", f"1 to {MAX_LEVELS}")
            lowest = (top_n or 1.0) / WeberLadder(self.number, 1.0, 1).ratio ** self.levels
            levels = quantisers.weber_levels(WeberLadder(self.number, lowest, self.levels))
            return Components(self.text, top_n * _SLACK, levels)
        if self.form == "weber":
            levels = quantisers.weber_levels(quantisers.weber_ladder(self.number, top_n))
        elif self.form == "lloyd-max":
            levels = quantisers.lloyd_max_levels(amplitudes, self.number)
        else:
            levels = quantisers.uniform_levels(self.number, top_n)
        if self.form == "components":
            if len(levels) - 1 > MAX_LEVELS:
                found = f"{len(levels) - 1} steps of {self.number:g} N to {top_n:.3g} N"
                raise InvalidArgument(
                    "quantiser components", found, f"up to {MAX_LEVELS}", "Take a larger step."
                )
            return Components(self.text, top_n * _SLACK, levels)
        codebook = None if self.directions == "none" else Codebook.get(self.directions)
        return Pairs(self.text, top_n * _SLACK, levels, codebook)
