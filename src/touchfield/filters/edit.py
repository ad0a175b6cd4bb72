"""Editing: operators that act in a region of a field, and nowhere else (paper section 4, "haptic editing").

Outside the region, and beyond its feather, every sample of the result has the bits that it had. Inside it is what
the operator makes of the whole field; in the feather the two are blended, F + w (G - F), so that no |F| is greater
than the greater of both.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.filters.edit_operators import Composed, EditOperator
from touchfield.filters.region import Region, weights
from touchfield.medium import BRICK, ForceField, HapticMedium
from touchfield.medium.budget import zero_forces
from touchfield.medium.field import brick_keys

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["edited", "edited_medium"]

_BRICKS_AT_ONCE: Final = 512
_LOCAL: Final = np.stack(np.meshgrid(*[np.arange(BRICK)] * 3, indexing="ij"), axis=-1)


def edited(field: ForceField, region: Region, operator: EditOperator, feather_m: float = 0.0) -> ForceField:
    """The field with an operator at work in a region.

    region : Region; `touchfield.filters.region`, in the metres of the field's grid.
    operator : EditOperator; of `touchfield.filters.edit_operators`, or a `FieldFilter`.
    feather_m : float; width of the transition outside the region, metres.
    Returns ForceField: On the same grid; bit for bit the field from `feather_m` outside the region on.
    Raises `InvalidArgument` if the feather is negative, or the operator or the region belongs to another grid.
    """
    if not 0 <= feather_m < math.inf:
        raise InvalidArgument("feather_m", repr(feather_m), "a finite length of 0 or more")
    made = operator(field)
    if made.grid != field.grid:
        raise InvalidArgument(f"operator {operator.name}", f"a field on {made.grid}", f"one on {field.grid}")
    grid, place = field.grid, region.on(field)
    keys = np.union1d(brick_keys(grid, field.bricks), brick_keys(grid, made.bricks))
    bricks = np.stack(np.unravel_index(keys, grid.brick_shape), axis=1).astype(np.int32)
    forces = zero_forces(len(keys))
    for begin in range(0, len(keys), _BRICKS_AT_ONCE):
        some = slice(begin, begin + _BRICKS_AT_ONCE)
        points = grid.to_m(bricks[some, None, None, None] * BRICK + _LOCAL)
        share = weights(place, points, feather_m)
        forces[some] = _blended(field.forces_at(keys[some]), made.forces_at(keys[some]), share)
    return ForceField.from_bricks(grid, bricks, forces)


def edited_medium(
    medium: HapticMedium,
    region: Region,
    operator: EditOperator,
    feather_m: float = 0.0,
    frames: tuple[int, int | None] | None = None,
) -> HapticMedium:
    """The medium with every frame of a range edited when it is asked for; the provenance names the edit.

    region, operator, feather_m; as of `edited`. The medium of a `Composed` begins with the range: its frame 0 goes to
        the first edited frame.
    frames : (int, int or None), optional; start and stop of the range, stop None meaning the end; all frames by
        default.
    Raises `InvalidArgument` if there is no such range, or the medium of a `Composed` is shorter than it or on another
    grid.
    """
    start, stop = frames or (0, None)
    stop = len(medium) if stop is None else stop
    if not 0 <= start < stop <= len(medium):
        raise InvalidArgument("frames to edit", f"{start}:{stop}", f"a range within 0:{len(medium)}")
    if isinstance(operator, Composed) and isinstance(operator.other, HapticMedium):
        _check_other(operator.other, medium, stop - start)

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
    before = medium.provenance.get("edits")
    provenance = {**medium.provenance, "edits": f"{before}; {words}" if before else words}
    return replace(medium, make_frame=make, provenance=provenance)


def _check_other(other: HapticMedium, medium: HapticMedium, needed: int) -> None:
    if other.grid != medium.grid:
        raise InvalidArgument("compose", f"a medium on {other.grid}", f"one on {medium.grid}")
    if len(other) < needed:
        raise InvalidArgument("compose", f"a medium of {len(other)} frames", f"at least the {needed} to be edited")


def _blended(
    before_n: NDArray[np.float32], after_n: NDArray[np.float32], share: NDArray[np.float64]
) -> NDArray[np.float32]:
    """`before_n` where the share is 0, `after_n` where it is 1, both to the bit; between them a mixture."""
    result = np.where((share == 1)[..., None], after_n, before_n)
    between = (share > 0) & (share < 1)
    if between.any():
        x, y = before_n[between].astype(np.float64), after_n[between].astype(np.float64)
        result[between] = x + share[between][:, None] * (y - x)
    return result
