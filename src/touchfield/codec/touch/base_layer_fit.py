"""Fit of base layers: a spline for smooth fields, columns for solids with steps.

The fit uses floating point. The coefficients of a spline are chosen so that as many samples as possible lie
within the mask. The first fit is linear: f should equal |F| where that is below the top, and its gradient
should equal -K n. Gauss-Newton steps on the force itself follow, with smaller weights outside the mask (an L1
norm there), so that an edge that no spline can follow does not distort its surroundings. About eight samples
of each cell of the lattice of nodes are used. The coarsest sufficient lattice is selected.

Columns are not fitted to fields without a main axis, nor to walls that end before the inner border of the
grid.
"""

from __future__ import annotations

from functools import partial
from typing import Any, Final

import numpy as np

from touchfield.arrays import Float32s, Float64s, Int64s, lengths_of
from touchfield.codec.kernels import LIST_CONTEXTS, LIST_SETS, finish, new_models, writer
from touchfield.codec.support import code_bricks, pad_payload
from touchfield.codec.touch import base_layer
from touchfield.codec.touch.error_bound import fraction_within_bound
from touchfield.codec.touch.kernels import guess as kernels
from touchfield.codec.touch.kernels.columns_fit import Fits, write_row
from touchfield.codec.touch.kernels.encode_pass import Limits
from touchfield.codec.touch.lattice import TOP, FixedField, Lattice
from touchfield.codec.touch.spec import TouchSpec
from touchfield.codec.varint import write_varint
from touchfield.medium import ForceField, Grid
from touchfield.medium.grid import BRICK

_MIN_AXIS_FRACTION: Final = 0.4  # fraction of the forces along one axis, else there is no main axis
_MIN_BORDER_FRACTION: Final = 0.2  # fraction of the tiles that reach the inner border
_AXIS_BRICKS: Final = 64  # bricks that determine the axis
_MAX_ROW_SAMPLES: Final = 1 << 24  # samples of a row of tiles in memory at once
# percentile of the growths used as the ramp; larger ones come from mixed surfaces
_RAMP_PERCENTILE: Final = 80
_XY_STEP, _Z_STEP, _A_STEP = 0.35, 1.4, 0.9  # steps in units of the mask


def fit_columns(frame: ForceField, lattice: Lattice, limits: Limits) -> tuple[bytes, FixedField] | None:
    """Fit columns to a frame: their bytes, and the decoded base layer.

    `limits` gives the mask. Returns None if the force has no main axis, or there is no solid behind a
    surface.
    """
    view = _find_view(frame)
    if view is None:
        return None
    mask = np.array([limits.k, max(limits.f0, 1.0)])
    heads = _find_heads(view, frame, lattice.unit_n, mask)
    if heads is None:
        return None
    columns = base_layer.new_columns(view, heads)
    # a surface has nine numbers, about 70 adaptive bits in all; one costs at most 14 bits, but few of them do
    bits = writer(len(columns.surfaces) * 200 + 64, new_models(kernels.COLUMN_CONTEXTS, kernels.COLUMN_SETS))
    ramp = np.array([heads[kernels.TOP], heads[kernels.RAMP] / 65536])
    workspace = (
        np.zeros(2, np.int64),
        np.zeros((3, 4)),
        np.zeros(view.depth),
        *np.zeros((2, 3)),
        np.zeros((view.depth, 3)),
    )
    rows, count = view.coded_shape
    for row in range(rows):
        if row % BRICK == 0:
            forces = _column_samples(view, frame, row // BRICK, 1 / lattice.unit_n)
        write_row(bits, columns, row, count, Fits(forces[row % BRICK], mask, ramp, *workspace))
    layer = base_layer.column_forces(view, columns)
    if len(layer.bricks) > 2 * len(frame.bricks) + 64:  # it extends far beyond the frame
        return None
    a, b, tiles_a, tiles_b = view.box
    head_numbers = (2 * view.axis + view.is_inverted, a, b, tiles_a - 1, tiles_b - 1, *heads.tolist())
    code = finish(bits).ljust(base_layer.min_size(view, len(layer.bricks)), b"\0")
    return b"".join(map(write_varint, head_numbers)) + code, layer


def _find_view(frame: ForceField) -> base_layer.View | None:
    """View along the main axis of the force.

    None if there is no main axis, few tiles reach the inner border, or the box is too large.
    """
    if not len(frame.bricks):
        return None
    sampled = frame.forces_n[:: -(-len(frame.bricks) // _AXIS_BRICKS)].reshape(-1, 3)
    total = sampled.sum(axis=0, dtype=np.float64)
    axis = int(np.abs(total).argmax())
    if abs(total[axis]) < _MIN_AXIS_FRACTION * np.sqrt(np.einsum("ij,ij->i", sampled, sampled)).sum(
        dtype=np.float64
    ):
        return None
    tiles = np.unique(np.delete(frame.bricks, axis, axis=1), axis=0)
    (a, b), (rows, row) = tiles.min(axis=0).tolist(), (np.ptp(tiles, axis=0) + 1).tolist()
    view = base_layer.View(frame.grid, axis, bool(total[axis] > 0), (a, b, rows, row))
    inner = 0 if view.is_inverted else frame.grid.brick_shape[axis] - 1
    if np.count_nonzero(frame.bricks[:, axis] == inner) < _MIN_BORDER_FRACTION * len(tiles):
        return None
    is_large = view.depth > base_layer.MAX_DEPTH or rows * row > base_layer.TILES_FREE + 4 * len(tiles)
    return None if is_large or row * BRICK**2 * view.depth > _MAX_ROW_SAMPLES else view


def _find_heads(view: base_layer.View, frame: ForceField, unit_n: float, mask: Float64s) -> Int64s | None:
    """Parameters common to all columns.

    None if no force grows behind a surface, or none exceeds the mask.
    """
    forces = frame.forces_n
    lengths = np.moveaxis(np.sqrt(np.einsum("...i,...i", forces, forces)), 1 + view.axis, -1) / unit_n
    outward = np.moveaxis(np.abs(forces[..., view.axis]), 1 + view.axis, -1) / unit_n
    top = float(lengths.max())
    inner, outer = (
        (slice(None, -1), slice(1, None)) if view.is_inverted else (slice(1, None), slice(None, -1))
    )
    low, growth = lengths[..., outer], lengths[..., inner] - lengths[..., outer]
    ramps = (low > 0.2 * top) & (low + growth < 0.9 * top) & (growth > 0.002 * top)
    ramps &= outward[..., outer] > 0.3 * low
    k, f0 = mask.tolist()
    if np.count_nonzero(ramps) < BRICK or top <= f0:
        return None
    ramp = (
        float(np.percentile(growth[ramps] * low[ramps] / outward[..., outer][ramps], _RAMP_PERCENTILE)) / top
    )
    tolerance = max(
        k, min(f0 / top, 0.5), 1e-3
    )  # relative to the force; the steps should not exceed it by much
    a, b, c = (view.grid.spacing_m[axis] for axis in view.order)
    z_step = 256 * max(f0 / top, 0.1 * k) / ramp * _Z_STEP
    steps = 16384 * tolerance * _XY_STEP, z_step, 65536 * tolerance * _A_STEP
    heads = np.array([top, 65536 * ramp, 256 * a / c, 256 * b / c, *steps])  # in the order of `kernels.HEADS`
    numbers: Int64s = np.rint(np.clip(heads, (1, 1, 0, 0, 16, 4, 16), np.array(kernels.HEADS) - 1)).astype(
        np.int64
    )
    return numbers


def _column_samples(view: base_layer.View, frame: ForceField, tiles: int, scale: float) -> Float32s:
    """Columns of a row of tiles, [8, columns, depth, 4], from outside to inside.

    The last axis has the two components across, the outward component, and the length, in units.
    """
    a, b, axis = view.order
    bricks = np.flatnonzero(frame.bricks[:, a] == view.box[0] + tiles)
    out = np.zeros((BRICK, view.box[3], BRICK, -(-view.depth // BRICK), BRICK, 4), np.float32)
    in_view = frame.forces_n[bricks].transpose(0, 1 + a, 1 + b, 1 + axis, 4)[..., view.order]
    out[:, frame.bricks[bricks, b] - view.box[1], :, frame.bricks[bricks, axis], :, :3] = (
        in_view * np.float32(scale)
    )
    out = out.reshape(BRICK, view.box[3] * BRICK, -1, 4)[:, :, : view.depth]
    if view.is_inverted:
        out = out[:, :, ::-1]
    else:
        out[..., 2] *= -1
    out[..., 3] = np.sqrt(np.einsum("...i,...i", out[..., :3], out[..., :3]))
    return np.ascontiguousarray(out)


_STIFFNESS_BRICKS: Final = 64  # bricks that determine whether a field is smooth, and its stiffness
_MIN_SMOOTH: Final = 0.78  # minimum fraction of samples of a smooth field within `_MAX_DEVIATION`
_MAX_DEVIATION: Final = 0.25  # deviation of the growth from the stiffness along the normal, relative
_RAMP: Final = (0.15 * TOP, 0.8 * TOP)
_STEP: Final = 2.0  # step of a coefficient, in units of the tolerance of a small force
_SATURATED: Final = 0.97
_EMPTY_WEIGHT: Final = 0.3  # weight of samples without a force
_ROUGHNESS: Final = 1e-3
_CG_ITERATIONS, _NEWTON_STEPS = 60, 4
_CG_TOLERANCE: Final = 0.03  # relative tolerance of the solver
_MAX_COEFFICIENT: Final = 1e15  # units: squares of float32 end at 1e38, and no force has more than 2^17
_IDENTITY: Final = np.eye(3, dtype=np.float32)


def fit_spline(
    frame: ForceField, lattice: Lattice, limits: Limits, level: int = 3
) -> tuple[bytes, FixedField] | None:
    """Fit a spline to a frame: its bytes, and the decoded base layer.

    `limits` gives the mask. Nodes lie 2^level samples apart along the axis of the smallest spacing. Returns
    None if the field is not smooth; otherwise the fit may still be bad.
    """
    grid, bricks, f0 = frame.grid, frame.bricks, max(limits.f0, 1.0)
    if not len(bricks) or f0 >= TOP:
        return None
    forces, spacing = frame.forces_n / np.float32(lattice.unit_n), np.array(grid.spacing_m)
    stiffness = _find_stiffness(forces[:: -(-len(bricks) // _STIFFNESS_BRICKS)], grid)
    if not stiffness:
        return None
    x, y, z = np.clip(np.rint(level - np.log2(spacing / spacing.min())), 2, 5).astype(int).tolist()
    a, b, c = np.clip(2**35 / 864 / stiffness / spacing, 1, (1 << 20) - 1).astype(int).tolist()
    step = int(np.clip(_STEP * max(f0, _RAMP[0] * limits.k), 1, (1 << 20) - 1))
    head = base_layer.Head((x, y, z), step, (a, b, c))
    nodes = base_layer.Nodes(bricks, head.shifts)
    fitted = _fit_coefficients(_Samples(frame, forces, head.shifts, nodes), limits.k, f0, stiffness)
    values = np.rint(np.clip(fitted, -kernels.REACH, kernels.REACH)).astype(np.int64)
    bits = writer(
        320 * len(bricks) + 64 * len(values) + 64, new_models(base_layer.SPLINE_CONTEXTS, LIST_SETS)
    )
    code_bricks(bits, 0, 0, grid.brick_shape, bricks, None)
    kernels.code_nodes(bits, LIST_CONTEXTS, nodes.predecessors, step, values, np.zeros_like(values))
    layer = base_layer.spline_forces(head, grid, bricks, values[nodes.per_brick])
    return head.to_bytes() + pad_payload(finish(bits), len(bricks)), layer


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
        self, frame: ForceField, forces: Float32s, shifts: tuple[int, int, int], nodes: base_layer.Nodes
    ) -> None:
        from scipy.sparse import csr_array, eye_array

        x, y, z = (np.arange((1 << shift) // 4, BRICK, (1 << shift) // 2) for shift in shifts)
        basis = []
        for shift, pick, index, spacing in zip(
            shifts, (x, y, z), frame.bricks.T, frame.grid.spacing_m, strict=True
        ):
            table = base_layer.corner_weights(shift)
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
            nodes.predecessors[:, :3],
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
    rows[..., 0, 0] = ((length > 0) & (length < _SATURATED * TOP)) / tolerance
    rows[..., 1:, 1:] = (length / (stiffness * tolerance))[..., None, None] * _IDENTITY
    goal = np.concatenate([length[..., None], -stiffness * normal], axis=-1)
    c = samples.solve(rows, np.einsum("...ij,...j->...i", rows, goal), np.zeros(samples.bending.shape[0]))
    weight = np.where(length > 0, 1 / tolerance, np.float32(_EMPTY_WEIGHT**0.5 / f0))
    for _ in range(_NEWTON_STEPS):
        if not (np.abs(c) < _MAX_COEFFICIENT).all():
            return np.zeros_like(c)  # a useless spline, which is never selected
        f = samples.evaluate(c)
        steepness = lengths_of(f[..., 1:])
        slope, size = np.maximum(steepness, stiffness / 2), np.clip(f[..., 0], 0, np.float32(TOP))
        direction = -f[..., 1:] / slope[..., None]
        residual = forces - size[..., None] * direction
        error = lengths_of(residual) / tolerance
        w = (weight / np.sqrt(np.maximum(1, error)))[..., None]
        along = (
            (steepness > stiffness / 2)[..., None, None] * direction[..., :, None] * direction[..., None, :]
        )
        grows = ((f[..., 0] > 0) & (f[..., 0] < TOP))[..., None]
        jacobian = [(grows * direction)[..., None], (size / slope)[..., None, None] * (along - _IDENTITY)]
        c = samples.solve(w[..., None] * np.concatenate(jacobian, axis=-1), w * residual, c)
    return np.nan_to_num(c)


# a base layer is tried if at least this fraction of its voxels is within the bound; in mode "nmse" any is
# tried
_MIN_FRACTION: Final = 0.5
# kinds in order, coarse splines first; a kind is not fitted if the best fraction so far reaches its last
# number
_FITS: Final = (
    (base_layer.SPLINE, partial(fit_spline, level=4), 1.0), (base_layer.SPLINE, fit_spline, 0.97),
    (base_layer.COLUMNS, fit_columns, 0.75),
)  # fmt: skip
_FINENESS: Final = 0.35
"""Error limit of a base layer in mode "nmse", in steps: its errors are correlated, and small ones are
cheap."""


def fit_base_layer(
    frame: ForceField, lattice: Lattice, limits: Limits, spec: TouchSpec
) -> tuple[tuple[bytes, FixedField] | None, float]:
    """Best base layer of a frame: its bytes and field, or None.

    `limits` gives the mask. Also returns the fraction of voxels at which the base layer is within the error
    bound.
    """
    best, best_fraction = None, _MIN_FRACTION
    if spec.mode == "nmse":
        limits, best_fraction = limits._replace(f0=_FINENESS * lattice.floor), 0.0
    for kind, fit_kind, enough in _FITS:
        fitted = fit_kind(frame, lattice, limits) if best_fraction < enough else None
        if fitted is not None:
            fraction = fraction_within_bound(frame, fitted[1], lattice.unit_n, spec)
            if fraction >= best_fraction:
                best, best_fraction = (bytes([kind]) + fitted[0], fitted[1]), fraction
    return best, best_fraction if best else 0.0
