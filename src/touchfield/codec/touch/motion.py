"""Block motion: a guess for a frame, made of blocks of the decoded frame before it, each moved by its own vector.

A standing scene needs none; where bodies fall or turn, or a camera's pose is off, a block of the field is mostly the
one before, displaced. Interpolation keeps the support sharp: a wall's edge stays a jump. The vectors take some ten
bits each. `motion_format` tells the bytes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from touchfield.codec.touch.fixed_field import FixedField
from touchfield.errors import CorruptFile, TruncatedFile
from touchfield.medium.field import brick_keys
from touchfield.medium.grid import BRICK

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.codec.touch.frame_model import Known
    from touchfield.medium import ForceField, Grid

    Int64s = NDArray[np.int64]

__all__ = ["find", "gain", "replay"]

_WHERE = "block motion"
_CHANGED = "The file was changed or cut."
_BRICK_SHIFT = 3
_SHIFTS = (3, 2)
_MOST_POINTS = {3: 64, 2: 32}
_FULL_SEARCHES = {3: 4, 2: 0}
_PASSES = {3: 2, 2: 1}
_FIRST_STEP = {3: 16, 2: 2}
_MOST_REACH = 2
_BRICKS_EACH, _BRICKS_MORE = 4, 64
_BESIDE = ((0, 0, -1), (0, -1, 0), (-1, 0, 0), (0, 0, 1), (0, 1, 0), (1, 0, 0))


# -- what both sides make of the previous frame -----------------------------------------------------------


@dataclass(frozen=True)
class _Before:
    """The previous frame, as the kernels take it."""

    keys: Int64s
    vectors: NDArray[np.int32]
    rows: Int64s
    counts: Int64s

    def as_tuple(self) -> tuple[Int64s, NDArray[np.int32], Int64s, Int64s]:
        return self.keys, self.vectors, self.rows, self.counts


def _before(grid: Grid, previous: FixedField) -> _Before:
    from touchfield.codec.kernels.touch_motion import rows_of

    vectors = _plain(previous.vectors, np.int32)
    return _Before(brick_keys(grid, previous.bricks), vectors, rows_of(vectors), np.array(grid.brick_shape, np.int64))


def _plain(array: NDArray[Any], dtype: type[np.generic]) -> NDArray[Any]:
    """Writeable and contiguous: a read-only array would be another type to the compiler."""
    return np.require(array, dtype, ["C", "W"])


def _block_counts(grid: Grid, shift: int) -> Int64s:
    return -(-np.array(grid.shape, np.int64) >> shift)


def _block_keys(blocks: Int64s, counts: Int64s) -> Int64s:
    keys: Int64s = (blocks[:, 0] * counts[1] + blocks[:, 1]) * counts[2] + blocks[:, 2]
    return keys


def _blocks(keys: Int64s, counts: Int64s) -> Int64s:
    rest, z = np.divmod(keys, counts[2])
    x, y = np.divmod(rest, counts[1])
    return np.stack([x, y, z], axis=1)


def _held(grid: Grid, bricks: NDArray[np.int32], rows: Int64s, shift: int) -> Int64s:
    """Keys of the blocks that hold a force, ascending."""
    from touchfield.codec.kernels.touch_motion import held_blocks

    counts = _block_counts(grid, shift)
    blocks = held_blocks(bricks.astype(np.int64), rows, shift)
    blocks = blocks[(blocks < counts).all(axis=1)]  # none, but for samples beyond the grid
    return np.unique(_block_keys(blocks, counts))


def _candidates(held: Int64s, counts: Int64s, reach: int) -> Int64s:
    """Keys of the blocks at most `reach` blocks away from one of `held` along each axis, ascending."""
    keys = held
    for axis in range(3):
        blocks = _blocks(keys, counts)
        spread = []
        for step in range(-reach, reach + 1):
            moved = blocks.copy()
            moved[:, axis] += step
            inside = (moved[:, axis] >= 0) & (moved[:, axis] < counts[axis])
            spread.append(_block_keys(moved[inside], counts))
        keys = np.unique(np.concatenate(spread))
    return keys


def _beside(keys: Int64s, counts: Int64s, sides: int) -> Int64s:
    """Index of the blocks before each one along z, y, x, and, for 6 `sides`, behind it; -1 for none."""
    blocks = _blocks(keys, counts)
    found = np.full((len(keys), sides), -1, np.int64)
    for side, offset in enumerate(_BESIDE[:sides]):
        beside = blocks + np.array(offset)
        inside = ((beside >= 0) & (beside < counts)).all(axis=1)
        key = _block_keys(beside, counts)
        at = np.minimum(np.searchsorted(keys, key), len(keys) - 1)
        hit = inside & (keys[at] == key)
        found[hit, side] = at[hit]
    return found


def _least(known: Known) -> int:
    """Shorter interpolated forces are none, units."""
    return known.lattice.floor >> 2


def _most_bricks(before: _Before) -> int:
    return _BRICKS_EACH * len(before.keys) + _BRICKS_MORE


def _moved(before: _Before, blocks: Int64s, moves: Int64s, shift: int, known: Known) -> FixedField | None:
    """The previous frame with blocks moved; None where it would have too many bricks."""
    from touchfield.codec.kernels.touch_motion import fetch_blocks

    own = _block_keys(blocks >> (_BRICK_SHIFT - shift), before.counts)
    keys = np.union1d(before.keys, own)
    if len(keys) > _most_bricks(before):
        return None
    out = np.zeros((len(keys), BRICK, BRICK, BRICK, 3), np.int32)
    kept = np.zeros(len(keys), np.bool_)
    old = np.searchsorted(keys, before.keys)
    out[old] = before.vectors
    kept[old] = True
    shape, slots = np.array(known.grid.shape, np.int64), np.searchsorted(keys, own)
    fetch_blocks(blocks, moves, shift, before.as_tuple(), _least(known), shape, slots, out, kept)
    if not kept.all():
        keys, out = keys[kept], out[kept]
    return FixedField(_blocks(keys, before.counts).astype(np.int32), out)


# -- the encoder's choice ---------------------------------------------------------------------------------


def find(frame: ForceField, known: Known) -> tuple[bytes, FixedField] | None:
    """A guess for `frame`: the previous one with its blocks moved, and the bytes that tell how.

    Blocks of 8 samples are tried, and then of 4, from the vectors of the larger ones; what saves more is taken.

    Parameters
    ----------
    frame : ForceField
        What is to be coded.
    known : Known
        `lattice` gives the steps in which errors are measured.

    Returns
    -------
    (bytes, FixedField) or None
        What `replay` takes and what it returns; None where there is no previous frame, or no gain over it.
    """
    from touchfield.codec.kernels import touch_motion_search

    if known.previous is None or not len(known.previous.bricks) or not len(frame.bricks):
        return None
    grid, least = known.grid, _least(known)
    before = _before(grid, known.previous)
    now = _now(frame)
    now_rows = np.packbits(frame.mask, axis=-1, bitorder="little")[..., 0].astype(np.int64)
    best: tuple[float, bytes, FixedField] | None = None
    larger: _Found | None = None
    for shift in _SHIFTS:
        counts = _block_counts(grid, shift)
        held = _held(grid, known.previous.bricks, before.rows, shift)
        keys = np.unique(np.concatenate([held, _held(grid, frame.bricks, now_rows, shift)]))
        blocks = _blocks(keys, counts)
        moves, settled = _seeds(blocks, larger)
        limits = _MOST_POINTS[shift], _FULL_SEARCHES[shift], _PASSES[shift], _FIRST_STEP[shift]
        where, old = (blocks, _beside(keys, counts, 6), shift), (before.keys, before.vectors)
        touch_motion_search.search(*where, now, old, before.counts, _steps(known), least, *limits, moves, settled)
        moving = moves.any(axis=1)
        larger = _Found(keys, moves, settled, counts)
        if not moving.any():
            continue
        data, chosen = _written(keys[moving], moves[moving], held, counts, shift)
        guess = _moved(before, _blocks(keys[moving][chosen], counts), moves[moving][chosen], shift, known)
        if guess is None:
            continue
        cost = 8 * len(data) + _cost(now, known, guess)
        if best is None or cost < best[0]:
            best = (cost, data, guess)
    if best is None or best[0] >= _cost(now, known, known.previous):
        return None
    return best[1], best[2]


def _steps(known: Known) -> tuple[np.float32, np.float32, np.float32]:
    """Units of a newton, and floor and rate of the steps, for the kernels that weigh errors."""
    lattice = known.lattice
    return np.float32(1 / lattice.unit_n), np.float32(max(1, lattice.floor)), np.float32(lattice.rate / 65536)


def _now(frame: ForceField) -> tuple[Int64s, NDArray[np.float32]]:
    return brick_keys(frame.grid, frame.bricks), _plain(frame.forces_n, np.float32)


@dataclass(frozen=True)
class _Found:
    """Vectors of blocks, by key, and which blocks are predicted well as they stand."""

    keys: Int64s
    moves: Int64s
    settled: NDArray[np.bool_]
    counts: Int64s


def _seeds(blocks: Int64s, larger: _Found | None) -> tuple[Int64s, NDArray[np.bool_]]:
    """Vectors to begin with, and what needs no search: as for the blocks of twice the size that hold these."""
    if larger is None:
        return np.zeros((len(blocks), 3), np.int64), np.zeros(len(blocks), np.bool_)
    at = np.searchsorted(larger.keys, _block_keys(blocks >> 1, larger.counts))
    return larger.moves[at], larger.settled[at]


def _written(
    keys: Int64s, moves: Int64s, held: Int64s, counts: Int64s, shift: int
) -> tuple[bytes, NDArray[np.bool_]]:
    """The bytes of vectors, and which of the blocks are within reach of the previous frame's: the others stand."""
    from touchfield.codec.kernels import touch_motion as kernels

    for reach in range(_MOST_REACH + 1):
        candidates = _candidates(held, counts, reach)
        chosen = np.isin(keys, candidates)
        if chosen.all():
            break
    at = np.searchsorted(candidates, keys[chosen])
    moved, vectors = np.zeros(len(candidates), np.bool_), np.zeros((len(candidates), 3), np.int64)
    moved[at], vectors[at] = True, moves[chosen]
    # an adaptive bit costs 14 bits at most, and a block has 1 + 3 * (2 + 8) of them and 18 raw ones at most
    coder = kernels.motion_coder(np.empty(57 * len(candidates) + 64, np.uint8), decoding=False)
    status = kernels.code_vectors(coder, _beside(candidates, counts, 3), np.isin(candidates, held), moved, vectors)
    if status != kernels.DONE:
        raise AssertionError("a displacement beyond its limit")
    place, end = coder.tail()
    return bytes([16 * reach + shift]) + coder.buffer[:place].tobytes() + end, chosen


# -- the decoder ------------------------------------------------------------------------------------------


def replay(data: bytes, known: Known) -> FixedField:
    """The guess that `find` returned with `data`.

    Parameters
    ----------
    data : bytes
    known : Known
        With the same grid, lattice and previous frame.

    Raises
    ------
    TruncatedFile, CorruptFile
        If the bytes are not what `find` writes for such a previous frame.
    """
    from touchfield.codec.kernels import touch_motion as kernels

    if not data:
        raise TruncatedFile(_WHERE, "no byte", "block size and vectors", _CHANGED)
    if known.previous is None or not len(known.previous.bricks):
        raise CorruptFile(_WHERE, "moved blocks", "a frame before that holds a force", _CHANGED)
    reach, shift = divmod(data[0], 16)
    if shift not in _SHIFTS or reach > _MOST_REACH:
        raise CorruptFile(
            _WHERE, f"the shape {data[0]}", "blocks of 4 or 8 samples, at most two from a force", _CHANGED
        )
    grid = known.grid
    before, counts = _before(grid, known.previous), _block_counts(grid, shift)
    held = _held(grid, known.previous.bricks, before.rows, shift)
    keys = _candidates(held, counts, reach)
    moved, moves = np.zeros(len(keys), np.bool_), np.zeros((len(keys), 3), np.int64)
    coder = kernels.motion_coder(np.frombuffer(data, np.uint8, offset=1).copy(), decoding=True)
    status = kernels.code_vectors(coder, _beside(keys, counts, 3), np.isin(keys, held), moved, moves)
    place, end = coder.tail()
    if len(data) < 1 + place + (len(end) if status == kernels.DONE else 0):
        raise TruncatedFile(_WHERE, f"the end of the code after {len(data)} bytes", f"{len(keys)} blocks", _CHANGED)
    if status != kernels.DONE:
        raise CorruptFile(_WHERE, "a displacement of nothing or too far", f"{kernels.REACH} voxels at most", _CHANGED)
    if data[1 + place :] != end:
        raise CorruptFile(_WHERE, "bytes behind the end of the code", f"{1 + place + len(end)} bytes", _CHANGED)
    if not moved.any():
        raise CorruptFile(_WHERE, "no block that moves", "one at least", _CHANGED)
    guess = _moved(before, _blocks(keys[moved], counts), moves[moved], shift, known)
    if guess is None:
        raise CorruptFile(_WHERE, "blocks moved far and wide", f"{_most_bricks(before)} bricks at most", _CHANGED)
    return guess


# -- a measure --------------------------------------------------------------------------------------------


def _cost(now: tuple[Int64s, NDArray[np.float32]], known: Known, guess: FixedField) -> float:
    """Bits that `guess` leaves to be coded, about."""
    from touchfield.codec.kernels.touch_motion_search import field_cost

    keys, vectors = brick_keys(known.grid, guess.bricks), _plain(guess.vectors, np.int32)
    return float(field_cost(*now, *_steps(known), keys, vectors))


def gain(frame: ForceField, known: Known, guess: FixedField) -> float:
    """How much better `guess` predicts than the previous frame, or than nothing: about bits saved a force.

    Parameters
    ----------
    frame : ForceField
    known : Known
    guess : FixedField

    Returns
    -------
    float
        For each sample of `frame` with a force; below 0 where the guess is the worse one.
    """
    empty = FixedField(np.zeros((0, 3), np.int32), np.zeros((0, BRICK, BRICK, BRICK, 3), np.int32))
    now = _now(frame)
    saved = _cost(now, known, known.previous or empty) - _cost(now, known, guess)
    return saved / max(1, frame.support_count)
