"""Q of the measures: a force vector becomes one symbol (paper section 3.1; theory: "every entropy must state Q").

In words such as a command line takes:

* ``AMPLITUDE:NUMBER/DIRECTIONS``: an amplitude quantiser of the coder (``weber:0.1``, the Weber fraction;
  ``uniform:0.05``, the step in newtons; ``lloyd-max:6``, bits) times a direction codebook (``ico5`` if none is named,
  ``none`` for the amplitude alone). The symbol is the pair.
* ``components:0.05``: each component in uniform steps of so many newtons (eq. 6, one Delta). The symbol is the
  triple.
* ``weber-components:0.1/31``: each signed component on a Weber ladder of k and so many levels to each side, the last
  of which ends at F_max. The symbol is the triple.
* ``distinct``: nothing is quantised; every different vector of the fields is a symbol. For fields that were decoded.

Symbol 0 is "no force": where the amplitude falls into the zero bin, too.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.codec.directions import DEFAULT as DEFAULT_DIRECTIONS
from touchfield.codec.directions import Codebook
from touchfield.codec.ladders import UniformSpec, WeberSpec
from touchfield.codec.lloyd_max import LloydMaxSpec
from touchfield.codec.paper_frames import amplitudes_n
from touchfield.codec.stage import AmplitudeSpec, Table
from touchfield.codec.weber_components import WeberComponents
from touchfield.errors import InvalidArgument
from touchfield.measure.field_symbols import FieldSymbols
from touchfield.medium.grid import BRICK

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.medium import ForceField

__all__ = ["DEFAULT_QUANTISER", "FieldQuantiser", "FieldQuantiserSpec"]

DEFAULT_QUANTISER: Final = "weber:0.1"
FORMS: Final = ("weber", "uniform", "lloyd-max", "components", "weber-components", "distinct")
MOST_STEPS: Final = 511
"""Of one component to each side, so that a triple stays within 2^30 symbols."""

MOST_DISTINCT: Final = 1 << 22

_MOST_TRAINED: Final = 1 << 22  # amplitudes a Lloyd-Max quantiser is trained on; of more, evenly spaced ones
_MOST_OF_A_FRAME: Final = 1 << 20
_SLACK: Final = 1 + 1e-6


@dataclass(frozen=True)
class FieldQuantiserSpec:
    """A quantiser as it is asked for.

    Parameters
    ----------
    form : str
        "weber", "uniform", "lloyd-max", "components", "weber-components" or "distinct".
    number : float
        k; the step in newtons; n_q; the step in newtons; k; unused.
    directions : str
        A direction codebook, or "none".
    levels : int
        Of "weber-components": levels to each side of zero.

    Raises
    ------
    InvalidArgument
        If a part is unknown or out of range.
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
        if self.form == "components":
            UniformSpec(self.number)
        elif self.form == "weber-components":
            WeberComponents.below(self.number, self.levels, 1.0)
        elif self.form != "distinct":
            self._amplitude_spec(self.number if self.form == "uniform" else 1.0)
        if self.directions != "none":
            Codebook.get(self.directions)

    @classmethod
    def parse(cls, text: str) -> FieldQuantiserSpec:
        """From words such as ``weber:0.1``, ``lloyd-max:6/octa3``, ``uniform:0.05/none``, ``components:0.02``."""
        if text == "distinct":
            return cls(text, 0.0, "none")
        amplitude, slash, directions = text.partition("/")
        form, colon, number = amplitude.partition(":")
        try:
            value = float(number)
        except ValueError:
            value = math.nan
        if not colon or not math.isfinite(value) or (slash and not directions):
            raise InvalidArgument("quantiser", repr(text), "FORM:NUMBER or FORM:NUMBER/DIRECTIONS, such as weber:0.1")
        if form == "components":
            if slash:
                raise InvalidArgument("quantiser", repr(text), "components without directions")
            return cls(form, value, "none")
        if form == "weber-components":
            if not directions.isdecimal():
                raise InvalidArgument("quantiser", repr(text), "weber-components:K/LEVELS, such as 0.1/31")
            return cls(form, value, "none", int(directions))
        return cls(form, value, directions or DEFAULT_DIRECTIONS)

    @property
    def words(self) -> str:
        """What `parse` takes."""
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
            return FieldQuantiser(self.words, math.inf, None, None, None, _distinct(fields))
        top, amplitudes = 0.0 if force_max_n is None else float(force_max_n), np.zeros(0, np.float32)
        if force_max_n is None or self.form == "lloyd-max":
            for field in fields:
                found = amplitudes_n(field.forces_n.reshape(-1, 3))
                found = found[found > 0]
                top = max(top, float(found.max(initial=0.0)))
                if self.form == "lloyd-max":
                    amplitudes = np.concatenate([amplitudes, found[:: -(-len(found) // _MOST_OF_A_FRAME) or 1]])
                    amplitudes = amplitudes[:: -(-len(amplitudes) // _MOST_TRAINED) or 1]
        if self.form == "components":
            return FieldQuantiser(self.words, top * _SLACK, None, None, self._steps(top))
        if self.form == "weber-components":
            components = WeberComponents.below(self.number, self.levels, top or 1.0)
            return FieldQuantiser(self.words, top * _SLACK, None, None, None, components=components)
        data = amplitudes if self.form == "lloyd-max" else np.full(1, top, np.float32)
        codebook = None if self.directions == "none" else Codebook.get(self.directions)
        return FieldQuantiser(self.words, top * _SLACK, self._amplitude_spec(top).fit(data), codebook, None)

    def _amplitude_spec(self, top_n: float) -> AmplitudeSpec:
        if self.form == "weber":
            base = WeberSpec(self.number)
            return WeberSpec(self.number, base.force_min_n, max(base.force_min_n, top_n))
        if self.form == "uniform":
            return UniformSpec(self.number)
        if self.number != int(self.number):
            raise InvalidArgument("quantiser lloyd-max", repr(self.number), "a whole number of bits")
        return LloydMaxSpec(int(self.number))

    def _steps(self, top_n: float) -> tuple[float, int]:
        count = math.floor(top_n / self.number + 0.5)
        if count > MOST_STEPS:
            raise InvalidArgument(
                "quantiser components", f"{count} steps of {self.number:g} N to {top_n:.3g} N", f"up to {MOST_STEPS}",
                "Take a larger step.",
            )  # fmt: skip
        return self.number, count


@dataclass(frozen=True, eq=False)
class FieldQuantiser:
    """Q, resolved: fields to symbols.

    Attributes
    ----------
    words : str
    top_n : float
        The greatest |F| that it was made for, newtons.
    table : Table or None
    codebook : Codebook or None
    steps : (float, int) or None
        Of "components": the step in newtons, and how many there are to each side.
    vectors : void12 [K - 1] or None
        Of "distinct": the vectors as `_packed` writes them, ascending.
    components : WeberComponents or None
        Of "weber-components".
    """

    words: str
    top_n: float
    table: Table | None
    codebook: Codebook | None
    steps: tuple[float, int] | None
    vectors: NDArray[Any] | None = None
    components: WeberComponents | None = None

    @property
    def alphabet(self) -> int:
        """K: how many symbols there are, "no force" among them."""
        if self.components is not None:
            return self.components.alphabet
        if self.vectors is not None:
            return 1 + len(self.vectors)
        if self.table is None:
            assert self.steps is not None
            return (2 * self.steps[1] + 1) ** 3
        return 1 + (len(self.table.levels_n) - self._zero_levels) * (self.directions or 1)

    @property
    def directions(self) -> int | None:
        """N_d: symbol s > 0 is the pair divmod(s - 1, N_d); None where symbols are no such pairs."""
        return None if self.codebook is None else len(self.codebook)

    @property
    def _zero_levels(self) -> int:
        return 0 if self.table is None else int(self.table.levels_n[0] == 0)

    def __call__(self, field: ForceField) -> FieldSymbols:
        """The symbols of one frame.

        Raises
        ------
        InvalidArgument
            If a force is greater than the quantiser was made for.
        """
        symbols = np.zeros((len(field.bricks), BRICK, BRICK, BRICK), np.int32)
        held = field.mask
        symbols[held] = self.symbols_of(field.forces_n[held])
        return FieldSymbols(field.grid, field.bricks, symbols, self.alphabet, self.words)

    def symbols_of(self, vectors_n: NDArray[np.float32]) -> NDArray[np.int32]:
        """The symbols of force vectors, newtons, float32 [m, 3], int32 [m]."""
        if self.vectors is not None:
            return self._places(self.vectors, vectors_n)
        amplitudes = amplitudes_n(vectors_n)
        top = float(amplitudes.max(initial=0.0))
        if top > self.top_n:
            raise InvalidArgument(
                f"quantiser {self.words}", f"a force of {top:.6g} N", f"up to the {self.top_n:.6g} N it was made for",
                "Fit it to this field, too.",
            )  # fmt: skip
        if self.components is not None:
            return self.components.symbols_of(vectors_n)
        if self.table is None:
            return self._triples(vectors_n)
        levels = self.table.encode(amplitudes).astype(np.int64) - self._zero_levels
        directions: Any = 0 if self.codebook is None else self.codebook.nearest(vectors_n)
        symbols: NDArray[np.int64] = 1 + levels * (self.directions or 1) + directions
        symbols[(levels < 0) | (amplitudes == 0)] = 0
        return symbols.astype(np.int32)

    def vectors_of(self, symbols: NDArray[np.int32]) -> NDArray[np.float32]:
        """The codewords of symbols [m], newtons, float32 [m, 3]: the inverse of `symbols_of` but for what Q lost.

        Raises
        ------
        InvalidArgument
            If the quantiser keeps no direction, or there is no such symbol.
        """
        if len(symbols) and not 0 <= symbols.min() <= symbols.max() < self.alphabet:
            raise InvalidArgument("symbols", f"{symbols.min()} to {symbols.max()}", f"0 to {self.alphabet - 1}")
        if self.components is not None:
            return self.components.vectors_of(symbols)
        vectors = np.zeros((len(symbols), 3), np.float32)
        held = symbols > 0
        if self.vectors is not None:
            vectors[held] = self.vectors[symbols[held] - 1].view(np.float32).reshape(-1, 3)
        elif self.table is None:
            assert self.steps is not None
            step, count = self.steps
            side = 2 * count + 1
            index = (symbols[held].astype(np.int64) + (side**3 - 1) // 2) % side**3
            vectors[held] = (np.stack(np.unravel_index(index, (side,) * 3), axis=-1) - count) * step
        elif self.codebook is None:
            raise InvalidArgument(f"quantiser {self.words}", "no direction", "one with directions")
        else:
            levels, directions = np.divmod(symbols[held] - 1, len(self.codebook))
            amplitudes = self.table.levels_n[levels + self._zero_levels]
            vectors[held] = amplitudes[:, None] * self.codebook.vertices_float32[directions]
        return vectors

    def _places(self, known: NDArray[Any], vectors_n: NDArray[np.float32]) -> NDArray[np.int32]:
        wanted = _packed(vectors_n)
        place: NDArray[np.int64] = np.minimum(np.searchsorted(known, wanted), max(0, len(known) - 1))
        zero = ~vectors_n.any(axis=1)
        if not (zero | (known[place] == wanted if len(known) else zero)).all():
            raise InvalidArgument(
                "quantiser distinct", "a force that it has not seen", "the fields it was made for",
                "Fit it to this field, too.",
            )  # fmt: skip
        places: NDArray[np.int32] = np.where(zero, 0, place + 1).astype(np.int32)
        return places

    def _triples(self, vectors_n: NDArray[np.float32]) -> NDArray[np.int32]:
        assert self.steps is not None
        step, count = self.steps
        side = 2 * count + 1
        x = vectors_n.astype(np.float64)
        q = (np.sign(x) * np.floor(np.abs(x) / step + 0.5)).astype(np.int64) + count
        index = (q[:, 0] * side + q[:, 1]) * side + q[:, 2]
        centre = (side**3 - 1) // 2
        symbols: NDArray[np.int32] = ((index - centre) % side**3).astype(np.int32)
        return symbols


def _packed(vectors_n: NDArray[np.float32]) -> NDArray[Any]:
    """Each vector as one value that sorts: its twelve bytes; -0.0 is 0.0."""
    rows = np.ascontiguousarray(vectors_n + np.float32(0))
    return rows.view(np.dtype((np.void, 12))).reshape(-1)


def _distinct(fields: Iterable[ForceField]) -> NDArray[Any]:
    known = _packed(np.zeros((0, 3), np.float32))
    for field in fields:
        known = np.unique(np.concatenate([known, _packed(field.forces_n[field.mask])]))
        if len(known) > MOST_DISTINCT:
            raise InvalidArgument(
                "quantiser distinct", f"more than {MOST_DISTINCT} different vectors", "a field of a decoder",
                "Name a quantiser such as weber:0.1.",
            )  # fmt: skip
    return known
