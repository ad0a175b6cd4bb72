"""Edits force fields (paper section 4): applies an operator within a region, with a soft border, and fades
from one medium to another.

Outside the region and its feather every sample keeps its bits. Inside the region a sample takes its value
from the result of the operator on the whole field; in the feather the two are blended, F + w (G - F). An
operator maps a field to a field on the same grid; every haptic filter is one, too. Frames stay lazy: each is
computed when it is requested.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Final, Protocol

import numpy as np

from touchfield.errors import InvalidArgument, is_finite, require_not_negative, require_one_of
from touchfield.filters.limit import limit_forces
from touchfield.filters.region import Region, RigidMotion, weights
from touchfield.filters.registry import add_note
from touchfield.filters.resample import interpolate
from touchfield.medium import BRICK, ForceField, HapticMedium
from touchfield.medium.budget import zero_forces
from touchfield.medium.field import bricks_of, keys_of_both
from touchfield.medium.grid import LOCAL

_BRICKS_AT_ONCE: Final = 512
COMPOSITIONS: Final = ("replace", "over", "add", "max")


class EditOperator(Protocol):
    """A map from a field to a field on the same grid, with a name and a text for the provenance."""

    @property
    def name(self) -> str: ...

    @property
    def text(self) -> str: ...

    def __call__(self, field: ForceField) -> ForceField: ...


@dataclass(frozen=True)
class Gain:
    """Multiply every force by a factor; a negative one reverses it.

    Raises `InvalidArgument` if the factor is not finite.
    """

    name: ClassVar[str] = "gain"
    factor: float

    def __post_init__(self) -> None:
        if not is_finite(self.factor):
            raise InvalidArgument("gain", repr(self.factor), "a finite factor")

    @property
    def text(self) -> str:
        return f"{self.factor!r}"

    def __call__(self, field: ForceField) -> ForceField:
        return field.scaled(self.factor)


@dataclass(frozen=True)
class Erase:
    """Remove every force."""

    name: ClassVar[str] = "erase"
    text: ClassVar[str] = ""

    def __call__(self, field: ForceField) -> ForceField:
        return ForceField.empty(field.grid)


@dataclass(frozen=True)
class Limit:
    """Shorten forces longer than `force_max_n`, positive newtons, to it; their direction is kept."""

    name: ClassVar[str] = "limit"
    force_max_n: float

    def __post_init__(self) -> None:
        if not (is_finite(self.force_max_n) and self.force_max_n > 0):
            raise InvalidArgument("limit", repr(self.force_max_n), "newtons, more than 0")

    @property
    def text(self) -> str:
        return f"{self.force_max_n!r} N"

    def __call__(self, field: ForceField) -> ForceField:
        return limit_forces(field, self.force_max_n)


@dataclass(frozen=True)
class Move:
    """Rotate, move or mirror the whole field, with trilinear interpolation between its samples.

    To move only a part, erase everything else, move it, and compose the result over the field.
    """

    name: ClassVar[str] = "move"
    motion: RigidMotion

    @property
    def text(self) -> str:
        return self.motion.text

    def __call__(self, field: ForceField) -> ForceField:
        return interpolate(field, field.grid, self.motion)


@dataclass(frozen=True, eq=False)
class Compose:
    """Compose the field with another one.

    other : ForceField or HapticMedium; on the grid of the field; of a medium, one frame per edited frame.
    mode : str; "replace": the other alone. "over": the other where it has a force, and the field elsewhere.
        "add": the sum. "max": the longer of the two forces, the field's where they are equal.
    Raises `InvalidArgument` if `mode` is unknown; on a call, if the grids differ or the other has several
    frames.
    """

    name: ClassVar[str] = "compose"
    other: ForceField | HapticMedium
    mode: str = "over"

    def __post_init__(self) -> None:
        require_one_of("compose", self.mode, COMPOSITIONS)

    @property
    def text(self) -> str:
        if isinstance(self.other, HapticMedium):
            return f"{self.mode} {self.other.provenance.get('source', 'another medium')}"
        return f"{self.mode} another field"

    def at(self, frame: int) -> Compose:
        """Return the operator for one frame of a range, with that frame of the other medium."""
        return Compose(self.other[frame], self.mode) if isinstance(self.other, HapticMedium) else self

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
        if self.mode == "replace":
            return other
        if self.mode == "add":
            return field + other
        keys = keys_of_both(field, other)
        below, above = field.forces_at(keys), other.forces_at(keys)
        if self.mode == "over":
            is_above = (above != 0).any(axis=-1)
        else:
            squares = (
                np.einsum("...c,...c->...", forces, forces, dtype=np.float64) for forces in (above, below)
            )
            is_above = np.greater(*squares)
        forces_n = np.where(is_above[..., None], above, below)
        return ForceField.from_bricks(field.grid, bricks_of(field.grid, keys), forces_n)


def edit_field(
    field: ForceField, region: Region, operator: EditOperator, feather_m: float = 0.0
) -> ForceField:
    """Apply an operator to a field within a region.

    operator : EditOperator; one of this module, or a `FieldFilter`.
    feather_m : float; width of the transition outside the region, metres; beyond it the field keeps its bits.
    Raises `InvalidArgument` if the feather is negative, or the operator or the region belongs to another
    grid.
    """
    require_not_negative(feather_m=feather_m)
    after = operator(field)
    if after.grid != field.grid:
        raise InvalidArgument(f"operator {operator.name}", f"a field on {after.grid}", f"one on {field.grid}")
    grid, local_region, keys = field.grid, region.on(field), keys_of_both(field, after)
    bricks, forces = bricks_of(grid, keys), zero_forces(len(keys))
    for start in range(0, len(keys), _BRICKS_AT_ONCE):
        chunk = slice(start, start + _BRICKS_AT_ONCE)
        points = grid.to_m(bricks[chunk, None, None, None] * BRICK + LOCAL)
        weight, before_n = weights(local_region, points, feather_m), field.forces_at(keys[chunk])
        after_n = after.forces_at(keys[chunk])
        blend = np.where((weight == 1)[..., None], after_n, before_n)
        between = (weight > 0) & (weight < 1)
        x, y = before_n[between].astype(np.float64), after_n[between].astype(np.float64)
        blend[between] = x + weight[between][:, None] * (y - x)
        forces[chunk] = blend
    return ForceField.from_bricks(grid, bricks, forces)


def edit_medium(
    medium: HapticMedium,
    region: Region,
    operator: EditOperator,
    feather_m: float = 0.0,
    frames: tuple[int, int | None] | None = None,
) -> HapticMedium:
    """Return the medium with a range of frames edited on request; the provenance names the edit.

    region, operator, feather_m; as in `edit_field`; frame 0 of the medium of a `Compose` goes to the first
    edited frame.
    frames : (int, int or None), optional; start and stop of the range; all frames by default.
    Raises `InvalidArgument` if there is no such range, or the medium of a `Compose` does not fit it.
    """
    start, stop = frames or (0, None)
    stop = len(medium) if stop is None else stop
    if not 0 <= start < stop <= len(medium):
        raise InvalidArgument("frames to edit", f"{start}:{stop}", f"a range within 0:{len(medium)}")
    other = operator.other if isinstance(operator, Compose) else None
    if isinstance(other, HapticMedium) and len(other) < stop - start:
        found = f"a medium of {len(other)} frames"
        raise InvalidArgument("compose", found, f"at least the {stop - start} to be edited")

    def make(i: int) -> ForceField:
        if not start <= i < stop:
            return medium[i]
        frame_operator = operator.at(i - start) if isinstance(operator, Compose) else operator
        return edit_field(medium[i], region, frame_operator, feather_m)

    text = f"{operator.name} {operator.text}".strip() + f", {region.text}"
    if feather_m:
        text += f", feather {feather_m:g} m"
    if (start, stop) != (0, len(medium)):
        text += f", frames {start}:{stop}"
    return replace(medium, make_frame=make, provenance=add_note(medium.provenance, "edits", text))


def cross_fade(first: HapticMedium, second: HapticMedium, frames: int) -> HapticMedium:
    """Cross-fade two media: blend the last `frames` of the first with the first `frames` of the second.

    frames : int; of the transition, 0 or more; 0 puts one after the other. Frame i of it is (1 - w) F + w G
        with w = (i + 1) / (frames + 1): the weight rises in equal steps from the last frame of the first
        medium alone to the first frame of the second alone.
    Raises `InvalidArgument` if a medium is shorter than the transition, or they differ in grid, rate, axes,
    friction, damping or tags.
    """
    shortest = min(len(first), len(second))
    if isinstance(frames, bool) or not isinstance(frames, int) or not 0 <= frames <= shortest:
        raise InvalidArgument("frames of a cross-fade", repr(frames), f"0 to {shortest}, the shorter medium")
    fade_start = len(first) - frames

    def make(i: int) -> ForceField:
        if i < fade_start:
            return first[i]
        if i >= len(first):
            return second[i - fade_start]
        weight = (i - fade_start + 1) / (frames + 1)
        return first[i].scaled(1 - weight) + second[i - fade_start].scaled(weight)

    for name in ("grid", *first.metadata):
        value, expected = getattr(second, name), getattr(first, name)
        if value != expected:
            raise InvalidArgument(f"medium 1 to splice, {name}", str(value), f"{expected}, as of medium 0")
    before = "; ".join(m.provenance["splices"] for m in (first, second) if "splices" in m.provenance)
    text = f"{len(first)} frames into {len(second)} over {frames}"
    provenance = add_note({**first.provenance, "splices": before}, "splices", text)
    count = fade_start + len(second)
    return replace(
        first, frame_count=count, make_frame=make, provenance=provenance, vibration=None, segments=None
    )
