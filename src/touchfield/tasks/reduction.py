"""A medium in fewer numbers (paper section 6.1): its modes and degrees of freedom; what no hand can feel left
out.

medium -> modes -> error, held-out frames, degrees of freedom, bits; the reduced medium as a file
medium -> a hand, a device, a trace -> what cannot be reached; the medium without it as a file
medium -> the fewest points that tell it, by its modes or a field without curl; where to measure next (6.2)
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation
from scipy.spatial import KDTree

from touchfield.arrays import Bools, Float32s, Float64s, Int64s, lengths_of
from touchfield.atomic import atomic_path
from touchfield.codec.segment import BOUND_KEYS
from touchfield.compute.threads import Report, silent
from touchfield.devices import Device, device
from touchfield.errors import InvalidArgument, require_between
from touchfield.filters.registry import noted
from touchfield.measure.fidelity import FidelityMeter
from touchfield.measure.interaction import visits
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.medium.budget import memory_budget_bytes
from touchfield.medium.selection import evenly_spaced
from touchfield.medium.trace import ContactTrace, read_trace
from touchfield.pipeline.preparation import Prepared
from touchfield.pipeline.result import Result
from touchfield.pipeline.spec import EncodeSpec, ReductionSpec
from touchfield.reduction import Hand, Reduced, freedom, held_out, reach_of, reduced
from touchfield.reduction.kernel_points import (
    Kernel,
    best_kernel,
    error_points,
    most_candidates,
    variance_points,
)
from touchfield.reduction.modes import ModePoints, mode_points, pod
from touchfield.render.point_device import BOX_AXES, axes_matrix
from touchfield.sources.recordings.contact_trace import (
    CurlFree,
    recorded_contacts,
    require_contacts,
    thinned_contacts,
)
from touchfield.tasks.editing import _write, fidelity_of, read_medium

_HAND_KG, _INERTIA_KG = 0.05, 0.045  # as `touchfield.render.spec` has them, the second of the least device
_SPEED_M_S: Final = 0.2  # the fastest slide of `touchfield.perception.hand_motion`
_PUSH_SHARE: Final = 0.25  # of a device's greatest force, where its continuous one is not known


def hand_of(known: Device, spec: ReductionSpec) -> Hand:
    """The hand that is asked for, with what a device tells where it is not."""
    push = known.force_continuous_n or _PUSH_SHARE * known.force_max_n
    mass = _HAND_KG + (known.inertia_kg or _INERTIA_KG)
    pairs = (spec.push_n, push), (spec.mass_kg, mass), (spec.speed_m_s, _SPEED_M_S)
    return Hand(*(own if asked is None else asked for asked, own in pairs))


def culled(medium: HapticMedium, felt: Bools) -> HapticMedium:
    """The medium with no force but at these samples, bool [nx, ny, nz]; there it keeps its bits."""

    def make(i: int) -> ForceField:
        return ForceField.from_dense(
            medium.grid, np.where(felt[..., None], medium[i].to_dense(), np.float32(0))
        )

    words = noted(medium.provenance, "edits", f"without {np.count_nonzero(~felt)} samples that no hand feels")
    return replace(medium, make_frame=make, segments=None, provenance=words)


def reduce_medium(
    source: str | Path,
    out: str | Path | None = None,
    cull: str | Path | None = None,
    spec: ReductionSpec | None = None,
    coder: EncodeSpec | None = None,
    report: Report = silent,
) -> Result:
    """Modes, degrees of freedom and what no hand can feel of a medium; `out` and `cull` are written if named.

    TouchfieldError if anything is at fault; nothing is then left under these names.
    """
    spec = spec or ReductionSpec()
    prepared = read_medium(source, coder)
    trace = None if spec.trace is None else read_trace(spec.trace)
    known = device(spec.device) if spec.device else prepared.device
    medium, hand = prepared.medium, hand_of(known, spec)
    approximation, shown = _modes(prepared, spec)
    reach = reach_of(medium, hand)
    felt, held = reach.samples, np.zeros(medium.grid.shape, bool)
    for frame in medium:
        held[tuple(frame.positions().T)] = True
    left_out = {"behind": ~felt}
    notes: tuple[str, ...] = (
        f"nothing changes for {hand.words}, if it begins where no force is and stays between the outermost "
        "samples",
    )
    if not reach.stopped_n:
        notes += (
            "nothing is proved to stop such a hand: less push, a lower speed or a finer lattice may help",
        )
    if spec.device:
        left_out["outside_workspace"] = _outside(medium, known)
        notes += (f"and, as to what is outside, if it stays in the workspace of {known.name}",)
    if trace is not None:
        near = np.zeros(felt.shape, bool)
        near[tuple(visits(trace, medium.grid).places.T)] = True
        left_out["never_visited"] = ~binary_dilation(near, np.ones((3, 3, 3), bool), iterations=2)
        notes += (
            "what the hand of --trace never came near is left out, too: nothing is promised to another",
        )
    felt = ~np.logical_or.reduce(list(left_out.values()))
    shown |= {
        "hand": hand.words,
        "stopping_force_n": reach.stopped_n,
        "supported_samples": int(np.count_nonzero(held)),
        **{f"{name}_samples": int(np.count_nonzero(held & own)) for name, own in left_out.items()},
        "felt_samples": int(np.count_nonzero(held & felt)),
    }
    if cull is not None:
        done = _write(prepared, [source], culled(medium, felt), cull, report)
        shown |= {"culled_file": str(done.path), "culled_file_bytes": done.path.stat().st_size}
        shown |= {f"culled_{name}": value for name, value in done.shown.items() if name in BOUND_KEYS}
        notes += done.notes
        if prepared.spec.coder != "touch" or prepared.spec.touch.mode != "lossless":
            notes += ("what is left was coded again: --mode lossless keeps its bits",)
    if out is not None:
        words = noted(
            medium.provenance, "edits", f"rebuilt from {approximation.modes.rank} modes, {spec.modes}"
        )
        rebuilt = replace(medium, make_frame=approximation.field, segments=None, provenance=words)
        done = _write(prepared, [source], rebuilt, out, report)
        shown |= {"file": str(done.path), "file_bytes": done.path.stat().st_size}
        shown |= {name: value for name, value in done.shown.items() if name in BOUND_KEYS}
        notes += done.notes
    return Result(shown, notes)


def _modes(prepared: Prepared, spec: ReductionSpec) -> tuple[Reduced, dict[str, Any]]:
    """The modes that are kept, and what they and the held-out frames tell."""
    medium = prepared.medium
    found = reduced(medium, spec.modes, spec.rank)
    if spec.rank is None:
        found = replace(found, modes=found.modes.first(max(1, found.modes.rank_for(spec.nmse_db))))
    f0_n = prepared.spec.f0_n or EncodeSpec().f0_n
    modes, free = found.modes, freedom(found, f0_n)
    meter = fidelity_of(prepared, replace(medium, make_frame=found.field))
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
        other = held_out(medium, spec.modes, spec.nmse_db)
        shown["held_out"] = {name: value for name, value in other._asdict().items() if name != "least_n"}
    return found, shown


def _outside(medium: HapticMedium, known: Device) -> Bools:
    """Samples that a device's point cannot be at nor beside, bool [nx, ny, nz]."""
    grid, half_m = medium.grid, np.array(known.physical_mm or known.workspace_mm) / 2000
    half_m = np.abs(axes_matrix(BOX_AXES, medium.axes, "lattice")) @ half_m
    inside = [np.abs(grid.axis_m(axis)) <= half_m[axis] + grid.spacing_m[axis] for axis in range(3)]
    outside: Bools = ~(inside[0][:, None, None] & inside[1][:, None] & inside[2])
    return outside


MOST_POINTS: Final = 1000
_LEARNT: Final = 400
_LATTICE: Final = 8000
_COLUMNS: Final = "x_m,y_m,z_m,fx_n,fy_n,fz_n"


@dataclass(frozen=True, kw_only=True)
class FewestPoints(Result):
    """Points of a medium or a recording, in the order they were chosen."""

    points_m: Float64s = field(repr=False)  # [n, 3]


class _Domain:
    """The samples of a medium that ever hold a force."""

    def __init__(self, medium: HapticMedium, frames: list[int], where: str) -> None:
        self.grid, keys = medium.grid, np.zeros(0, np.int64)
        for frame in frames:
            keys = np.union1d(keys, self._keys(medium[frame]))
        if not len(keys):
            raise InvalidArgument(where, "no force in any frame", "a medium that can be felt")
        needed, allowed = 24 * len(keys) * len(frames), memory_budget_bytes()
        if needed > allowed:
            found = f"{len(keys)} samples in {len(frames)} frames, {needed / 2**30:.1f} GiB"
            raise InvalidArgument(
                where, found, f"at most {allowed / 2**30:.1f} GiB", "Take a coarser lattice."
            )
        self.keys = keys
        self.index = np.stack(np.unravel_index(keys, self.grid.shape), axis=1)
        self.places_m = self.grid.to_m(self.index)

    def _keys(self, one: ForceField) -> Int64s:
        return np.asarray(np.ravel_multi_index(tuple(one.positions().T.astype(np.int64)), self.grid.shape))

    def forces_n(self, one: ForceField) -> Float32s:
        """Of a field at the samples, float32 [m, 3]."""
        own, forces = self._keys(one), np.zeros((len(self.keys), 3), np.float32)
        at = np.minimum(np.searchsorted(self.keys, own), len(self.keys) - 1)
        is_here = self.keys[at] == own  # a frame that was not learnt may reach further
        forces[at[is_here]] = one.vectors_n()[is_here]
        return forces

    def field(self, forces_n: NDArray[Any], least_n: float) -> ForceField:
        """The field of forces [m, 3]; those below the threshold of a hand are left out."""
        felt = lengths_of(forces_n) >= least_n
        return ForceField.from_support(self.grid, self.index[felt], forces_n[felt])


def fewest_points(
    source: str | Path,
    count: int,
    out: str | Path | None = None,
    modes: int | None = None,
    spec: EncodeSpec | None = None,
    report: Report = silent,
) -> FewestPoints:
    """The points of a medium or a recording of contacts from which all of it is rebuilt best.

    `count` is how many, `modes` that of the modes of a medium that moves (`count`, or as many as it has).
    `out` is the medium rebuilt, OUT.touch, FIELD.npz or FIELD.vti, or the points with their forces, OUT.csv
    (of a recording only these). `spec` is the coder's and the mask's. TouchfieldError if anything is at
    fault; nothing is then left under the name `out`.
    """
    require_between(1, MOST_POINTS, points=count)
    trace = recorded_contacts(Path(source))
    if trace is not None:
        if modes is not None:
            raise InvalidArgument("modes", "a recording", "a medium that moves")
        return _of_recording(trace, str(source), count, out)
    given = read_medium(source, spec)
    frames = evenly_spaced(len(given.medium), _LEARNT)
    domain = _Domain(given.medium, frames, str(source))
    middle = domain.forces_n(given.medium[len(given.medium) // 2]).astype(np.float64)
    if len(given.medium) == 1:
        if modes is not None:
            raise InvalidArgument("modes", "a medium of one frame", "one that moves")
        chosen, kernel, back = _kept(domain.places_m, middle, count)
        rebuild: Callable[[ForceField], NDArray[Any]] = lambda one: back  # noqa: E731
        shown = _words(kernel)
    else:
        by_modes = _by_modes(given.medium, domain, frames, count, modes)
        chosen, rank = by_modes.points, by_modes.modes.rank
        floor = by_modes.modes.tail(rank) / by_modes.modes.energy
        shown = {"criterion": "modes", "modes": rank, "floor_db": _db(floor), "bound": by_modes.bound}

        def rebuild(one: ForceField) -> NDArray[Any]:
            measured = domain.forces_n(one)[chosen].astype(np.float64)
            return np.asarray(by_modes.modes.rebuild(by_modes.coefficients(measured)).reshape(-1, 3))

    meter = FidelityMeter(given.spec.k, given.spec.f0_n or EncodeSpec().f0_n)
    words = noted(given.medium.provenance, "edits", f"rebuilt from {count} points")
    medium = replace(given.medium, vibration=None, segments=None, provenance=words)
    medium = replace(medium, make_frame=lambda i: domain.field(rebuild(given.medium[i]), meter.f0_n))
    for n, frame in enumerate(frames):
        meter.add(given.medium[frame], medium[frame])
        report(n + 1, len(frames))
    figures = {"points": count, "samples": len(middle), "frames_learnt": len(frames), **shown}
    figures |= {
        name: getattr(meter, name) for name in ("nmse_db", "worst_mask_ratio", "mask_violation_share")
    }
    done = FewestPoints(figures, points_m=domain.places_m[chosen])
    if out is None or Path(out).suffix == ".csv":
        return _with_points(done, out, middle[chosen])
    written = _write(given, [source], medium, out, report)
    left_out = () if given.medium.vibration is None else ("the vibration is left out",)
    return replace(done, shown={**figures, **written.shown}, notes=(*written.notes, *left_out))


def _of_recording(trace: ContactTrace, source: str, count: int, out: str | Path | None) -> FewestPoints:
    require_contacts(trace, source)
    if out is not None and Path(out).suffix != ".csv":
        raise InvalidArgument(str(out), "the points of a recording", "OUT.csv, which encode reads")
    if count > len(trace.positions_m):
        raise InvalidArgument(
            "points", f"{count}", f"at most {len(trace.positions_m)}, the samples of {source}"
        )
    chosen, kernel, back = _kept(trace.positions_m, trace.forces_n, count)
    error, whole = ((back - trace.forces_n) ** 2).sum(), (trace.forces_n**2).sum()
    shown = {"points": count, "samples": len(back), **_words(kernel), "nmse_db": _db(error / whole)}
    return _with_points(FewestPoints(shown, points_m=trace.positions_m[chosen]), out, trace.forces_n[chosen])


def _kept(points_m: Float64s, forces_n: Float64s, count: int) -> tuple[Int64s, Kernel, Float64s]:
    """Points of a known field that stands still, the kernel, and the field rebuilt."""
    some = np.arange(len(points_m))[:: -(-len(points_m) // most_candidates(count))]
    kernel = best_kernel(points_m[some], forces_n[some], count)
    chosen = some[error_points(points_m[some], forces_n[some], count, kernel)]
    through = CurlFree.through(points_m[chosen], forces_n[chosen], kernel.length_m, kernel.noise)
    return chosen, kernel, through.forces_n(points_m)


def _by_modes(
    medium: HapticMedium, domain: _Domain, frames: list[int], count: int, modes: int | None
) -> ModePoints:
    most = min(3 * count, len(frames))
    if modes is not None and not 1 <= modes <= most:
        raise InvalidArgument("modes", f"{modes}", f"1 to {most}")
    rows = np.empty((len(frames), 3 * len(domain.keys)), np.float32)
    for row, frame in zip(rows, frames, strict=True):
        row[:] = domain.forces_n(medium[frame]).reshape(-1)
    basis = pod(rows, min(count if modes is None else modes, len(frames)))
    rows -= basis.rebuild(basis.coefficients(rows)).astype(np.float32)
    return mode_points(basis, count, (rows**2).mean(axis=0, dtype=np.float64).reshape(-1, 3).sum(axis=1))


def next_points(source: str | Path, count: int, measured: str | Path | None = None) -> FewestPoints:
    """Where a robot or a hand should record next, each place once those before it are recorded.

    `source` is a recording, whose box is looked through, or a medium, whose felt samples are; `measured` a
    recording of what is known already (without it, that of the source). `shown["next"]` has a row for each:
    metres, and the standard deviation of the force there, newtons. TouchfieldError if anything is at fault.
    """
    require_between(1, MOST_POINTS, points=count)
    known = recorded_contacts(Path(measured or source))
    if known is None:
        mend = "Name what was measured: --measured FELT.csv."
        raise InvalidArgument(
            str(measured or source), "no recording of contacts", f"columns {_COLUMNS}", mend
        )
    require_contacts(known, str(measured or source))
    points_m, forces_n, side_m = thinned_contacts(known.positions_m, known.forces_n)
    apart_m = KDTree(points_m).query(points_m, k=2)[0][:, 1]
    interpolant = CurlFree.fitted(points_m, forces_n, max(side_m, float(np.median(apart_m))))
    own = known if measured is None else recorded_contacts(Path(source))
    if own is not None:
        low, high = own.positions_m.min(axis=0), own.positions_m.max(axis=0)
        side = np.maximum(high - low, 1e-3 * float((high - low).max()))
        step = float(np.prod(side) / _LATTICE) ** (1 / 3)
        shape = np.clip(np.rint(side / step), 1, _LATTICE ** (1 / 2)).astype(int)
        grid = Grid.over_box(low, low + side, tuple(shape.tolist()))
        places = grid.to_m(np.indices(grid.shape).reshape(3, -1).T)
    else:
        medium = read_medium(source).medium
        places = _Domain(medium, evenly_spaced(len(medium), _LEARNT), str(source)).places_m
    most = max(count, most_candidates(len(interpolant.points_m) + count) - len(interpolant.points_m))
    places = places[:: -(-len(places) // most)]
    kernel = Kernel(interpolant.length_m, interpolant.noise)
    every = np.concatenate([interpolant.points_m, places])
    chosen, variances = variance_points(every, count, kernel, len(interpolant.points_m))
    deviations = interpolant.scale_n * np.sqrt(variances)
    names = ("x_m", "y_m", "z_m", "deviation_n")
    rows = [dict(zip(names, row)) for row in np.column_stack([every[chosen], deviations]).tolist()]
    shown = {
        "measured": len(known.positions_m),
        "candidates": len(places),
        **_words(kernel, "variance"),
        "deviation_nowhere_measured_n": interpolant.scale_n * 3**0.5,
        "next": rows,
    }
    return FewestPoints(shown, points_m=every[chosen])


def _words(kernel: Kernel, criterion: str = "error") -> dict[str, Any]:
    return {"criterion": criterion, "length_mm": 1e3 * kernel.length_m, "noise": kernel.noise}


def _db(share: float) -> float | None:
    return float(10 * np.log10(share)) if share > 0 else None


def _with_points(done: FewestPoints, out: str | Path | None, forces_n: Float64s) -> FewestPoints:
    """The same once its points are in a file, with their forces."""
    if out is None:
        return done
    with atomic_path(Path(out)) as temporary:
        rows = np.hstack([done.points_m, forces_n])
        np.savetxt(temporary, rows, delimiter=",", header=_COLUMNS, comments="", fmt="%.9g")
    return replace(done, shown={**done.shown, "file": str(out)})
