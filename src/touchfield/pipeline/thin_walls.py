"""Thickens walls of a scene that the lattice cannot hold, and reports them (decision 25)."""

from __future__ import annotations

from typing import Final

import numpy as np

from touchfield.pipeline.objects import MOVING_SPACING, turned_spacing_m
from touchfield.pipeline.placement import Mapping
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.scene import Scene
from touchfield.sources.thin_walls import SURFACE_N, MinThickness, ThinWall

_MAX_NAMES: Final = 4


def thicken(scene: Scene, mapping: Mapping, spec: EncodeSpec, is_of_objects: bool) -> tuple[Scene, str]:
    """Return a scene without walls that are too thin, or as it is, and a note on them; "" if there are none.

    A wall is the penalty law's, and is pressed with a point: scenes for arrays, and other laws, stay as they
    are.
    """
    if mapping.device.is_array or not scene.has_law or "penalty" not in spec.law_spec(1.0).names:
        return scene, ""
    thick, walls = scene.thickened(_min_thickness(mapping, spec, is_of_objects))
    if not walls:
        return scene, ""
    if spec.thin == "keep":
        return scene, _note(walls, mapping.placement.scale, is_kept=True)
    return thick, _note(walls, mapping.placement.scale, is_kept=False)


def _min_thickness(mapping: Mapping, spec: EncodeSpec, is_of_objects: bool) -> MinThickness:
    """The rule for a scene; a moving body of the object representation has a lattice of its own."""
    scale, spacing = mapping.placement.scale, np.asarray(mapping.grid.spacing_m)
    shifted, turned = spacing, np.full(3, spacing.max())
    if is_of_objects:
        shifted, turned = MOVING_SPACING * spacing, turned_spacing_m(MOVING_SPACING * spacing)
    x, y, z = ((a / scale, b / scale, c / scale) for a, b, c in (spacing, shifted, turned))
    return MinThickness(x, y, z, 2 * SURFACE_N / spec.stiffness_n_per_m / scale, is_of_objects=is_of_objects)


def _note(walls: tuple[ThinWall, ...], scale: float, is_kept: bool) -> str:
    """One line: which walls are too thin, and what was done; lengths are those of the hand."""
    texts = []
    for wall in sorted(walls, key=lambda wall: wall.thickness_m)[:_MAX_NAMES]:
        before, after = 1e3 * scale * wall.thickness_m, 1e3 * scale * wall.thickened_m
        texts.append(
            f"{wall.name} of {before:.2g} mm "
            + (f"({after:.3g} mm would hold)" if is_kept else f"is now {after:.3g} mm thick")
        )
    more = f" and {len(walls) - _MAX_NAMES} more" if len(walls) > _MAX_NAMES else ""
    listed = ", ".join(texts) + more
    if is_kept:
        return f"Too thin for the lattice: {listed}: the hand may pass through (--thin thicken, --nw)."
    return f"Too thin for the lattice, thickened: {listed} (--thin keep leaves it, --nw)."
