"""What a device can render of a medium, in bits: the mapping M of the paper's section 3.1 applied to a stored W.

W is a medium on its own lattice, the reference space. For each device it is scaled into the workspace, low-passed and
resampled to the device's lattice, clipped to F_max and quantised; equations 1 to 3 then compare the two.

A point device is given the lattice over W's own box, and where its lattice is finer than W's, W's: more samples of
the same field would not be more information (the "active mappings" that the paper's min() excludes), nor would the
empty rest of a larger workspace. An array has its actuators and no others.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from touchfield.codec.field_quantiser import DEFAULT_QUANTISER, FieldQuantiserSpec
from touchfield.devices import Device, device
from touchfield.filters.device_filter import DeviceFilterSpec, device_medium, limited
from touchfield.job.prepare import placed_lattice
from touchfield.job.spec import EncodeSpec
from touchfield.medium import Grid
from touchfield.sources.laws import LawSpec, profile_of
from touchfield.sources.stored import StoredScene

if TYPE_CHECKING:
    from touchfield.filters.placement import Placement
    from touchfield.medium import HapticMedium

__all__ = ["Mapped", "mapped"]


@dataclass(frozen=True)
class Mapped:
    """M(W) for one device.

    Attributes
    ----------
    device : Device
    medium : HapticMedium
    quantiser : FieldQuantiserSpec
        The force levels that the device is given: its own steps where the profile counts them, else Q.
    notes : tuple of str
    """

    device: Device
    medium: HapticMedium
    quantiser: FieldQuantiserSpec
    notes: tuple[str, ...]


def mapped(medium: HapticMedium, name: str, asked: FieldQuantiserSpec, spec: EncodeSpec | None = None) -> Mapped:
    """A medium through the mapping M of one device.

    Parameters
    ----------
    medium : HapticMedium
        W; its forces are used as they are.
    name : str
        A device profile, or a TOML file.
    asked : FieldQuantiserSpec
        Q of W.
    spec : EncodeSpec, optional
        Its mapping, oversample, pool and cutoff are used.
    """
    spec = replace(spec or EncodeSpec(), device=name, nw=None)
    chosen, scene = device(name), StoredScene(medium)
    # a stored field has no law; this one only says how thin a wall the depth pooling of an array must not miss
    profile = profile_of(LawSpec("penalty", 500.0, chosen.force_max_n), math.inf)
    placement, grid = placed_lattice(scene, chosen, spec, profile)
    grid, notes = (grid, ()) if chosen.is_array else _no_finer(grid, placement.to_hand(medium.grid))
    filter_spec = DeviceFilterSpec(oversample=spec.oversample, pool=spec.pool, cutoff=spec.cutoff)
    shown = device_medium(scene, chosen, grid, placement, profile, filter_spec)
    # a lattice equal to W's passes the device filter untouched, but no device exceeds its F_max
    clipped = replace(shown, make_frame=lambda i: limited(shown[i], chosen.force_max_n))
    return Mapped(chosen, clipped, _levels(chosen, asked), (*notes, _scale_note(placement)))


def _no_finer(nominal: Grid, reference: Grid) -> tuple[Grid, tuple[str, ...]]:
    """The nominal lattice over the box of W, both in the device's metres; W's own where that is finer."""
    low, high = reference.box_m
    counts = [
        min(n, max(1, round((b - a) / h)))
        for a, b, h, n in zip(low, high, nominal.spacing_m, reference.shape, strict=True)
    ]
    if tuple(counts) != reference.shape:
        x, y, z = counts
        return Grid.over_box(low, high, (x, y, z)), ()
    was = "x".join(map(str, nominal.shape))
    return reference, (f"its {was} samples are finer than the medium's, whose own are taken",)


def _scale_note(placement: Placement) -> str:
    return f"1 mm of the device's hand is {1 / placement.scale:.4g} mm of the medium"


def _levels(chosen: Device, asked: FieldQuantiserSpec) -> FieldQuantiserSpec:
    """Q of the device: its own levels; an array renders magnitudes, and has no directions to tell."""
    if asked.form == "distinct":
        asked = FieldQuantiserSpec.parse(DEFAULT_QUANTISER)
    if chosen.levels is not None and chosen.levels > 1:
        return FieldQuantiserSpec("uniform", chosen.force_max_n / (chosen.levels - 1), "none")
    if chosen.is_array:
        return replace(asked, directions="none")
    return asked
