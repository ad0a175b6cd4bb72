"""A medium as a device can render it, in bits: the mapping M of the paper's section 3.1 applied to a stored
W.

W is a medium on its own lattice, the reference space. For each device it is scaled into the workspace,
low-passed and resampled to the device's lattice, clipped to F_max and quantised; equations 1 to 3 then
compare the two. A point device is given the lattice over as much of W's box as its workspace holds, and no
finer one than W's: more samples of the same field would not be more information (the "active mappings" that
the paper's min() excludes).
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
from touchfield.compute.threads import Report, silent
from touchfield.devices import Device, device
from touchfield.errors import InvalidArgument
from touchfield.filters.device_filter import limited
from touchfield.filters.resample import resample
from touchfield.measure.field_symbols import FieldSymbols
from touchfield.measure.partition import BoxLosses, DyadicLattice, Partition, optimal_partition
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.pipeline.placement import Mapping, mapping_of
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.laws import LawSpec, profile_of
from touchfield.sources.stored import StoredScene

_COARSE_QUANTISER: Final = "weber:0.25/ico1"  # ten amplitudes by twelve directions: a box holds many of each


@dataclass(frozen=True)
class Mapped:
    """M(W) for one device.

    `own_grid` is the lattice of W in the hand metres of `medium`, so that both can be asked about the same
    places; `quantiser` the force levels that the device is given: its own steps where the profile counts
    them, else Q.
    """

    device: Device
    medium: HapticMedium
    own_grid: Grid
    quantiser: FieldQuantiserSpec
    notes: tuple[str, ...]


def mapped(
    medium: HapticMedium,
    name: str,
    asked: FieldQuantiserSpec,
    spec: EncodeSpec | None = None,
    density: float | None = None,
) -> Mapped:
    """A medium, whose forces are used as they are, through the mapping M of one device: a profile, or a TOML
    file.

    `asked` is Q of W; of `spec` the mapping, oversample, pool and cutoff are used. `density`: samples of W
    along each axis for one of a point device, in place of what its data sheet says.
    """
    spec = replace(spec or EncodeSpec(), device=name, nw=None)
    chosen, scene = device(name), StoredScene(medium)
    # a stored field has no law; this one only says how thin a wall the depth pooling of an array must not
    # miss
    law = profile_of(LawSpec("penalty", 500.0, chosen.force_max_n), math.inf)
    mapping = mapping_of(scene, chosen, spec, law)
    shown, notes = _shown(scene, mapping, density)
    # a lattice equal to W's passes the device filter untouched, but no device exceeds its F_max
    clipped = replace(shown, make_frame=lambda i: limited(shown[i], chosen.force_max_n))
    scale_note = f"1 mm of the device's hand is {1 / mapping.placement.scale:.4g} mm of the medium"
    own = mapping.placement.to_hand(medium.grid)
    if asked.form == "distinct":
        asked = FieldQuantiserSpec.parse(DEFAULT_QUANTISER)
    if chosen.levels is not None and chosen.levels > 1:  # its own levels
        asked = FieldQuantiserSpec("uniform", chosen.force_max_n / (chosen.levels - 1), "none")
    elif chosen.is_array:  # renders magnitudes, and has no directions to tell
        asked = replace(asked, directions="none")
    return Mapped(chosen, clipped, own, asked, (*notes, scale_note))


def _shown(
    scene: StoredScene, mapping: Mapping, density: float | None
) -> tuple[HapticMedium, tuple[str, ...]]:
    """W on the lattice that the device is given; that of `mapping` is the device's own."""
    if mapping.device.is_array:
        return mapping.medium(scene), ()
    nominal, own = mapping.grid, mapping.placement.to_hand(scene.medium.grid)
    first, last = (own.to_index(corner) for corner in nominal.box_m)
    low = np.clip(np.ceil(first - 1e-6), 0, np.subtract(own.shape, 1)).astype(np.int64)
    high = np.clip(np.floor(last + 1e-6) + 1, low + 1, own.shape).astype(np.int64)  # one sample at least
    each = np.asarray(nominal.spacing_m) / own.spacing_m if density is None else density
    counts = np.minimum(np.maximum(1, np.round((high - low) / each)), high - low)
    if (counts < high - low).any():
        box = own.to_m(low - 0.5), own.to_m(high - 0.5)
        x, y, z = counts.astype(int).tolist()
        note = f"{density:g} samples of the medium along each axis for one of the device" if density else ""
        return replace(mapping, grid=Grid.over_box(*box, (x, y, z))).medium(scene), (note,) if note else ()
    was = "x".join(map(str, nominal.shape))
    note = f"its {was} samples are finer than the medium's, whose own are taken: its lattice loses nothing"
    note += "" if density else " (--density 5 sets it as far below the medium's as the paper does)"
    return _cropped(scene.medium, own, low, high), (note,)


def _cropped(medium: HapticMedium, own: Grid, low: Int64s, high: Int64s) -> HapticMedium:
    """Samples `low` to `high` of a medium, on the part of the grid `own` that they are."""
    x, y, z = (high - low).tolist()
    grid = Grid((x, y, z), own.spacing_m, tuple(own.to_m(low).tolist()))

    def frame(i: int) -> ForceField:
        field = medium[i]
        if grid.shape == field.grid.shape:
            return field.on_grid(grid)
        positions = field.positions()
        inside = ((positions >= low) & (positions < high)).all(axis=1)
        return ForceField.from_support(grid, positions[inside] - low, field.vectors_n()[inside])

    return replace(medium, grid=grid, make_frame=frame, vibration=None)


class SymbolFrames(Sequence[FieldSymbols]):
    """The frames of a medium through Q, each made when it is asked for; the last two are kept.

    `object_counts` tells how many voxels of each that was made are not 0. A slice makes nothing yet, and
    shares what is kept.
    """

    def __init__(self, medium: HapticMedium, quantiser: FieldQuantiser) -> None:
        self.medium, self.quantiser = medium, quantiser
        self.object_counts: dict[int, int] = {}
        self._kept: dict[int, FieldSymbols] = {}
        self._numbers = range(len(medium))

    def __len__(self) -> int:
        return len(self._numbers)

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, slice):
            part = copy(self)
            part._numbers = self._numbers[index]
            return part
        i = self._numbers[index]
        if i not in self._kept:
            while len(self._kept) > 1:
                self._kept.pop(next(iter(self._kept)))
            self._kept[i] = self.quantiser(self.medium[i])
            self.object_counts[i] = self._kept[i].object_count
        return self._kept[i]


def partition_workspace(
    medium: HapticMedium,
    device_shape: tuple[int, int, int],
    penalty_bits: float,
    quantiser: str | FieldQuantiserSpec = _COARSE_QUANTISER,
    report: Report = silent,
) -> Partition:
    """Divide the workspace into the dyadic boxes, each of the device's lattice, that lose least (paper
    section 4).

    The medium lies on 2^D times the samples that the device shows at once, `device_shape`
    (`touchfield.measure.partition`). `penalty_bits` is lambda, bits a frame that another box must save; what
    a box is told of a cell is Q of its mean force. InvalidArgument if the lattice does not fit, lambda is
    negative or the quantiser knows no forces but those of the medium.
    """
    asked = FieldQuantiserSpec.parse(quantiser) if isinstance(quantiser, str) else quantiser
    if asked.form == "distinct":
        raise InvalidArgument(
            "quantiser", "distinct", "one that also knows mean forces, such as weber:0.25/ico1"
        )
    lattice = DyadicLattice(medium.grid, device_shape)
    losses, quantise = BoxLosses(lattice), asked.fit(medium)
    for i, frame in enumerate(medium):
        coarse = [resample(frame, lattice.lattice(d), "box") for d in range(lattice.depth)]
        # weights that round up must not leave Q
        losses.add([quantise(limited(level, quantise.top_n)) for level in (*coarse, frame)])
        report(i + 1, len(medium))
    return optimal_partition(lattice, losses.bits(), penalty_bits)
