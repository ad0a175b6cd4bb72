"""Scales and moves a scene into the workspace of a device, and chooses the lattice of samples over it (the
mapping M, paper section 3.1)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from touchfield.arrays import Float64s
from touchfield.devices import Device
from touchfield.errors import InvalidArgument, SourceError
from touchfield.filters.array_filter import array_margin_m
from touchfield.filters.device_spec import DeviceFilter, device_grid
from touchfield.medium import Grid
from touchfield.medium.grid import Placement
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.laws import ForceProfile, profile_of
from touchfield.sources.scene import Scene

FIT_MARGIN: Final = 0.05
"""Free margin that a fit leaves on every side, as a fraction of the workspace's shortest side.

A hand approaches a surface from outside.
"""
MIN_SCALE: Final = 1e-30  # of a placement that a file can state, as of `touchfield.container.records`
MAX_OFFSET_M: Final = 1e9
_ROUNDING_M: Final = 1e-9


@dataclass(frozen=True, kw_only=True)
class Mapping(DeviceFilter):
    """The mapping M of one device, and how it was fitted to a scene.

    `fit_frames` are the frames, start and stop, whose surface
    is fitted into the workspace; `fit_box_m` is its box, scene metres, float64 [2, 3]. `keeps_lattice` is
    True if the lattice is that of a stored field, which is kept without loss.
    """

    fit_frames: tuple[int, int]
    fit_box_m: Float64s
    keeps_lattice: bool = False


def mapping_of(
    scene: Scene, device: Device, spec: EncodeSpec, profile: ForceProfile | None = None
) -> Mapping:
    """The mapping of a scene to the workspace of a device.

    `profile` is by default that of the force law of `spec`. InvalidArgument if the mapping is unknown, or a
    field that is kept without loss is larger than the workspace.
    """
    lossless, law = None, spec.law_spec(device.force_max_n)
    force_profile = profile or profile_of(law, math.inf if scene.is_solid else law.saturation_m)
    frames = _fit_range(scene, spec)
    box_m = scene.bounds_between_m(*frames)
    placement, grid = _lattice(scene, box_m, device, spec, force_profile)
    if profile is None:
        lossless = _lossless_lattice(scene, device, spec)
        placement, grid = lossless or (placement, grid)
    _require_usual_size(scene, box_m, placement)
    return Mapping(
        device,
        grid,
        placement,
        force_profile,
        spec.device_filter,
        fit_frames=frames,
        fit_box_m=box_m,
        keeps_lattice=lossless is not None,
    )


def _require_usual_size(scene: Scene, box_m: Float64s, placement: Placement) -> None:
    """SourceError for a scene so small, large or far away that a file cannot state its placement."""
    option, *_ = scene.unit or ("the unit",)
    size_m, distance_m = float(np.ptp(box_m, axis=0).max()), float(np.abs(placement.offset_m).max())
    if not MIN_SCALE <= placement.scale <= 1 / MIN_SCALE:
        where, expected = f"a scene of {size_m:.3g} m", "the size of a scene in metres"
        raise SourceError("The source", where, expected, f"Check {option}, and values that mark gaps.")
    if not distance_m <= MAX_OFFSET_M:
        found = f"a scene {distance_m:.3g} m from its origin"
        expected = f"at most {MAX_OFFSET_M:g} m"
        raise SourceError("The source", found, expected, f"Check {option}, or subtract an offset.")


def _fit_range(scene: Scene, spec: EncodeSpec) -> tuple[int, int]:
    """The frames, start and stop, whose surface is fitted into the workspace."""
    start, spec_stop = spec.fit_frames or spec.frames or (0, None)
    stop = scene.frame_count if spec_stop is None else spec_stop
    if not 0 <= start < stop <= scene.frame_count:
        name = "fit_frames" if spec.fit_frames else "frames"
        expected = f"a range within 0:{scene.frame_count}"
        raise InvalidArgument(name, f"{start}:{stop}", expected, "Name frames that exist.")
    return start, stop


def _lattice(
    scene: Scene, box_m: Float64s, device: Device, spec: EncodeSpec, profile: ForceProfile
) -> tuple[Placement, Grid]:
    """The placement of a scene whose surface fills a box, and the device's lattice over it.

    An array pools the whole depth of the scene, so that the depth does not limit the scale.
    """
    workspace, margin_m = device.workspace_m, 0.0
    if device.is_array:
        workspace = (workspace[0], workspace[1], math.inf)
    elif scene.stored is None:
        margin_m = max(0.0, profile.high_m)
        if 2 * margin_m >= min(workspace):
            expected = f"metres, less than half the workspace, {min(workspace) / 2:g} m"
            raise InvalidArgument("band_m", f"{spec.band_m:g}", expected, "4 mm are 0.004.")
        margin_m += FIT_MARGIN * min(workspace) if spec.mapping == "fit" else 0.0
    if spec.factor is None:
        placement = Placement.fit(box_m, workspace, margin_m=margin_m)
    else:
        placement = Placement.scaled(box_m, spec.factor)
    pooled_m = None
    if device.is_array:
        pooled_m = placement.scale * float(box_m[1][2] - box_m[0][2]) + 2 * array_margin_m(profile)
    return placement, device_grid(device, spec.nw, pooled_m or None)


def _lossless_lattice(scene: Scene, device: Device, spec: EncodeSpec) -> tuple[Placement, Grid] | None:
    """The placement and lattice of a stored field that is kept without loss, centred or scaled.

    None for any other scene. InvalidArgument if the field is larger than the workspace.
    """
    stored = scene.stored
    if spec.coder != "touch" or spec.touch.mode != "lossless" or device.is_array or stored is None:
        return None
    half, box = np.asarray(device.workspace_m) / 2 + _ROUNDING_M, np.stack(stored.grid.box_m)
    factor = spec.factor or 1.0
    if factor == 1.0 and (np.abs(box) <= half).all():
        return Placement(), stored.grid
    sides_m = factor * np.ptp(box, axis=0)
    if not (sides_m <= 2 * half).all():
        raise InvalidArgument(
            "--lossless-quantised",
            f"a stored field of {sides_mm(sides_m)} mm in a workspace of {sides_mm(2 * half)} mm",
            "one that fits, as the samples of another lattice would be other forces",
            "Take a larger --device, a --mapping factor that makes it fit, or --mode mask.",
        )
    placement = Placement.scaled(box, factor)
    return placement, placement.to_hand(stored.grid)


def sides_mm(sides_m: Float64s) -> str:
    """The sides of a box in millimetres, for a message."""
    return " x ".join(f"{1e3 * side:.4g}" for side in sides_m)
