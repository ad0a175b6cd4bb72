"""The quick frame models of coder `touch`: efforts `fast` and `default`.

One pass from deep to shallow codes support, amplitude and direction together, in closed loop, each sample expected
from its neighbours by linear weights that travel in the frame; paper section 5.2, whose a and D these are.

The bytes of a frame: the length of the list of bricks, varint, and that list (`codec.support`, all bricks full);
nothing more if it is empty. Then a byte: which axis is slowest (0 to 2), and 4, 8, 16 where the slowest, the middle
or the fastest axis is walked downwards; the slopes along the three axes of the scan, zigzag varints; two bytes, bit
n set where class n has weights of its own, and these, 13 signed bytes each; then the arithmetic code to the end, of
whose last six bytes trailing zeros are left away.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.codec.support import decode_support, encode_support
from touchfield.codec.touch.fixed_field import FixedField
from touchfield.codec.touch.frame_model import CodedFrame
from touchfield.codec.varint import read_varint, write_varint
from touchfield.errors import CorruptFile, TruncatedFile
from touchfield.medium.field import brick_keys
from touchfield.medium.grid import BRICK

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.codec.touch.frame_model import Known, Rule
    from touchfield.codec.touch.lattice import Lattice
    from touchfield.medium import ForceField, Grid

    Int64s = NDArray[np.int64]

__all__ = ["LightModel"]

_WHERE: Final = "frame of coder touch"
_SLOPE_LIMIT: Final = 1 << 17
_FEW: Final = 20
"""Samples of a class below which it goes without weights of its own."""

_NOISE: Final = 0.2
"""What coding adds to the variance of a feature, in squared steps."""

_NOISE_CLOSED: Final = 0.02
"""The same where the features were coded already."""

_FITTED: Final = 12000
"""Samples that weights are fitted to, about."""


@dataclass(frozen=True)
class _Scan:
    """How a frame is walked, from what both sides know: see `kernels.touch_light.code_frame`."""

    where: Int64s
    reference_slot: Int64s
    tiles: Int64s
    low: Int64s
    high: Int64s
    layers: Int64s
    layer_at: Int64s
    stride: Int64s
    width: int


class LightModel:
    """A frame model without (`fast`) or with mixed chances.

    Parameters
    ----------
    fast : bool
    """

    def __init__(self, fast: bool) -> None:
        self.fast = fast
        self.number = 0 if fast else 1

    def encode(self, frame: ForceField, known: Known, rule: Rule) -> CodedFrame:
        """Code one frame; see `FrameModel`."""
        from touchfield.codec.kernels import touch_light as kernels
        from touchfield.codec.kernels import touch_light_choice as choice
        from touchfield.codec.kernels import touch_light_coder as coder

        lattice = known.lattice
        scale = 1.0 / np.float64(np.float32(lattice.unit_n))
        f0 = lattice.floor * 0.5 if rule.free else rule.f0_n * scale
        numbers = np.array([rule.k, f0, rule.sine, rule.thrift, rule.free, rule.movable], np.float64)
        bricks, forces = np.array(frame.bricks), frame.forces_n
        if rule.movable and len(bricks):
            peak = np.abs(forces).reshape(len(bricks), -1).max(axis=1) * scale > f0 / 2
            if not peak.all():
                bricks, forces = bricks[peak], forces[peak]
        forces = np.array(forces, np.float32)
        listed = self._list(known, bricks)
        head = write_varint(len(listed)) + listed
        out = np.zeros((len(bricks) * BRICK**3, 3), np.int32)
        decoded = FixedField(bricks, out.reshape(-1, BRICK, BRICK, BRICK, 3))
        if len(bricks) == 0:
            return CodedFrame(head, decoded, (8.0 * len(head), 0.0, 0.0), np.zeros(0, np.int64))
        falls, sums = choice.slopes(forces, scale)
        turn, down = _orientation(sums, frame.grid)
        signs = np.where(down, -1, 1)[turn]
        slope = np.clip(np.rint(falls[turn] * signs), 1 - _SLOPE_LIMIT, _SLOPE_LIMIT - 1).astype(np.int64)
        way = int(turn[0]) | sum(4 << n for n in range(3) if down[turn[n]])
        head += bytes([way]) + b"".join(write_varint(2 * s if s >= 0 else -2 * s - 1) for s in slope.tolist())
        scan, reference = _scan(known, bricks, way)
        flat = forces.reshape(-1, 3)
        common = (flat, scale, numbers)
        tail = (np.concatenate([slope, turn]), *_lattice(lattice))
        sampled = 1 + int(np.count_nonzero(flat[:, 0])) // _FITTED

        def run(task: int, weights: Int64s, gather: int) -> tuple[bytes, NDArray[np.int32], Any, Any]:
            room = len(bricks) * BRICK**3 + (1 << 16)
            while True:
                state, buffer = coder.start(None), np.empty(room, np.uint8)
                taken, prices, equations = np.zeros_like(out), np.zeros(3), np.zeros(kernels.SUMS)
                end = self._run(
                    task, gather, common, taken, reference, scan, weights, tail, state, buffer, equations, prices
                )
                if end != kernels.FULL:
                    return coder.stop(state, buffer), taken, equations, prices
                room *= 4

        none = np.zeros((kernels.CLASSES, kernels.FEATURES), np.int64)
        weights = _solve(run(kernels.FIT, none, sampled)[2])
        data, out, equations, prices = run(kernels.ENCODE, weights, 0 if self.fast else sampled)
        data = _weight_bytes(weights) + data
        if not self.fast:  # again, with what the closed loop taught
            weights = _solve(equations, _NOISE_CLOSED)
            again, other, _, more = run(kernels.ENCODE, weights, 0)
            again = _weight_bytes(weights) + again
            if len(again) < len(data):
                data, out, prices = again, other, more
        decoded = FixedField(bricks, out.reshape(-1, BRICK, BRICK, BRICK, 3))
        misses = np.flatnonzero(choice.missed(flat, out, scale, numbers))
        prices *= 8.0 * len(data) / max(prices.sum(), 1.0)
        prices[0] += 8.0 * len(head)
        support, amplitude, direction = prices.tolist()
        return CodedFrame(head + data, decoded, (support, amplitude, direction), misses)

    def decode(self, payload: bytes, known: Known) -> FixedField:
        """The inverse; see `FrameModel`.

        Raises
        ------
        CorruptFile, TruncatedFile
            If the bytes are not what `encode` writes.
        """
        from touchfield.codec.kernels import touch_light as kernels
        from touchfield.codec.kernels import touch_light_coder as coder

        size, at = read_varint(payload, 0, _WHERE, len(payload) + 1)
        if at + size > len(payload):
            raise TruncatedFile(_WHERE, f"{len(payload)} bytes", f"{at + size} for the list of bricks")
        bricks, at = self._listed(known, payload[at : at + size]), at + size
        out = np.zeros((len(bricks) * BRICK**3, 3), np.int32)
        if len(bricks) == 0:
            if len(payload) > at:
                raise CorruptFile(_WHERE, f"{len(payload) - at} bytes behind an empty frame", "none")
            return FixedField(bricks, out.reshape(-1, BRICK, BRICK, BRICK, 3))
        if at >= len(payload):
            raise TruncatedFile(_WHERE, f"the end of the bytes at offset {at}", "the direction of the scan")
        way = payload[at]
        if way & 3 == 3 or way > 31:
            raise CorruptFile(_WHERE, f"direction of the scan {way}", "an axis 0 to 2 and three bits")
        slope, at = _read_slopes(payload, at + 1)
        turn = _turn(way & 3)
        weights, at = _read_weights(payload, at)
        scan, reference = _scan(known, bricks, way)
        data = np.frombuffer(payload, np.uint8, offset=at).copy()
        state = coder.start(data)
        common = (np.zeros((1, 3), np.float32), 1.0, np.zeros(6))
        tail = (np.concatenate([slope, turn]), *_lattice(known.lattice))
        nothing = np.zeros((1, 1, 1))
        status = self._run(
            kernels.DECODE, 0, common, out, reference, scan, weights, tail, state, data, nothing, np.zeros(3)
        )
        place = int(state[coder.PLACE])
        if status == kernels.ENDED or place > len(data) + 6:
            raise TruncatedFile(_WHERE, f"the end of the code after {len(payload)} bytes", f"{len(bricks)} bricks")
        if len(data) > place:
            raise CorruptFile(_WHERE, f"{len(data) - place} bytes behind the end of the code", "none")
        return FixedField(bricks, out.reshape(-1, BRICK, BRICK, BRICK, 3))

    def _run(
        self, task: int, sampled: int, common: tuple[Any, ...], out: NDArray[np.int32], reference: NDArray[np.int32],
        scan: _Scan, weights: Int64s, tail: tuple[Any, ...], state: Int64s, buffer: NDArray[np.uint8],
        sums: NDArray[np.float64], prices: NDArray[np.float64],
    ) -> int:  # fmt: skip
        from touchfield.codec.kernels import touch_light as kernels
        from touchfield.codec.kernels import touch_light_coder as coder

        chances = np.full(kernels.CHANCES, coder.FRESH, np.uint32)
        mixes = np.full((kernels.MIXES, 3), 26214, np.int64)
        slope, *lattice = tail
        status = kernels.code_frame(
            task, sampled, not self.fast, *common, out, reference, scan.reference_slot, scan.where, scan.tiles,
            scan.low, scan.high, scan.layers, scan.layer_at, scan.stride, scan.width, slope, weights.reshape(-1),
            *lattice, state, buffer, chances, mixes, sums, prices, *kernels.workspace(scan.width),
        )  # fmt: skip
        return int(status)

    def _list(self, known: Known, bricks: NDArray[np.int32]) -> bytes:
        before = (
            None if known.previous is None else (known.previous.bricks, _whole(known.grid, known.previous.bricks))
        )
        return encode_support(known.grid, bricks, _whole(known.grid, bricks), before)

    def _listed(self, known: Known, data: bytes) -> NDArray[np.int32]:
        before = (
            None if known.previous is None else (known.previous.bricks, _whole(known.grid, known.previous.bricks))
        )
        bricks, mask = decode_support(data, known.grid, before)
        if not np.array_equal(mask, _whole(known.grid, bricks)):
            raise CorruptFile(_WHERE, "a brick listed in part", "whole bricks")
        return bricks


def _whole(grid: Grid, bricks: NDArray[np.int32]) -> NDArray[np.bool_]:
    """The samples of bricks that lie within the grid, bool [n, 8, 8, 8]."""
    left = np.asarray(grid.shape) - bricks.astype(np.int64) * BRICK
    if len(bricks) == 0 or left.min() >= BRICK:
        return np.ones((len(bricks), BRICK, BRICK, BRICK), np.bool_)
    x, y, z = (np.arange(BRICK) < left[:, axis, None] for axis in range(3))
    return x[:, :, None, None] & y[:, None, :, None] & z[:, None, None, :]


def _lattice(lattice: Lattice) -> tuple[Int64s, Int64s, Int64s]:
    from touchfield.codec.touch.warp import warp_of

    steps = np.array([lattice.floor, lattice.rate, lattice.cross_floor, lattice.cross_rate], np.int64)
    return (steps, *warp_of(lattice.floor, lattice.rate))


# -- the scan ---------------------------------------------------------------------------------------------


def _turn(axis: int) -> Int64s:
    """The axes of the scan, slowest first."""
    return np.array([axis, *(c for c in range(3) if c != axis)], np.int64)


def _orientation(sums: NDArray[np.float64], grid: Grid) -> tuple[Int64s, NDArray[np.bool_]]:
    """Which axis is slowest, and which are walked downwards: with the force, that is from deep to shallow.

    The slowest is the one along which the force points most; of two alike, not that of the finest sampling, whose
    neighbours are worth more in the plane.
    """
    fine = np.asarray(grid.spacing_m) < min(1.01 * min(grid.spacing_m), 0.99 * max(grid.spacing_m))
    return _turn(int(np.argmax((np.abs(sums[1]) + 0.01 * sums[0]) * np.where(fine, 0.85, 1.0)))), sums[1] < 0


def _scan(known: Known, bricks: NDArray[np.int32], way: int) -> tuple[_Scan, NDArray[np.int32]]:
    """The walk over bricks in ascending order, and the vectors of the reference, int32 [m, 3]."""
    grid = known.grid
    turn = _turn(way & 3)
    down = np.array([way >> (2 + n) & 1 for n in range(3)], np.int64)
    shape = np.asarray(grid.brick_shape, np.int64)[turn]
    extent = np.asarray(grid.shape, np.int64)[turn]
    natural = np.array([BRICK * BRICK, BRICK, 1], np.int64)[turn]
    turned = bricks[:, turn].astype(np.int64)
    at = np.where(down == 1, shape - 1 - turned, turned)
    order = np.lexsort((at[:, 2], at[:, 1], at[:, 0]))
    at, turned = at[order], turned[order]
    begin = int((down * (BRICK - 1) * natural).sum())
    left = np.clip(extent - turned * BRICK, 0, BRICK)
    low = np.where(down == 1, BRICK - left, 0)
    high = np.where(down == 1, BRICK, left)
    layers = np.flatnonzero(np.diff(at[:, 0], prepend=-1, append=-1))
    tiles, width = _tiles(at, int(shape[2]))
    reference = known.guess if known.guess is not None else known.previous
    vectors, slot = np.zeros((1, 3), np.int32), np.full(len(bricks), -1, np.int64)
    if reference is not None and len(reference.bricks):
        vectors = np.array(reference.vectors).reshape(-1, 3)
        keys, own = brick_keys(grid, reference.bricks), brick_keys(grid, bricks[order])
        place = np.minimum(np.searchsorted(keys, own), len(keys) - 1)
        slot = np.where(keys[place] == own, place * BRICK**3 + begin, -1)
    stride = np.where(down == 1, -natural, natural)
    where = order * BRICK**3 + begin
    scan = _Scan(where, slot, tiles, low, high, layers.astype(np.int64), at[layers[:-1], 0], stride, width)
    return scan, vectors


def _tiles(at: Int64s, across: int) -> tuple[Int64s, int]:
    """Where each brick's tile, that before and that after it begin in a row of cells, int64 [n, 3]; and its cells.

    Tiles side by side share a border; others are two cells apart. A tile that is not there is one of zeros, 2.
    """
    keys = at[:, 1] * across + at[:, 2]
    columns, place = np.unique(keys, return_inverse=True)
    apart = (np.diff(columns, prepend=-2) != 1) | (columns % across == 0)
    offset = 10 + BRICK * np.arange(len(columns)) + 2 * np.cumsum(apart)
    found = np.empty((len(columns), 3), np.int64)
    for n, step in enumerate((0, -across, across)):
        other = columns + step
        near = np.minimum(np.searchsorted(columns, other), len(columns) - 1)
        found[:, n] = np.where(columns[near] == other, offset[near], 2)
    return found[place.reshape(-1)], int(offset[-1]) + BRICK + 4


# -- numbers that travel in the frame ---------------------------------------------------------------------


def _solve(sums: NDArray[np.float64], noise: float = _NOISE) -> Int64s:
    """Weights of each class by least squares, 1/64, int64 [16, 13]."""
    features = sums.shape[1] - 1
    out = np.zeros((len(sums), features), np.int64)
    for kind, equations in enumerate(sums):
        if equations[features, features] < _FEW:
            continue
        square = np.tril(equations[:features, :features])
        square = square + np.tril(square, -1).T
        square[np.diag_indices(features)] += 1.0 + noise * equations[:features, features]
        out[kind] = np.clip(np.rint(64 * np.linalg.solve(square, equations[features, :features])), -128, 127)
    return out


def _weight_bytes(weights: Int64s) -> bytes:
    own = weights.any(axis=1)
    flags = sum(1 << n for n in np.flatnonzero(own).tolist())
    return flags.to_bytes(2, "little") + weights[own].astype(np.int8).tobytes()


def _read_weights(payload: bytes, at: int) -> tuple[Int64s, int]:
    from touchfield.codec.kernels import touch_light as kernels

    flags = int.from_bytes(payload[at : at + 2], "little")
    end = at + 2 + flags.bit_count() * kernels.FEATURES
    if len(payload) < end:
        raise TruncatedFile(_WHERE, f"the end of the bytes at offset {len(payload)}", f"weights up to {end}")
    out = np.zeros((kernels.CLASSES, kernels.FEATURES), np.int64)
    own = [n for n in range(kernels.CLASSES) if flags >> n & 1]
    out[own] = np.frombuffer(payload, np.int8, end - at - 2, at + 2).reshape(-1, kernels.FEATURES)
    return out, end


def _read_slopes(payload: bytes, at: int) -> tuple[Int64s, int]:
    out = []
    for _ in range(3):
        value, at = read_varint(payload, at, f"{_WHERE}, slope", 2 * _SLOPE_LIMIT)
        out.append(value >> 1 if value & 1 == 0 else -(value >> 1) - 1)
    return np.array(out, np.int64), at
