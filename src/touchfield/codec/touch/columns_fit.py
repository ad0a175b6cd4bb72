"""The encoder's side of the column guess: which surfaces a solid's columns speak for (floats).

Fields without a main axis, and walls that end before the inner border of the grid, are not for it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.codec.kernels.bits import end_of, fresh, writer
from touchfield.codec.touch import columns as guess
from touchfield.codec.touch.kernels import columns as kernels
from touchfield.codec.touch.kernels.columns_choice import Fits, write_row
from touchfield.codec.touch.kernels.columns_fit import fit_row
from touchfield.codec.varint import write_varint
from touchfield.medium.grid import BRICK

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.codec.touch.fixed_field import FixedField
    from touchfield.codec.touch.kernels.choice import Limits
    from touchfield.codec.touch.lattice import Lattice
    from touchfield.medium import ForceField

    Floats = NDArray[np.float32]

__all__ = ["fit"]

_LEAST_SHARE: Final = 0.4  # of the forces along one axis, else there is none to look along
_LEAST_REACHING: Final = 0.2  # of the tiles that reach the inner border
_SAMPLED: Final = 64  # bricks that the axis is taken from
_ROOM: Final = 1 << 24  # samples of a row of tiles laid out at once
_STEEP_RAMP: Final = 80  # per cent of the growths that the ramp is above
_Z_SHARE, _XY_SHARE, _A_SHARE = 1.4, 0.35, 0.9  # steps, of the mask


def fit(frame: ForceField, lattice: Lattice, limits: Limits) -> tuple[bytes, FixedField] | None:
    """The bytes of columns for a frame, and the guess that `synthesise` makes of them.

    Parameters
    ----------
    frame : ForceField
    lattice : Lattice
        Gives the unit.
    limits : Limits
        The mask that the guess should keep where it can.

    Returns
    -------
    (bytes, FixedField) or None
        None where there are no columns to be told: no main axis of the force, or no solid behind a surface.
    """
    view = _view_of(frame)
    if view is None:
        return None
    f0 = lattice.floor if limits.free else max(limits.f0, 1.0)
    mask = np.array([0.0 if limits.free else limits.k, f0])
    heads = _heads(view, frame.forces_n, lattice.unit_n, mask)
    if heads is None:
        return None
    columns = guess.columns_of(view, heads)
    count = len(columns.surfaces) // kernels.SLOTS
    # of nine numbers of some 70 bits each: an adaptive bit costs 14 bits at most, but few of them do
    bits = writer(count * 400 + 64, fresh(kernels.CONTEXTS, kernels.SETS))
    room = np.zeros_like(columns.residuals)
    for tiles in range(view.box[2]):
        forces = _laid_out(view, frame, tiles, np.float32(1 / lattice.unit_n))
        for i in range(view.told[0] - tiles * BRICK if tiles == view.box[2] - 1 else BRICK):
            row = np.flatnonzero(forces[i, :, -1, 3] > 0)
            write_row(bits, guess.AT, columns, tiles * BRICK + i, view.told[1], _fits(row, forces[i, row], heads, mask), room)
    made = guess.forces_of(view, columns)
    a, b, rows, row = view.box
    head = b"".join(
        write_varint(x) for x in (2 * view.axis + view.inverted, a, b, rows - 1, row - 1, *heads.tolist())
    )
    return head + end_of(bits).ljust(guess.least_size(view, len(made.bricks)), b"\0"), made


def _view_of(frame: ForceField) -> guess.View | None:
    """Along the main axis of the force; None where there is none or it is too long, or few tiles reach the border."""
    if not len(frame.bricks):
        return None
    some = frame.forces_n[:: -(-len(frame.bricks) // _SAMPLED)].reshape(-1, 3)
    total = some.sum(axis=0, dtype=np.float64)
    axis = int(np.abs(total).argmax())
    if abs(total[axis]) < _LEAST_SHARE * np.sqrt(np.einsum("ij,ij->i", some, some)).sum(dtype=np.float64):
        return None
    inverted = bool(total[axis] > 0)
    inner = 0 if inverted else frame.grid.brick_shape[axis] - 1
    tiles = np.unique(np.delete(frame.bricks, axis, axis=1), axis=0)
    low, high = tiles.min(axis=0).tolist(), tiles.max(axis=0).tolist()
    rows, row = high[0] - low[0] + 1, high[1] - low[1] + 1
    view = guess.View(frame.grid, axis, inverted, (low[0], low[1], rows, row))
    if np.count_nonzero(frame.bricks[:, axis] == inner) < _LEAST_REACHING * len(tiles):
        return None
    return view if row * BRICK**2 * view.depth <= _ROOM and rows * row <= guess.BRICKS_FREE + 64 * len(tiles) else None


def _heads(view: guess.View, forces: Floats, unit_n: float, mask: NDArray[np.float64]) -> NDArray[np.int64] | None:
    """What all columns share; None where there is no ramp, or no force above the mask."""
    length = np.sqrt(np.einsum("...i,...i", forces, forces)) / unit_n
    top, least = float(length.max()), float(length[length > 0].min(initial=np.inf))
    out = np.abs(forces[..., view.axis]) / unit_n
    along, cosine = np.moveaxis(length, 1 + view.axis, -1), np.moveaxis(out, 1 + view.axis, -1)
    low, high = along[..., :-1], along[..., 1:]
    if view.inverted:
        low, high = high, low
    ramp = ((high - low) * low / np.maximum(cosine[..., :-1], 0.3 * low + 1e-9))[(low > 0.2 * top) & (high < 0.9 * top) & (high - low > 0.002 * top)] / top
    k, f0 = mask
    if len(ramp) < BRICK or top <= f0:
        return None
    ramp = float(np.percentile(ramp, _STEEP_RAMP))
    share = max(k, min(f0 / top, 0.5), 1e-3)  # of the force, what the steps should not exceed by much
    a, b, c = (view.grid.spacing_m[axis] for axis in view.order)
    told = {
        kernels.TOP: top,
        kernels.RAMP: 65536 * ramp,
        kernels.RATIO_A: 256 * a / c,
        kernels.RATIO_B: 256 * b / c,
        kernels.Z_STEP: _Z_SHARE * 256 * max(f0 / top, 0.1 * k) / ramp,
        kernels.XY_STEP: 16384 * share * _XY_SHARE,
        kernels.A_STEP: 65536 * share * _A_SHARE,
        kernels.CUT: 0.9 * least,
    }
    heads = np.array([told[n] for n in range(len(told))])
    least_heads = np.array([1, 1, 0, 0, 4, 16, 16, 0])
    whole: NDArray[np.int64] = np.rint(np.clip(heads, least_heads, np.array(kernels.HEADS) - 1)).astype(np.int64)
    return whole


def _laid_out(view: guess.View, frame: ForceField, tiles: int, scale: np.float32) -> Floats:
    """Columns of a row of tiles, [8, columns, depth, 4]: across, across, outward and length, units, from outside."""
    a, b, axis = view.order
    bricks = np.flatnonzero(frame.bricks[:, a] == view.box[0] + tiles)
    out = np.zeros((BRICK, view.box[3], BRICK, -(-view.depth // BRICK), BRICK, 4), np.float32)
    seen = frame.forces_n[bricks].transpose(0, 1 + a, 1 + b, 1 + axis, 4)[..., view.order] * scale
    out[:, frame.bricks[bricks, b] - view.box[1], :, frame.bricks[bricks, axis], :, :3] = seen.transpose(0, 1, 2, 3, 4)
    out = out.reshape(BRICK, view.box[3] * BRICK, -1, 4)[:, : view.told[1], : view.depth]
    if view.inverted:
        out = out[:, :, ::-1]
    else:
        out[..., 2] *= -1
    out[..., 3] = np.sqrt(np.einsum("...i,...i", out[..., :3], out[..., :3]))
    return np.ascontiguousarray(out)


def _fits(places: NDArray[np.int64], forces: Floats, heads: NDArray[np.int64], mask: NDArray[np.float64]) -> Fits:
    """What the columns of a row, [n, depth, 4], speak for."""
    n, depth, _ = forces.shape
    spans, surfaces = np.zeros((n, 2), np.int64), np.zeros((n, 3, 4))
    work = np.zeros(depth), np.zeros(3), np.zeros(3), np.zeros((depth, 3))
    fit_row(forces, (float(heads[kernels.TOP]), heads[kernels.RAMP] / 65536), mask, spans, surfaces, work)
    return Fits(places, forces, spans, surfaces, mask)
