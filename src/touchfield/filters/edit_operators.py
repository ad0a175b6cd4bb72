"""What an edit does to a field: gain, erase, compose with another field, move, limit (paper section 4, editing).

An operator takes a field to a field on the same grid; `touchfield.filters.edit` lets it act within a region. Every
registered haptic filter (`FieldFilter`) is one, too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Final, Protocol

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.filters.device_filter import limited
from touchfield.filters.interpolate import interpolated
from touchfield.filters.rigid_motion import RigidMotion
from touchfield.medium import ForceField, HapticMedium
from touchfield.medium.field import brick_keys

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["COMPOSITIONS", "Composed", "EditOperator", "Erased", "Gain", "Limited", "Moved"]

COMPOSITIONS: Final = ("replace", "over", "add", "max")


class EditOperator(Protocol):
    """A field to a field on the same grid, with a name and words for the provenance."""

    @property
    def name(self) -> str: ...

    @property
    def words(self) -> str: ...

    def __call__(self, field: ForceField) -> ForceField: ...


@dataclass(frozen=True)
class Gain:
    """Every force times a factor; a negative one turns it round.

    Raises `InvalidArgument` if the factor is not finite.
    """

    name: ClassVar[str] = "gain"
    factor: float

    def __post_init__(self) -> None:
        if not math.isfinite(self.factor):
            raise InvalidArgument("gain", repr(self.factor), "a finite factor")

    @property
    def words(self) -> str:
        return f"{self.factor!r}"

    def __call__(self, field: ForceField) -> ForceField:
        return field.scaled(self.factor)


@dataclass(frozen=True)
class Erased:
    """No force."""

    name: ClassVar[str] = "erase"
    words: ClassVar[str] = ""

    def __call__(self, field: ForceField) -> ForceField:
        return ForceField.empty(field.grid)


@dataclass(frozen=True)
class Limited:
    """Forces longer than `force_max_n` shortened to it, their direction kept.

    Raises `InvalidArgument` if the limit is not positive.
    """

    name: ClassVar[str] = "limit"
    force_max_n: float

    def __post_init__(self) -> None:
        if not 0 < self.force_max_n < math.inf:
            raise InvalidArgument("limit", repr(self.force_max_n), "newtons, more than 0")

    @property
    def words(self) -> str:
        return f"{self.force_max_n!r} N"

    def __call__(self, field: ForceField) -> ForceField:
        return limited(field, self.force_max_n)


@dataclass(frozen=True)
class Moved:
    """The field turned, moved or mirrored as a whole, trilinear between its samples.

    In a region it shows what the motion brings there, from wherever it comes. To cut something out and put it
    elsewhere, compose the moved cutting over the field.
    """

    name: ClassVar[str] = "move"
    motion: RigidMotion

    @property
    def words(self) -> str:
        return self.motion.words

    def __call__(self, field: ForceField) -> ForceField:
        return interpolated(field, field.grid, self.motion)


@dataclass(frozen=True, eq=False)
class Composed:
    """The field together with another one.

    other : ForceField or HapticMedium; on the grid of the field. Of a medium each frame goes to one frame of the
        edited medium.
    how : str; "replace": the other alone. "over": the other where it has a force, and the field elsewhere. "add": the
        sum, as a probe in two walls feels both. "max": the longer of the two forces, the field's where they are
        equal.
    Raises `InvalidArgument` if `how` is unknown; when called, if the grids differ or the other is a medium of several
    frames.
    """

    name: ClassVar[str] = "compose"
    other: ForceField | HapticMedium
    how: str = "over"

    def __post_init__(self) -> None:
        if self.how not in COMPOSITIONS:
            raise InvalidArgument("compose", repr(self.how), f"one of {', '.join(COMPOSITIONS)}")

    @property
    def words(self) -> str:
        if isinstance(self.other, HapticMedium):
            return f"{self.how} {self.other.provenance.get('source', 'another medium')}"
        return f"{self.how} another field"

    def at(self, frame: int) -> Composed:
        """The operator for one frame of a range: with that frame of the other medium."""
        return Composed(self.other[frame], self.how) if isinstance(self.other, HapticMedium) else self

    def __call__(self, field: ForceField) -> ForceField:
        other = self.other
        if isinstance(other, HapticMedium):
            if len(other) != 1:
                raise InvalidArgument("compose", f"a medium of {len(other)} frames", "a field, or a single frame")
            other = other[0]
        if other.grid != field.grid:
            raise InvalidArgument("compose", f"a field on {other.grid}", f"one on {field.grid}")
        if self.how == "replace":
            return other
        if self.how == "add":
            return field + other
        keys = np.union1d(brick_keys(field.grid, field.bricks), brick_keys(field.grid, other.bricks))
        below, above = field.forces_at(keys), other.forces_at(keys)
        shown: NDArray[np.bool_] = (
            (above != 0).any(axis=-1) if self.how == "over" else _squares(above) > _squares(below)
        )
        bricks = np.stack(np.unravel_index(keys, field.grid.brick_shape), axis=1)
        return ForceField.from_bricks(field.grid, bricks, np.where(shown[..., None], above, below))


def _squares(forces_n: NDArray[np.float32]) -> NDArray[np.float64]:
    squares: NDArray[np.float64] = np.einsum("...c,...c->...", forces_n, forces_n, dtype=np.float64)
    return squares
