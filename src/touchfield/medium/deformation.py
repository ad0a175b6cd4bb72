"""Deforms the field that a receiver renders, by moving control points, without any change of the stored
medium (paper section 6.3).

Nothing is sent upstream to the source. The field at x is read at psi(x) = x + u(x) in the stored medium; u is
a cubic B-spline on a small lattice of control points, and constant outside the lattice along each axis. With
F = -grad f the force is

    F'(x) = (I + grad u)^T F(psi(x)) = -grad (f o psi),

which is curl-free if F is. A deformed conservative field therefore generates no energy; it would if the
magnitudes of the forces were kept. The map goes from the position of the hand to the undeformed medium, so
that a query does not have to invert it.

Control points move in two ways, whose displacements are added. **Tracks** are displacements of the lattice
for each frame, interpolated linearly in time. Control points **yield** under the finger like a spring of
`compliance_m_per_n` in series with the field, which follows with the time constant `relax_s`.
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

MAX_CONTROLS: Final = 32  # control points along each axis
MAX_CELLS: Final = 1 << 18
"""Cells of the lattice in all frames; checking them for folds takes 1 to 2 s.

For 8 x 8 x 8 control points the limit is 35 s at 60 Hz.
"""

STEP_M: Final = 2e-5  # quantisation step of displacements in a file
_MAX_BYTES: Final = MAX_CELLS * 4**3 * 3 * 2  # of 4 x 4 x 4 control points a cell
_FINE: Final = 3  # points along each side of a cell at which the determinant is evaluated
_ARRAYS: Final = {"corner_m": 3, "spacing_m": 3, "rate_hz": 1, "compliance_m_per_n": 1, "relax_s": 1}


@dataclass(frozen=True, eq=False)
class Deformation:
    """Displacements of control points, and their compliance.

    displacement_m : float [T, nx, ny, nz, 3]; u at the control points of each frame, metres, from the
        position of the hand to the position in the stored medium. 4 to 32 control points along each axis.
    corner_m, spacing_m : float [3]; lower corner of the cells of the lattice (the position of control point 1
        along each axis), and the sides of a cell, metres.
    compliance_m_per_n : float; displacement of the medium for each newton, m/N; 0 for a medium that does not
        yield.
    relax_s : float; time constant with which the medium yields and recovers, seconds.
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
        """Return a deformation of one frame without displacement, over a box.

        `low_m` and `high_m` float [3] are the corners of the box, metres; `controls` is the number of control
        points along each axis; `yields` are the parameters `compliance_m_per_n` and `relax_s`.
        """
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
        """Maximum yield of a control point along an axis, metres, without a fold.

        The map does not fold where |grad u| < 1. The slope of a B-spline is at most the difference of
        neighbouring control points divided by their distance; the slope of the tracks is subtracted first.
        """
        u, square = self.displacement_m, 0.0
        for axis in range(3):
            square += float(
                (np.linalg.norm(np.diff(u, axis=axis + 1), axis=-1).max() / self.spacing_m[axis]) ** 2
            )
        slope = sum(
            3 * (2.0 / h) ** 2 for h in self.spacing_m
        )  # for neighbouring control points that differ by 2 m
        return max(0.0, (0.95 - math.sqrt(square)) / math.sqrt(slope))

    @cached_property
    def max_stretch(self) -> float:
        """Gershgorin bound of the largest singular value of I + grad u.

        It is evaluated at the points at which `min_determinant` evaluates the determinant.
        """
        squares = (np.abs(np.swapaxes(j, -2, -1) @ j).sum(axis=-1).max() for j in self._jacobians())
        return math.sqrt(max(squares))

    def min_determinant(self) -> tuple[float, int]:
        """Return the minimum determinant of I + grad u, and its frame.

        It is evaluated at 3^3 points of every cell.
        """
        return min((float(np.linalg.det(j).min()), frame) for frame, j in enumerate(self._jacobians()))

    def _jacobians(self) -> Iterator[Float64s]:
        """Yield I + grad u of each frame, float64 [.., 3, 3]."""
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
        """Return the control points that determine u at each point, and their weights.

        Both are [n, 64]; the control points are flat indices, and u(x) is their weighted sum.
        """
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
        """Write the deformation as ``.npz``, with displacements in steps of 20 um.

        The file appears when it is complete. It stores second differences in time, int16 with wrap-around,
        zigzag-coded (the sign in the lowest bit), and all low bytes before all high bytes. This takes half
        the bytes of first differences.
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
    """Read a file that `Deformation.write` wrote.

    Raises `SourceError`, which names the file and the array, if it is invalid.
    """
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
    """Evaluate the cubic B-spline at positions 0 to 1 in a cell.

    Returns the weights of the four control points, float64 [n, 4], and their derivatives.
    """
    r = 1 - t
    values = [r**3, 3 * t**3 - 6 * t**2 + 4, 3 * r**3 - 6 * r**2 + 4, t**3]
    slopes = [-3 * r**2, 9 * t**2 - 12 * t, -9 * r**2 + 12 * r, 3 * t**2]
    return np.stack(values, axis=-1) / 6, np.stack(slopes, axis=-1) / 6


def _along(u: Float64s, rows: Float64s, axis: int) -> Float64s:
    """Interpolate control points along an axis at the points of each cell.

    `rows` [points, 4] are the weights of four control points at each point of a cell.
    """
    lanes = np.moveaxis(u, axis, -1)
    windows = np.lib.stride_tricks.sliding_window_view(lanes, 4, axis=-1)
    placed = np.einsum("...cw,pw->...cp", windows, rows)
    return np.moveaxis(placed.reshape(*lanes.shape[:-1], -1), -1, axis)


_SMOOTH: Final = (3e-3, 3e-2, 0.3)
"""Weights of the smoothing term relative to the mean weight of a vertex; the first without a fold is used."""


def fitted(
    rest_m: Float64s,
    frames_m: Iterable[Float64s],
    lattice: Deformation,
    rate_hz: float,
    report: Callable[[int], None] = lambda _: None,
) -> tuple[Deformation, float]:
    """Fit tracks to moving vertices; return them and the RMS residual, metres.

    rest_m : float64 [n, 3]; vertices in the stored medium, metres.
    frames_m : iterable of float64 [n, 3]; vertices of each frame, metres.
    lattice : Deformation; provides the lattice of control points.
    rate_hz : float; frames a second.
    report : callable; ``report(done)`` is called after each frame.
    Raises `InvalidArgument` if the number of vertices changes, or every fit of some frame folds.
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
    ):  # penalty on second differences along each axis, and a small one on first differences
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
