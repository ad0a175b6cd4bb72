"""Reduces a medium to a few modes or points, or to the samples that a hand can reach (paper section 6.1), and
writes the result as a file.

medium -> modes -> error, held-out frames, degrees of freedom, bits; the reduced medium as a file
medium -> a hand, a device, a trace -> unreachable samples; the medium without them as a file
medium -> few points that determine it, by its modes or a curl-free field; where to measure next (6.2)
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from operator import itemgetter
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation
from scipy.spatial import KDTree

from touchfield.arrays import Bools, Float32s, Float64s, Int64s, lengths_of
from touchfield.atomic import atomic_path
from touchfield.codec.segment import BOUND_KEYS
from touchfield.compute.threads import Progress, silent
from touchfield.devices import Device, device
from touchfield.errors import InvalidArgument, require_between
from touchfield.files import readable
from touchfield.filters.registry import add_note
from touchfield.measure.fidelity import FidelityMeter
from touchfield.measure.interaction import visits
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.medium.budget import memory_budget_bytes
from touchfield.medium.selection import evenly_spaced
from touchfield.medium.trace import ContactTrace, read_trace
from touchfield.perception.mask import Weber
from touchfield.pipeline.preparation import Prepared
from touchfield.pipeline.result import Result
from touchfield.pipeline.spec import DEFAULT_F0_N, EncodeSpec, ReductionSpec
from touchfield.reduction import Hand, ReducedMedium, freedom, held_out, reach_of, reduce_to_modes
from touchfield.reduction.kernel_points import (
    Kernel,
    best_kernels,
    error_points,
    max_candidates,
    variance_points,
)
from touchfield.reduction.modes import ModePoints, mode_points, pod
from touchfield.render.point_device import BOX_AXES, axes_matrix
from touchfield.sources.recordings.contact_trace import (
    CurlFree,
    recorded_contacts,
    require_contacts,
    thin_contacts,
)
from touchfield.tasks.editing import fidelity_of, write_result
from touchfield.tasks.matching import read_medium
from touchfield.viewer.reduction import draw_points, draw_reduction

_HAND_KG, _INERTIA_KG = (
    0.05,
    0.045,
)  # as in `touchfield.render.spec`; the second is that of the lightest device
_SPEED_M_S: Final = 0.2  # the fastest slide of `touchfield.perception.hand_motion`
_PUSH_FRACTION: Final = 0.25  # fraction of a device's largest force, if its continuous force is unknown


@dataclass(frozen=True, kw_only=True)
class Reduction(Result):
    """Figures of a reduction, the singular values, the middle frame, and the samples within reach."""

    singular_values: Float64s = field(repr=False)  # [n]
    middle_frame: ForceField = field(repr=False)
    is_reachable: Bools = field(repr=False)  # [nx, ny, nz]
    axes: str = ""

    def draw(self, path: str | Path) -> None:
        """Write the picture of the error by the number of modes, and of the samples left out, PNG.

        MissingExtra if matplotlib is not installed.
        """
        rank, hand = self.figures["rank"], self.figures["hand"]
        title = f"rank {rank}; what is left out changes nothing for {hand}"
        draw_reduction(
            Path(path), self.singular_values, self.middle_frame, self.is_reachable, title, self.axes
        )


def hand_of(device: Device, spec: ReductionSpec) -> Hand:
    """Return the requested hand; values that are not given are those of the device."""
    push = device.force_continuous_n or _PUSH_FRACTION * device.force_max_n
    mass = _HAND_KG + (device.inertia_kg or _INERTIA_KG)
    values_and_defaults = (spec.push_n, push), (spec.mass_kg, mass), (spec.speed_m_s, _SPEED_M_S)
    return Hand(*(default if value is None else value for value, default in values_and_defaults))


def without_unreachable(medium: HapticMedium, reachable: Bools) -> HapticMedium:
    """Return the medium with forces only at `reachable` samples, bool [nx, ny, nz].

    These forces are unchanged, bit for bit.
    """

    def make(i: int) -> ForceField:
        return ForceField.from_dense(
            medium.grid, np.where(reachable[..., None], medium[i].to_dense(), np.float32(0))
        )

    provenance = add_note(
        medium.provenance, "edits", f"without {np.count_nonzero(~reachable)} samples that no hand reaches"
    )
    return replace(medium, make_frame=make, segments=None, provenance=provenance)


def reduce_medium(
    source: str | Path,
    out: str | Path | None = None,
    cull: str | Path | None = None,
    spec: ReductionSpec | None = None,
    coder: EncodeSpec | None = None,
    report: Progress = silent,
) -> Reduction:
    """Reduce a medium to a few modes.

    Reports degrees of freedom, their entropy, and unreachable samples.

    `out` is the file rebuilt from the modes, `cull` the medium without the unreachable samples; each is
    written if named. Raises TouchfieldError; neither file is then left.
    """
    spec = spec or ReductionSpec()
    prepared = read_medium(source, coder)
    trace = None if spec.trace is None else read_trace(spec.trace)
    target = device(spec.device) if spec.device else prepared.device
    medium, hand = prepared.medium, hand_of(target, spec)
    approximation, figures = _modes(prepared, spec)
    reach = reach_of(medium, hand)
    is_reachable, supported = reach.samples, np.zeros(medium.grid.shape, bool)
    for frame in medium:
        supported[tuple(frame.positions().T)] = True
    excluded = {"behind": ~is_reachable}
    notes: tuple[str, ...] = (
        f"nothing changes for {hand.text}, if it begins where no force is and stays between the outermost "
        "samples",
    )
    if not reach.stopped_n:
        notes += (
            "no sample is out of reach, as nothing is proved to stop such a hand: at edges, such as those "
            "of a box, forces turn too fast; less push, a lower speed or a finer lattice may help",
        )
    if spec.device:
        excluded["outside_workspace"] = _outside(medium, target)
        notes += (f"and, as to what is outside, if it stays in the workspace of {target.name}",)
    if trace is not None:
        visited = np.zeros(is_reachable.shape, bool)
        visited[tuple(visits(trace, medium.grid).indices.T)] = True
        excluded["never_visited"] = ~binary_dilation(visited, np.ones((3, 3, 3), bool), iterations=2)
        notes += (
            "what the hand of --trace never came near is left out, too: nothing is promised to another",
        )
    is_reachable = ~np.logical_or.reduce(list(excluded.values()))
    figures |= {
        "hand": hand.text,
        "stopping_force_n": reach.stopped_n,
        "supported_samples": int(np.count_nonzero(supported)),
        **{
            f"{name}_samples": int(np.count_nonzero(supported & samples))
            for name, samples in excluded.items()
        },
        "felt_samples": int(np.count_nonzero(supported & is_reachable)),
    }
    if cull is not None:
        written = write_result(prepared, [source], without_unreachable(medium, is_reachable), cull, report)
        figures |= {"culled_file": str(written.path), "culled_file_bytes": written.path.stat().st_size}
        figures |= {f"culled_{name}": value for name, value in written.figures.items() if name in BOUND_KEYS}
        notes += written.notes
        if prepared.spec.coder != "touch" or prepared.spec.touch.mode != "lossless":
            notes += ("what is left was coded again: --mode lossless keeps its bits",)
    if out is not None:
        provenance = add_note(
            medium.provenance, "edits", f"rebuilt from {approximation.modes.rank} modes, {spec.modes}"
        )
        rebuilt = replace(medium, make_frame=approximation.field, segments=None, provenance=provenance)
        written = write_result(prepared, [source], rebuilt, out, report)
        figures |= {"file": str(written.path), "file_bytes": written.path.stat().st_size}
        figures |= {name: value for name, value in written.figures.items() if name in BOUND_KEYS}
        notes += written.notes
    return Reduction(
        figures,
        notes,
        singular_values=approximation.modes.values,
        middle_frame=medium[len(medium) // 2],
        is_reachable=is_reachable,
        axes=medium.axes,
    )


def _modes(prepared: Prepared, spec: ReductionSpec) -> tuple[ReducedMedium, dict[str, Any]]:
    """Return the reduced medium, and the figures of its modes and of the held-out frames."""
    medium = prepared.medium
    approximation = reduce_to_modes(medium, spec.modes, spec.rank)
    if spec.rank is None:
        approximation = replace(
            approximation, modes=approximation.modes.first(max(1, approximation.modes.rank_for(spec.nmse_db)))
        )
    f0_n = prepared.spec.f0_n or EncodeSpec().f0_n
    modes, degrees = approximation.modes, freedom(approximation, f0_n)
    meter = fidelity_of(prepared, replace(medium, make_frame=approximation.field))
    figures: dict[str, Any] = {
        "modes": spec.modes,
        "rank": modes.rank,
        "snapshots": modes.count,
        "values_each": len(modes.basis),
        "nmse_db_beforehand": 10 * math.log10(max(modes.tail(modes.rank) / modes.energy, 1e-30)),
        "nmse_db": meter.nmse_db,
        "mask_violation_share": meter.mask_violation_share,
        "degrees_of_freedom": degrees.effective,
        "step_n": degrees.step_n,
        "bits_per_coefficient": degrees.bits,
        "coefficients_not_zero": degrees.modes,
    }
    if len(medium) > 1:
        other = held_out(medium, spec.modes, spec.nmse_db)
        figures["held_out"] = {name: value for name, value in other._asdict().items() if name != "min_n"}
    return approximation, figures


def _outside(medium: HapticMedium, device: Device) -> Bools:
    """Return the samples neither in a device's workspace nor next to it, bool [nx, ny, nz]."""
    grid, half_m = medium.grid, np.array(device.physical_mm or device.workspace_mm) / 2000
    half_m = np.abs(axes_matrix(BOX_AXES, medium.axes, "lattice")) @ half_m
    inside = [np.abs(grid.axis_m(axis)) <= half_m[axis] + grid.spacing_m[axis] for axis in range(3)]
    outside: Bools = ~(inside[0][:, None, None] & inside[1][:, None] & inside[2])
    return outside


MAX_POINTS: Final = 1000
_KERNELS: Final = 4
"""Number of kernels that are tried on all samples of a static field."""
_MAX_LEARNT_FRAMES: Final = 400
_MAX_CANDIDATES: Final = 8000
_COLUMNS: Final = "x_m,y_m,z_m,fx_n,fy_n,fz_n"


@dataclass(frozen=True, kw_only=True)
class FewestPoints(Result):
    """Points of a medium or a recording, in the order of selection.

    `positions_m` are the samples where the force is known, `forces_n` the forces there, in the middle frame
    of a medium, and `rebuilt_n` those rebuilt from the points; None if the points are yet to be measured.
    """

    points_m: Float64s = field(repr=False)  # [n, 3]
    positions_m: Float64s = field(repr=False)  # [m, 3]
    forces_n: Float64s = field(repr=False)  # [m, 3]
    rebuilt_n: Float64s | None = field(default=None, repr=False)  # [m, 3]
    mask: tuple[Weber, float] = (EncodeSpec().k, DEFAULT_F0_N)  # k and F_0 of max(F_0, k |F|)
    axes: str = ""

    def draw(self, path: str | Path) -> None:
        """Write the picture of the points, the field, the rebuilt field and its error, PNG.

        MissingExtra if matplotlib is not installed.
        """
        known = self.positions_m, self.forces_n, self.rebuilt_n
        draw_points(Path(path), self.points_m, *known, self.mask, self.axes)


class _Domain:
    """The samples of a medium that have a force in any frame."""

    def __init__(self, medium: HapticMedium, frames: list[int], where: str) -> None:
        self.grid, keys = medium.grid, np.zeros(0, np.int64)
        for frame in frames:
            keys = np.union1d(keys, self._keys(medium[frame]))
        if not len(keys):
            raise InvalidArgument(where, "no force in any frame", "a medium with a force")
        needed, allowed = 24 * len(keys) * len(frames), memory_budget_bytes()
        if needed > allowed:
            found = f"{len(keys)} samples in {len(frames)} frames, {needed / 2**30:.1f} GiB"
            raise InvalidArgument(
                where, found, f"at most {allowed / 2**30:.1f} GiB", "Take a coarser lattice."
            )
        self.keys = keys
        self.index = np.stack(np.unravel_index(keys, self.grid.shape), axis=1)
        self.positions_m = self.grid.to_m(self.index)

    def _keys(self, field: ForceField) -> Int64s:
        return np.asarray(np.ravel_multi_index(tuple(field.positions().T.astype(np.int64)), self.grid.shape))

    def forces_n(self, field: ForceField) -> Float32s:
        """Return the forces of a field at the samples, float32 [m, 3]."""
        field_keys, forces = self._keys(field), np.zeros((len(self.keys), 3), np.float32)
        nearest = np.minimum(np.searchsorted(self.keys, field_keys), len(self.keys) - 1)
        is_in_domain = self.keys[nearest] == field_keys  # a frame that was not learnt may have other samples
        forces[nearest[is_in_domain]] = field.vectors_n()[is_in_domain]
        return forces

    def field(self, forces_n: NDArray[Any], threshold_n: float) -> ForceField:
        """Return the field of forces [m, 3], without those below the perception threshold."""
        is_above = lengths_of(forces_n) >= threshold_n
        return ForceField.from_support(self.grid, self.index[is_above], forces_n[is_above])


def fewest_points(
    source: str | Path,
    count: int,
    out: str | Path | None = None,
    modes: int | None = None,
    spec: EncodeSpec | None = None,
    report: Progress = silent,
) -> FewestPoints:
    """Find the points from which a medium or a recording of contacts is rebuilt best.

    `modes` is the number of modes of a moving medium (default: `count`, or as many as it has). `out` is the
    file to write: the rebuilt medium as OUT.touch, FIELD.npz or FIELD.vti, or the points with their forces as
    OUT.csv (the only format for a recording). `spec` has the coder and the mask. Raises TouchfieldError; no
    file `out` is then left.
    """
    require_between(1, MAX_POINTS, points=count)
    trace = recorded_contacts(Path(source))
    if trace is not None:
        if modes is not None:
            raise InvalidArgument("modes", "a recording", "a medium that moves")
        return _points_of_recording(trace, str(source), count, out)
    prepared = read_medium(source, spec)
    frames = evenly_spaced(len(prepared.medium), _MAX_LEARNT_FRAMES)
    domain = _Domain(prepared.medium, frames, str(source))
    middle = domain.forces_n(prepared.medium[len(prepared.medium) // 2]).astype(np.float64)
    if len(prepared.medium) == 1:
        if modes is not None:
            raise InvalidArgument("modes", "a medium of one frame", "one that moves")
        indices, kernel, rebuilt_n = _best_points(domain.positions_m, middle, count)
        rebuild: Callable[[ForceField], NDArray[Any]] = lambda one: rebuilt_n  # noqa: E731
        criterion = _kernel_figures(kernel)
    else:
        by_modes = _by_modes(prepared.medium, domain, frames, count, modes)
        indices, rank = by_modes.points, by_modes.modes.rank
        floor = by_modes.modes.tail(rank) / by_modes.modes.energy
        criterion = {
            "criterion": "modes",
            "modes": rank,
            "floor_db": _decibels(floor),
            "bound": by_modes.bound,
        }

        def rebuild(field: ForceField) -> NDArray[Any]:
            measured = domain.forces_n(field)[indices].astype(np.float64)
            return np.asarray(by_modes.modes.rebuild(by_modes.coefficients(measured)).reshape(-1, 3))

        rebuilt_n = rebuild(prepared.medium[len(prepared.medium) // 2])

    meter = FidelityMeter(prepared.spec.weber, prepared.spec.f0_n or EncodeSpec().f0_n)
    provenance = add_note(prepared.medium.provenance, "edits", f"rebuilt from {count} points")
    medium = replace(prepared.medium, vibration=None, segments=None, provenance=provenance)
    medium = replace(medium, make_frame=lambda i: domain.field(rebuild(prepared.medium[i]), meter.f0_n))
    for n, frame in enumerate(frames):
        meter.add(prepared.medium[frame], medium[frame])
        report(n + 1, len(frames))
    figures = {"points": count, "samples": len(middle), "frames_learnt": len(frames), **criterion}
    figures |= {
        name: getattr(meter, name) for name in ("nmse_db", "worst_mask_ratio", "mask_violation_share")
    }
    result = FewestPoints(
        figures,
        points_m=domain.positions_m[indices],
        positions_m=domain.positions_m,
        forces_n=middle,
        rebuilt_n=rebuilt_n,
        mask=(meter.weber, meter.f0_n),
        axes=prepared.medium.axes,
    )
    if out is None or Path(out).suffix == ".csv":
        return _with_points(result, out, middle[indices])
    written = write_result(prepared, [source], medium, out, report)
    notes = () if prepared.medium.vibration is None else ("the vibration is left out",)
    return replace(result, figures={**figures, **written.figures}, notes=(*written.notes, *notes))


def _points_of_recording(
    trace: ContactTrace, source: str, count: int, out: str | Path | None
) -> FewestPoints:
    require_contacts(trace, source)
    if out is not None and Path(out).suffix != ".csv":
        raise InvalidArgument(str(out), "the points of a recording", "OUT.csv, which encode reads")
    if count > len(trace.positions_m):
        raise InvalidArgument(
            "points", f"{count}", f"at most {len(trace.positions_m)}, the samples of {source}"
        )
    indices, kernel, rebuilt_n = _best_points(trace.positions_m, trace.forces_n, count)
    error, energy = ((rebuilt_n - trace.forces_n) ** 2).sum(), (trace.forces_n**2).sum()
    figures = {
        "points": count,
        "samples": len(rebuilt_n),
        **_kernel_figures(kernel),
        "nmse_db": _decibels(error / energy),
    }
    result = FewestPoints(
        figures,
        points_m=trace.positions_m[indices],
        positions_m=trace.positions_m,
        forces_n=trace.forces_n,
        rebuilt_n=rebuilt_n,
    )
    return _with_points(result, out, trace.forces_n[indices])


def _best_points(points_m: Float64s, forces_n: Float64s, count: int) -> tuple[Int64s, Kernel, Float64s]:
    """Return the best points of a static field, the kernel, and the rebuilt field.

    The kernels that are best on a subset are tried on all candidates.
    """
    candidates = np.arange(len(points_m))[:: -(-len(points_m) // max_candidates(count))]
    tried = []
    for kernel in best_kernels(points_m[candidates], forces_n[candidates], count)[:_KERNELS]:
        indices = candidates[error_points(points_m[candidates], forces_n[candidates], count, kernel)]
        interpolant = CurlFree.through(points_m[indices], forces_n[indices], kernel.length_m, kernel.noise)
        rebuilt_n = interpolant.forces_n(points_m)
        tried.append((float(((rebuilt_n - forces_n) ** 2).sum()), indices, kernel, rebuilt_n))
    return min(tried, key=itemgetter(0))[1:]


def _by_modes(
    medium: HapticMedium, domain: _Domain, frames: list[int], count: int, modes: int | None
) -> ModePoints:
    max_modes = min(3 * count, len(frames))
    if modes is not None and not 1 <= modes <= max_modes:
        raise InvalidArgument("modes", f"{modes}", f"1 to {max_modes}")
    rows = np.empty((len(frames), 3 * len(domain.keys)), np.float32)
    for row, frame in zip(rows, frames, strict=True):
        row[:] = domain.forces_n(medium[frame]).reshape(-1)
    basis = pod(rows, min(count if modes is None else modes, len(frames)))
    rows -= basis.rebuild(basis.coefficients(rows)).astype(np.float32)
    return mode_points(basis, count, (rows**2).mean(axis=0, dtype=np.float64).reshape(-1, 3).sum(axis=1))


def next_points(source: str | Path, count: int, measured: str | Path | None = None) -> FewestPoints:
    """Find the positions where a robot or a hand should record next.

    Each position takes the previous ones into account: it leaves the smallest mean variance. On a recorded
    contact, whose samples crowd along a path, such positions leave less error than as many random ones; in a
    solid they do not (`bench/bench_points.py`).

    The candidates are in the box of `source`, a recording, or at the samples with a force of a medium.
    `measured` is a recording of the known forces (default: the source). ``figures["next"]`` has a row for
    each: its position in metres, and the standard deviation of the force there in newtons. Raises
    TouchfieldError.
    """
    require_between(1, MAX_POINTS, points=count)
    recorded = Path(measured or source)
    with readable(recorded, "a recording of contacts"):
        recorded.stat()
    recording = recorded_contacts(recorded)
    if recording is None:
        hint = "Name what was measured: --measured FELT.csv."
        raise InvalidArgument(
            str(measured or source), "no recording of contacts", f"columns {_COLUMNS}", hint
        )
    require_contacts(recording, str(measured or source))
    points_m, forces_n, side_m = thin_contacts(recording.positions_m, recording.forces_n)
    neighbour_m = KDTree(points_m).query(points_m, k=2)[0][:, 1]
    interpolant = CurlFree.fitted(points_m, forces_n, max(side_m, float(np.median(neighbour_m))))
    source_recording = recording if measured is None else recorded_contacts(Path(source))
    if source_recording is not None:
        low, high = source_recording.positions_m.min(axis=0), source_recording.positions_m.max(axis=0)
        side = np.maximum(high - low, 1e-3 * float((high - low).max()))
        step = float(np.prod(side) / _MAX_CANDIDATES) ** (1 / 3)
        shape = np.clip(np.rint(side / step), 1, _MAX_CANDIDATES ** (1 / 2)).astype(int)
        grid = Grid.over_box(low, low + side, tuple(shape.tolist()))
        candidates_m = grid.to_m(np.indices(grid.shape).reshape(3, -1).T)
    else:
        medium = read_medium(source).medium
        candidates_m = _Domain(
            medium, evenly_spaced(len(medium), _MAX_LEARNT_FRAMES), str(source)
        ).positions_m
    max_count = max(count, max_candidates(len(interpolant.points_m) + count) - len(interpolant.points_m))
    candidates_m = candidates_m[:: -(-len(candidates_m) // max_count)]
    kernel = Kernel(interpolant.length_m, interpolant.noise)
    points_and_candidates_m = np.concatenate([interpolant.points_m, candidates_m])
    indices, variances = variance_points(points_and_candidates_m, count, kernel, len(interpolant.points_m))
    deviations = interpolant.scale_n * np.sqrt(variances)
    names = ("x_m", "y_m", "z_m", "deviation_n")
    rows = [
        dict(zip(names, row))
        for row in np.column_stack([points_and_candidates_m[indices], deviations]).tolist()
    ]
    figures = {
        "measured": len(recording.positions_m),
        "candidates": len(candidates_m),
        **_kernel_figures(kernel, "variance"),
        "deviation_nowhere_measured_n": interpolant.scale_n * 3**0.5,
        "next": rows,
    }
    return FewestPoints(
        figures,
        points_m=points_and_candidates_m[indices],
        positions_m=recording.positions_m,
        forces_n=recording.forces_n,
    )


def _kernel_figures(kernel: Kernel, criterion: str = "error") -> dict[str, Any]:
    return {"criterion": criterion, "length_mm": 1e3 * kernel.length_m, "noise": kernel.noise}


def _decibels(ratio: float) -> float | None:
    return float(10 * np.log10(ratio)) if ratio > 0 else None


def _with_points(result: FewestPoints, out: str | Path | None, forces_n: Float64s) -> FewestPoints:
    """Write the points and their forces to a file, if one is named.

    Returns the result with the name of the file.
    """
    if out is None:
        return result
    with atomic_path(Path(out)) as temporary:
        rows = np.hstack([result.points_m, forces_n])
        np.savetxt(temporary, rows, delimiter=",", header=_COLUMNS, comments="", fmt="%.9g")
    return replace(result, figures={**result.figures, "file": str(out)})
