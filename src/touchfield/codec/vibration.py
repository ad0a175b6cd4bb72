"""Vibration beside force, coded: which samples vibrate, how strongly and how fast (start of paper section
6.4).

Only whole numbers travel. The amplitude is one of four steps an octave, so that it is off by a ninth at most:
less than the least difference that is felt (a fifth, perception/human.toml). The frequency is in whole hertz.
Where samples vibrate is a support as that of the force, each given the frame before; amplitude and frequency
are differences to the same sample in the frame before, or else to the sample before. docs/format/vibration.md
tells the bytes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Bools, Float32s, Int32s, Int64s
from touchfield.codec import kernels, support
from touchfield.codec.kernels import Bits, end_of, fresh, reader, writer
from touchfield.codec.support import BRICKS_PER_BYTE, Bricks, check_end, padded
from touchfield.errors import CorruptFile, InvalidArgument, TruncatedFile
from touchfield.medium.budget import memory_budget_bytes
from touchfield.medium.field import brick_keys, bricks_of
from touchfield.medium.grid import BRICK, Grid
from touchfield.medium.kernels import raster_slots
from touchfield.medium.medium import MAX_FREQUENCY_HZ, VibrationFrame

_IN_OCTAVE: Final = 4
_LEAST_EXPONENT: Final = -22
AMPLITUDE_STEPS: Final = (
    160  # step s is (4 + s mod 4) 2^(s // 4 - 22) newtons: 1 micronewton to 0.9 meganewton
)
MOST_RELATIVE_ERROR: Final = 1 / 9  # of an amplitude: in the middle between steps 4 and 5 of an octave
_MOST_HZ: Final = int(MAX_FREQUENCY_HZ)
_BYTES_PER_SAMPLE: Final = 128  # what decoding takes for each sample at its height
_FRAME: Final = BRICKS_PER_BYTE  # bricks that a frame counts for, so that a byte tells of a frame at most
_CONTEXTS: Final = support.CONTEXTS + 2 * kernels.NUMBER_CONTEXTS
_SETS: Final = support.SETS + 2 * kernels.NUMBER_SETS
# places [L] and values [2, L] of a frame without samples
_NOTHING: Final = np.zeros(0, np.int64), np.zeros((2, 0), np.int64)
_WHERE: Final = "VIBR.body"
_CHANGED: Final = "The file was changed or cut."


class VibrationSymbols(NamedTuple):
    """One frame in whole numbers, int32: samples [L, 3] in raster order, steps below `AMPLITUDE_STEPS`, and
    hertz.
    """

    positions: Int32s
    amplitudes: Int32s
    frequencies: Int32s


def symbols_of(frame: VibrationFrame) -> VibrationSymbols:
    """The nearest steps; none below the lowest, 1 micronewton, and InvalidArgument beyond the highest."""
    shares, exponents = np.frexp(frame.amplitudes_n.astype(np.float64))
    # 2 * _IN_OCTAVE shares lie from 4 to 8, and 8 is the first of the next octave
    octaves = exponents.astype(np.int64) - 3 - _LEAST_EXPONENT
    steps = _IN_OCTAVE * octaves + np.rint(2 * _IN_OCTAVE * shares).astype(np.int64) - _IN_OCTAVE
    if len(steps) and steps.max() >= AMPLITUDE_STEPS:
        most = float(_amplitudes_n(np.array([AMPLITUDE_STEPS - 1]))[0])
        raise InvalidArgument("amplitudes_n", f"{frame.amplitudes_n.max():g} N", f"at most {most:g} N")
    kept = steps >= 0
    hertz = np.maximum(np.rint(frame.frequencies_hz[kept]), 1)
    return VibrationSymbols(frame.positions[kept], steps[kept].astype(np.int32), hertz.astype(np.int32))


def frame_of(grid: Grid, symbols: VibrationSymbols) -> VibrationFrame:
    """Values that the symbols stand for."""
    hertz = symbols.frequencies.astype(np.float32)
    return VibrationFrame(grid, symbols.positions, _amplitudes_n(symbols.amplitudes), hertz)


def _amplitudes_n(steps: NDArray[np.integer]) -> Float32s:
    octaves, within = np.divmod(steps.astype(np.int64), _IN_OCTAVE)
    shares = (_IN_OCTAVE + within).astype(np.float32)
    return np.ldexp(shares, (octaves + _LEAST_EXPONENT).astype(np.int32))


def encode_vibration(frames: Sequence[VibrationFrame]) -> bytes:
    """The body of VIBR for the frames of one segment, at least one, all on one grid."""
    return encode_symbols(frames[0].grid, [symbols_of(frame) for frame in frames])


def decode_vibration(body: bytes, grid: Grid, frame_count: int) -> list[VibrationFrame]:
    """The inverse of `encode_vibration`, to within the steps; see `decode_symbols`."""
    return [frame_of(grid, symbols) for symbols in decode_symbols(body, grid, frame_count)]


def encode_symbols(grid: Grid, frames: Sequence[VibrationSymbols]) -> bytes:
    """The body of VIBR for frames in whole numbers."""
    supports = [_bricks_of(grid, one.positions) for one in frames]
    differences, before = [np.zeros((2, 0), np.int64)], _NOTHING
    for one in frames:
        places, values = (
            _places(grid, one.positions),
            np.stack([one.amplitudes, one.frequencies]).astype(np.int64),
        )
        guess = np.append(np.zeros((2, 1), np.int64), values, axis=1)[:, :-1]
        same, past = _same_samples(before, places)
        guess[:, same] = past
        differences.append(values - guess)
        before = places, values
    numbers = np.concatenate(differences, axis=1)
    brick_count = sum(len(bricks) for bricks, _ in supports)
    bits = writer(
        brick_count * support.ROOM + numbers.size * kernels.NUMBER_ROOM + 64, fresh(_CONTEXTS, _SETS)
    )
    known: Bricks | None = None
    for bricks in supports:
        known = support.code_support(bits, 0, 0, grid, bricks, known)
    _code_numbers(bits, numbers)
    return padded(end_of(bits), brick_count + _FRAME * len(frames))


def decode_symbols(body: bytes, grid: Grid, frame_count: int) -> list[VibrationSymbols]:
    """The inverse of `encode_symbols`.

    Whatever the bytes, each asks for no more than 8192 samples, and the first for 32768. TruncatedFile or
    CorruptFile if the bytes are not what `encode_symbols` writes. InvalidArgument if the samples would take
    more memory than `memory_budget_bytes`.
    """
    bits = reader(body, fresh(_CONTEXTS, _SETS))
    known: Bricks | None = None
    brick_count, positions = 0, [np.zeros((0, 3), np.int32)]
    for i in range(frame_count):
        known = support.code_support(bits, 0, 0, grid, None, known)
        brick_count += _FRAME + len(known[0])
        if len(body) < len(padded(b"", brick_count)):
            raise TruncatedFile(
                _WHERE, f"{len(body)} bytes", f"{len(padded(b'', brick_count))} or more to frame {i}"
            )
        positions.append(_positions(*known))
        needed, allowed = sum(map(len, positions)) * _BYTES_PER_SAMPLE, memory_budget_bytes()
        if needed > allowed:
            found, expected = (
                f"{needed / 2**30:.1f} GiB of samples",
                f"at most {allowed / 2**30:.1f} GiB a segment",
            )
            raise InvalidArgument(_WHERE, found, expected, "Set TOUCHFIELD_MEMORY_GIB.")
    numbers = np.zeros((2, sum(map(len, positions))), np.int64)
    _code_numbers(bits, numbers)
    check_end(bits, brick_count, _WHERE)
    frames: list[VibrationSymbols] = []
    before, begin = _NOTHING, 0
    for i, own in enumerate(positions[1:]):
        places = _places(grid, own)
        values = _summed(numbers[:, begin : begin + len(own)], *_same_samples(before, places))
        _check_values(values[0], 0, AMPLITUDE_STEPS - 1, f"amplitudes of frame {i}")
        _check_values(values[1], 1, _MOST_HZ, f"frequencies of frame {i}")
        frames.append(VibrationSymbols(own, *values.astype(np.int32)))
        before, begin = (places, values), begin + len(own)
    return frames


def _code_numbers(bits: Bits, numbers: Int64s) -> None:
    for n, row in enumerate(numbers):
        at = support.CONTEXTS + n * kernels.NUMBER_CONTEXTS, support.SETS + n * kernels.NUMBER_SETS
        kernels.code_numbers(bits, *at, row)


def _same_samples(before: tuple[Int64s, Int64s], places: Int64s) -> tuple[Bools, Int64s]:
    """Samples that the frame before has too, bool [L], and the values of those, int64 [2, n]."""
    slots = np.searchsorted(before[0], places)
    known = np.append(before[0], -1)[slots] == places
    return known, before[1][:, slots[known]]


def _summed(numbers: Int64s, known: Bools, past: Int64s) -> Int64s:
    """Values, int64 [2, L], of differences: to `past` where it is known, and to the sample before elsewhere."""
    sums, latest = np.cumsum(numbers, axis=1), np.cumsum(known)
    shift = np.append(np.zeros((2, 1), np.int64), past + numbers[:, known] - sums[:, known], axis=1)
    values: Int64s = sums + shift[:, latest]  # of the last known sample up to each
    return values


def _check_values(values: Int64s, least: int, most: int, what: str) -> None:
    if len(values) and not (least <= values.min() and values.max() <= most):
        wrong = values.min() if values.min() < least else values.max()
        raise CorruptFile(f"{_WHERE}, {what}", str(wrong), f"{least} to {most}", _CHANGED)


def _places(grid: Grid, positions: Int32s) -> Int64s:
    """The place of each sample in raster order, int64 [L]."""
    _, ny, nz = grid.shape
    x, y, z = positions.astype(np.int64).T
    places: Int64s = (x * ny + y) * nz + z
    return places


def _bricks_of(grid: Grid, positions: Int32s) -> Bricks:
    """The bricks of samples, and which of theirs are meant."""
    own = positions // BRICK
    keys, slots = np.unique(brick_keys(grid, own), return_inverse=True)
    bricks = bricks_of(grid, keys)
    mask = np.zeros((len(keys), BRICK, BRICK, BRICK), np.bool_)
    local = positions % BRICK
    mask[slots.reshape(-1), local[:, 0], local[:, 1], local[:, 2]] = True
    return bricks, mask


def _positions(bricks: Int32s, mask: Bools) -> Int32s:
    """The samples of bricks in raster order, int32 [L, 3]."""
    brick, local = np.divmod(raster_slots(bricks, mask), BRICK**3)
    within = np.stack(np.unravel_index(local, (BRICK,) * 3), axis=-1)
    return (bricks[brick] * BRICK + within).astype(np.int32)
