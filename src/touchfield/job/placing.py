"""The place of a scene in a device's workspace, and the lattice over it: the mapping M of the paper's section 3.1."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.arrays import Float64s
from touchfield.errors import InvalidArgument
from touchfield.filters.device_filter import device_grid, device_medium
from touchfield.medium import Grid, HapticMedium
from touchfield.medium.grid import Placement
from touchfield.sources.laws import LawSpec, profile_of
from touchfield.sources.registry import unit_notes

if TYPE_CHECKING:
    from touchfield.devices import Device
    from touchfield.job.spec import EncodeSpec
    from touchfield.sources.laws import ForceProfile
    from touchfield.sources.scene import Scene


FIT_MARGIN: Final = 0.05
"""Of the workspace's shortest side, what a fit leaves free on every side: a hand comes from outside the surface."""

_ROUNDING_M: Final = 1e-9


@dataclass(frozen=True)
class Mapping:
    """The mapping M of one device, for scenes in any frame.

    `grid` is the lattice over the workspace and `profile` the force law, both in hand metres; of `spec` the device
    filter is used, and not the haptic filters; `notes` are on the scale, and on units that look odd. `is_own` tells
    that the lattice is that of a stored field, which is kept without loss.
    """

    device: Device
    grid: Grid
    placement: Placement
    profile: ForceProfile
    spec: EncodeSpec
    notes: tuple[str, ...] = ()
    is_own: bool = False

    def medium(self, scene: Scene) -> HapticMedium:
        """A scene where it is, through the device filter."""
        return device_medium(scene, self.device, self.grid, self.placement, self.profile, self.spec.device_filter)

    def about_origin(self, grid: Grid) -> Mapping:
        """The same for a scene in its own frame, on a lattice of its own."""
        return replace(self, grid=grid, placement=Placement(self.placement.scale))


def mapping_of(scene: Scene, chosen: Device, spec: EncodeSpec, profile: ForceProfile | None = None) -> Mapping:
    """The mapping of a scene to the workspace of a device; `profile` is by default that of the force law of `spec`.

    InvalidArgument if the mapping is unknown, or a field that is kept without loss is larger than the workspace.
    """
    own, law = None, law_of(spec, chosen)
    of_law = profile or profile_of(law, math.inf if scene.is_solid else law.saturation_m)
    placement, grid = _lattice(scene, chosen, spec, of_law)
    if profile is None:
        own = _own_lattice(scene, chosen, spec)
        placement, grid = own or (placement, grid)
    length = _wording(scene, chosen, placement, spec)
    if own:
        length += "; the field keeps its own lattice, as it is kept without loss: --nw is not used"
    notes = (length, *unit_notes(scene, *_fitted(scene, spec)))
    return Mapping(chosen, grid, placement, of_law, spec, notes, own is not None)


def law_of(spec: EncodeSpec, chosen: Device) -> LawSpec:
    """The force law that was asked for, with the device's F_max."""
    return LawSpec(
        spec.law,
        spec.stiffness_n_per_m,
        chosen.force_max_n,
        spec.thickness_m,
        spec.band_m,
        spec.surface_damping_n_s_per_m,
    )


def stored_medium(scene: Scene) -> HapticMedium | None:
    """The medium of a scene that is a stored field; of any other None."""
    stored = getattr(scene, "medium", None)
    return stored if isinstance(stored, HapticMedium) else None


def _lattice(scene: Scene, chosen: Device, spec: EncodeSpec, profile: ForceProfile) -> tuple[Placement, Grid]:
    """The device's own lattice over the scene.

    An array pools the whole depth of the scene, so that its third axis sets no limit to the scale.
    """
    box = scene.bounds_between_m(*_fitted(scene, spec))
    is_stored = stored_medium(scene) is not None
    reach_m = 0.0 if is_stored else max(0.0, profile.high_m)
    workspace = chosen.workspace_m
    if not chosen.is_array:
        margin_m = reach_m if is_stored or spec.mapping != "fit" else reach_m + FIT_MARGIN * min(workspace)
        return _placement(box, workspace, spec.mapping, margin_m), device_grid(chosen, spec.nw)
    placement = _placement(box, (*workspace[:2], math.inf), spec.mapping, 0.0)
    wall_m = -profile.low_m if math.isfinite(profile.low_m) else 0.0
    depth_m = placement.scale * float(box[1][2] - box[0][2]) + 2 * (reach_m + wall_m)
    return placement, device_grid(chosen, spec.nw, depth_m or None)


def _own_lattice(scene: Scene, chosen: Device, spec: EncodeSpec) -> tuple[Placement, Grid] | None:
    """The lattice of a stored field that is to be kept without loss: the device's would change its forces.

    The field stays where it is, or is moved to the middle; a factor as `mapping` makes the lattice larger or smaller
    by that, and its forces no other. None where nothing stored is to be kept without loss, or an array takes it.
    """
    stored = stored_medium(scene)
    if spec.coder != "touch" or spec.touch.mode != "lossless" or chosen.is_array or stored is None:
        return None
    half, box = np.asarray(chosen.workspace_m) / 2 + _ROUNDING_M, np.stack(stored.grid.box_m)
    factor = 1.0 if spec.mapping in ("fit", "fill", "crop") else float(spec.mapping)
    if factor == 1.0 and (np.abs(box) <= half).all():
        return Placement(), stored.grid
    if not (factor * np.ptp(box, axis=0) <= 2 * half).all():
        size, room = (" x ".join(f"{1e3 * side:.4g}" for side in s) for s in (factor * np.ptp(box, axis=0), 2 * half))
        raise InvalidArgument(
            "--lossless-quantised",
            f"a stored field of {size} mm in a workspace of {room} mm",
            "one that fits, as the samples of another lattice would be other forces",
            "Take a larger --device, a --mapping factor that makes it fit, or --mode mask.",
        )
    placement = Placement.scaled(box, factor)
    return placement, placement.to_hand(stored.grid)


def _fitted(scene: Scene, spec: EncodeSpec) -> tuple[int, int]:
    """The frames, start and stop, whose surface is fitted into the workspace."""
    start, stop = spec.fit_frames or spec.frames or (0, None)
    end = scene.frame_count if stop is None else stop
    if not 0 <= start < end <= scene.frame_count:
        name, expected = "fit_frames" if spec.fit_frames else "frames", f"a range within 0:{scene.frame_count}"
        raise InvalidArgument(name, f"{start}:{end}", expected, "Name frames that are there.")
    return start, end


def _wording(scene: Scene, chosen: Device, placement: Placement, spec: EncodeSpec) -> str:
    """A note on the scale, and on what was fitted."""
    length = placement.wording
    if chosen.is_array or spec.mapping != "fit" or stored_medium(scene) is not None:
        return length
    start, stop = _fitted(scene, spec)
    frames = f" in frames {start} to {stop - 1}" if scene.frame_count > 1 else ""
    frames = " in the first picture" if scene.is_captured else frames
    margin_mm = 1e3 * FIT_MARGIN * min(chosen.workspace_m)
    return (
        f"{length}: {scene.box_wording}{frames} fits into the workspace, {margin_mm:.3g} mm of it left on every side"
    )


def _placement(box_m: Float64s, workspace_m: tuple[float, float, float], mapping: str, margin_m: float) -> Placement:
    if mapping in ("fit", "fill"):
        return Placement.fit(box_m, workspace_m, margin_m=margin_m)
    if mapping == "crop":
        return Placement.crop(box_m)
    try:
        factor = float(mapping)
    except ValueError:
        raise InvalidArgument("mapping", repr(mapping), "fit, fill, crop, or a factor such as 0.05") from None
    return Placement.scaled(box_m, factor)
