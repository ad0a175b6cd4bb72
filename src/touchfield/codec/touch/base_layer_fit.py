"""Fits a smooth spline to a force field. Coder `touch` can send the spline's few coefficients as a first
approximation, the *base layer*, and then only the differences to it (docs/format/touch-base-layer.md).

In a penalty field F = min(K d, F_max) n the depth d grows against the normal n. All of it follows from the
potential f = K d, which is smooth through the surface and negative outside. Therefore f is coded as the
coefficients of a cubic B-spline on a coarse lattice of nodes, and

    F = -min(f, 65536) grad f / max(|grad f|, K / 2),   where f > 0.

The fit uses floating point. The coefficients are chosen so that as many samples as possible lie within the
mask. The first fit is linear: f should equal |F| where that is below the top, and its gradient should equal
-K n. Gauss-Newton steps on the force itself follow, with smaller weights outside the mask (an L1 norm there),
so that an edge that no spline can follow does not distort its surroundings. About eight samples of each cell
of the lattice of nodes are used. ``c/touch_encode.h`` codes the spline, and decides whether it is used; it
fits the other base layers, columns, itself.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.arrays import Float32s, Int32s, Int64s, lengths_of
from touchfield.medium import ForceField, Grid
from touchfield.medium.grid import BRICK

if TYPE_CHECKING:
    from touchfield._native import Spline

_TOP: Final = 1 << 16  # units: length of the longest force of a segment

_STIFFNESS_BRICKS: Final = 64  # bricks that determine whether a field is smooth, and its stiffness
_MIN_SMOOTH: Final = 0.78  # minimum fraction of samples of a smooth field within `_MAX_DEVIATION`
_MAX_DEVIATION: Final = 0.25  # deviation of the growth from the stiffness along the normal, relative
_RAMP: Final = (0.15 * _TOP, 0.8 * _TOP)
_STEP: Final = 2.0  # step of a coefficient, in units of the tolerance of a small force
_SATURATED: Final = 0.97
_EMPTY_WEIGHT: Final = 0.3  # weight of samples without a force
_ROUGHNESS: Final = 1e-3
_CG_ITERATIONS, _NEWTON_STEPS = 60, 4
_CG_TOLERANCE: Final = 0.03  # relative tolerance of the solver
_MAX_COEFFICIENT: Final = 1e15  # units: squares of float32 end at 1e38, and no force has more than 2^17
_IDENTITY: Final = np.eye(3, dtype=np.float32)


class Nodes:
    """Nodes of the spline over bricks, int32 [n, 3], in raster order (x slowest).

    `per_brick`, int64 [n, x, y, z]: indices of the nodes of each brick. `predecessors`, int64 [nodes, 3]:
    indices of the nodes before each along the axes, -1 where there is none.
    """

    def __init__(self, bricks: Int32s, shifts: tuple[int, int, int]) -> None:
        first = bricks.astype(np.int64) * BRICK >> np.array(shifts)
        # an empty first layer, so that keys of missing predecessors match no node
        first -= first.min(axis=0) - 1
        counts = [max(BRICK >> shift, 1) + 3 for shift in shifts]
        _, ny, nz = (first.max(axis=0) + counts).tolist()
        x, y, z = ny * nz, nz, 1
        offsets = np.indices(counts).reshape(3, -1).T @ (x, y, z)
        keys, per_brick = np.unique((first @ (x, y, z))[:, None] + offsets, return_inverse=True)
        self.per_brick: Int64s = per_brick.reshape(-1, *counts)
        earlier = keys[:, None] - (x, y, z)
        self.predecessors: Int64s = np.searchsorted(keys, earlier)
        self.predecessors[keys[self.predecessors] != earlier] = -1


def corner_weights(shift: int) -> Int64s:
    """Weights of the nodes at the corners of a brick, int64 [h / 8, nodes, 9].

    The first axis is the position of the brick in its cell. With h = 2^shift, the weights at a corner sum to
    6 h^3 over the nodes.
    """
    h, cells = 1 << shift, max(BRICK >> shift, 1)
    out = np.zeros((max(h // BRICK, 1), cells + 3, BRICK + 1), np.int64)
    for brick, corner in np.ndindex(len(out), BRICK + 1):
        cell = min(corner >> shift, cells - 1)
        p = BRICK * brick + corner - cell * h
        q = h - p
        row = (q**3, 4 * h**3 - 6 * h * p**2 + 3 * p**3, 4 * h**3 - 6 * h * q**2 + 3 * q**3, p**3)
        out[brick, cell : cell + 4, corner] = row
    return out


def fit_spline(frame: ForceField, level: int, unit_n: float, k: float, f0: float) -> Spline | None:
    """Fit a spline to a frame: its parameters and coefficients, as `encode_segment` of the module takes them.

    `unit_n` is a unit in newtons; the mask is max(`f0`, `k` |F|), units. Nodes lie 2^level samples apart
    along the axis of the smallest spacing. Returns None if the field is not smooth; otherwise the fit may
    still be bad.
    """
    grid, bricks, f0 = frame.grid, frame.bricks, max(f0, 1.0)
    if not len(bricks) or f0 >= _TOP:
        return None
    forces, spacing = frame.forces_n / np.float32(unit_n), np.array(grid.spacing_m)
    stiffness = _find_stiffness(forces[:: -(-len(bricks) // _STIFFNESS_BRICKS)], grid)
    if not stiffness:
        return None
    x, y, z = np.clip(np.rint(level - np.log2(spacing / spacing.min())), 2, 5).astype(int).tolist()
    # factors of the derivatives that scale the stiffness to 32768
    a, b, c = np.clip(2**35 / 864 / stiffness / spacing, 1, (1 << 20) - 1).astype(int).tolist()
    step = int(np.clip(_STEP * max(f0, _RAMP[0] * k), 1, (1 << 20) - 1))
    samples = _Samples(frame, forces, (x, y, z), Nodes(bricks, (x, y, z)))
    coefficients = np.ascontiguousarray(_fit_coefficients(samples, k, f0, stiffness), np.float64)
    return (x, y, z), step, (a, b, c), coefficients


def _find_stiffness(forces: Float32s, grid: Grid) -> float:
    """Growth of the force in bricks [n, 8, 8, 8, 3], units per metre.

    0 if the bricks are not smooth.
    """
    lengths = lengths_of(forces)
    growth = np.stack(np.gradient(lengths, *grid.spacing_m, axis=(1, 2, 3)), axis=-1)
    ramp = (lengths > _RAMP[0]) & (lengths < _RAMP[1])
    stiffness = float(np.median(lengths_of(growth[ramp]))) if ramp.any() else 0.0
    if stiffness * min(grid.spacing_m) < 1:
        return 0.0
    deviation = growth[ramp] / stiffness + forces[ramp] / lengths[ramp][:, None]
    return stiffness if np.mean(lengths_of(deviation) < _MAX_DEVIATION) >= _MIN_SMOOTH else 0.0


class _Samples:
    """Samples of each brick used by the fit, and the linear map from the nodes.

    The map gives f and its gradient. `per_brick`, int64 [bricks, nodes], are the nodes of each brick;
    `basis`, float32 [bricks, samples, 4, nodes]; `forces`, float32 [bricks, samples, 3].
    """

    def __init__(
        self, frame: ForceField, forces: Float32s, shifts: tuple[int, int, int], nodes: Nodes
    ) -> None:
        from scipy.sparse import csr_array, eye_array

        x, y, z = (np.arange((1 << shift) // 4, BRICK, (1 << shift) // 2) for shift in shifts)
        basis = []
        for shift, pick, index, spacing in zip(
            shifts, (x, y, z), frame.bricks.T, frame.grid.spacing_m, strict=True
        ):
            table = corner_weights(shift)
            corners = table[index % len(table)] / (6 << 3 * shift)
            low, high = corners[:, :, pick], corners[:, :, pick + 1]
            basis.append(np.stack([low + high, 2 * (high - low) / spacing]).astype(np.float32) / 2)
        kinds = [
            np.einsum("nia,njb,nkc->nabcijk", *(b[int(a == n)] for a, b in enumerate(basis)))
            for n in range(-1, 3)
        ]
        self.per_brick = nodes.per_brick.reshape(len(frame.bricks), -1)
        bricks, count = self.per_brick.shape
        self.basis = np.stack(kinds, axis=4).reshape(bricks, -1, 4, count)
        self.forces = forces[:, x[:, None, None], y[:, None], z].reshape(bricks, -1, 3)
        parent, node = (
            nodes.predecessors,
            np.arange(len(nodes.predecessors))[:, None] + np.zeros(3, int),
        )
        grandparent = np.take_along_axis(parent, parent, axis=0)
        triples = np.stack([node, parent, grandparent], axis=-1)[(parent >= 0) & (grandparent >= 0)]
        entries = np.tile([1.0, -2.0, 1.0], len(triples)), triples.ravel(), 3 * np.arange(len(triples) + 1)
        second = csr_array(entries, shape=(len(triples), len(node)))
        self.bending = second.T @ second + 1e-6 * eye_array(len(node))

    def evaluate(self, c: Any) -> Any:
        """The potential and its gradient at the samples, float32 [bricks, samples, 4]."""
        bricks, count, _, nodes = self.basis.shape
        at = c.astype(np.float32)[self.per_brick]
        return (self.basis.reshape(bricks, -1, nodes) @ at[..., None]).reshape(bricks, count, 4)

    def solve(self, rows: Any, target: Any, c: Any) -> Any:
        """Coefficients c + x, with x a least-squares solution of the linearised equations.

        The equations are rows @ potential(x) = target. `rows` are [bricks, samples, r, 4], `target` [bricks,
        samples, r]. The diagonal is the preconditioner: nodes at the rim of the field have small weights and
        would not converge without it.
        """
        from scipy.sparse.linalg import LinearOperator, cg

        a = (rows @ self.basis).reshape(len(rows), -1, self.per_brick.shape[1])
        rough = _ROUGHNESS * float((rows[..., 0] ** 2).sum(axis=-1).mean())

        def summed(contributions: Any) -> Any:
            return np.bincount(self.per_brick.ravel(), weights=contributions.ravel(), minlength=len(c))

        def normal(x: Any) -> Any:
            at = x.astype(np.float32)[self.per_brick]
            return summed((a @ at[..., None]).swapaxes(1, 2) @ a) + rough * (self.bending @ x)

        count = (len(c), len(c))
        diagonal = summed(np.einsum("brn,brn->bn", a, a)) + rough * self.bending.diagonal()
        diagonal[diagonal <= 0] = 1  # nodes without samples
        goal = summed(target.reshape(len(rows), 1, -1) @ a) - rough * (self.bending @ c)
        matrix = LinearOperator(count, matvec=normal, dtype=np.float64)
        scaled = LinearOperator(count, matvec=lambda x: x / diagonal, dtype=np.float64)
        return c + cg(matrix, goal, rtol=_CG_TOLERANCE, maxiter=_CG_ITERATIONS, M=scaled)[0]


def _fit_coefficients(samples: _Samples, k: float, f0: float, growth: float) -> Any:
    """Fitted coefficients in units, float64 [nodes].

    The mask is (`k`, `f0`), the stiffness `growth`.
    """
    forces, stiffness = samples.forces, np.float32(growth)
    length = lengths_of(forces)
    tolerance = np.maximum(np.float32(f0), np.float32(k) * length)
    normal = forces / np.maximum(length, 1)[..., None]
    rows = np.zeros((*length.shape, 4, 4), np.float32)
    rows[..., 0, 0] = ((length > 0) & (length < _SATURATED * _TOP)) / tolerance
    rows[..., 1:, 1:] = (length / (stiffness * tolerance))[..., None, None] * _IDENTITY
    goal = np.concatenate([length[..., None], -stiffness * normal], axis=-1)
    c = samples.solve(rows, np.einsum("...ij,...j->...i", rows, goal), np.zeros(samples.bending.shape[0]))
    weight = np.where(length > 0, 1 / tolerance, np.float32(_EMPTY_WEIGHT**0.5 / f0))
    for _ in range(_NEWTON_STEPS):
        if not (np.abs(c) < _MAX_COEFFICIENT).all():
            return np.zeros_like(c)  # a useless spline, which is never selected
        f = samples.evaluate(c)
        steepness = lengths_of(f[..., 1:])
        slope, size = np.maximum(steepness, stiffness / 2), np.clip(f[..., 0], 0, np.float32(_TOP))
        direction = -f[..., 1:] / slope[..., None]
        residual = forces - size[..., None] * direction
        error = lengths_of(residual) / tolerance
        w = (weight / np.sqrt(np.maximum(1, error)))[..., None]
        along = (
            (steepness > stiffness / 2)[..., None, None] * direction[..., :, None] * direction[..., None, :]
        )
        grows = ((f[..., 0] > 0) & (f[..., 0] < _TOP))[..., None]
        jacobian = [(grows * direction)[..., None], (size / slope)[..., None, None] * (along - _IDENTITY)]
        c = samples.solve(w[..., None] * np.concatenate(jacobian, axis=-1), w * residual, c)
    return np.nan_to_num(c)
