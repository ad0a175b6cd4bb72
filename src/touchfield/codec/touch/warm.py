"""Tasks that compile the kernels of the coder `touch`.

They are the kernels that a first ``touchfield encode`` waits for.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

import numpy as np

from touchfield.codec.touch.spec import TouchSpec
from touchfield.medium import ForceField, Grid


def solid() -> ForceField:
    """A solid with a wavy top, on a grid of three bricks along each axis."""
    x, y, z = np.indices((24, 24, 24), np.float32)
    depth = 18 + np.sin(x / 3) + np.cos(y / 4) - z
    steep = np.stack([-np.cos(x / 3) / 3, np.sin(y / 4) / 4, np.ones_like(z)], axis=-1)
    grid = Grid((24, 24, 24), (0.01,) * 3, (0.0,) * 3)
    return ForceField.from_dense(grid, np.clip(0.2 * depth, 0, 2)[..., None] * steep)


def _passes() -> None:
    from touchfield.codec.touch.encoder import TouchEncoder

    TouchEncoder(solid().grid, TouchSpec(guess="off")).encode_segment([solid()] * 2)


def _columns() -> None:
    from touchfield.codec.touch.base_layer import decode_columns
    from touchfield.codec.touch.base_layer_fit import fit_columns
    from touchfield.codec.touch.frame_encoder import lattice_for, limits_for

    field, spec = solid(), TouchSpec()
    lattice = lattice_for(spec, 2.0)
    columns = fit_columns(field, lattice, limits_for(spec, lattice))
    if columns is not None:
        decode_columns(columns[0], field.grid)


GROUPS: Final[Mapping[str, Callable[[], None]]] = {"passes": _passes, "columns": _columns}
"""Groups of kernels; each task compiles its group by calling the kernels as an encoder does."""
