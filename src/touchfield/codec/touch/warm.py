"""Small jobs of the coder `touch` that compile what a first ``touchfield encode`` takes longest to compile."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

import numpy as np

from touchfield.codec.touch.spec import TouchSpec
from touchfield.medium import ForceField, Grid


def solid() -> ForceField:
    """A solid with a wavy top that fills three bricks along each axis of its grid."""
    x, y, z = np.indices((24, 24, 24), np.float32)
    depth = 18 + np.sin(x / 3) + np.cos(y / 4) - z
    steep = np.stack([-np.cos(x / 3) / 3, np.sin(y / 4) / 4, np.ones_like(z)], axis=-1)
    grid = Grid((24, 24, 24), (0.01,) * 3, (0.0,) * 3)
    return ForceField.from_dense(grid, np.clip(0.2 * depth, 0, 2)[..., None] * steep)


def _passes() -> None:
    from touchfield.codec.touch.encoder import TouchEncoder

    TouchEncoder(solid().grid, TouchSpec(guess="off")).encode_segment([solid()] * 2)


def _columns() -> None:
    from touchfield.codec.touch.frame_encoder import lattice_for, limits_for
    from touchfield.codec.touch.guess import columns_of_bytes
    from touchfield.codec.touch.guess_fit import fit_columns

    field, spec = solid(), TouchSpec()
    lattice = lattice_for(spec, 2.0)
    columns = fit_columns(field, lattice, limits_for(spec, lattice))
    if columns is not None:
        columns_of_bytes(columns[0], field.grid)


GROUPS: Final[Mapping[str, Callable[[], None]]] = {"passes": _passes, "columns": _columns}
"""Kernels that are compiled together, each by a small job that calls them as the large ones do."""
