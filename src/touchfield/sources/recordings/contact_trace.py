"""Turns recorded contacts (positions of a probe and the forces on it, from CSV or MCAP) into a force field
that interpolates them.

Forces are those on the probe, in the axes and metres of the recording. They are interpolated by a curl-free
field (`CurlFree`): a Gaussian process whose potential has the kernel k(r) = exp(-r^2 / 2 l^2). The forces,
its gradient, then have the covariance (I - d d^T / l^2) exp(-r^2 / 2 l^2) / l^2 for two points at the offset
d (Macedo and Castro 2010; Fuselier and Wright 2017). The leave-one-out error has a closed form; length and
noise minimise it. Friction is not a gradient: it remains as a residual, and the relative error shows its
size.

The field extends to `REACH` kernel lengths from the samples used: there is no extrapolation beyond. A kernel
is at least `MIN_SAMPLES` samples of the medium's lattice long (`ContactScene.set_lattice`): a narrower one
lies between samples, and the medium then misses the recorded forces. Of the kernels that are tried for a
lattice, the one with the least leave-one-out error and sampling loss is used: a fit without noise may exceed
the device's greatest force beside the path, where the samples are, and is then clipped there.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from touchfield.arrays import Bools, Float64s
from touchfield.compute.threads import for_chunks
from touchfield.errors import InvalidArgument, SourceError, import_extra
from touchfield.files import library_faults, readable, require_plain
from touchfield.medium import ForceField, Grid
from touchfield.medium.field import field_of_points
from touchfield.medium.grid import CORNERS
from touchfield.medium.trace import MAX_SAMPLES, ContactTrace, has_forces, read_contacts
from touchfield.sources.laws import ForceProfile
from touchfield.sources.options import SourceOptions
from touchfield.sources.recordings.mcap_chunks import require_distinct_chunks
from touchfield.sources.registry import SourceKind
from touchfield.sources.scene import UP_Z_AXES, Scene, find_bricks_by_sphere

Triple = tuple[float, float, float]

_POSITIONS: Final = ("pose.position", "position", "point", "transform.translation", "translation")
_FORCES: Final = ("field.force", "wrench.force", "force")  # the first is that of a log of `play`
# schemas of geometry_msgs -> 0 for a position, 1 for a force
_CDR: Final = {"PoseStamped": 0, "PointStamped": 0, "TransformStamped": 0, "WrenchStamped": 1}
_EXPECTED: Final = "an MCAP file of positions and forces"

MAX_POINTS: Final = 350

REACH: Final = 1.0  # kernel lengths: a sample at this distance still determines 60 % of the potential
MIN_SAMPLES: Final = 3.0
"""Samples of the lattice in the shortest kernel.

Two suffice for a force at all eight corners around a contact; at three the low-pass and the interpolation
between samples lose less.
"""

_MIN_POINTS: Final = 4
_FARTHEST_M: Final = 1e4
_STRONGEST_N: Final = 1e6
_HIGH_ERROR: Final = 0.5
_LENGTHS: Final = (1.0, 1.5, 2.25, 3.5, 5.0)
_NOISES: Final = (1e-4, 1e-2, 0.1, 0.5)
_CHUNK: Final = 1024


@dataclass(frozen=True)
class CurlFree:
    """A curl-free interpolant of forces."""

    points_m: Float64s  # float64 [n, 3]
    weights: Float64s  # float64 [n, 3]
    length_m: float  # l of the kernel
    relative_error: float  # RMS of the leave-one-out errors, over that of the forces
    noise: float  # variance of the residual, over that of the field
    scale_n: float  # prior standard deviation of a force component

    @classmethod
    def through(
        cls,
        points_m: Float64s,
        forces_n: Float64s,
        length_m: float,
        noise: float,
        kernel: Float64s | None = None,
    ) -> CurlFree:
        """Interpolate forces, `points_m` and `forces_n` float64 [n, 3].

        `kernel` are the `covariances` of the points, if known.
        """
        from scipy.linalg.lapack import dtrtri

        kernel = covariances(points_m / length_m) if kernel is None else kernel
        count = len(points_m)
        size = float(np.sqrt(np.mean(forces_n**2))) or 1.0
        target = forces_n.reshape(-1) / size
        factor = np.linalg.cholesky(kernel + noise * np.eye(len(target)))
        half = dtrtri(factor, lower=1)[0]  # the inverse is half.T @ half
        solved = half.T @ (half @ target)
        columns = half.reshape(len(target), count, 3)
        blocks = np.einsum("kni,knj->nij", columns, columns)
        residuals = np.linalg.solve(blocks, solved.reshape(-1, 3, 1))
        relative_error = float(np.sqrt(np.mean(residuals**2)))
        return cls(
            points_m,
            size * solved.reshape(-1, 3),
            length_m,
            relative_error,
            noise,
            size / math.sqrt(1 + noise),
        )

    @classmethod
    def fitted(
        cls,
        points_m: Float64s,
        forces_n: Float64s,
        spacing_m: float,
        min_length_m: float = 0.0,
        loss: Callable[[CurlFree], float] = lambda fit: 0.0,
    ) -> CurlFree:
        """Return the interpolant with the smallest leave-one-out error.

        `loss` is another error of a fit, relative to the forces; the root of the sum of squares counts.
        `points_m`, `forces_n` float64 [n, 3]: at least 4, not all forces 0, no two points equal; `spacing_m`
        float: spacing of the points; the lengths that are tried are multiples of it, at least `min_length_m`.
        """
        fits = []
        for length_m in sorted({max(length * spacing_m, min_length_m) for length in _LENGTHS}):
            kernel = covariances(points_m / length_m)
            fits += [cls.through(points_m, forces_n, length_m, noise, kernel) for noise in _NOISES]
        return min(fits, key=lambda fit: math.hypot(fit.relative_error, loss(fit)))

    def forces_n(self, at_m: Float64s, reach_m: float = math.inf) -> Float64s:
        """Return forces, newtons, float64 [n, 3], at points [n, 3]; 0 beyond `reach_m`."""
        from touchfield.sources.shapes.kernels import add_forces

        at, points = np.ascontiguousarray(at_m / self.length_m), self.points_m / self.length_m
        forces = np.zeros((len(at), 3))
        reach = reach_m / self.length_m
        for_chunks(add_forces, len(at), at, points, self.weights, reach, forces, chunk=_CHUNK)
        return forces


def covariances(points: Float64s, others: Float64s | None = None) -> Float64s:
    """Return covariances of the forces at points and at others.

    `others` defaults to the points; both are in kernel lengths.

    Float64 [3 n, 3 m] for float64 [n, 3] and [m, 3]; times l^2, so that variances are 1.
    """
    offsets = points.T[:, :, None] - (points if others is None else others).T[:, None]
    gaussian = np.exp(-0.5 * (offsets**2).sum(axis=0))
    blocks = np.empty((len(gaussian), 3, gaussian.shape[1], 3))
    for i, j in np.ndindex(3, 3):
        blocks[:, i, :, j] = (float(i == j) - offsets[i] * offsets[j]) * gaussian
    return blocks.reshape(3 * len(gaussian), -1)


def sampling_loss(fit: CurlFree, points_m: Float64s, grid: Grid, force_max_n: float) -> float:
    """Return what a lattice loses of an interpolant at points [n, 3], as a fraction of its RMS force there.

    Forces are clipped to `force_max_n` at the samples and trilinear between them.
    """
    index = grid.to_index(points_m)
    low = np.floor(index)
    sampled_n = np.zeros_like(points_m)
    for corner in CORNERS:
        weights = np.where(corner, index - low, 1 - (index - low)).prod(axis=1)
        forces_n = fit.forces_n(grid.to_m(low + corner), REACH * fit.length_m)
        sampled_n += weights[:, None] * _clipped(forces_n, force_max_n)
    exact_n = fit.forces_n(points_m)
    missed = np.mean((sampled_n - _clipped(exact_n, force_max_n)) ** 2)
    return math.sqrt(float(missed) / max(float(np.mean(exact_n**2)), 1e-30))


def _clipped(forces_n: Float64s, force_max_n: float) -> Float64s:
    lengths = np.linalg.norm(forces_n, axis=1, keepdims=True)
    return np.asarray(forces_n * (force_max_n / np.maximum(lengths, force_max_n)))


def thin_contacts(points_m: Float64s, forces_n: Float64s) -> tuple[Float64s, Float64s, float]:
    """Average contacts over the cells of a lattice.

    The lattice is about the finest one with at most `MAX_POINTS` occupied cells.

    Returns points and forces, float64 [m, 3], m at most `MAX_POINTS`, and the side of a cell.
    """
    low = points_m.min(axis=0)
    extent = float((points_m.max(axis=0) - low).max())
    side = extent / 256
    while True:
        cells = np.floor((points_m - low) / side).astype(np.int64)
        _, cell_of, counts = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
        if len(counts) <= MAX_POINTS:
            break
        side *= 1.15
    sums = [
        np.stack([np.bincount(cell_of.reshape(-1), c) for c in values.T], axis=1)
        for values in (points_m, forces_n)
    ]
    return sums[0] / counts[:, None], sums[1] / counts[:, None], side


def require_contacts(trace: ContactTrace, where: str) -> None:
    """Raise `SourceError` if the contacts of a trace are implausible.

    All positions are equal, all forces are 0, or values are too large.
    """
    with np.errstate(over="ignore"):
        extent = np.ptp(trace.positions_m, axis=0).max()
    if not (extent < _FARTHEST_M and np.abs(trace.forces_n).max() < _STRONGEST_N):
        found = f"{extent:g} m and {np.abs(trace.forces_n).max():g} N"
        raise SourceError(
            where, found, f"less than {_FARTHEST_M:g} m and {_STRONGEST_N:g} N", "Check the units."
        )
    if not extent > 0 or not trace.forces_n.any():
        found = "a probe that never moved" if not extent > 0 else "no force"
        raise SourceError(where, found, "forces at several places", "Record a contact.")


class ContactScene(Scene):
    """Recorded forces as a static field; `notes` on how they were read come first in its notes.

    Raises `SourceError` as `require_contacts` does, or if there are too few contacts.
    """

    axes = UP_Z_AXES
    box_wording = "the trace"
    unit = ("positions are metres", 1e-4, 10.0)
    has_law = False
    has_decoded_notes = True

    def __init__(self, trace: ContactTrace, where: str = "trace", notes: tuple[str, ...] = ()) -> None:
        require_contacts(trace, where)
        self._source_notes = notes
        self._trace, self._averages = trace, thin_contacts(trace.positions_m, trace.forces_n)
        if len(self._averages[0]) < _MIN_POINTS:
            found = f"{len(self._averages[0])} places"
            raise SourceError(where, found, f"at least {_MIN_POINTS}", "Record a longer contact.")
        self._fits: dict[tuple[Grid, float], CurlFree] = {}
        self._set_fit(CurlFree.fitted(*self._averages))
        # the box does not depend on a lattice, which is placed by it
        self._margin_m = self.reach_m

    def set_lattice(self, grid: Grid, force_max_n: float) -> None:
        """See `Scene.set_lattice`: the kernel becomes at least `MIN_SAMPLES` samples long."""
        key = grid, force_max_n
        if key not in self._fits:
            points_m = self._averages[0]
            self._fits[key] = CurlFree.fitted(
                *self._averages,
                MIN_SAMPLES * max(grid.spacing_m),
                lambda fit: sampling_loss(fit, points_m, grid, force_max_n),
            )
        self._set_fit(self._fits[key])

    def _set_fit(self, fit: CurlFree) -> None:
        self.interpolant, self.reach_m = fit, REACH * fit.length_m
        error = fit.relative_error
        self.notes = (
            *self._source_notes,
            f"A curl-free field through {len(fit.points_m)} means of {len(self._trace.positions_m)} samples, "
            f"with a leave-one-out error of {100 * error:.3g} % before it is sampled; no force beyond "
            f"{1e3 * self.reach_m:.3g} mm of a sample; the force law is ignored.",
        )
        if error > _HIGH_ERROR:
            self.notes += (
                "This part of the forces is not a gradient: friction, inertia, or varying contacts. The "
                "field is a rough mean of them.",
            )

    def decoded_notes(
        self, field: ForceField, to_hand: Callable[[Float64s], Float64s], force_max_n: float
    ) -> tuple[str, ...]:
        """See `Scene.decoded_notes`: the part of the recorded forces that the file misses."""
        positions_m = to_hand(self._trace.positions_m)
        low, high = field.grid.box_m
        is_inside = ((positions_m >= low) & (positions_m <= high)).all(axis=1)
        recorded_n = self._trace.forces_n[is_inside]
        outside = 1 - float(is_inside.mean())
        notes: tuple[str, ...] = ()
        if recorded_n.any():
            missed_n = field.sample_n(positions_m[is_inside]) - recorded_n
            missed = float(np.sqrt((missed_n**2).sum() / (recorded_n**2).sum()))
            notes = (
                f"At the {len(recorded_n)} recorded positions the file misses {100 * missed:.3g} % of the "
                "forces (RMS of the difference over that of the recording).",
            )
        too_great = (
            float((np.linalg.norm(recorded_n, axis=1) > force_max_n).mean()) if len(recorded_n) else 0.0
        )
        if too_great:
            notes += (
                f"{100 * too_great:.3g} % of the recorded forces exceed {force_max_n:g} N, the device's "
                "greatest, and are clipped to it.",
            )
        if outside:
            notes += (f"{100 * outside:.3g} % of the recorded positions are outside the workspace.",)
        return notes

    def bounds_m(self) -> Float64s:
        """Return the box of the trace, float64 [2, 3]."""
        points = self.interpolant.points_m
        return np.stack([points.min(axis=0) - self._margin_m, points.max(axis=0) + self._margin_m])

    def field(self, frame: int, grid: Grid, profile: ForceProfile) -> ForceField:
        """See `Scene.field`; frame and law are ignored."""
        from scipy.spatial import KDTree

        tree = KDTree(self.interpolant.points_m)

        def may_hold(centres: Float64s, radius_m: float) -> Bools:
            is_within: Bools = tree.query(centres, distance_upper_bound=self.reach_m + radius_m)[0] < np.inf
            return is_within

        bricks = find_bricks_by_sphere(may_hold, grid)
        return field_of_points(grid, bricks, lambda points: self.interpolant.forces_n(points, self.reach_m))


# -- MCAP, the container of robotics recordings (extra: mcap) ----------------------------------------------

# Messages are JSON, or CDR of ROS 2 with the schemas of geometry_msgs for a stamped pose, point, transform
# and wrench. The first channel with positions and the first with forces are used, with log times; the
# position of a force is interpolated.


def read_mcap(path: Path) -> ContactTrace:
    """Read the contacts in an ``.mcap`` file.

    Raises `MissingExtra` if the library mcap is not installed; `SourceError` if the file cannot be read, a
    message is damaged, or there are no positions or no forces.
    """
    reader = import_extra("mcap.reader", str(path), "mcap", "mcap")
    require_plain(path, _EXPECTED)
    rows_of: tuple[dict[int, list[tuple[float, ...]]], ...] = ({}, {})
    names: dict[str, None] = {}
    count = 0
    with (
        readable(path, _EXPECTED),
        path.open("rb") as file,
        library_faults(path, "no sound MCAP", _EXPECTED, "Copy it again."),
    ):
        messages = reader.make_reader(file)
        require_distinct_chunks(messages.get_summary(), str(path))
        for schema, channel, message in messages.iter_messages():  # by time
            name = schema.name if schema is not None else ""
            names[f"{channel.topic} ({name}, {channel.message_encoding})"] = None
            for kind, values in _contents(
                name, channel.message_encoding, message.data, f"{path}: {channel.topic}"
            ):
                rows_of[kind].setdefault(channel.id, []).append((message.log_time / 1e9, *values))
                count += 1
            if count > 2 * MAX_SAMPLES:
                raise SourceError(
                    str(path), f"more than {2 * MAX_SAMPLES} messages", _EXPECTED, "Cut it in parts."
                )
    for rows, quantity in zip(rows_of, ("positions", "forces")):
        if not rows:
            listed = ", ".join(list(names)[:6]) or "no message"
            expected = f"{quantity}: JSON, or CDR of geometry_msgs ({', '.join(_CDR)})"
            raise SourceError(str(path), f"no {quantity} in {listed}", expected)
    positions, forces = (np.array(next(iter(rows.values()))) for rows in rows_of)
    if not (np.isfinite(positions).all() and np.isfinite(forces).all()):
        raise SourceError(str(path), "a number that is not finite", "finite metres and newtons")
    is_between = (forces[:, 0] >= positions[0, 0]) & (forces[:, 0] <= positions[-1, 0])
    if not is_between.any():
        raise SourceError(str(path), "forces at other times than positions", "both at the same times")
    forces = forces[is_between]
    positions_m = np.stack(
        [np.interp(forces[:, 0], positions[:, 0], of) for of in positions[:, 1:].T], axis=1
    )
    return ContactTrace(positions_m, forces[:, 1:])


def _contents(name: str, encoding: str, data: bytes, where: str) -> list[tuple[int, Triple]]:
    """Return the contents of a message: (0, position) and (1, force)."""
    kind = name.rpartition("/")[2]
    if encoding == "cdr":
        return [(_CDR[kind], _cdr(data, kind, where))] if kind in _CDR else []
    if encoding != "json":
        return []
    try:
        value = json.loads(data)
    except ValueError as error:
        raise SourceError(where, f"no JSON ({error})", "a JSON message") from None
    contents = []
    for quantity, paths in enumerate((_POSITIONS, _FORCES)):
        for keys in paths:
            inner = value
            for key in keys.split("."):
                inner = inner.get(key) if isinstance(inner, dict) else None
            if isinstance(inner, dict) and all(type(inner.get(axis)) in (int, float) for axis in "xyz"):
                contents.append((quantity, (float(inner["x"]), float(inner["y"]), float(inner["z"]))))
                break
    return contents


def _cdr(data: bytes, kind: str, where: str) -> Triple:
    """Read three doubles after a header of stamp and frame name (two names for a transform)."""
    order = "<" if data[1:2] == b"\x01" else ">"
    body, at = data[4:], 8
    for _ in range(2 if kind == "TransformStamped" else 1):
        at += -at % 4
        (length,) = struct.unpack_from(order + "I", body, at)
        at += 4 + length
    at += -at % 8
    if at + 24 > len(body):
        raise SourceError(where, f"a message of {len(data)} bytes", f"a {kind} of at least {at + 28}")
    x, y, z = struct.unpack_from(order + "3d", body, at)
    return x, y, z


def recorded_contacts(path: Path) -> ContactTrace | None:
    """Read the contacts in a recording; None if the file is not one."""
    return _read(path) if _recognise(path) else None


def _read(path: Path) -> ContactTrace:
    return read_mcap(path) if path.suffix.lower() == ".mcap" else read_contacts(path)


def _recognise(path: Path) -> bool:
    if not path.is_file():
        return False
    return path.suffix.lower() == ".mcap" or (
        path.suffix.lower() in (".csv", ".tsv", ".txt") and has_forces(path)
    )


def require_world_frame(options: SourceOptions, source: str) -> None:
    """Raise `InvalidArgument` if options ask for the frame of a camera, which `source` has not."""
    if options.frame == "camera":
        raise InvalidArgument("--frame", "camera", f"world: {source} has no camera")


def _open(path: Path, options: SourceOptions) -> Scene:
    require_world_frame(options, "a trace")
    return ContactScene(_read(path), str(path))


KIND = SourceKind(
    "contacts",
    "a recording of positions and forces: .csv with t_s,x_m,y_m,z_m,fx_n,fy_n,fz_n, or MCAP (extra: mcap)",
    _recognise,
    _open,
)
