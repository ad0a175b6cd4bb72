"""Scan orders: the permutation of samples and bricks, and the samples within the grid (`c/touch_model.h`)."""

from __future__ import annotations

import numpy as np
import pytest
from field_makers import GRID
from native_model import scan_of

SCAN_CODES = [code for code in range(32) if code & 3 < 3]


@pytest.mark.parametrize("code", SCAN_CODES)
def test_samples_and_bricks_agree_with_the_grid(code: int) -> None:
    """Bits 0 and 1 name the slowest axis, the other axes follow in order; bits 2 to 4: descending axes."""
    axes = [code & 3, *(n for n in range(3) if n != code & 3)]
    down = [bool(code >> 2 + n & 1) for n in range(3)]
    padded = 8 * np.array(GRID.brick_shape)[axes]
    local = np.stack(np.indices((8, 8, 8)), axis=-1)
    found = set()
    for brick in np.argwhere(np.ones(GRID.brick_shape)):
        scan = scan_of(code, GRID, brick.tolist())
        found.add(tuple(scan.brick.tolist()))
        along = 8 * scan.brick + local
        # on a descending axis samples are counted from the end of the padded grid
        along = np.where(down, padded - 1 - along, along)
        index = np.zeros(along.shape, int)
        index[..., axes] = along
        assert (index >> 3 == brick).all()
        i, j, k = np.moveaxis(index % 8, -1, 0)
        assert (scan.sample == (i << 6 | j << 3 | k)).all()
        is_inside = ((scan.low <= local) & (local < scan.high)).all(axis=-1)
        assert (is_inside == (index < GRID.shape).all(axis=-1)).all()
    assert found == set(np.ndindex(*np.array(GRID.brick_shape)[axes].tolist()))
