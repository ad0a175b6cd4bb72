"""Updates: a field as a base with bricks replaced, and its filtering where it differs from the base."""

from __future__ import annotations

import numpy as np
import pytest

from random_fields import random_field
from touchfield.filters.resample import resample, resample_update
from touchfield.medium import ForceField, Grid
from touchfield.medium.field import brick_keys
from touchfield.medium.updates import FieldUpdate, with_bricks

GRID = Grid((40, 36, 44), (0.002, 0.0025, 0.003), (-0.04, 0.01, 0.02))


def updated(base: ForceField, seed: int) -> tuple[FieldUpdate, np.ndarray]:
    """An update of a third of the bricks, one of which vanishes and one of which is new; its dense field."""
    rng = np.random.default_rng(seed)
    bricks = np.argwhere(rng.random(GRID.brick_shape) < 0.3).astype(np.int32)
    dense, other = base.to_dense(), random_field(GRID, seed + 1, 0.02).to_dense()
    for number, (x, y, z) in enumerate(8 * bricks):
        box = slice(x, x + 8), slice(y, y + 8), slice(z, z + 8)
        dense[box] = other[box] = 0.0 if number % 5 == 0 else other[box]
    is_part = np.zeros(GRID.shape, bool)
    for x, y, z in 8 * bricks:
        is_part[x : x + 8, y : y + 8, z : z + 8] = True
    part = ForceField.from_dense(GRID, np.where(is_part[..., None], other, 0.0))
    assert len(part.bricks) < len(bricks)
    return FieldUpdate(base, rng.permutation(bricks), part), dense


@pytest.mark.parametrize("density", [0.0, 0.002, 0.05])
def test_an_update_is_the_base_with_bricks_replaced(density: float) -> None:
    base = random_field(GRID, 1, density)
    update, dense = updated(base, 2)
    assert update.field == ForceField.from_dense(GRID, dense)
    assert update.field is update.field
    near = update.bricks[:4]
    is_near = np.isin(brick_keys(GRID, update.base.bricks), brick_keys(GRID, near))
    expected = with_bricks(ForceField(GRID, base.bricks[is_near], base.forces_n[is_near]), near, update.part)
    assert update.between(near) == with_bricks(expected, update.bricks, update.part)


def test_an_update_of_nothing_is_the_base_itself() -> None:
    base = random_field(GRID, 1)
    update = FieldUpdate(base, np.empty((0, 3), np.int32), ForceField.empty(GRID))
    assert update.field is base


@pytest.mark.parametrize("kernel", ["spline", "box", "sinc"])
@pytest.mark.parametrize("shape", [(20, 18, 22), (61, 33, 50)])
def test_an_update_is_resampled_to_the_bits_of_its_field(kernel: str, shape: tuple[int, int, int]) -> None:
    spacing = [0.9 * n * h / m for n, m, h in zip(GRID.shape, shape, GRID.spacing_m, strict=True)]
    target = Grid(shape, tuple(spacing), tuple(x + 0.001 for x in GRID.origin_m))  # type: ignore[arg-type]
    base = random_field(GRID, 3, 0.01)
    update, _ = updated(base, 4)
    few = FieldUpdate(base, update.bricks[:3], ForceField.empty(GRID))
    for case in (update, few):
        bricks, part = resample_update(case, target, kernel)
        whole = resample(case.field, target, kernel)
        assert with_bricks(resample(base, target, kernel), bricks, part) == whole
    assert len(bricks) < len(whole.bricks)
