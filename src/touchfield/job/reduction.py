"""A medium in fewer numbers (paper section 6.1): its modes and degrees of freedom; what no hand can feel left out.

medium -> modes -> error, held-out frames, degrees of freedom, bits; the reduced medium as a file
medium -> a hand, a device, a trace -> what cannot be reached; the medium without it as a file
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from scipy.ndimage import binary_dilation

from touchfield.arrays import Bools, Float64s
from touchfield.devices import device
from touchfield.errors import InvalidArgument
from touchfield.job.editing import _write
from touchfield.job.joining import read_medium, spread, with_history
from touchfield.job.measure import MeasureSpec, measure_medium
from touchfield.job.spec import EncodeSpec
from touchfield.measure.fidelity import FidelityMeter
from touchfield.measure.interaction import visits
from touchfield.medium import ForceField, HapticMedium
from touchfield.medium.grid import BRICK
from touchfield.medium.trace import read_trace
from touchfield.parallel import Report, silent
from touchfield.reduction import Hand, Reduced, freedom, held_out, reach_of, reduced
from touchfield.render.point_device import BOX_AXES, axes_matrix

if TYPE_CHECKING:
    from touchfield.devices import Device
    from touchfield.job.prepare import Prepared


_LOOKED_AT: Final = 8
_HAND_KG, _INERTIA_KG = 0.05, 0.045  # as `touchfield.render.spec` has them, the second of the least device
_SPEED_M_S: Final = 0.2  # the fastest slide of `touchfield.perception.hand_motion`
_PUSH_SHARE: Final = 0.25  # of a device's greatest force, where its continuous one is not known


@dataclass(frozen=True)
class ReductionSpec:
    """What is asked of `reduce_medium`.

    `modes` is "global" (whole frames) or "bricks"; `rank` how many are kept, by default as many as `decibels` needs.
    `push_n`, `mass_kg` and `speed_m_s` are the hand's, by default the continuous force of `device` (or that of the
    medium), its mass with a light hand's, and 0.2 m/s. `trace` is a recorded hand, as a play's log.
    """

    modes: str = "global"
    rank: int | None = None
    decibels: float = -30.0
    device: str | None = None
    push_n: float | None = None
    mass_kg: float | None = None
    speed_m_s: float | None = None
    trace: Path | None = None

    def __post_init__(self) -> None:
        if not -200 <= self.decibels < 0:
            raise InvalidArgument("--nmse-db", repr(self.decibels), "decibels below 0, such as -30")


class Reduction(NamedTuple):
    """Findings for people and programs, notes; singular values, the frame in the middle, and what of it is felt."""

    shown: dict[str, Any]
    notes: tuple[str, ...]
    values: Float64s
    field: ForceField
    felt: Bools


def hand_of(known: Device, spec: ReductionSpec) -> Hand:
    """The hand that is asked for, with what a device tells where it is not."""
    push = known.force_continuous_n or _PUSH_SHARE * known.force_max_n
    mass = _HAND_KG + (known.inertia_kg or _INERTIA_KG)
    pairs = (spec.push_n, push), (spec.mass_kg, mass), (spec.speed_m_s, _SPEED_M_S)
    return Hand(*(own if asked is None else asked for asked, own in pairs))


def culled(medium: HapticMedium, felt: Bools) -> HapticMedium:
    """The medium with no force but at these samples, bool [nx, ny, nz]; there it keeps its bits."""

    def make(i: int) -> ForceField:
        return ForceField.from_dense(medium.grid, np.where(felt[..., None], medium[i].to_dense(), np.float32(0)))

    words = with_history(medium, "edits", f"without {np.count_nonzero(~felt)} samples that no hand feels")
    return replace(medium, make_frame=make, segments=None, provenance=words)


def reduce_medium(
    source: str | Path,
    out: str | Path | None = None,
    cull: str | Path | None = None,
    spec: ReductionSpec | None = None,
    coder: EncodeSpec | None = None,
    report: Report = silent,
) -> Reduction:
    """Modes, degrees of freedom and what no hand can feel of a medium; `out` and `cull` are written if named.

    TouchfieldError if anything is at fault; nothing is then left under these names.
    """
    spec = spec or ReductionSpec()
    given = read_medium(source, coder)
    trace = None if spec.trace is None else read_trace(spec.trace)
    known = device(spec.device) if spec.device else given.device
    medium, hand = given.medium, hand_of(known, spec)
    found, shown = _modes(given, spec)
    reach = reach_of(medium, hand)
    felt, held = reach.samples, np.zeros(medium.grid.shape, bool)
    for frame in medium:
        held[tuple(frame.positions().T)] = True
    left_out = {"behind": ~felt}
    notes: tuple[str, ...] = (
        f"nothing changes for {hand.words}, if it begins where no force is and stays between the outermost samples",
    )
    if not reach.stopped_n:
        notes += ("nothing is proved to stop such a hand: less push, a lower speed or a finer lattice may help",)
    if spec.device:
        left_out["outside_workspace"] = _outside(medium, known)
        notes += (f"and, as to what is outside, if it stays in the workspace of {known.name}",)
    if trace is not None:
        near = np.zeros(felt.shape, bool)
        near[tuple(visits(trace, medium.grid).places.T)] = True
        left_out["never_visited"] = ~binary_dilation(near, np.ones((3, 3, 3), bool), iterations=2)
        notes += ("what the hand of --trace never came near is left out, too: nothing is promised to another",)
    felt = ~np.logical_or.reduce(list(left_out.values()))
    over = "voxel" if trace is None else f"interaction:{spec.trace}"
    told = measure_medium(medium, MeasureSpec("weber:0.1", over, limits=False, encode=given.spec))
    every, kept = (np.unique(np.argwhere(own) // BRICK, axis=0) for own in (held, held & felt))
    shown |= {
        "entropy_bits_per_voxel": told.voxel.value,
        **({} if trace is None else {"entropy_bits_per_visit": told.entropy.value}),
        "hand": hand.words,
        "stopping_force_n": reach.stopped_n,
        "supported_samples": int(np.count_nonzero(held)),
        **{f"{name}_samples": int(np.count_nonzero(held & own)) for name, own in left_out.items()},
        "felt_samples": int(np.count_nonzero(held & felt)),
        "bricks_left_out": len(every) - len(kept),
    }
    if cull is not None:
        path, more = _write(given, [source], culled(medium, felt), cull, report)
        shown |= {"culled_file": str(path), "culled_file_bytes": path.stat().st_size}
        notes += more
        if given.spec.coder != "touch" or given.spec.touch.mode != "lossless":
            notes += ("what is left was coded again: --mode lossless keeps its bits",)
    if out is not None:
        words = with_history(medium, "edits", f"rebuilt from {found.modes.rank} modes, {spec.modes}")
        rebuilt = replace(medium, make_frame=found.field, segments=None, provenance=words)
        path, more = _write(given, [source], rebuilt, out, report)
        shown |= {"file": str(path), "file_bytes": path.stat().st_size}
        notes += more
    return Reduction(shown, notes, found.modes.values, medium[len(medium) // 2], felt)


def _modes(given: Prepared, spec: ReductionSpec) -> tuple[Reduced, dict[str, Any]]:
    """The modes that are kept, and what they and the held-out frames tell."""
    medium = given.medium
    found = reduced(medium, spec.modes, spec.rank)
    if spec.rank is None:
        found = replace(found, modes=found.modes.first(max(1, found.modes.rank_for(spec.decibels))))
    f0_n = given.spec.f0_n or EncodeSpec().f0_n
    modes, meter, free = found.modes, FidelityMeter(given.spec.k, f0_n), freedom(found, f0_n)
    for i in spread(len(medium), _LOOKED_AT):
        meter.add(medium[i], found.field(i))
    shown: dict[str, Any] = {
        "modes": spec.modes,
        "rank": modes.rank,
        "snapshots": modes.count,
        "values_each": len(modes.basis),
        "nmse_db_beforehand": 10 * math.log10(max(modes.tail(modes.rank) / modes.energy, 1e-30)),
        "nmse_db": meter.nmse_db,
        "mask_violation_share": meter.mask_violation_share,
        "degrees_of_freedom": free.effective,
        "step_n": free.step_n,
        "bits_per_coefficient": free.bits,
        "coefficients_not_zero": free.modes,
    }
    if len(medium) > 1:
        other = held_out(medium, spec.modes, spec.decibels)
        shown["held_out"] = {name: value for name, value in other._asdict().items() if name != "least_n"}
    return found, shown


def _outside(medium: HapticMedium, known: Device) -> Bools:
    """Samples that a device's point cannot be at nor beside, bool [nx, ny, nz]."""
    grid, half_m = medium.grid, np.array(known.physical_mm or known.workspace_mm) / 2000
    half_m = np.abs(axes_matrix(BOX_AXES, medium.axes, "lattice")) @ half_m
    inside = [np.abs(grid.axis_m(axis)) <= half_m[axis] + grid.spacing_m[axis] for axis in range(3)]
    outside: Bools = ~(inside[0][:, None, None] & inside[1][:, None] & inside[2])
    return outside
