"""Control points fitted to a surface that moves: the same vertices at rest and in each frame (paper section 6.3).

At a vertex of a frame u is where it was less where it is. Least squares over the vertices, and second differences of
the control points along each axis, which carry the fit on to where there is no vertex: into the body, and around it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Final

import numpy as np

from touchfield.arrays import Float64s
from touchfield.errors import InvalidArgument
from touchfield.medium.deformation import Deformation

_SMOOTH: Final = (3e-3, 3e-2, 0.3)
"""Weights of the second differences, over the mean weight of a vertex; the first that does not fold is taken."""


def fitted(
    rest_m: Float64s,
    frames_m: Iterable[Float64s],
    lattice: Deformation,
    rate_hz: float,
    report: Callable[[int], None] = lambda _: None,
) -> tuple[Deformation, float]:
    """Tracks on the lattice of another deformation, and the rms distance that they leave, metres.

    rest_m : float64 [n, 3]; the vertices in the medium as it is stored, metres.
    frames_m : of float64 [n, 3]; the vertices of each frame.
    Raises `InvalidArgument` if the vertices are not the same in number, or no fit of a frame is without a fold.
    """
    tracks, square = [], 0.0
    for number, now in enumerate(frames_m):
        if now.shape != rest_m.shape:
            raise InvalidArgument(f"frame {number}", f"{len(now)} vertices", f"{len(rest_m)} as at rest")
        u, rms = _frame(rest_m - now, now, lattice, rate_hz, number)
        tracks.append(u)
        square += rms**2
        report(number + 1)
    made = Deformation(np.stack(tracks), lattice.corner_m, lattice.spacing_m, rate_hz)
    return made, float(np.sqrt(square / len(tracks)))


def _frame(
    wanted: Float64s, now: Float64s, lattice: Deformation, rate_hz: float, number: int
) -> tuple[Float64s, float]:
    from scipy import sparse
    from scipy.sparse.linalg import spsolve

    shape = lattice.displacement_m.shape[1:4]
    if not wanted.any():
        return np.zeros((*shape, 3)), 0.0
    flat, weights = lattice.design(now)
    rows = np.repeat(np.arange(len(now)), 64)
    design = sparse.csr_matrix((weights.ravel(), (rows, flat.ravel())), shape=(len(now), int(np.prod(shape))))
    normal, right = design.T @ design, design.T @ wanted
    bends = _bends(shape)
    for smooth in _SMOOTH:
        solved = spsolve((normal + smooth * len(now) / int(np.prod(shape)) * bends).tocsc(), right)
        u = np.asarray(solved).reshape(*shape, 3)
        try:
            Deformation(u[None], lattice.corner_m, lattice.spacing_m, rate_hz)
        except InvalidArgument:
            continue
        return u, float(np.sqrt(((design @ solved - wanted) ** 2).sum(axis=1).mean()))
    expected = "a motion in which no two places come together"
    mend = "Take fewer frames about the one at rest, and begin anew behind them."
    raise InvalidArgument(f"frame {number} of the tracks", "a fit that folds", expected, mend)


def _bends(shape: tuple[int, ...]):  # type: ignore[no-untyped-def]
    """Squares of second differences along each axis, and a little of the first, as a matrix."""
    from scipy import sparse

    eyes = [sparse.identity(n) for n in shape]
    total = 0
    for axis, n in enumerate(shape):
        second = sparse.diags([1.0, -2.0, 1.0], [0, 1, 2], shape=(n - 2, n))
        first = sparse.diags([1.0, -1.0], [0, 1], shape=(n - 1, n))
        parts = list(eyes)
        parts[axis] = second.T @ second + 1e-3 * (first.T @ first)
        total = total + sparse.kron(sparse.kron(parts[0], parts[1]), parts[2])
    return total + 1e-9 * sparse.identity(int(np.prod(shape)))
