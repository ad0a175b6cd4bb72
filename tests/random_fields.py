"""Random fields, for a device."""

from __future__ import annotations

import numpy as np

from touchfield.devices import device
from touchfield.medium import ForceField, Grid

OMNI = device("phantom-omni")


def random_field(grid: Grid, seed: int, density: float = 0.05) -> ForceField:
    rng = np.random.default_rng(seed)
    return ForceField.from_dense(
        grid, rng.normal(size=(*grid.shape, 3)) * (rng.random(grid.shape) < density)[..., None]
    )
