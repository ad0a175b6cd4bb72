"""Maps a stored medium to a device (the mapping M of paper section 3.1): scaled, resampled, clipped and
quantised, so that `touchfield measure` can say how many bits the device loses.

W is a medium on its own lattice, the reference space. For each device it is scaled into the workspace,
low-passed and resampled to the device's lattice, clipped to F_max and quantised; equations 1 to 3 then
compare the two. For a point device the lattice covers the part of W's box that fits into its workspace, and
is never finer than W's: more samples of the same field would not be more information (the "active mappings"
that the paper's min() excludes).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from touchfield.arrays import Int64s
from touchfield.codec.paper.field_quantiser import DEFAULT_QUANTISER, FieldQuantiser, FieldQuantiserSpec
from touchfield.compute.threads import Progress, silent
from touchfield.devices import Device, device
from touchfield.errors import InvalidArgument
from touchfield.filters.device_filter import device_medium
from touchfield.filters.limit import limit_forces
from touchfield.filters.resample import resample
from touchfield.measure.field_symbols import FieldSymbols
from touchfield.measure.partition import BoxLosses, DyadicLattice, Partition, optimal_partition
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.pipeline.placement import Mapping, mapping_of
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.laws import LawSpec, profile_of
from touchfield.sources.stored import StoredScene

_COARSE_QUANTISER: Final = "weber:0.25/ico1"  # ten amplitudes by twelve directions: a box has many of each


@dataclass(frozen=True)
class MappedMedium:
    """M(W) for one device.

    `source_grid` is the lattice of W in the hand metres of `medium`, so that both can be sampled at the same
    positions. `quantiser` has the force levels of the device: its own steps if the profile states them,
    else Q.
    """

    device: Device
    medium: HapticMedium
    source_grid: Grid
    quantiser: FieldQuantiserSpec
    notes: tuple[str, ...]


def map_to_device(
    medium: HapticMedium,
    name: str,
    quantiser: FieldQuantiserSpec,
    spec: EncodeSpec | None = None,
    density: float | None = None,
) -> MappedMedium:
    """Apply the mapping M of one device, a profile or a TOML file, to a medium with forces as they are.

    `quantiser` is Q of W. Of `spec` the mapping, oversample, pool and cutoff are used. `density` is the
    number of samples of W along each axis per sample of a point device, instead of its data sheet's value.
    """
    spec = replace(spec or EncodeSpec(), device=name, nw=None)
    target, scene = device(name), StoredScene(medium)
    # a stored field has no law; this one only sets the thinnest wall that an array's depth pooling detects
    law = profile_of(LawSpec("penalty", 500.0, target.force_max_n), math.inf)
    mapping = mapping_of(scene, target, spec, law)
    on_device, notes = _medium_on_device(scene, mapping, density)
    # a lattice equal to W's passes the device filter untouched, but no device exceeds its F_max
    clipped = replace(on_device, make_frame=lambda i: limit_forces(on_device[i], target.force_max_n))
    scale_note = f"1 mm of the device's hand is {1 / mapping.placement.scale:.4g} mm of the medium"
    source_grid = mapping.placement.to_hand(medium.grid)
    if quantiser.form == "distinct":
        quantiser = FieldQuantiserSpec.parse(DEFAULT_QUANTISER)
    if target.levels is not None and target.levels > 1:
        quantiser = FieldQuantiserSpec("uniform", target.force_max_n / (target.levels - 1), "none")
    elif target.is_array:  # an array renders magnitudes without direction
        quantiser = replace(quantiser, directions="none")
    return MappedMedium(target, clipped, source_grid, quantiser, (*notes, scale_note))


def _medium_on_device(
    scene: StoredScene, mapping: Mapping, density: float | None
) -> tuple[HapticMedium, tuple[str, ...]]:
    """W on the lattice that the device renders, and notes; `mapping` has the device's own lattice."""
    if mapping.device.is_array:
        return device_medium(scene, mapping), ()
    nominal, source_grid = mapping.grid, mapping.placement.to_hand(scene.stored.grid)
    first, last = (source_grid.to_index(corner) for corner in nominal.box_m)
    low = np.clip(np.ceil(first - 1e-6), 0, np.subtract(source_grid.shape, 1)).astype(np.int64)
    stop = np.clip(np.floor(last + 1e-6) + 1, low + 1, source_grid.shape)  # at least one sample
    high = stop.astype(np.int64)
    ratio = np.asarray(nominal.spacing_m) / source_grid.spacing_m if density is None else density
    counts = np.minimum(np.maximum(1, np.round((high - low) / ratio)), high - low)
    if (counts < high - low).any():
        box = source_grid.to_m(low - 0.5), source_grid.to_m(high - 0.5)
        x, y, z = counts.astype(int).tolist()
        resampled = device_medium(scene, replace(mapping, grid=Grid.over_box(*box, (x, y, z))))
        if not density:
            return resampled, ()
        return resampled, (f"{density:g} samples of the medium along each axis for one of the device",)
    shape_text = "x".join(map(str, nominal.shape))
    note = f"its {shape_text} samples are finer than the medium's, which are used: its lattice loses nothing"
    if not density:
        note += " (--density 5 sets it as far below the medium's as the paper does)"
    return _cropped(scene.stored, source_grid, low, high), (note,)


def _cropped(medium: HapticMedium, source_grid: Grid, low: Int64s, high: Int64s) -> HapticMedium:
    """Samples `low` to `high` of a medium, on that part of its grid `source_grid`."""
    x, y, z = (high - low).tolist()
    grid = Grid((x, y, z), source_grid.spacing_m, tuple(source_grid.to_m(low).tolist()))

    def frame(i: int) -> ForceField:
        field = medium[i]
        if grid.shape == field.grid.shape:
            return field.on_grid(grid)
        positions = field.positions()
        inside = ((positions >= low) & (positions < high)).all(axis=1)
        return ForceField.from_support(grid, positions[inside] - low, field.vectors_n()[inside])

    return replace(medium, grid=grid, make_frame=frame, vibration=None)


class SymbolFrames(Sequence[FieldSymbols]):
    """The frames of a medium after Q, each made on access; the last two are cached.

    `object_counts` has the number of voxels that are not 0, of each frame that was made. A slice makes no
    frame, and shares the cache.
    """

    def __init__(self, medium: HapticMedium, quantiser: FieldQuantiser) -> None:
        self.medium, self.quantiser = medium, quantiser
        self.object_counts: dict[int, int] = {}
        self._recent: dict[int, FieldSymbols] = {}
        self._numbers = range(len(medium))

    def __len__(self) -> int:
        return len(self._numbers)

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, slice):
            part = copy(self)
            part._numbers = self._numbers[index]
            return part
        i = self._numbers[index]
        if i not in self._recent:
            while len(self._recent) > 1:
                self._recent.pop(next(iter(self._recent)))
            self._recent[i] = self.quantiser(self.medium[i])
            self.object_counts[i] = self._recent[i].object_count
        return self._recent[i]


def partition_workspace(
    medium: HapticMedium,
    device_shape: tuple[int, int, int],
    penalty_bits: float,
    quantiser: str | FieldQuantiserSpec = _COARSE_QUANTISER,
    report: Progress = silent,
) -> Partition:
    """Divide the workspace into dyadic boxes of the device's lattice with the least loss (paper section 4).

    The lattice of the medium has 2^D times the samples that the device renders at once, `device_shape`
    (`touchfield.measure.partition`). `penalty_bits` is lambda, the bits per frame that another box must save.
    The value of a cell in a box is Q of its mean force. InvalidArgument if the lattice does not fit, lambda
    is negative, or the quantiser has only the forces of the medium.
    """
    quantiser_spec = FieldQuantiserSpec.parse(quantiser) if isinstance(quantiser, str) else quantiser
    if quantiser_spec.form == "distinct":
        raise InvalidArgument(
            "quantiser", "distinct", "one that also has mean forces, such as weber:0.25/ico1"
        )
    lattice = DyadicLattice(medium.grid, device_shape)
    losses, quantise = BoxLosses(lattice), quantiser_spec.fit(medium)
    for i, frame in enumerate(medium):
        coarse = [resample(frame, lattice.lattice(d), "box") for d in range(lattice.depth)]
        # weights that round up must not leave Q
        losses.add([quantise(limit_forces(level, quantise.top_n)) for level in (*coarse, frame)])
        report(i + 1, len(medium))
    return optimal_partition(lattice, losses.bits(), penalty_bits)
