"""The encoder's side of the column guess: where its columns lie, and what they share.

Fields without a main axis, and walls that end before the inner border of the grid, are not for it.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from touchfield.arrays import Float32s, Float64s, Int64s
from touchfield.codec.kernels.bits import end_of, fresh, writer
from touchfield.codec.touch import columns as guess
from touchfield.codec.touch.kernels import guess as kernels
from touchfield.codec.touch.kernels.columns_fit import Fits, choose_row
from touchfield.codec.touch.kernels.encode_pass import Limits
from touchfield.codec.touch.lattice import FixedField, Lattice
from touchfield.codec.varint import write_varint
from touchfield.medium import ForceField
from touchfield.medium.grid import BRICK

_LEAST_SHARE: Final = 0.4  # of the forces along one axis, else there is none to look along
_LEAST_REACHING: Final = 0.2  # of the tiles that reach the inner border
_SAMPLED: Final = 64  # bricks that the axis is taken from
_ROOM: Final = 1 << 24  # samples of a row of tiles, laid out at once
_STEEP: Final = 80  # per cent of the growths that are below the ramp's; others are of mixed surfaces
_XY_SHARE, _Z_SHARE, _A_SHARE = 0.35, 1.4, 0.9  # steps, of the mask


def fit(frame: ForceField, lattice: Lattice, limits: Limits) -> tuple[bytes, FixedField] | None:
    """The bytes of columns for a frame, and the guess that `synthesise` makes of them, in the mask of `limits`.

    None where there are no columns to be told: no main axis of the force, or no solid behind a surface.
    """
    view = _view_of(frame)
    if view is None:
        return None
    mask = np.array([limits.k, max(limits.f0, 1.0)])
    heads = _heads(view, frame, lattice.unit_n, mask)
    if heads is None:
        return None
    columns = guess.columns_of(view, heads)
    # of nine numbers of some 70 bits each: an adaptive bit costs 14 bits at most, but few of them do
    bits = writer(len(columns.surfaces) * 200 + 64, fresh(kernels.COLUMN_CONTEXTS, kernels.COLUMN_SETS))
    ramp = np.array([heads[kernels.TOP], heads[kernels.RAMP] / 65536])
    room = np.zeros(view.depth), np.zeros(3), np.zeros(3), np.zeros((view.depth, 3))
    rows, count = view.told
    for row in range(rows):
        if row % BRICK == 0:
            forces = _laid_out(view, frame, row // BRICK, 1 / lattice.unit_n)
        places = np.flatnonzero(forces[row % BRICK, :, -1, 3] > 0)
        spans, surfaces = np.zeros((len(places), 2), np.int64), np.zeros((len(places), 3, 4))
        fits = Fits(places, forces[row % BRICK, places], spans, surfaces, mask, ramp, *room)
        wishes = np.zeros((count, kernels.WISHES), np.int64)
        choose_row(columns, row, fits, wishes)
        kernels.code_row(bits, columns, row, wishes)
    made = guess.forces_of(view, columns)
    a, b, tiles_a, tiles_b = view.box
    told = (2 * view.axis + view.inverted, a, b, tiles_a - 1, tiles_b - 1, *heads.tolist())
    code = end_of(bits).ljust(guess.least_size(view, len(made.bricks)), b"\0")
    return b"".join(map(write_varint, told)) + code, made


def _view_of(frame: ForceField) -> guess.View | None:
    """Along the main axis of the force; None if there is none, few tiles reach the border, or it is too large."""
    if not len(frame.bricks):
        return None
    some = frame.forces_n[:: -(-len(frame.bricks) // _SAMPLED)].reshape(-1, 3)
    total = some.sum(axis=0, dtype=np.float64)
    axis = int(np.abs(total).argmax())
    if abs(total[axis]) < _LEAST_SHARE * np.sqrt(np.einsum("ij,ij->i", some, some)).sum(dtype=np.float64):
        return None
    tiles = np.unique(np.delete(frame.bricks, axis, axis=1), axis=0)
    (a, b), (rows, row) = tiles.min(axis=0).tolist(), (np.ptp(tiles, axis=0) + 1).tolist()
    view = guess.View(frame.grid, axis, bool(total[axis] > 0), (a, b, rows, row))
    inner = 0 if view.inverted else frame.grid.brick_shape[axis] - 1
    if np.count_nonzero(frame.bricks[:, axis] == inner) < _LEAST_REACHING * len(tiles):
        return None
    large = view.depth > guess.DEEPEST or rows * row > guess.TILES_FREE + 4 * len(tiles)
    return None if large or row * BRICK**2 * view.depth > _ROOM else view


def _heads(view: guess.View, frame: ForceField, unit_n: float, mask: Float64s) -> Int64s | None:
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
    heads = np.empty(len(kernels.HEADS))
    heads[kernels.TOP], heads[kernels.RAMP] = top, 65536 * ramp
    heads[kernels.RATIO_A], heads[kernels.RATIO_B] = 256 * a / c, 256 * b / c
    heads[kernels.XY_STEP], heads[kernels.A_STEP] = 16384 * share * _XY_SHARE, 65536 * share * _A_SHARE
    heads[kernels.Z_STEP] = 256 * max(f0 / top, 0.1 * k) / ramp * _Z_SHARE
    least_heads = np.array([1, 1, 0, 0, 16, 4, 16])
    whole: Int64s = np.rint(np.clip(heads, least_heads, np.array(kernels.HEADS) - 1)).astype(np.int64)
    return whole


def _laid_out(view: guess.View, frame: ForceField, tiles: int, scale: float) -> Float32s:
    """Columns of a row of tiles, [8, columns, depth, 4]: across, across, outward and length, units, from outside."""
    a, b, axis = view.order
    bricks = np.flatnonzero(frame.bricks[:, a] == view.box[0] + tiles)
    out = np.zeros((BRICK, view.box[3], BRICK, -(-view.depth // BRICK), BRICK, 4), np.float32)
    seen = frame.forces_n[bricks].transpose(0, 1 + a, 1 + b, 1 + axis, 4)[..., view.order]
    out[:, frame.bricks[bricks, b] - view.box[1], :, frame.bricks[bricks, axis], :, :3] = seen * np.float32(scale)
    out = out.reshape(BRICK, view.box[3] * BRICK, -1, 4)[:, :, : view.depth]
    if view.inverted:
        out = out[:, :, ::-1]
    else:
        out[..., 2] *= -1
    out[..., 3] = np.sqrt(np.einsum("...i,...i", out[..., :3], out[..., :3]))
    return np.ascontiguousarray(out)
