"""Lattices and limits as the encoder computes them."""

from __future__ import annotations

from typing import Any

import numpy as np

from touchfield.codec.touch.frame_encoder import lattice_for, limits_for
from touchfield.codec.touch.kernels.encode_pass import Limits
from touchfield.codec.touch.lattice import Lattice
from touchfield.codec.touch.spec import TouchSpec
from touchfield.medium import ForceField

FLAT = Lattice(1e-4, 500, 7000, 500, 7000)


def lattice_of(frame: ForceField) -> Lattice:
    """The lattice of a field with the default options."""
    return lattice_for(TouchSpec(), float(np.linalg.norm(frame.forces_n.astype(np.float64), axis=-1).max()))


def limits_of(lattice: Lattice, **options: Any) -> Limits:
    """The allowed error for the given options."""
    return limits_for(TouchSpec(**options), lattice)
