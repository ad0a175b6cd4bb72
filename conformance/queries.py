"""Force, gradient and vibration at points and times, by docs/format/queries.md alone, with numpy.

    python conformance/queries.py QUERIES.csv

compares a file of golden queries with what is computed here, and prints the largest differences. `Field` has
the samples of a lattice; `Voxels`, `Bodies` and `Deformed` are the kinds of medium; `rebuilt` makes voxels
of a coarse layer.
"""

from __future__ import annotations

import csv
import sys
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import decode_objects
import decoder
import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
CORNERS = list(product((0, 1), repeat=3))  # raster order
ON_PLANE = 1e-9
"""So near to a plane of a lattice a point is on it, in samples; and a time is at a frame, in intervals."""

COLUMNS = (
    "time_s", "x_m", "y_m", "z_m", "fx_n", "fy_n", "fz_n",
    *(f"df{i}_d{j}_n_per_m" for i in "xyz" for j in "xyz"), "vibration_n", "vibration_hz",
)  # fmt: skip


class Answers(NamedTuple):
    """Force, N [n, 3], gradient, N/m [n, 3, 3], and vibration, N and Hz [n, 2], at n points."""

    force: Array
    gradient: Array
    vibration: Array


class Field:
    """Samples [nx, ny, nz, c] of a lattice; all others are zero."""

    def __init__(self, samples: Array, lattice: dict[str, Any]) -> None:
        self.samples = np.pad(samples.astype(np.float64), [(1, 2)] * 3 + [(0, 0)])
        self.origin_m, self.spacing_m = np.array(lattice["origin_m"]), np.array(lattice["spacing_m"])
        self.shape = np.array(samples.shape[:3])

    def cells(self, points_m: Array) -> tuple[Array, Array]:
        """Corners [8, n, c] of the cell about each point, and the fraction of the way through it [n, 3]."""
        index = (points_m - self.origin_m) / self.spacing_m
        index = np.where(np.isfinite(index), np.clip(index, -9, self.shape + 9), -9)
        low = np.floor(index + ON_PLANE).astype(int)
        inside = ((low >= -1) & (low < self.shape)).all(axis=1)
        low, index = np.where(inside[:, None], low, 0), np.where(inside[:, None], index, 0.0)
        x, y, z = low.T + 1
        corners = np.array([self.samples[x + i, y + j, z + k] for i, j, k in CORNERS])
        part = index - low
        return corners * inside[:, None], np.where(part > ON_PLANE, part, 0.0)

    def at(self, points_m: Array) -> tuple[Array, Array]:
        """Values [n, c] and their gradients [n, c, 3]."""
        corners, part = self.cells(points_m)
        value, slopes = np.zeros(corners.shape[1:]), np.zeros((*corners.shape[1:], 3))
        for corner, samples in zip(CORNERS, corners, strict=True):
            weight = np.where(corner, part, 1 - part)
            value += weight.prod(axis=1)[:, None] * samples
            for axis in range(3):
                others = np.delete(weight, axis, axis=1).prod(axis=1)
                sign = 1 if corner[axis] else -1
                slopes[..., axis] += sign * (others / self.spacing_m[axis])[:, None] * samples
        return value, slopes

    def vibration(self, points_m: Array) -> Array:
        """Amplitude and frequency [n, 2] of samples that have both."""
        corners, part = self.cells(points_m)
        out = np.zeros((len(points_m), 2))
        for n in range(len(points_m)):
            largest = 0.0
            for corner, (amplitude, hertz) in zip(CORNERS, corners[:, n], strict=True):
                added = np.where(corner, part[n], 1 - part[n]).prod() * amplitude
                out[n, 0] += added
                if exceeds(added, largest):
                    largest, out[n, 1] = added, hertz
        return out


def exceeds(amplitude: float, largest: float) -> bool:
    """Whether an amplitude adds more than the largest before it, by a millionth."""
    return amplitude > (1 + 1e-6) * largest


class Medium(Protocol):
    """A medium at one time: at `s` of the way from frame `a` to frame `b` = a + 1, or at `a` = `b`."""

    rate_hz: float
    frame_count: int

    def answers(self, a: int, b: int, s: float, points_m: Array) -> Answers:
        """Answers at points float64 [n, 3], metres."""
        ...


@dataclass
class Voxels:
    """A medium of voxels, with or without vibration."""

    head: dict[str, Any]
    forces_n: Any  # [frame, nx, ny, nz, 3]
    vibration: Any = None  # [frame, nx, ny, nz, 2]

    @property
    def rate_hz(self) -> float:
        return float(self.head["rate_hz"])

    @property
    def frame_count(self) -> int:
        return len(self.forces_n)

    def answers(self, a: int, b: int, s: float, points_m: Array) -> Answers:
        """The forces of both frames, blended linearly; the frequency is that of the frame that adds more."""
        (f0, g0), (f1, g1) = (Field(self.forces_n[n], self.head).at(points_m) for n in (a, b))
        v = np.zeros((len(points_m), 2))
        if self.vibration is not None:
            v0, v1 = (Field(self.vibration[n], self.head).vibration(points_m) for n in (a, b))
            later = np.array([exceeds(s * y, (1 - s) * x) for x, y in zip(v0[:, 0], v1[:, 0])], bool)
            v = np.stack([(1 - s) * v0[:, 0] + s * v1[:, 0], np.where(later, v1[:, 1], v0[:, 1])], axis=1)
        return Answers((1 - s) * f0 + s * f1, (1 - s) * g0 + s * g1, v)


@dataclass
class Bodies:
    """A scene of bodies with fields of their own."""

    scene: Any

    @property
    def rate_hz(self) -> float:
        return float(self.scene.head["rate_hz"])

    @property
    def frame_count(self) -> int:
        return int(self.scene.head["frame_count"])

    def pose(self, body: Any, a: int, b: int, s: float) -> tuple[Array, Array]:
        """Rotation [3, 3] and position [3]: the quaternions of both frames are mixed and made unit."""
        p, q = body.quaternions[a], body.quaternions[b]
        mixed = (1 - s) * p + (s if p @ q >= 0 else -s) * q
        position = (1 - s) * body.positions_m[a] + s * body.positions_m[b]
        return decode_objects.rotation_of(mixed / np.linalg.norm(mixed)), position

    def fields(self, body: Any, a: int, b: int, s: float) -> list[tuple[float, Field]]:
        """Fields of a body with their weights; one of a rigid body."""
        if not body.record["is_deforming"]:
            return [(1.0, Field(body.forces_n[0], body.record))]
        return [(w, Field(body.forces_n[n], body.record)) for w, n in ((1 - s, a), (s, b))]

    def answers(self, a: int, b: int, s: float, points_m: Array) -> Answers:
        """The sum over the bodies, shortened to the greatest force."""
        scene, count = self.scene, len(points_m)
        total, slopes, max_n = np.zeros((count, 3)), np.zeros((count, 3, 3)), scene.head["force_max_n"]
        for body in scene.bodies:
            rotation, position = self.pose(body, a, b, s)
            arm, own, own_slopes = points_m - position, np.zeros((count, 3)), np.zeros((count, 3, 3))
            for weight, samples in self.fields(body, a, b, s):
                f, g = samples.at(arm @ rotation)
                own, own_slopes = own + weight * f, own_slopes + weight * g
            total += own @ rotation.T
            slopes += rotation @ own_slopes @ rotation.T
            if scene.surface_damping > 0:
                (v0, w0), (v1, w1) = (decode_objects.motion(body, n, self.rate_hz) for n in (a, b))
                velocity, (x, y, z) = (1 - s) * v0 + s * v1, (1 - s) * w0 + s * w1
                cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
                touched = (np.linalg.norm(own, axis=1) > 1e-9 * max_n)[:, None]
                total += touched * scene.surface_damping * (velocity + arm @ cross.T)
                slopes += touched[..., None] * scene.surface_damping * cross
        return Answers(*shortened(total, slopes, max_n), np.zeros((count, 2)))


def shortened(force: Array, slopes: Array, max_n: float) -> tuple[Array, Array]:
    """Forces of at most a length, and the derivatives of that."""
    size = np.linalg.norm(force, axis=1)[:, None]
    is_cut = size > max_n
    size = np.where(is_cut, size, 1.0)
    direction = force / size
    across = slopes - direction[:, :, None] * np.einsum("ni,nij->nj", direction, slopes)[:, None, :]
    cut_slopes = (max_n / size)[..., None] * across
    return np.where(is_cut, max_n * direction, force), np.where(is_cut[..., None], cut_slopes, slopes)


def rebuilt(coarse: Array, shape: tuple[int, ...]) -> Array:
    """The samples of a stream's lattice from those of its coarse layer, [frame, nx, ny, nz, 3]."""
    for axis, count in enumerate(shape, start=1):
        own = np.moveaxis(coarse, axis, 0)
        beside = np.concatenate([own[1:], own[-1:]])  # beyond the last sample: the last sample
        if count > 1:
            own = np.stack([own, (own + beside) / 2], axis=1).reshape(-1, *own.shape[1:])[:count]
        coarse = np.moveaxis(own, 0, axis)
    return coarse


@dataclass
class Deformed:
    """A medium of voxels that control points bend."""

    voxels: Voxels
    displacement_m: Array  # [frames, nx, ny, nz, 3]
    corner_m: Array
    spacing_m: Array
    counts: Array = field(init=False)

    def __post_init__(self) -> None:
        self.counts = np.array(self.displacement_m.shape[1:4])

    @property
    def rate_hz(self) -> float:
        return self.voxels.rate_hz

    @property
    def frame_count(self) -> int:
        return self.voxels.frame_count

    def bend(self, a: int, b: int, s: float, p: Array) -> tuple[Array, Array, Array]:
        """u [3], grad u [3, 3] (du_k/dx_j), and the second derivatives [3, 3, 3] at a point."""
        control = (1 - s) * self.displacement_m[a] + s * self.displacement_m[b]
        index = (p - self.corner_m) / self.spacing_m
        cells = self.counts - 3
        inside = (index >= 0) & (index <= cells)
        index = np.clip(index, 0, cells)
        low = np.minimum(index.astype(int), cells - 1)
        basis = [spline(t) for t in index - low]  # [order, 4] along each axis
        x, y, z = (slice(n, n + 4) for n in low)
        scale = inside / self.spacing_m

        def sum_of(i: int, j: int, k: int) -> Array:
            value = np.einsum("a,b,c,abck->k", basis[0][i], basis[1][j], basis[2][k], control[x, y, z])
            return np.asarray(value * scale[0] ** i * scale[1] ** j * scale[2] ** k)

        unit = np.eye(3, dtype=int)
        slope = np.stack([sum_of(*unit[j]) for j in range(3)], axis=1)
        second = np.stack([[sum_of(*(unit[i] + unit[j])) for j in range(3)] for i in range(3)])
        return sum_of(0, 0, 0), slope, np.moveaxis(second, 2, 0)

    def answers(self, a: int, b: int, s: float, points_m: Array) -> Answers:
        """(I + grad u)^T F(x + u), its gradient, and the vibration at x + u."""
        found = []
        for p in points_m:
            u, slope, second = self.bend(a, b, s, p)
            (force,), (gradient,), (vibration,) = self.voxels.answers(a, b, s, (p + u)[None])
            m = np.eye(3) + slope
            bent = m.T @ gradient @ m + np.einsum("k,kij->ij", force, second)
            found.append((m.T @ force, bent, vibration))
        return Answers(*(np.array(part) for part in zip(*found)))


def spline(t: float) -> Array:
    """The four weights of the cubic B-spline in a cell, and their first two derivatives, float64 [3, 4]."""
    r = 1 - t
    return np.array(
        [
            [r**3 / 6, (3 * t**3 - 6 * t**2 + 4) / 6, (3 * r**3 - 6 * r**2 + 4) / 6, t**3 / 6],
            [-(r**2) / 2, (3 * t**2 - 4 * t) / 2, -(3 * r**2 - 4 * r) / 2, t**2 / 2],
            [r, 3 * t - 2, 3 * r - 2, t],
        ]
    )


# -- files -------------------------------------------------------------------------------------------------


def medium_of(stream: Path) -> Voxels | Bodies:
    """The medium of a file, decoded."""
    file = decoder.read_file(stream.read_bytes())
    if file.objects:
        return Bodies(decode_objects.decode_scene(file.head, file.objects, file.segments))
    found, vibration = decoder.decode(stream), None
    if "amplitudes_n" in found:
        vibration = np.stack([found["amplitudes_n"], found["frequencies_hz"]], axis=-1)
    return Voxels(file.head, found["forces_n"], vibration)


def answer(medium: Medium, times_s: Array, points_m: Array) -> Answers:
    """Answers at n points, each with its time."""
    position = np.clip(np.asarray(times_s) * medium.rate_hz, 0, medium.frame_count - 1)
    first = np.floor(position + ON_PLANE).astype(int)
    found = []
    for a, s, point in zip(first, position - first, points_m, strict=True):
        s = s if s > ON_PLANE else 0.0
        found.append(medium.answers(a, a + (s > 0), s, point[None]))
    return Answers(*(np.concatenate(part) for part in zip(*found)))


@dataclass
class Queries:
    """A file of golden queries: what its first lines state, and rows [n, 18] in the order of `COLUMNS`."""

    path: Path
    stated: dict[str, str]
    rows: Array

    @classmethod
    def read(cls, path: str | Path) -> Queries:
        """Read a file."""
        lines = Path(path).read_text(encoding="ascii").splitlines()
        stated = dict(line[2:].split(": ", 1) for line in lines if line.startswith("# "))
        rows = list(csv.reader(line for line in lines if not line.startswith("#")))
        if tuple(rows[0]) != COLUMNS:
            raise ValueError(f"{path}: columns {rows[0]}")
        return cls(Path(path), stated, np.array(rows[1:], np.float64))

    @property
    def stream(self) -> Path:
        """The file of the medium."""
        return (self.path.parent / self.stated["stream"]).resolve()

    @property
    def expected(self) -> Answers:
        """The golden answers."""
        return Answers(self.rows[:, 4:7], self.rows[:, 7:16].reshape(-1, 3, 3), self.rows[:, 16:])

    @property
    def tolerances(self) -> tuple[float, float, float]:
        """Largest differences of force, N, gradient, N/m, and amplitude, N. Frequencies are equal."""
        force, gradient, amplitude = map(float, self.stated["tolerances"].split())
        return force, gradient, amplitude

    @cached_property
    def medium(self) -> Medium:
        """The medium, by the reference decoder."""
        medium: Any = medium_of(self.stream)
        if "lattice" in self.stated:
            shape = tuple(map(int, self.stated["lattice"].split()))
            spacing = np.where(
                np.array(shape) > 1, np.array(medium.head["spacing_m"]) / 2, medium.head["spacing_m"]
            )
            head = {**medium.head, "grid_shape": shape, "spacing_m": spacing}
            medium = Voxels(head, rebuilt(medium.forces_n, shape))
        if "deformation" in self.stated:
            with np.load(self.path.parent / self.stated["deformation"]) as arrays:
                medium = Deformed(medium, **arrays)
        return medium

    def differences(self, found: Answers, rows: Any = slice(None)) -> tuple[float, float, float, int]:
        """Largest differences of force, gradient and amplitude, and the number of other frequencies.

        A difference that is not a number counts as infinite.
        """
        expected = Answers(*(part[rows] for part in self.expected))
        pairs = list(zip(found, expected, strict=True))
        pairs[2] = found.vibration[:, 0], expected.vibration[:, 0]
        largest = [float(np.nan_to_num(np.abs(a - b), nan=np.inf).max(initial=0.0)) for a, b in pairs]
        others = int((found.vibration[:, 1] != expected.vibration[:, 1]).sum())
        return largest[0], largest[1], largest[2], others

    def agrees(self, found: Answers, rows: Any = slice(None)) -> bool:
        """Whether answers to some of the rows are within the tolerances."""
        *largest, others = self.differences(found, rows)
        return others == 0 and all(a <= b for a, b in zip(largest, self.tolerances, strict=True))


def main() -> None:
    has_failed = False
    for name in sys.argv[1:]:
        queries = Queries.read(name)
        found = answer(queries.medium, queries.rows[:, 0], queries.rows[:, 1:4])
        force, gradient, amplitude, others = queries.differences(found)
        print(f"{name} {force:.2g} N {gradient:.2g} N/m {amplitude:.2g} N, {others} other frequencies")
        has_failed |= not queries.agrees(found)
    sys.exit(has_failed)


if __name__ == "__main__":
    main()
