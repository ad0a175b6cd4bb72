"""Haptic editing (paper section 4): operators that act in a region of a field, and pieces of media put
together.

Outside the region, and beyond its feather, every sample keeps its bits. Inside it is what the operator makes
of the whole field; in the feather the two are blended, F + w (G - F). An operator takes a field to a field on
the same grid; every haptic filter is one, too. Frames stay lazy: nothing is made before it is asked for.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Final, Protocol

import numpy as np

from touchfield.errors import InvalidArgument, is_finite, require_not_negative, require_one_of
from touchfield.filters.device_filter import limited
from touchfield.filters.region import Region, RigidMotion, weights
from touchfield.filters.registry import noted
from touchfield.filters.resample import interpolated
from touchfield.medium import BRICK, ForceField, HapticMedium
from touchfield.medium.budget import zero_forces
from touchfield.medium.field import bricks_of, keys_of_both
from touchfield.medium.grid import LOCAL

_BRICKS_AT_ONCE: Final = 512
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
    """Every force times a factor; a negative one turns it round; `InvalidArgument` if the factor is not
    finite.
    """

    name: ClassVar[str] = "gain"
    factor: float

    def __post_init__(self) -> None:
        if not is_finite(self.factor):
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
    """Forces longer than `force_max_n`, positive newtons, shortened to it, their direction kept."""

    name: ClassVar[str] = "limit"
    force_max_n: float

    def __post_init__(self) -> None:
        if not (is_finite(self.force_max_n) and self.force_max_n > 0):
            raise InvalidArgument("limit", repr(self.force_max_n), "newtons, more than 0")

    @property
    def words(self) -> str:
        return f"{self.force_max_n!r} N"

    def __call__(self, field: ForceField) -> ForceField:
        return limited(field, self.force_max_n)


@dataclass(frozen=True)
class Moved:
    """The field turned, moved or mirrored as a whole, trilinear between its samples.

    To cut something out and put it elsewhere, compose the moved cutting over the field.
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

    other : ForceField or HapticMedium; on the grid of the field; a frame of a medium for each that is edited.
    how : str; "replace": the other alone. "over": the other where it has a force, and the field elsewhere.
        "add": the sum. "max": the longer of the two forces, the field's where they are equal.
    Raises `InvalidArgument` if `how` is unknown; on a call, if the grids differ or the other has several
    frames.
    """

    name: ClassVar[str] = "compose"
    other: ForceField | HapticMedium
    how: str = "over"

    def __post_init__(self) -> None:
        require_one_of("compose", self.how, COMPOSITIONS)

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
                raise InvalidArgument(
                    "compose", f"a medium of {len(other)} frames", "a field, or a single frame"
                )
            other = other[0]
        if other.grid != field.grid:
            raise InvalidArgument("compose", f"a field on {other.grid}", f"one on {field.grid}")
        if self.how == "replace":
            return other
        if self.how == "add":
            return field + other
        keys = keys_of_both(field, other)
        below, above = field.forces_at(keys), other.forces_at(keys)
        if self.how == "over":
            is_shown = (above != 0).any(axis=-1)
        else:
            squares = (
                np.einsum("...c,...c->...", forces, forces, dtype=np.float64) for forces in (above, below)
            )
            is_shown = np.greater(*squares)
        forces_n = np.where(is_shown[..., None], above, below)
        return ForceField.from_bricks(field.grid, bricks_of(field.grid, keys), forces_n)


def edited(field: ForceField, region: Region, operator: EditOperator, feather_m: float = 0.0) -> ForceField:
    """The field with an operator at work in a region.

    operator : EditOperator; one of this file, or a `FieldFilter`.
    feather_m : float; width of the transition outside the region, metres; beyond it the field keeps its bits.
    Raises `InvalidArgument` if the feather is negative, or the operator or the region belongs to another
    grid.
    """
    require_not_negative(feather_m=feather_m)
    after = operator(field)
    if after.grid != field.grid:
        raise InvalidArgument(f"operator {operator.name}", f"a field on {after.grid}", f"one on {field.grid}")
    grid, place, keys = field.grid, region.on(field), keys_of_both(field, after)
    bricks, forces = bricks_of(grid, keys), zero_forces(len(keys))
    for begin in range(0, len(keys), _BRICKS_AT_ONCE):
        some = slice(begin, begin + _BRICKS_AT_ONCE)
        points = grid.to_m(bricks[some, None, None, None] * BRICK + LOCAL)
        share, before_n = weights(place, points, feather_m), field.forces_at(keys[some])
        after_n = after.forces_at(keys[some])
        blend = np.where((share == 1)[..., None], after_n, before_n)
        between = (share > 0) & (share < 1)
        x, y = before_n[between].astype(np.float64), after_n[between].astype(np.float64)
        blend[between] = x + share[between][:, None] * (y - x)
        forces[some] = blend
    return ForceField.from_bricks(grid, bricks, forces)


def edited_medium(
    medium: HapticMedium,
    region: Region,
    operator: EditOperator,
    feather_m: float = 0.0,
    frames: tuple[int, int | None] | None = None,
) -> HapticMedium:
    """The medium with every frame of a range edited when it is asked for; the provenance names the edit.

    region, operator, feather_m; as of `edited`; frame 0 of the medium of a `Composed` goes to the first
    edited frame.
    frames : (int, int or None), optional; start and stop of the range; all frames by default.
    Raises `InvalidArgument` if there is no such range, or the medium of a `Composed` does not fit it.
    """
    start, stop = frames or (0, None)
    stop = len(medium) if stop is None else stop
    if not 0 <= start < stop <= len(medium):
        raise InvalidArgument("frames to edit", f"{start}:{stop}", f"a range within 0:{len(medium)}")
    other = operator.other if isinstance(operator, Composed) else None
    if isinstance(other, HapticMedium) and len(other) < stop - start:
        found = f"a medium of {len(other)} frames"
        raise InvalidArgument("compose", found, f"at least the {stop - start} to be edited")

    def make(i: int) -> ForceField:
        if not start <= i < stop:
            return medium[i]
        once = operator.at(i - start) if isinstance(operator, Composed) else operator
        return edited(medium[i], region, once, feather_m)

    words = f"{operator.name} {operator.words}".strip() + f", {region.words}"
    if feather_m:
        words += f", feather {feather_m:g} m"
    if (start, stop) != (0, len(medium)):
        words += f", frames {start}:{stop}"
    return replace(medium, make_frame=make, provenance=noted(medium.provenance, "edits", words))


def cross_faded(first: HapticMedium, second: HapticMedium, frames: int) -> HapticMedium:
    """The first medium into the second, the last `frames` of the one mixed with as many of the other.

    frames : int; of the transition, 0 or more; 0 puts one after the other. Frame i of it is (1 - w) F + w G
        with w = (i + 1) / (frames + 1): the frames before and after it are those of one medium, and go on in
        equal steps.
    Raises `InvalidArgument` if a medium is shorter than the transition, or they differ in grid, rate, axes,
    friction,
        damping or tags.
    """
    shortest = min(len(first), len(second))
    if isinstance(frames, bool) or not isinstance(frames, int) or not 0 <= frames <= shortest:
        raise InvalidArgument("frames of a cross-fade", repr(frames), f"0 to {shortest}, the shorter medium")
    begin = len(first) - frames

    def make(i: int) -> ForceField:
        if i < begin:
            return first[i]
        if i >= len(first):
            return second[i - begin]
        share = (i - begin + 1) / (frames + 1)
        return first[i].scaled(1 - share) + second[i - begin].scaled(share)

    for name in ("grid", *first.beside):
        mine, theirs = getattr(second, name), getattr(first, name)
        if mine != theirs:
            raise InvalidArgument(f"medium 1 to splice, {name}", str(mine), f"{theirs}, as of medium 0")
    before = "; ".join(m.provenance["splices"] for m in (first, second) if "splices" in m.provenance)
    words = f"{len(first)} frames into {len(second)} over {frames}"
    provenance = noted({**first.provenance, "splices": before}, "splices", words)
    count = begin + len(second)
    return replace(
        first, frame_count=count, make_frame=make, provenance=provenance, vibration=None, segments=None
    )
