"""Converts a scene to the lattice of a device that a hand moves as a point (type 1): samples it finely, then
low-passes it to the device's spacing.

The scene's field is sampled on a lattice `oversample` times finer than the device's that reaches slightly
beyond the workspace. A low-pass takes it to the device's lattice.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, TypeVar
from weakref import ref

import numpy as np

from touchfield.arrays import Float64s
from touchfield.filters.device_spec import DeviceFilter
from touchfield.filters.limit import limit_forces
from touchfield.filters.resample import low_pass, resample, resample_update
from touchfield.medium import ForceField
from touchfield.medium.grid import Placement
from touchfield.medium.updates import FieldUpdate, with_bricks

if TYPE_CHECKING:
    from touchfield.sources.laws import ForceProfile
    from touchfield.sources.scene import Scene
    from touchfield.sources.shapes.analytic_scene import AnalyticScene

_Source = TypeVar("_Source", ForceField, FieldUpdate)


def _repeating(function: Callable[[_Source], ForceField]) -> Callable[[_Source], ForceField]:
    """Return a function that repeats its latest result for the same object.

    It keeps a weak reference: a fine field takes several times the memory of the result.
    """
    latest: tuple[ref[_Source], ForceField] | None = None

    def repeated(source: _Source) -> ForceField:
        nonlocal latest
        last = latest
        if last is None or last[0]() is not source:
            last = latest = ref(source), function(source)
        return last[1]

    return repeated


def point_frames(scene: Scene, mapping: DeviceFilter) -> Callable[[int], ForceField]:
    """Return M(W) of a point device by frame; if the scene repeats a field object, so does the result."""
    grid, placement, spec = mapping.grid, mapping.placement, mapping.spec
    factor, law = spec.oversample, mapping.profile.rescaled(placement.scale)
    # finer than the device's lattice, and reaching beyond the workspace
    margin = math.ceil(2 * low_pass(spec.low_pass).half_width * factor) + 1
    fine = grid.refined(factor).padded((margin, margin, margin))
    requested, lattice = placement.to_scene(fine), placement.to_scene(grid)
    force_max_n = mapping.device.force_max_n
    scene.set_lattice(lattice, force_max_n)  # also for the notes of the source
    floor_n = force_max_n * spec.force_floor_share

    def filter_field(source: ForceField) -> ForceField:
        return limit_forces(resample(source.on_grid(fine), grid, spec.low_pass), force_max_n, floor_n)

    def filter_update(update: FieldUpdate) -> ForceField:
        base = filtered(update.base)
        if not len(update.bricks):
            return base
        bricks, part = resample_update(update.on_grid(fine), grid, spec.low_pass)
        return with_bricks(base, bricks, limit_forces(part, force_max_n, floor_n))

    filtered, updated = _repeating(filter_field), _repeating(filter_update)

    def frame(i: int) -> ForceField:
        scene.set_lattice(lattice, force_max_n)  # the scene may serve several media in turn
        update = scene.field_update(i, requested, law)
        return filtered(scene.field(i, requested, law)) if update is None else updated(update)

    return frame


def exact_forces(
    scene: AnalyticScene, placement: Placement, profile_hand: ForceProfile, force_max_n: float
) -> Callable[[Float64s], Float64s]:
    """Return the exact force of analytic shapes, clipped to F_max, as a function of points.

    The function is ``forces(points_m float64 [n, 3]) -> newtons [n, 3]``. Points and the force law are in
    metres of the hand.
    """
    law = profile_hand.rescaled(placement.scale)
    offset_m = np.asarray(placement.offset_m)

    def forces(points_m: Float64s) -> Float64s:
        forces_n = scene.forces_n(points_m / placement.scale + offset_m, law)
        size = np.linalg.norm(forces_n, axis=1, keepdims=True)
        return np.asarray(forces_n * (force_max_n / np.maximum(size, force_max_n)))

    return forces
