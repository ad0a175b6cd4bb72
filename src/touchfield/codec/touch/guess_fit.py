"""The guess that is sent before a frame: a spline where it is smooth, columns for a solid with steps
(floats).

The spline's coefficients are those whose field is within the mask at most samples. A first fit is linear: f
should be
|F| where that is below the top, and its gradient -K n. Then some steps of Gauss and Newton on the force itself, whose
weights fall where the mask is left (an L1 norm beyond it), so that an edge that no spline can follow does not
bend what lies around it. About eight samples of each cell of the lattice of nodes are looked at. The coarsest
lattice that will do is taken. Fields without a main axis, and walls that end before the inner border of the
grid, have no columns.
"""

from __future__ import annotations

from functools import partial
from typing import Any, Final

import numpy as np

from touchfield.arrays import Float32s, Float64s, Int64s, lengths_of
from touchfield.codec.kernels import LIST_CONTEXTS, LIST_SETS, end_of, fresh, writer
from touchfield.codec.support import code_bricks, padded
from touchfield.codec.touch import guess as synthesis
from touchfield.codec.touch.kernels import guess as kernels
from touchfield.codec.touch.kernels.columns_fit import Fits, write_row
from touchfield.codec.touch.kernels.encode_pass import Limits
from touchfield.codec.touch.lattice import TOP, FixedField, Lattice
from touchfield.codec.touch.promise import agreement
from touchfield.codec.touch.spec import TouchSpec
from touchfield.codec.varint import write_varint
from touchfield.medium import ForceField, Grid
from touchfield.medium.grid import BRICK

_LEAST_SHARE: Final = 0.4  # of the forces along one axis, else there is none to look along
_LEAST_REACHING: Final = 0.2  # of the tiles that reach the inner border
_SAMPLED: Final = 64  # bricks that the axis is taken from
_ROOM: Final = 1 << 24  # samples of a row of tiles, laid out at once
_STEEP: Final = 80  # per cent of the growths that are below the ramp's; others are of mixed surfaces
_XY_SHARE, _Z_SHARE, _A_SHARE = 0.35, 1.4, 0.9  # steps, of the mask


def fit_columns(frame: ForceField, lattice: Lattice, limits: Limits) -> tuple[bytes, FixedField] | None:
    """The bytes of columns for a frame, and the guess that `synthesise` makes of them, in the mask of
    `limits`.

    None where there are no columns to be told: no main axis of the force, or no solid behind a surface.
    """
    view = _view_of(frame)
    if view is None:
        return None
    mask = np.array([limits.k, max(limits.f0, 1.0)])
    heads = _heads(view, frame, lattice.unit_n, mask)
    if heads is None:
        return None
    columns = synthesis.columns_of(view, heads)
    # of nine numbers of some 70 bits each: an adaptive bit costs 14 bits at most, but few of them do
    bits = writer(len(columns.surfaces) * 200 + 64, fresh(kernels.COLUMN_CONTEXTS, kernels.COLUMN_SETS))
    ramp = np.array([heads[kernels.TOP], heads[kernels.RAMP] / 65536])
    room = (
        np.zeros(2, np.int64),
        np.zeros((3, 4)),
        np.zeros(view.depth),
        *np.zeros((2, 3)),
        np.zeros((view.depth, 3)),
    )
    rows, count = view.told
    for row in range(rows):
        if row % BRICK == 0:
            forces = _laid_out(view, frame, row // BRICK, 1 / lattice.unit_n)
        write_row(bits, columns, row, count, Fits(forces[row % BRICK], mask, ramp, *room))
    made = synthesis.column_forces(view, columns)
    a, b, tiles_a, tiles_b = view.box
    told = (2 * view.axis + view.inverted, a, b, tiles_a - 1, tiles_b - 1, *heads.tolist())
    code = end_of(bits).ljust(synthesis.least_size(view, len(made.bricks)), b"\0")
    return b"".join(map(write_varint, told)) + code, made


def _view_of(frame: ForceField) -> synthesis.View | None:
    """Along the main axis of the force; None if there is none, few tiles reach the border, or it is too
    large.
    """
    if not len(frame.bricks):
        return None
    some = frame.forces_n[:: -(-len(frame.bricks) // _SAMPLED)].reshape(-1, 3)
    total = some.sum(axis=0, dtype=np.float64)
    axis = int(np.abs(total).argmax())
    if abs(total[axis]) < _LEAST_SHARE * np.sqrt(np.einsum("ij,ij->i", some, some)).sum(dtype=np.float64):
        return None
    tiles = np.unique(np.delete(frame.bricks, axis, axis=1), axis=0)
    (a, b), (rows, row) = tiles.min(axis=0).tolist(), (np.ptp(tiles, axis=0) + 1).tolist()
    view = synthesis.View(frame.grid, axis, bool(total[axis] > 0), (a, b, rows, row))
    inner = 0 if view.inverted else frame.grid.brick_shape[axis] - 1
    if np.count_nonzero(frame.bricks[:, axis] == inner) < _LEAST_REACHING * len(tiles):
        return None
    large = view.depth > synthesis.DEEPEST or rows * row > synthesis.TILES_FREE + 4 * len(tiles)
    return None if large or row * BRICK**2 * view.depth > _ROOM else view


def _heads(view: synthesis.View, frame: ForceField, unit_n: float, mask: Float64s) -> Int64s | None:
    """Numbers that all columns share; None where no force grows behind a surface, or none is above the mask."""
    forces = frame.forces_n
    lengths = np.moveaxis(np.sqrt(np.einsum("...i,...i", forces, forces)), 1 + view.axis, -1) / unit_n
    outward = np.moveaxis(np.abs(forces[..., view.axis]), 1 + view.axis, -1) / unit_n
    top = float(lengths.max())
    inner, outer = (slice(None, -1), slice(1, None)) if view.inverted else (slice(1, None), slice(None, -1))
    low, growth = lengths[..., outer], lengths[..., inner] - lengths[..., outer]
    ramps = (low > 0.2 * top) & (low + growth < 0.9 * top) & (growth > 0.002 * top)
    ramps &= outward[..., outer] > 0.3 * low
    k, f0 = mask.tolist()
    if np.count_nonzero(ramps) < BRICK or top <= f0:
        return None
    ramp = float(np.percentile(growth[ramps] * low[ramps] / outward[..., outer][ramps], _STEEP)) / top
    share = max(k, min(f0 / top, 0.5), 1e-3)  # of the force, what the steps should not exceed by much
    a, b, c = (view.grid.spacing_m[axis] for axis in view.order)
    z_step = 256 * max(f0 / top, 0.1 * k) / ramp * _Z_SHARE
    steps = 16384 * share * _XY_SHARE, z_step, 65536 * share * _A_SHARE
    heads = np.array([top, 65536 * ramp, 256 * a / c, 256 * b / c, *steps])  # in the order of `kernels.HEADS`
    whole: Int64s = np.rint(np.clip(heads, (1, 1, 0, 0, 16, 4, 16), np.array(kernels.HEADS) - 1)).astype(
        np.int64
    )
    return whole


def _laid_out(view: synthesis.View, frame: ForceField, tiles: int, scale: float) -> Float32s:
    """Columns of a row of tiles, [8, columns, depth, 4]: across, across, outward and length, units, from
    outside.
    """
    a, b, axis = view.order
    bricks = np.flatnonzero(frame.bricks[:, a] == view.box[0] + tiles)
    out = np.zeros((BRICK, view.box[3], BRICK, -(-view.depth // BRICK), BRICK, 4), np.float32)
    seen = frame.forces_n[bricks].transpose(0, 1 + a, 1 + b, 1 + axis, 4)[..., view.order]
    out[:, frame.bricks[bricks, b] - view.box[1], :, frame.bricks[bricks, axis], :, :3] = seen * np.float32(
        scale
    )
    out = out.reshape(BRICK, view.box[3] * BRICK, -1, 4)[:, :, : view.depth]
    if view.inverted:
        out = out[:, :, ::-1]
    else:
        out[..., 2] *= -1
    out[..., 3] = np.sqrt(np.einsum("...i,...i", out[..., :3], out[..., :3]))
    return np.ascontiguousarray(out)


_LOOKED_AT: Final = 64  # bricks that tell whether a field is smooth, and its stiffness
_LEAST_SMOOTH: Final = 0.78  # of the samples there where the force grows
_MOST_OFF: Final = 0.25  # of the growth from the stiffness along the normal, where it is smooth
_RAMP: Final = (0.15 * TOP, 0.8 * TOP)
_STEP: Final = 2.0  # of a coefficient, in tolerances of a small force
_SATURATED: Final = 0.97
_EMPTY: Final = 0.3  # weight of samples without a force
_ROUGHNESS: Final = 1e-3
_TURNS, _ROUNDS = 60, 4
_SETTLED: Final = 0.03  # of what is asked
_DIVERGED: Final = 1e15  # units: squares of float32 end at 1e38, and no force has more than 2^17
_EYE: Final = np.eye(3, dtype=np.float32)


def fit_spline(
    frame: ForceField, lattice: Lattice, limits: Limits, level: int = 3
) -> tuple[bytes, FixedField] | None:
    """The bytes of a spline for a frame, and its field, good or bad; None if it is not smooth. `limits`: its
    mask.

    Nodes lie 2^level samples apart along the axis of the smallest spacing.
    """
    grid, bricks, f0 = frame.grid, frame.bricks, max(limits.f0, 1.0)
    if not len(bricks) or f0 >= TOP:
        return None
    forces, spacing = frame.forces_n / np.float32(lattice.unit_n), np.array(grid.spacing_m)
    stiffness = _stiffness(forces[:: -(-len(bricks) // _LOOKED_AT)], grid)
    if not stiffness:
        return None
    x, y, z = np.clip(np.rint(level - np.log2(spacing / spacing.min())), 2, 5).astype(int).tolist()
    a, b, c = np.clip(2**35 / 864 / stiffness / spacing, 1, (1 << 20) - 1).astype(int).tolist()
    step = int(np.clip(_STEP * max(f0, _RAMP[0] * limits.k), 1, (1 << 20) - 1))
    head = synthesis.Head((x, y, z), step, (a, b, c))
    nodes = synthesis.Nodes(bricks, head.shifts)
    fitted = _coefficients(_Samples(frame, forces, head.shifts, nodes), limits.k, f0, stiffness)
    values = np.rint(np.clip(fitted, -kernels.REACH, kernels.REACH)).astype(np.int64)
    bits = writer(320 * len(bricks) + 64 * len(values) + 64, fresh(synthesis.SPLINE_CONTEXTS, LIST_SETS))
    code_bricks(bits, 0, 0, grid.brick_shape, bricks, None)
    kernels.code_nodes(bits, LIST_CONTEXTS, nodes.before, step, values, np.zeros_like(values))
    guess = synthesis.forces_of(head, grid, bricks, values[nodes.around])
    return head.to_bytes() + padded(end_of(bits), len(bricks)), guess


def _stiffness(some: Float32s, grid: Grid) -> float:
    """Growth of the force, units a metre, of bricks [n, 8, 8, 8, 3] that are smooth; 0 of others."""
    lengths = lengths_of(some)
    growth = np.stack(np.gradient(lengths, *grid.spacing_m, axis=(1, 2, 3)), axis=-1)
    ramp = (lengths > _RAMP[0]) & (lengths < _RAMP[1])
    stiffness = float(np.median(lengths_of(growth[ramp]))) if ramp.any() else 0.0
    if stiffness * min(grid.spacing_m) < 1:
        return 0.0
    off = growth[ramp] / stiffness + some[ramp] / lengths[ramp][:, None]
    return stiffness if np.mean(lengths_of(off) < _MOST_OFF) >= _LEAST_SMOOTH else 0.0


class _Samples:
    """The samples of each brick that are looked at: their forces, the brick's nodes, and f and its gradient
    by those.

    `around`, int64 [bricks, nodes]; `basis`, float32 [bricks, samples, 4, nodes]; `forces`, float32 [.., ..,
    3].
    """

    def __init__(
        self, frame: ForceField, forces: Float32s, shifts: tuple[int, int, int], nodes: synthesis.Nodes
    ) -> None:
        from scipy.sparse import csr_array, eye_array

        x, y, z = (np.arange((1 << shift) // 4, BRICK, (1 << shift) // 2) for shift in shifts)
        basis = []
        for shift, pick, place, spacing in zip(
            shifts, (x, y, z), frame.bricks.T, frame.grid.spacing_m, strict=True
        ):
            table = synthesis.weights(shift)
            corners = table[place % len(table)] / (6 << 3 * shift)
            low, high = corners[:, :, pick], corners[:, :, pick + 1]
            basis.append(np.stack([low + high, 2 * (high - low) / spacing]).astype(np.float32) / 2)
        kinds = [
            np.einsum("nia,njb,nkc->nabcijk", *(b[int(a == n)] for a, b in enumerate(basis)))
            for n in range(-1, 3)
        ]
        self.around = nodes.around.reshape(len(frame.bricks), -1)
        bricks, count = self.around.shape
        self.basis = np.stack(kinds, axis=4).reshape(bricks, -1, 4, count)
        self.forces = forces[:, x[:, None, None], y[:, None], z].reshape(bricks, -1, 3)
        one, here = nodes.before[:, :3], np.arange(len(nodes.before))[:, None] + np.zeros(3, int)
        two = np.take_along_axis(one, one, axis=0)
        three = np.stack([here, one, two], axis=-1)[(one >= 0) & (two >= 0)]
        entries = np.tile([1.0, -2.0, 1.0], len(three)), three.ravel(), 3 * np.arange(len(three) + 1)
        second = csr_array(entries, shape=(len(three), len(here)))
        self.bending = second.T @ second + 1e-6 * eye_array(len(here))

    def seen_of(self, c: Any) -> Any:
        """The potential and its gradient at the samples, float32 [bricks, samples, 4]."""
        bricks, count, _, nodes = self.basis.shape
        at = c.astype(np.float32)[self.around]
        return (self.basis.reshape(bricks, -1, nodes) @ at[..., None]).reshape(bricks, count, 4)

    def solved(self, rows: Any, wanted: Any, c: Any) -> Any:
        """Coefficients c + x with ``rows``, [bricks, samples, r, 4], of the potential of x about `wanted`,
        [.., r].

        Nodes at the rim of the field weigh little: without the diagonal as preconditioner they would never
        settle.
        """
        from scipy.sparse.linalg import LinearOperator, cg

        a = (rows @ self.basis).reshape(len(rows), -1, self.around.shape[1])
        rough = _ROUGHNESS * float((rows[..., 0] ** 2).sum(axis=-1).mean())

        def summed(shares: Any) -> Any:
            return np.bincount(self.around.ravel(), weights=shares.ravel(), minlength=len(c))

        def normal(x: Any) -> Any:
            at = x.astype(np.float32)[self.around]
            return summed((a @ at[..., None]).swapaxes(1, 2) @ a) + rough * (self.bending @ x)

        count = (len(c), len(c))
        diagonal = summed(np.einsum("brn,brn->bn", a, a)) + rough * self.bending.diagonal()
        diagonal[diagonal <= 0] = 1  # of a node that nothing asks for
        goal = summed(wanted.reshape(len(rows), 1, -1) @ a) - rough * (self.bending @ c)
        matrix = LinearOperator(count, matvec=normal, dtype=np.float64)
        scaled = LinearOperator(count, matvec=lambda x: x / diagonal, dtype=np.float64)
        return c + cg(matrix, goal, rtol=_SETTLED, maxiter=_TURNS, M=scaled)[0]


def _coefficients(samples: _Samples, k: float, f0: float, growth: float) -> Any:
    """The coefficients in units, float64 [nodes], for a mask and a stiffness."""
    forces, stiffness = samples.forces, np.float32(growth)
    length = lengths_of(forces)
    tolerance = np.maximum(np.float32(f0), np.float32(k) * length)
    normal = forces / np.maximum(length, 1)[..., None]
    rows = np.zeros((*length.shape, 4, 4), np.float32)
    rows[..., 0, 0] = ((length > 0) & (length < _SATURATED * TOP)) / tolerance
    rows[..., 1:, 1:] = (length / (stiffness * tolerance))[..., None, None] * _EYE
    goal = np.concatenate([length[..., None], -stiffness * normal], axis=-1)
    c = samples.solved(rows, np.einsum("...ij,...j->...i", rows, goal), np.zeros(samples.bending.shape[0]))
    weight = np.where(length > 0, 1 / tolerance, np.float32(_EMPTY**0.5 / f0))
    for _ in range(_ROUNDS):
        if not (np.abs(c) < _DIVERGED).all():
            return np.zeros_like(c)  # a spline that no field is coded after
        f = samples.seen_of(c)
        steep = lengths_of(f[..., 1:])
        slow, size = np.maximum(steep, stiffness / 2), np.clip(f[..., 0], 0, np.float32(TOP))
        direction = -f[..., 1:] / slow[..., None]
        missing = forces - size[..., None] * direction
        share = lengths_of(missing) / tolerance
        w = (weight / np.sqrt(np.maximum(1, share)))[..., None]
        along = (steep > stiffness / 2)[..., None, None] * direction[..., :, None] * direction[..., None, :]
        grows = ((f[..., 0] > 0) & (f[..., 0] < TOP))[..., None]
        ways = [(grows * direction)[..., None], (size / slow)[..., None, None] * (along - _EYE)]
        c = samples.solved(w[..., None] * np.concatenate(ways, axis=-1), w * missing, c)
    return np.nan_to_num(c)


# the share of voxels at which a guess worth a trial keeps the rule; in mode "nmse" any is worth one
_LEAST: Final = 0.5
# the kinds in turn, coarse splines first, each with the share from which on it is not looked for
_PROVIDERS: Final = (
    (synthesis.SPLINE, partial(fit_spline, level=4), 1.0), (synthesis.SPLINE, fit_spline, 0.97),
    (synthesis.COLUMNS, fit_columns, 0.75),
)  # fmt: skip
_FINENESS: Final = 0.35
"""Error of a guess in mode "nmse", steps: errors of a guess are many alike, and finer ones are told cheaply.

"""


def fit(
    frame: ForceField, lattice: Lattice, limits: Limits, spec: TouchSpec
) -> tuple[tuple[bytes, FixedField] | None, float]:
    """The bytes of a guess within the mask of `limits` and its field, or None; and how often it keeps the
    rule.
    """
    best, most = None, _LEAST
    if spec.mode == "nmse":
        limits, most = limits._replace(f0=_FINENESS * lattice.floor), 0.0
    for kind, provider, enough in _PROVIDERS:
        fitted = provider(frame, lattice, limits) if most < enough else None
        if fitted is not None:
            share = agreement(frame, fitted[1], lattice.unit_n, spec)
            if share >= most:
                best, most = (bytes([kind]) + fitted[0], fitted[1]), share
    return best, most if best else 0.0
