"""The encoder's side of the column guess: which columns save most of the voxels' bits for their own.

Fields without a main axis, and walls that end before the inner border of the grid, are not for it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.codec.brick_list import code_bricks
from touchfield.codec.kernels.bits import end_of, fresh, writer
from touchfield.codec.touch import columns as guess
from touchfield.codec.touch.kernels import columns as layout
from touchfield.codec.touch.kernels import columns_fit as kernels
from touchfield.codec.touch.kernels.columns_choice import work_for, write_columns
from touchfield.codec.varint import write_varint
from touchfield.medium.grid import BRICK

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.codec.touch.fixed_field import FixedField
    from touchfield.codec.touch.kernels.choice import Limits
    from touchfield.codec.touch.lattice import Lattice
    from touchfield.medium import ForceField

__all__ = ["fit"]

_LEAST_SHARE: Final = 0.4  # of the forces along one axis, else there is none to look along
_LEAST_REACHING: Final = 0.2  # of the tiles that reach the inner border
_DEEPEST: Final = 1 << 14  # samples of a column
_LEAST_SOLID: Final = 0.5  # of the samples in columns that do
_ROOM: Final = 1 << 26  # bytes of columns laid out at once
_SAMPLED: Final = 64  # tiles that the heads are taken from
_COLUMNS: Final = BRICK * BRICK
_Z_SHARE, _DIRECTION_SHARE, _AMPLITUDE_SHARE = 1.4, 0.7, 0.9  # steps, of the mask


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
    tiles, source = _source_of(frame, view, lattice, limits)
    heads = _heads(view, len(tiles), source)
    if heads is None:
        return None
    columns = guess.columns_of(view, tiles, heads)
    # of nine numbers of some 70 bits each: an adaptive bit costs 14 bits at most, but few of them do
    bits = writer(len(tiles) * (_COLUMNS * 400 + 320) + 64, fresh(guess.CONTEXTS, guess.SETS))
    code_bricks(bits, 0, 0, view.tiles_shape, tiles, None)
    work = work_for(source.mask)
    at_once = max(1, _ROOM // (_COLUMNS * source.depth * 16))
    for begin in range(0, len(tiles), at_once):
        end = min(begin + at_once, len(tiles))
        dense, fits, held = _laid_out(begin, end, source)
        columns.cols[begin * _COLUMNS : end * _COLUMNS, layout.PRESENT] = held
        write_columns(bits, guess.AT, columns, begin, end, (dense, fits), work)
    made = guess.forces_of(view, columns)
    head = b"".join(write_varint(x) for x in (2 * view.axis + view.inverted, *heads.tolist()))
    return head + end_of(bits).ljust(guess.least_size(len(tiles), len(made.bricks)), b"\0"), made


def _view_of(frame: ForceField) -> guess.View | None:
    """Along the main axis of the force; None where there is none or it is too long, or few tiles reach the border."""
    if not len(frame.bricks):
        return None
    some = frame.forces_n[:: -(-len(frame.bricks) // _SAMPLED)].reshape(-1, 3)
    total = some.sum(axis=0, dtype=np.float64)
    axis = int(np.abs(total).argmax())
    if abs(total[axis]) < _LEAST_SHARE * np.sqrt(np.einsum("ij,ij->i", some, some)).sum(dtype=np.float64):
        return None
    view = guess.View(frame.grid, axis, bool(total[axis] > 0))
    if view.sizes[2] > _DEEPEST:
        return None
    inner = 0 if view.inverted else frame.grid.brick_shape[axis] - 1
    tiles = len(np.unique(np.delete(frame.bricks, axis, axis=1), axis=0))
    return view if np.count_nonzero(frame.bricks[:, axis] == inner) >= _LEAST_REACHING * tiles else None


def _source_of(
    frame: ForceField, view: guess.View, lattice: Lattice, limits: Limits
) -> tuple[NDArray[np.int32], kernels.Source]:
    """The tiles of a frame, int32 [n, 3], and its bricks in their order."""
    a, b, axis = view.order
    across = view.tiles_shape[1]
    keys = frame.bricks[:, a].astype(np.int64) * across + frame.bricks[:, b]
    order = np.lexsort((frame.bricks[:, axis], keys))
    found, first = np.unique(keys[order], return_index=True)
    tiles = np.stack([*np.divmod(found, across), np.zeros_like(found)], axis=1).astype(np.int32)
    forces = frame.forces_n.transpose(0, *(1 + c for c in view.order), 4)[order][..., list(view.order)]
    f0 = lattice.floor if limits.free else max(limits.f0, 1.0)
    return tiles, kernels.Source(
        np.append(first, len(keys)).astype(np.int64), frame.bricks[order, axis].astype(np.int64) * BRICK,
        np.ascontiguousarray(forces), view.sizes[2], view.inverted, 1.0 / lattice.unit_n,
        np.array([0.0 if limits.free else limits.k, f0]),
    )  # fmt: skip


def _laid_out(
    begin: int, end: int, source: kernels.Source
) -> tuple[NDArray[np.float32], NDArray[np.float64], NDArray[np.bool_]]:
    """The columns of tiles begin to end - 1, what is found of each, and which of them can be told."""
    count = (end - begin) * _COLUMNS
    dense = np.zeros((count, source.depth, 4), np.float32)
    fits, held = np.zeros((count, kernels.FIT)), np.zeros(count, np.bool_)
    kernels.fit_columns(begin, end, source, dense, fits, held)
    return dense, fits, held


def _heads(view: guess.View, tiles: int, source: kernels.Source) -> NDArray[np.int64] | None:
    """What all columns share, from some of them; None where few samples lie in a solid."""
    samples, lengths, solid, count = [], [], 0, 0
    for tile in np.unique(np.linspace(0, tiles - 1, min(tiles, _SAMPLED)).astype(np.int64)).tolist():
        dense, fits, held = _laid_out(tile, tile + 1, source)
        out = np.zeros(1 << 10)
        samples.append(out[: kernels.ramp_samples(dense, fits, held, out)])
        lengths.append(dense[..., 3][dense[..., 3] > 0])
        count += len(lengths[-1])
        solid += int((fits[held, kernels.STOP] - fits[held, kernels.FIRST]).sum())
    ramps, every = np.concatenate(samples), np.concatenate(lengths)
    k, f0 = source.mask
    if len(ramps) < BRICK or solid < _LEAST_SOLID * count or every.max() <= f0:
        return None
    ramp, top = float(np.median(ramps)), float(every.max())
    share = max(k, min(f0 / top, 0.5), 1e-3)  # of the force, what the steps should not exceed by much
    a, b, c = (view.grid.spacing_m[axis] for axis in view.order)
    told = {
        layout.TOP: top,
        layout.RAMP: 65536 * ramp,
        layout.RATIO_A: 256 * a / c,
        layout.RATIO_B: 256 * b / c,
        layout.Z_STEP: _Z_SHARE * 256 * max(f0 / top, 0.1 * k) / ramp,
        layout.DIRECTION_STEP: 16384 * share * _DIRECTION_SHARE,
        layout.AMPLITUDE_STEP: 65536 * share * _AMPLITUDE_SHARE,
        layout.CUT: 0.9 * float(every.min()),
    }
    heads = np.array([told[n] for n in range(layout.HEADS)])
    least = np.array([1, 1, 0, 0, 4, 16, 16, 0])
    whole: NDArray[np.int64] = np.rint(np.clip(heads, least, np.array(layout.HEAD_LIMITS) - 1)).astype(np.int64)
    return whole
