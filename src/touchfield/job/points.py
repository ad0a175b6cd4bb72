"""The fewest points that tell a medium, and where to measure next (paper section 6.2, "multi-view").

A medium that moves is rebuilt from the forces at its points by least squares on its own modes; one that stands still,
and a recording of contacts, by a field without curl through them. Rebuilt are the samples that ever hold a force.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from touchfield.arrays import Float32s, Float64s, Int64s
from touchfield.errors import InvalidArgument
from touchfield.job.editing import Written, _meter, _write
from touchfield.job.joining import read_medium, spread, with_history
from touchfield.job.spec import EncodeSpec
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.medium.atomic import atomic_path
from touchfield.medium.budget import memory_budget_bytes
from touchfield.medium.trace import ContactTrace
from touchfield.parallel import Report, silent
from touchfield.reduction.kernel_points import Kernel, best_kernel, error_points, most_candidates, variance_points
from touchfield.reduction.mode_points import ModePoints, mode_points
from touchfield.reduction.modes import pod
from touchfield.sources.contact_trace import recorded_contacts, require_contacts, thinned_contacts
from touchfield.sources.curl_free import CurlFree

MOST_POINTS: Final = 1000
_LEARNT: Final = 400
_LATTICE: Final = 8000
_COLUMNS: Final = "x_m,y_m,z_m,fx_n,fy_n,fz_n"


@dataclass(frozen=True)
class FewestPoints:
    """Points of a medium or a recording, in the order they were chosen."""

    points_m: Float64s  # [n, 3]
    shown: Mapping[str, Any]
    places_m: Float64s = field(repr=False)  # [m, 3]; where the field is known
    forces_n: Float64s = field(repr=False)  # [m, 3]; there, in the frame that is drawn
    rebuilt_n: Float64s | None = field(
        default=None, repr=False
    )  # [m, 3]; likewise; None of points yet to be measured
    written: Written | None = None
    notes: tuple[str, ...] = ()

    def summary(self) -> dict[str, Any]:
        """Stable keys for people and programs."""
        return {**self.shown, **(self.written.summary() if self.written else {})}

    def draw(self, path: Path, mask: tuple[float, float]) -> None:
        """Write the picture, PNG: the field, the field rebuilt and the error in units of the mask (k, F_0)."""
        from touchfield.viewer.plots import draw_points

        draw_points(path, self.points_m, self.places_m, self.forces_n, self.rebuilt_n, mask)


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
            raise InvalidArgument(where, found, f"at most {allowed / 2**30:.1f} GiB", "Take a coarser lattice.")
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
        felt = np.linalg.norm(forces_n, axis=1) >= least_n
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

    `count` is how many, `modes` that of the modes of a medium that moves (`count`, or as many as it has). `out` is
    the medium rebuilt, OUT.touch, FIELD.npz or FIELD.vti, or the points with their forces, OUT.csv (of a recording
    only these). `spec` is the coder's and the mask's.

    TouchfieldError if anything is at fault; nothing is then left under the name `out`.
    """
    if not 1 <= count <= MOST_POINTS:
        raise InvalidArgument("points", f"{count}", f"1 to {MOST_POINTS}")
    trace = recorded_contacts(Path(source))
    if trace is not None:
        if modes is not None:
            raise InvalidArgument("--modes", "a recording", "a medium that moves")
        return _of_recording(trace, str(source), count, out)
    given = read_medium(source, spec)
    frames = spread(len(given.medium), _LEARNT)
    domain = _Domain(given.medium, frames, str(source))
    middle = domain.forces_n(given.medium[len(given.medium) // 2]).astype(np.float64)
    if len(given.medium) == 1:
        if modes is not None:
            raise InvalidArgument("--modes", "a medium of one frame", "one that moves")
        chosen, kernel, back = _kept(domain.places_m, middle, count)
        rebuild: Callable[[ForceField], NDArray[Any]] = lambda one: back  # noqa: E731
        shown = _told(kernel)
    else:
        by_modes = _by_modes(given.medium, domain, frames, count, modes)
        chosen, rank = by_modes.points, by_modes.modes.rank
        floor = by_modes.modes.tail(rank) / by_modes.modes.energy
        shown = {"criterion": "modes", "modes": rank, "floor_db": _db(floor), "bound": by_modes.bound}

        def rebuild(one: ForceField) -> NDArray[Any]:
            measured = domain.forces_n(one)[chosen].astype(np.float64)
            return np.asarray(by_modes.modes.rebuild(by_modes.coefficients(measured)).reshape(-1, 3))

        back = rebuild(given.medium[len(given.medium) // 2])
    meter = _meter(given.spec)
    words = with_history(given.medium, "edits", f"rebuilt from {count} points")
    medium = replace(
        given.medium, make_frame=lambda i: domain.field(rebuild(given.medium[i]), meter.f0_n), vibration=None,
        segments=None, provenance=words,
    )  # fmt: skip
    for n, frame in enumerate(frames):
        meter.add(given.medium[frame], medium[frame])
        report(n + 1, len(frames))
    told = {
        "points": count,
        "samples": len(middle),
        "frames_learnt": len(frames),
        **shown,
        "nmse_db": meter.nmse_db,
        "worst_mask_ratio": meter.worst_mask_ratio,
        "mask_violation_share": meter.mask_violation_share,
    }
    done = FewestPoints(domain.places_m[chosen], told, domain.places_m, middle, back)
    if out is None or Path(out).suffix == ".csv":
        return _with_points(done, out, middle[chosen])
    path, notes = _write(given, [source], medium, out, report)
    if given.medium.vibration is not None:
        notes = (*notes, "the vibration is left out")
    return replace(done, written=Written(path, medium, {}), notes=notes)


def _of_recording(trace: ContactTrace, source: str, count: int, out: str | Path | None) -> FewestPoints:
    require_contacts(trace, source)
    if out is not None and Path(out).suffix != ".csv":
        raise InvalidArgument(str(out), "the points of a recording", "OUT.csv, which encode reads")
    if count > len(trace.positions_m):
        raise InvalidArgument("points", f"{count}", f"at most {len(trace.positions_m)}, the samples of {source}")
    chosen, kernel, back = _kept(trace.positions_m, trace.forces_n, count)
    error, whole = ((back - trace.forces_n) ** 2).sum(), (trace.forces_n**2).sum()
    shown = {"points": count, "samples": len(back), **_told(kernel), "nmse_db": _db(error / whole)}
    done = FewestPoints(trace.positions_m[chosen], shown, trace.positions_m, trace.forces_n, back)
    return _with_points(done, out, trace.forces_n[chosen])


def _kept(points_m: Float64s, forces_n: Float64s, count: int) -> tuple[Int64s, Kernel, Float64s]:
    """Points of a known field that stands still, the kernel, and the field rebuilt."""
    some = np.arange(len(points_m))[:: -(-len(points_m) // most_candidates(count))]
    kernel = best_kernel(points_m[some], forces_n[some], count)
    chosen = some[error_points(points_m[some], forces_n[some], count, kernel)]
    through = CurlFree.through(points_m[chosen], forces_n[chosen], kernel.length_m, kernel.noise)
    return chosen, kernel, through.forces_n(points_m)


def _by_modes(medium: HapticMedium, domain: _Domain, frames: list[int], count: int, modes: int | None) -> ModePoints:
    rows = np.empty((len(frames), 3 * len(domain.keys)), np.float32)
    for row, frame in zip(rows, frames, strict=True):
        row[:] = domain.forces_n(medium[frame]).reshape(-1)
    if modes is not None and not 1 <= modes <= min(3 * count, len(frames)):
        raise InvalidArgument("--modes", f"{modes}", f"1 to {min(3 * count, len(frames))}")
    made = pod(rows, min(count if modes is None else modes, len(frames)))
    rows -= made.rebuild(made.coefficients(rows)).astype(np.float32)
    return mode_points(made, count, (rows**2).mean(axis=0, dtype=np.float64).reshape(-1, 3).sum(axis=1))


def next_points(source: str | Path, count: int, measured: str | Path | None = None) -> FewestPoints:
    """Where a robot or a hand should record next, each place once those before it are recorded.

    `source` is a recording, whose box is looked through, or a medium, whose felt samples are; `measured` a recording
    of what is known already (without it, that of the source). `shown["next"]` has a row for each: metres, and the
    standard deviation of the force there, newtons.

    TouchfieldError if anything is at fault.
    """
    if not 1 <= count <= MOST_POINTS:
        raise InvalidArgument("points", f"{count}", f"1 to {MOST_POINTS}")
    known = recorded_contacts(Path(measured or source))
    if known is None:
        mend = "Name what was measured: --measured FELT.csv."
        raise InvalidArgument(str(measured or source), "no recording of contacts", f"columns {_COLUMNS}", mend)
    require_contacts(known, str(measured or source))
    points_m, forces_n, side_m = thinned_contacts(known.positions_m, known.forces_n)
    apart_m = KDTree(points_m).query(points_m, k=2)[0][:, 1]
    interpolant = CurlFree.fitted(points_m, forces_n, max(side_m, float(np.median(apart_m))))
    if measured is None or recorded_contacts(Path(source)) is not None:
        own = known if measured is None else recorded_contacts(Path(source))
        assert own is not None
        low, high = own.positions_m.min(axis=0), own.positions_m.max(axis=0)
        side = np.maximum(high - low, 1e-3 * float((high - low).max()))
        step = float(np.prod(side) / _LATTICE) ** (1 / 3)
        shape = np.clip(np.rint(side / step), 1, _LATTICE ** (1 / 2)).astype(int)
        grid = Grid.over_box(low, low + side, tuple(shape.tolist()))
        places = grid.to_m(np.indices(grid.shape).reshape(3, -1).T)
    else:
        medium = read_medium(source).medium
        places = _Domain(medium, spread(len(medium), _LEARNT), str(source)).places_m
    most = max(count, most_candidates(len(interpolant.points_m) + count) - len(interpolant.points_m))
    places = places[:: -(-len(places) // most)]
    kernel = Kernel(interpolant.length_m, interpolant.noise)
    every = np.concatenate([interpolant.points_m, places])
    chosen, variances = variance_points(every, count, kernel, len(interpolant.points_m))
    deviations = interpolant.scale_n * np.sqrt(variances)
    rows = [
        {"x_m": x, "y_m": y, "z_m": z, "deviation_n": deviation}
        for (x, y, z), deviation in zip(every[chosen].tolist(), deviations.tolist(), strict=True)
    ]
    shown = {
        "measured": len(known.positions_m),
        "candidates": len(places),
        **_told(kernel, "variance"),
        "deviation_nowhere_measured_n": interpolant.scale_n * 3**0.5,
        "next": rows,
    }
    return FewestPoints(every[chosen], shown, known.positions_m, known.forces_n)


def _told(kernel: Kernel, criterion: str = "error") -> dict[str, Any]:
    return {"criterion": criterion, "length_mm": 1e3 * kernel.length_m, "noise": kernel.noise}


def _db(share: float) -> float | None:
    return float(10 * np.log10(share)) if share > 0 else None


def _with_points(done: FewestPoints, out: str | Path | None, forces_n: Float64s) -> FewestPoints:
    """The same once its points are in a file, with their forces."""
    if out is not None:
        with atomic_path(Path(out)) as temporary:
            rows = np.hstack([done.points_m, forces_n])
            np.savetxt(temporary, rows, delimiter=",", header=_COLUMNS, comments="", fmt="%.9g")
    return replace(done, shown={**done.shown, **({"file": str(out)} if out is not None else {})})
