"""The wall that a field tells of: how stiff, and where its surface is taken to lie; None where a field is no wall's.

A penalty force grows against itself: a sample farther out it is less by K for each metre, and points alike. Where
most samples do so the field is a wall's; its stiffness is that of the steeper ones, as edges, thin walls and the
low-pass lessen it. Where the file states the stiffness of its walls, that is taken: a thin wall is as hard as a thick
one.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping

    from touchfield.medium import ForceField

__all__ = ["Wall", "stated_n_per_m", "wall_of"]

_LOOKED_AT: Final = 20_000  # samples
_LARGE: Final = 98.0  # percentile of the forces: their limit, or near it; a few overshoot it
_RAMP: Final = (0.1, 0.85)  # of a large force: neither at the surface nor at the limit
_ALIKE: Final = 0.8  # cosine of forces a sample apart
_LESS: Final = 0.97  # of a force, a sample farther out
_LEAST: Final = 0.6  # of the samples
_STEEPER: Final = 75.0  # percentile
_LEVEL_N: Final = 0.05
_STATED_N_PER_M: Final = (1.0, 5000.0)  # what a file may ask for
_LEVEL_SHARE: Final = 0.1  # of a large force


@dataclass(frozen=True)
class Wall:
    """A wall.

    Parameters
    ----------
    stiffness_n_per_m : float
        By how much the force grows behind the surface.
    level_n : float
        The force at which the surface is taken to lie.
    spacing_m : (float, float, float)
        Of the samples that tell of it.
    """

    stiffness_n_per_m: float
    level_n: float
    spacing_m: tuple[float, float, float]


def wall_of(field: ForceField) -> Wall | None:
    """The wall that a field tells of, from at most 20,000 of its samples.

    Parameters
    ----------
    field : ForceField

    Returns
    -------
    Wall or None
        None where most of the field does not grow against its force, as a steady pull.
    """
    sizes = np.linalg.norm(field.forces_n, axis=-1)
    if not sizes.any():
        return None
    large = float(np.percentile(sizes[sizes > 0], _LARGE))
    brick, *local = np.nonzero((sizes > _RAMP[0] * large) & (sizes < _RAMP[1] * large))
    if not len(brick):
        return None
    some = slice(None, None, -(-len(brick) // _LOOKED_AT))
    forces = field.forces_n[brick, *local][some].astype(np.float64)
    size = np.linalg.norm(forces, axis=1)
    outwards = forces / size[:, None]
    spacing_m = np.array(field.grid.spacing_m)
    way_m = np.linalg.norm(outwards * spacing_m, axis=1)
    at = 8 * field.bricks[brick[some]] + np.stack(local, axis=-1)[some]
    beyond = field.sample_n(field.grid.to_m(at) + way_m[:, None] * outwards).astype(np.float64)
    farther = np.linalg.norm(beyond, axis=1)
    is_wall = (np.einsum("ij,ij->i", beyond, outwards) >= _ALIKE * farther) & (farther < _LESS * size)
    if np.mean(is_wall) < _LEAST:
        return None
    stiffness = float(np.percentile(((size - farther) / way_m)[is_wall], _STEEPER))
    return Wall(stiffness, min(_LEVEL_N, _LEVEL_SHARE * large), field.grid.spacing_m)


def stated_n_per_m(provenance: Mapping[str, str]) -> float | None:
    """The stiffness that a medium's provenance states for its walls; None where it states none that could be."""
    try:
        spec = json.loads(provenance.get("spec", "{}"))
        stated = float(spec["stiffness_n_per_m"]) if spec["law"] == "penalty" else math.nan
    except (ValueError, KeyError, TypeError, RecursionError):
        return None
    low, high = _STATED_N_PER_M
    return stated if low <= stated <= high else None
