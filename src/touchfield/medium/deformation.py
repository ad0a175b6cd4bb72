"""Deformation of a medium at the receiver by control points; nothing is sent upstream (paper section 6.3).

The field at x is looked up at psi(x) = x + u(x) in the stored medium; u is a cubic B-spline over a small
lattice of control points, constant beyond it along each axis. With F = -grad f the force is

    F'(x) = (I + grad u)^T F(psi(x)) = -grad (f o psi),

as free of curl as F: bending a field generates no energy, which it would if the forces kept their size. The
map goes backwards, from the position of the hand to the undeformed medium, so that a query inverts nothing.

The control points move by **tracks**, a lattice of displacements for each frame, interpolated linearly in
time; or they **yield** under the finger, as a spring of `compliance_m_per_n` in series with the field that
follows with the time constant `relax_s`. Both add up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import ArrayLike

from touchfield.arrays import Float64s, Int64s
from touchfield.atomic import atomic_path
from touchfield.errors import InvalidArgument, SourceError, as_source_error, require_between
from touchfield.medium.field import frozen
from touchfield.medium.stores.npz import NpzArchive

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

MAX_CONTROLS: Final = 32  # along an axis
MAX_CELLS: Final = 1 << 18
"""Over all frames; checking them for folds takes 1 to 2 s. With 8 x 8 x 8 control points: 35 s at 60 Hz."""

STEP_M: Final = 2e-5  # of displacements in a file: imperceptible, and negligible in the slopes of the map
_MAX_BYTES: Final = MAX_CELLS * 4**3 * 3 * 2  # of the least lattice, whose one cell has most control points
_FINE: Final = 3  # places along each side of a cell at which the determinant is looked at
_ARRAYS: Final = {"corner_m": 3, "spacing_m": 3, "rate_hz": 1, "compliance_m_per_n": 1, "relax_s": 1}


@dataclass(frozen=True, eq=False)
class Deformation:
    """Displacements of control points, and how they yield.

    displacement_m : float [T, nx, ny, nz, 3]; u at the control points of each frame, metres: from where the
        hand is to where the medium was. 4 to 32 along each axis.
    corner_m, spacing_m : float [3]; where the cells of the lattice begin (control point 1 of each axis), and
        their sides, metres.
    compliance_m_per_n : float; metres that the medium gives way for a newton; 0: it does not yield.
    relax_s : float; time constant with which it does, and comes back, seconds.
    Raises `InvalidArgument` if a shape does not fit, a number is out of range or not finite, or the map
    folds: the determinant of I + grad u is not positive somewhere.
    """

    displacement_m: Float64s
    corner_m: tuple[float, float, float]
    spacing_m: tuple[float, float, float]
    rate_hz: float = 1.0
    compliance_m_per_n: float = 0.0
    relax_s: float = 0.05

    def __post_init__(self) -> None:
        u = np.array(self.displacement_m, np.float64)
        if (
            u.ndim != 5
            or u.shape[4] != 3
            or not len(u)
            or not all(4 <= n <= MAX_CONTROLS for n in u.shape[1:4])
        ):
            expected = f"[frames, nx, ny, nz, 3] with 4 to {MAX_CONTROLS} control points along each axis"
            raise InvalidArgument("displacement_m", f"shape {u.shape}", expected)
        cells = len(u) * math.prod(n - 3 for n in u.shape[1:4])
        if cells > MAX_CELLS:
            raise InvalidArgument("displacement_m", f"{cells} cells over all frames", f"at most {MAX_CELLS}")
        for name in ("corner_m", "spacing_m"):
            three = tuple(map(float, getattr(self, name)))
            low, high = (1e-6, 10.0) if name == "spacing_m" else (-1e3, 1e3)
            if len(three) != 3 or not all(low <= value <= high for value in three):
                raise InvalidArgument(
                    name, repr(getattr(self, name)), f"three lengths from {low:g} to {high:g} m"
                )
            object.__setattr__(self, name, three)
        if not np.isfinite(u).all() or np.abs(u).max() > 0.5:
            raise InvalidArgument("displacement_m", "a number that is not finite or beyond 0.5 m", "metres")
        for name, low, high in (
            ("rate_hz", 1e-3, 1e4),
            ("relax_s", 1e-3, 60.0),
            ("compliance_m_per_n", 0.0, 1.0),
        ):
            if not low <= getattr(self, name) <= high:
                raise InvalidArgument(name, repr(getattr(self, name)), f"a number from {low:g} to {high:g}")
        object.__setattr__(self, "displacement_m", frozen(u))
        determinant, frame = self.min_determinant()
        if determinant <= 0:
            expected = "a positive determinant of I + grad u everywhere"
            raise InvalidArgument(
                f"displacement_m, frame {frame}", f"a fold: {determinant:.3g}", expected, "Bend it less."
            )
        if self.compliance_m_per_n and self.max_yield_m <= 0:
            found = "tracks that bend by their utmost"
            raise InvalidArgument("compliance_m_per_n", found, "none, or tracks that bend less")

    @classmethod
    def at_rest(cls, low_m: ArrayLike, high_m: ArrayLike, controls: int = 8, **yields: float) -> Deformation:
        """One frame without any displacement over a box; `yields` as of the class."""
        low, high = (np.asarray(m, np.float64) for m in (low_m, high_m))
        require_between(4, MAX_CONTROLS, controls=controls)
        spacing = (high - low) / (controls - 3)
        return cls(np.zeros((1, controls, controls, controls, 3)), tuple(low), tuple(spacing), **yields)

    def __len__(self) -> int:
        return len(self.displacement_m)

    def __repr__(self) -> str:
        nx, ny, nz = self.displacement_m.shape[1:4]
        return f"<Deformation: {len(self)} frames of {nx} x {ny} x {nz} control points>"

    @property
    def max_yield_m(self) -> float:
        """Most that a control point may yield along an axis, metres, so that the map surely does not fold.

        The map does not fold where |grad u| < 1. Of a B-spline that slope is at most the difference of
        neighbouring control points over their distance, and that of the tracks is taken off first.
        """
        u, square = self.displacement_m, 0.0
        for axis in range(3):
            square += float(
                (np.linalg.norm(np.diff(u, axis=axis + 1), axis=-1).max() / self.spacing_m[axis]) ** 2
            )
        slope = sum(
            3 * (2.0 / h) ** 2 for h in self.spacing_m
        )  # of control points that differ by up to twice 1 m
        return max(0.0, (0.95 - math.sqrt(square)) / math.sqrt(slope))

    @cached_property
    def max_stretch(self) -> float:
        """Gershgorin bound of the largest singular value of I + grad u, at the points of the determinant."""
        squares = (np.abs(np.swapaxes(j, -2, -1) @ j).sum(axis=-1).max() for j in self._jacobians())
        return math.sqrt(max(squares))

    def min_determinant(self) -> tuple[float, int]:
        """Return the minimum determinant of I + grad u, at 3^3 points of every cell, and its frame."""
        return min((float(np.linalg.det(j).min()), frame) for frame, j in enumerate(self._jacobians()))

    def _jacobians(self) -> Iterator[Float64s]:
        """I + grad u [.., 3, 3] of each frame."""
        values, slopes = _basis(np.arange(_FINE) / (_FINE - 1))
        for u in self.displacement_m:
            if not u.any():
                yield np.eye(3)[None]
                continue
            jacobian = np.empty((*(_FINE * (n - 3) for n in u.shape[:3]), 3, 3))
            for axis in range(3):
                gradient = u
                for other in range(3):
                    rows = slopes / self.spacing_m[axis] if other == axis else values
                    gradient = _along(gradient, rows, other)
                jacobian[..., axis] = gradient
            yield jacobian + np.eye(3)

    def design(self, points_m: Float64s) -> tuple[Int64s, Float64s]:
        """Control points, flat, and weights of each point [n, 64]: u(x) is the weighted sum."""
        shape = np.array(self.displacement_m.shape[1:4])
        s = np.clip((points_m - np.array(self.corner_m)) / np.array(self.spacing_m), 0, shape - 3)
        cell = np.minimum(s.astype(np.int64), shape - 4)
        weights = [_basis(s[:, a] - cell[:, a])[0] for a in range(3)]
        step = np.arange(4)
        i, j, k = (cell[:, a, None] + step for a in range(3))
        flat = (i[:, :, None, None] * shape[1] + j[:, None, :, None]) * shape[2] + k[:, None, None, :]
        both = weights[0][:, :, None, None] * weights[1][:, None, :, None] * weights[2][:, None, None, :]
        return flat.reshape(-1, 64), both.reshape(-1, 64)

    def write(self, path: str | Path) -> None:
        """Write it as ``.npz``, displacements as whole steps of 20 um, whole or not at all.

        What stands there are second differences in time, int16 which wraps, their signs in the lowest bit,
        all low bytes before all high ones: half of what first differences take.
        """
        steps = np.rint(self.displacement_m / STEP_M).astype(np.int16)
        second = np.diff(steps, n=2, axis=0, prepend=np.zeros((2, *steps.shape[1:]), np.int16)).astype(
            np.int64
        )
        folded = (second << 1) ^ (second >> 15)
        arrays: dict[str, Any] = {name: np.array(getattr(self, name)) for name in _ARRAYS}
        with atomic_path(Path(path)) as temporary, temporary.open("wb") as stream:
            np.savez_compressed(
                stream, displacement=np.stack([folded, folded >> 8]).astype(np.uint8), **arrays
            )


def read_deformation(path: str | Path) -> Deformation:
    """Read a file of `Deformation.write`; `SourceError` that names file and array if it is invalid."""
    archive = NpzArchive(Path(path))
    header, where = archive.header("displacement"), f"{path}, array displacement"
    if (
        header.dtype != np.uint8
        or len(header.shape) != 6
        or header.shape[0] != 2
        or header.data_bytes > _MAX_BYTES
    ):
        raise SourceError(
            where, header.description, f"bytes [2, frame, nx, ny, nz, 3], at most {_MAX_BYTES >> 20} MiB"
        )
    arrays = {name: archive.numbers(name, count) for name, count in _ARRAYS.items()}
    parameters: dict[str, Any] = {
        name: tuple(values) if len(values) > 1 else values[0] for name, values in arrays.items()
    }
    low, high = archive.read("displacement").astype(np.int64)
    folded = low | high << 8
    second = ((folded >> 1) ^ -(folded & 1)).astype(np.int16)
    steps = np.cumsum(np.cumsum(second, axis=0, dtype=np.int16), axis=0, dtype=np.int16)
    with as_source_error(f"{path}, "):
        return Deformation(STEP_M * steps.astype(np.float64), **parameters)


def _basis(t: Float64s) -> tuple[Float64s, Float64s]:
    """Cubic B-spline at positions 0 to 1 in a cell: weights of four control points [n, 4], and slopes."""
    r = 1 - t
    values = [r**3, 3 * t**3 - 6 * t**2 + 4, 3 * r**3 - 6 * r**2 + 4, t**3]
    slopes = [-3 * r**2, 9 * t**2 - 12 * t, -9 * r**2 + 12 * r, 3 * t**2]
    return np.stack(values, axis=-1) / 6, np.stack(slopes, axis=-1) / 6


def _along(u: Float64s, rows: Float64s, axis: int) -> Float64s:
    """Interpolate control points along an axis at the points of each cell; `rows` are the weights of four."""
    lanes = np.moveaxis(u, axis, -1)
    windows = np.lib.stride_tricks.sliding_window_view(lanes, 4, axis=-1)
    placed = np.einsum("...cw,pw->...cp", windows, rows)
    return np.moveaxis(placed.reshape(*lanes.shape[:-1], -1), -1, axis)


_SMOOTH: Final = (3e-3, 3e-2, 0.3)
"""Weights of the second differences over the mean weight of a vertex; the first without a fold is used."""


def fitted(
    rest_m: Float64s,
    frames_m: Iterable[Float64s],
    lattice: Deformation,
    rate_hz: float,
    report: Callable[[int], None] = lambda _: None,
) -> tuple[Deformation, float]:
    """Fit tracks on the lattice of another deformation; return them and the rms residual, metres.

    rest_m : float64 [n, 3]; the vertices in the medium as it is stored, metres.
    frames_m : of float64 [n, 3]; the vertices of each frame.
    Raises `InvalidArgument` if the vertices are not the same in number, or no fit of a frame is without a
    fold.
    """
    tracks, square = [], 0.0
    for number, now in enumerate(frames_m):
        if now.shape != rest_m.shape:
            raise InvalidArgument(f"frame {number}", f"{len(now)} vertices", f"{len(rest_m)} as at rest")
        u, rms = _frame(rest_m - now, now, lattice, rate_hz, number)
        tracks.append(u)
        square += rms**2
        report(number + 1)
    fit = Deformation(np.stack(tracks), lattice.corner_m, lattice.spacing_m, rate_hz)
    return fit, float(np.sqrt(square / len(tracks)))


def _frame(
    target: Float64s, now: Float64s, lattice: Deformation, rate_hz: float, number: int
) -> tuple[Float64s, float]:
    from scipy import sparse
    from scipy.sparse.linalg import spsolve

    shape = lattice.displacement_m.shape[1:4]
    if not target.any():
        return np.zeros((*shape, 3)), 0.0
    flat, weights = lattice.design(now)
    rows = np.repeat(np.arange(len(now)), 64)
    design = sparse.csr_matrix((weights.ravel(), (rows, flat.ravel())), shape=(len(now), int(np.prod(shape))))
    normal, right = design.T @ design, design.T @ target
    bends, eyes = 1e-9 * sparse.identity(int(np.prod(shape))), [sparse.identity(n) for n in shape]
    for axis, n in enumerate(
        shape
    ):  # squares of second differences along each axis, and a little of the first
        second = sparse.diags([1.0, -2.0, 1.0], [0, 1, 2], shape=(n - 2, n))
        first = sparse.diags([1.0, -1.0], [0, 1], shape=(n - 1, n))
        penalty = second.T @ second + 1e-3 * (first.T @ first)
        x, y, z = (penalty if a == axis else eye for a, eye in enumerate(eyes))
        bends = bends + sparse.kron(sparse.kron(x, y), z)
    for smooth in _SMOOTH:
        solved = spsolve((normal + smooth * len(now) / int(np.prod(shape)) * bends).tocsc(), right)
        u = np.asarray(solved).reshape(*shape, 3)
        try:
            Deformation(u[None], lattice.corner_m, lattice.spacing_m, rate_hz)
        except InvalidArgument:
            continue
        return u, float(np.sqrt(((design @ solved - target) ** 2).sum(axis=1).mean()))
    expected = "a motion in which no two places come together"
    hint = "Take fewer frames about the one at rest, and begin anew behind them."
    raise InvalidArgument(f"frame {number} of the tracks", "a fit that folds", expected, hint)
