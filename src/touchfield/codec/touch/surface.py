"""The surface source model of the coder `touch`: a frame is guessed from one surface, told column by column.

Paper figure 4 lets "source models" compete with plain samples. A penalty field is F = K d n behind a surface,
F_max at most (docs/theory.md): along the main axis of the force a column of samples shares n, and its depth
d = n_axis (t - z) grows from the surface on. So a column of a solid is told by a direction, a start z, the force
deep inside, and how much steeper than the direction says its ramp is; where a low-pass has mixed the surfaces at
both sides of a step, by two such surfaces whose forces add. All is predicted from the columns beside and chosen so
that most samples lie within the mask of the guess; what it misses is the voxel coder's. Fields without a main axis,
and walls that end before the inner border of the grid, are not for it.

`surface_format` tells the bytes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.codec.touch.fixed_field import FixedField
from touchfield.codec.touch.surface_tiles import read_tiles, tiles_around, write_tiles
from touchfield.codec.varint import read_varint, write_varint
from touchfield.errors import CorruptFile, TruncatedFile
from touchfield.medium.field import brick_keys
from touchfield.medium.grid import BRICK, Grid
from touchfield.parallel import for_chunks

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.codec.kernels.mixer import Coder
    from touchfield.codec.touch.frame_model import Known, Rule
    from touchfield.medium import ForceField

    Int64s = NDArray[np.int64]

__all__ = ["fit", "synthesise"]

_WHERE: Final = "surface"
_CHANGED: Final = "The file was changed or cut."
_BRICKS_PER_BYTE: Final = 4
_LEAST_SHARE: Final = 0.4  # of the forces along one axis, else there is none to look along
_LEAST_SOLID: Final = 0.5  # of the samples in columns that reach the inner border
_ROOM: Final = 1 << 26  # bytes of columns laid out at once
_SAMPLED: Final = 64  # tiles that the heads are taken from
_Z_SHARE, _DIRECTION_SHARE, _AMPLITUDE_SHARE = 1.4, 0.7, 0.9  # steps, of the mask


@dataclass(frozen=True)
class _View:
    """Columns along `axis`, from outside to inside; `inverted` where that is against the grid's sense."""

    grid: Grid
    axis: int
    inverted: bool

    @property
    def order(self) -> tuple[int, int, int]:
        """The axes across, and the main one."""
        a, b = (c for c in range(3) if c != self.axis)
        return a, b, self.axis

    @property
    def sizes(self) -> tuple[int, int, int]:
        """Samples along these axes."""
        a, b, c = (self.grid.shape[axis] for axis in self.order)
        return a, b, c

    @property
    def tiles_across(self) -> tuple[int, int]:
        a, b, _ = (self.grid.brick_shape[axis] for axis in self.order)
        return a, b


@dataclass(frozen=True)
class _Columns:
    """The bricks of a frame, tile after tile, as its columns are laid out from."""

    view: _View
    tiles: Int64s
    starts: Int64s
    lows: Int64s
    forces: NDArray[np.float32]
    unit_n: float
    tolerance: NDArray[np.float64]

    def laid_out(self, begin: int, end: int, held: NDArray[np.bool_]) -> tuple[Any, Any, Any]:
        """Tiles begin to end - 1: what `choose` works from; `held` tells which of all columns can be told."""
        from touchfield.codec.kernels import touch_surface_fit as kernels

        depth = self.view.sizes[2]
        dense = np.zeros((end - begin, BRICK * BRICK, depth, 4), np.float32)
        fits = np.zeros(((end - begin) * BRICK * BRICK, kernels.FIT))
        scale, k, f0 = 1.0 / self.unit_n, float(self.tolerance[0]), float(self.tolerance[1])
        where = (self.starts, self.lows, self.forces, depth, self.view.inverted, scale, k, f0)
        kernels.fit_columns(begin, end, begin, *where, dense, fits, held)
        return dense, fits, self.tolerance


def fit(frame: ForceField, known: Known, rule: Rule) -> tuple[bytes, FixedField] | None:
    """The bytes of a surface for a frame, and the guess that `synthesise` makes of them.

    Parameters
    ----------
    frame : ForceField
    known : Known
        Its lattice gives the unit; frames before are not looked at.
    rule : Rule
        The mask that the guess should keep where it can.

    Returns
    -------
    (bytes, FixedField) or None
        None where there is no surface to be told: no main axis of the force, or no solid behind it.
    """
    columns = _columns_of(frame, known, rule)
    if columns is None:
        return None
    held = np.zeros(len(columns.tiles) * BRICK * BRICK, np.bool_)
    heads = _heads(columns, held)
    if heads is None:
        return None
    view = columns.view
    code, cols = _coded(columns, heads, held)
    bricks, vectors = _forces(view, columns.tiles, heads, cols, None)
    head = bytes([2 * view.axis + view.inverted]) + b"".join(write_varint(x) for x in heads.tolist())
    data = head + write_tiles(columns.tiles, view.tiles_across[1]) + code
    return data.ljust(_least_size(len(columns.tiles), len(bricks)), b"\0"), FixedField(bricks, vectors)


def synthesise(data: bytes, known: Known) -> FixedField:
    """The guess of `fit` from its bytes; whole numbers throughout.

    Some 50 KiB are taken for each byte at most.

    Raises
    ------
    TruncatedFile, CorruptFile
        If the bytes are not what `fit` writes.
    """
    from touchfield.codec.kernels import touch_surface as layout
    from touchfield.codec.kernels import touch_surface_coder as kernels

    if not data:
        raise TruncatedFile(_WHERE, "no bytes", "an axis", _CHANGED)
    if data[0] > 5:
        raise CorruptFile(_WHERE, f"axis {data[0]}", "0 to 5", _CHANGED)
    view, at = _View(known.grid, data[0] >> 1, bool(data[0] & 1)), 1
    heads = np.zeros(layout.HEADS, np.int64)
    for n, limit in enumerate(layout.HEAD_LIMITS):
        heads[n], at = read_varint(data, at, f"{_WHERE}, head {n}", limit)
    tiles, at = read_tiles(data, at, view.tiles_across)
    coder = kernels.surface_coder(np.frombuffer(data, np.uint8, offset=at).copy(), decoding=True)
    cols = np.zeros((len(tiles) * BRICK * BRICK + 1, layout.WIDTH), np.int64)
    nothing = (np.zeros((0, 64, 0, 4), np.float32), np.zeros((0, 8)), np.zeros(2))
    last = np.full(1, -1, np.int64)
    status = _run(coder, (0, len(tiles)), (view, tiles, heads, cols), nothing, last)
    if status == kernels.ENDED:
        raise TruncatedFile(_WHERE, f"the end of the code after {len(data)} bytes", f"{len(tiles)} tiles", _CHANGED)
    if status != kernels.DONE:
        raise CorruptFile(_WHERE, "a column predicted from none", "one beside it", _CHANGED)
    bricks, vectors = _forces(view, tiles, heads, cols, len(data))
    place, end = coder.tail()
    size = max(at + place + len(end), _least_size(len(tiles), len(bricks)))
    if len(data) < size:
        raise TruncatedFile(_WHERE, f"{len(data)} bytes", f"{size}", _CHANGED)
    rest = data[at + place :]
    if len(data) > size or rest != end.ljust(len(rest), b"\0"):
        raise CorruptFile(_WHERE, "bytes behind the end of the code", f"the {size} bytes of the code", _CHANGED)
    return FixedField(bricks, vectors)


def _least_size(tiles: int, bricks: int) -> int:
    return max(tiles, -(-bricks // _BRICKS_PER_BYTE))


# -- the encoder's view of a frame ------------------------------------------------------------------------


def _columns_of(frame: ForceField, known: Known, rule: Rule) -> _Columns | None:
    if not len(frame.bricks):
        return None
    flat = frame.forces_n.reshape(-1, 3)
    total = flat.sum(axis=0, dtype=np.float64)
    axis = int(np.abs(total).argmax())
    if abs(total[axis]) < _LEAST_SHARE * np.sqrt(np.einsum("ij,ij->i", flat, flat)).sum(dtype=np.float64):
        return None
    view = _View(frame.grid, axis, bool(total[axis] > 0))
    a, b, _ = view.order
    across = view.tiles_across[1]
    keys = frame.bricks[:, a].astype(np.int64) * across + frame.bricks[:, b]
    order = np.lexsort((frame.bricks[:, axis], keys))
    found, first = np.unique(keys[order], return_index=True)
    tiles = np.stack(np.divmod(found, across), axis=1)
    starts = np.append(first, len(keys)).astype(np.int64)
    forces = frame.forces_n.transpose(0, *(1 + c for c in view.order), 4)[order][..., list(view.order)]
    unit_n = known.lattice.unit_n
    f0 = known.lattice.floor if rule.free else rule.f0_n / unit_n
    return _Columns(
        view=view,
        tiles=tiles,
        starts=starts,
        lows=frame.bricks[order, axis].astype(np.int64) * BRICK,
        forces=np.ascontiguousarray(forces),
        unit_n=unit_n,
        tolerance=np.array([0.0 if rule.free else rule.k, f0]),
    )


def _heads(columns: _Columns, held: NDArray[np.bool_]) -> Int64s | None:
    """What all columns share, from some of them; None where few samples lie in a solid."""
    from touchfield.codec.kernels import touch_surface as layout
    from touchfield.codec.kernels import touch_surface_fit as kernels

    tiles = len(columns.tiles)
    samples, lengths, solid, count = [], [], 0, 0
    for tile in np.unique(np.linspace(0, tiles - 1, min(tiles, _SAMPLED)).astype(np.int64)).tolist():
        dense, fits, _ = columns.laid_out(tile, tile + 1, held)
        here = held[tile * 64 : tile * 64 + 64]
        out = np.zeros(1 << 10)
        samples.append(out[: kernels.ramp_samples(dense, fits, here, out)])
        lengths.append(dense[..., 3][dense[..., 3] > 0])
        count += len(lengths[-1])
        solid += int((fits[here, kernels.STOP] - fits[here, kernels.FIRST]).sum())
    ramps, every = np.concatenate(samples), np.concatenate(lengths)
    if len(ramps) < BRICK or solid < _LEAST_SOLID * count or every.max() <= columns.tolerance[1]:
        return None
    ramp, top = float(np.median(ramps)), float(every.max())
    k, f0 = columns.tolerance
    share = max(k, min(f0 / top, 0.5), 1e-3)  # of the force, what the steps should not exceed by much
    a, b, c = (columns.view.grid.spacing_m[axis] for axis in columns.view.order)
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
    whole: Int64s = np.rint(np.clip(heads, least, np.array(layout.HEAD_LIMITS) - 1)).astype(np.int64)
    return whole


def _coded(columns: _Columns, heads: Int64s, held: NDArray[np.bool_]) -> tuple[bytes, Int64s]:
    from touchfield.codec.kernels import touch_surface as layout
    from touchfield.codec.kernels import touch_surface_coder as kernels

    tiles, depth = len(columns.tiles), columns.view.sizes[2]
    cols = np.zeros((tiles * BRICK * BRICK + 1, layout.WIDTH), np.int64)
    # nine numbers of some 70 bits each: an adaptive bit costs 14 bits at most, but few of them do
    coder = kernels.surface_coder(np.empty(tiles * BRICK * BRICK * 400 + 64, np.uint8), decoding=False)
    at_once = max(1, _ROOM // (BRICK * BRICK * depth * 16))
    last = np.full(1, -1, np.int64)
    for begin in range(0, tiles, at_once):
        end = min(begin + at_once, tiles)
        fitting = columns.laid_out(begin, end, held)
        cols[begin * 64 : end * 64, layout.PRESENT] = held[begin * 64 : end * 64]
        status = _run(coder, (begin, end), (columns.view, columns.tiles, heads, cols), fitting, last)
        if status != kernels.DONE:
            raise AssertionError("a surface that cannot be told")
    place, tail = coder.tail()
    return coder.buffer[:place].tobytes() + tail, cols


# -- what both sides do -----------------------------------------------------------------------------------


def _run(
    coder: Coder, span: tuple[int, int], what: tuple[_View, Int64s, Int64s, Int64s], fitting: Any, last: Int64s
) -> int:
    from touchfield.codec.kernels import touch_surface_coder as kernels

    view, tiles, heads, cols = what
    code = (coder.state, coder.buffer, coder.chances, coder.visits, coder.weights)
    around = tiles_around(tiles, view.tiles_across[1])
    sizes = np.array(view.sizes[:2], np.int64)
    return int(kernels.code_columns(*span, coder.decoding, code, tiles, around, sizes, heads, cols, fitting, last))


def _forces(view: _View, tiles: Int64s, heads: Int64s, cols: Int64s, size: int | None) -> Any:
    """Bricks int32 [n, 3] and vectors int32 [n, 8, 8, 8, 3] of the columns; `size` bytes bound how many."""
    from touchfield.codec.kernels import touch_surface as kernels

    depth = view.sizes[2]
    first = np.empty(len(tiles), np.int64)
    kernels.tile_spans(cols, depth, first)
    low = np.zeros(len(tiles), np.int64) if view.inverted else first // BRICK
    high = -(-(depth - first if view.inverted else np.full(len(tiles), depth)) // BRICK)
    count = np.where(first < depth, high - low, 0)
    total = int(count.sum())
    if size is not None and total > _BRICKS_PER_BYTE * size:
        raise TruncatedFile(
            _WHERE, f"{size} bytes for {total} bricks", f"{_BRICKS_PER_BYTE} a byte at most", _CHANGED
        )
    tile_of = np.repeat(np.arange(len(tiles)), count)
    along = np.arange(total) - np.repeat(np.cumsum(count) - count, count) + np.repeat(low, count)
    bricks = np.zeros((total, 3), np.int32)
    bricks[:, list(view.order[:2])] = tiles[tile_of]
    bricks[:, view.axis] = along
    order = np.argsort(brick_keys(view.grid, bricks))
    places = np.empty(total, np.int64)
    places[order] = np.arange(total)
    vectors = np.zeros((total, BRICK, BRICK, BRICK, 3), np.int32)
    seen = vectors.transpose(0, *(1 + c for c in view.order), 4)
    where = (tile_of, along * BRICK, places, cols, heads, depth, view.inverted, np.array(view.order))
    for_chunks(kernels.fill_bricks, total, *where, seen, chunk=64)
    return bricks[order], vectors
