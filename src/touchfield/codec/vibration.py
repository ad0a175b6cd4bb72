"""Code of vibrations: samples, amplitudes and frequencies (paper section 6.4).

The amplitude has four steps per octave, so that its error is at most one ninth: less than the just noticeable
difference (a fifth, perception/human.toml). The frequency is in whole hertz. The vibrating samples are coded
as a support like that of the force, predicted from the support of the frame before. Amplitude and frequency
are coded as differences to the same sample of the frame before or, if that did not vibrate, to the preceding
sample. docs/format/vibration.md defines the bytes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Bools, Float32s, Int32s, Int64s
from touchfield.codec import kernels, support
from touchfield.codec.kernels import Bits, finish, new_models, reader, writer
from touchfield.codec.support import BRICKS_PER_BYTE, Bricks, check_end, pad_payload
from touchfield.errors import CorruptFile, InvalidArgument, TruncatedFile
from touchfield.medium.budget import memory_budget_bytes
from touchfield.medium.field import brick_keys, bricks_of
from touchfield.medium.grid import BRICK, Grid
from touchfield.medium.kernels import raster_slots
from touchfield.medium.medium import MAX_FREQUENCY_HZ, VibrationFrame

_IN_OCTAVE: Final = 4
_MIN_EXPONENT: Final = -22
# step s is (4 + s mod 4) 2^(s // 4 - 22) newtons: 1 micronewton to 0.9 meganewton
AMPLITUDE_STEPS: Final = 160
MAX_RELATIVE_ERROR: Final = 1 / 9  # of an amplitude, reached half-way between steps 4 and 5 of an octave
_MAX_HZ: Final = int(MAX_FREQUENCY_HZ)
_BYTES_PER_SAMPLE: Final = 128  # peak memory of decoding
_BRICKS_PER_FRAME: Final = (
    BRICKS_PER_BYTE  # each frame counts as so many bricks, so that a byte codes at most one frame
)
_CONTEXTS: Final = support.CONTEXTS + 2 * kernels.NUMBER_CONTEXTS
_SETS: Final = support.SETS + 2 * kernels.NUMBER_SETS
# indices [L] and values [2, L] of a frame without samples
_NO_SAMPLES: Final = np.zeros(0, np.int64), np.zeros((2, 0), np.int64)
_WHERE: Final = "VIBR.body"
_CHANGED: Final = "The file was changed or cut."


class VibrationSymbols(NamedTuple):
    """One frame in whole numbers, int32.

    `positions`: samples [L, 3] in raster order. `amplitudes`: steps [L], below `AMPLITUDE_STEPS`.
    `frequencies`: hertz [L].
    """

    positions: Int32s
    amplitudes: Int32s
    frequencies: Int32s


def quantise_vibration(frame: VibrationFrame) -> VibrationSymbols:
    """Round to the nearest steps.

    Samples below the lowest step, 1 micronewton, are removed; InvalidArgument if one is above the highest.
    """
    mantissas, exponents = np.frexp(frame.amplitudes_n.astype(np.float64))
    # 2 * _IN_OCTAVE * mantissas lies in [4, 8); if it is rounded to 8, this is the first step of the next
    # octave
    octaves = exponents.astype(np.int64) - 3 - _MIN_EXPONENT
    steps = _IN_OCTAVE * octaves + np.rint(2 * _IN_OCTAVE * mantissas).astype(np.int64) - _IN_OCTAVE
    if len(steps) and steps.max() >= AMPLITUDE_STEPS:
        max_n = float(_amplitudes_n(np.array([AMPLITUDE_STEPS - 1]))[0])
        raise InvalidArgument("amplitudes_n", f"{frame.amplitudes_n.max():g} N", f"at most {max_n:g} N")
    is_coded = steps >= 0
    hertz = np.maximum(np.rint(frame.frequencies_hz[is_coded]), 1)
    return VibrationSymbols(
        frame.positions[is_coded], steps[is_coded].astype(np.int32), hertz.astype(np.int32)
    )


def dequantise_vibration(grid: Grid, symbols: VibrationSymbols) -> VibrationFrame:
    """The frame that symbols represent."""
    hertz = symbols.frequencies.astype(np.float32)
    return VibrationFrame(grid, symbols.positions, _amplitudes_n(symbols.amplitudes), hertz)


def _amplitudes_n(steps: NDArray[np.integer]) -> Float32s:
    octaves, step_in_octave = np.divmod(steps.astype(np.int64), _IN_OCTAVE)
    mantissas = (_IN_OCTAVE + step_in_octave).astype(np.float32)
    return np.ldexp(mantissas, (octaves + _MIN_EXPONENT).astype(np.int32))


def encode_vibration(frames: Sequence[VibrationFrame]) -> bytes:
    """Body of VIBR for the frames of one segment: at least one, all on one grid."""
    return encode_symbols(frames[0].grid, [quantise_vibration(frame) for frame in frames])


def decode_vibration(body: bytes, grid: Grid, frame_count: int) -> list[VibrationFrame]:
    """The inverse of `encode_vibration`, up to quantisation; see `decode_symbols`."""
    return [dequantise_vibration(grid, symbols) for symbols in decode_symbols(body, grid, frame_count)]


def encode_symbols(grid: Grid, frames: Sequence[VibrationSymbols]) -> bytes:
    """Body of VIBR for frames in whole numbers."""
    supports = [_bricks_of(grid, frame.positions) for frame in frames]
    differences, previous = [np.zeros((2, 0), np.int64)], _NO_SAMPLES
    for frame in frames:
        indices = _raster_indices(grid, frame.positions)
        values = np.stack([frame.amplitudes, frame.frequencies]).astype(np.int64)
        prediction = np.append(np.zeros((2, 1), np.int64), values, axis=1)[:, :-1]
        same, previous_values = _same_samples(previous, indices)
        prediction[:, same] = previous_values
        differences.append(values - prediction)
        previous = indices, values
    numbers = np.concatenate(differences, axis=1)
    brick_count = sum(len(bricks) for bricks, _ in supports)
    capacity = brick_count * support.BYTES_PER_BRICK + numbers.size * kernels.BYTES_PER_NUMBER + 64
    bits = writer(capacity, new_models(_CONTEXTS, _SETS))
    support_before: Bricks | None = None
    for bricks in supports:
        support_before = support.code_support(bits, 0, 0, grid, bricks, support_before)
    _code_numbers(bits, numbers)
    return pad_payload(finish(bits), brick_count + _BRICKS_PER_FRAME * len(frames))


def decode_symbols(body: bytes, grid: Grid, frame_count: int) -> list[VibrationSymbols]:
    """The inverse of `encode_symbols`.

    Each byte yields at most 8192 samples; the first yields up to 32768. TruncatedFile or CorruptFile if the
    bytes are invalid. InvalidArgument if the samples would take more memory than `memory_budget_bytes`.
    """
    bits = reader(body, new_models(_CONTEXTS, _SETS))
    support_before: Bricks | None = None
    brick_count, positions = 0, [np.zeros((0, 3), np.int32)]
    for i in range(frame_count):
        support_before = support.code_support(bits, 0, 0, grid, None, support_before)
        brick_count += _BRICKS_PER_FRAME + len(support_before[0])
        if len(body) < len(pad_payload(b"", brick_count)):
            raise TruncatedFile(
                _WHERE, f"{len(body)} bytes", f"{len(pad_payload(b'', brick_count))} or more to frame {i}"
            )
        positions.append(_positions(*support_before))
        needed, allowed = sum(map(len, positions)) * _BYTES_PER_SAMPLE, memory_budget_bytes()
        if needed > allowed:
            found = f"{needed / 2**30:.1f} GiB of samples"
            expected = f"at most {allowed / 2**30:.1f} GiB a segment"
            raise InvalidArgument(_WHERE, found, expected, "Set TOUCHFIELD_MEMORY_GIB.")
    numbers = np.zeros((2, sum(map(len, positions))), np.int64)
    _code_numbers(bits, numbers)
    check_end(bits, brick_count, _WHERE)
    frames: list[VibrationSymbols] = []
    previous, start = _NO_SAMPLES, 0
    for i, frame_positions in enumerate(positions[1:]):
        indices = _raster_indices(grid, frame_positions)
        values = _integrate(
            numbers[:, start : start + len(frame_positions)], *_same_samples(previous, indices)
        )
        _check_values(values[0], 0, AMPLITUDE_STEPS - 1, f"amplitudes of frame {i}")
        _check_values(values[1], 1, _MAX_HZ, f"frequencies of frame {i}")
        frames.append(VibrationSymbols(frame_positions, *values.astype(np.int32)))
        previous, start = (indices, values), start + len(frame_positions)
    return frames


def _code_numbers(bits: Bits, numbers: Int64s) -> None:
    for n, row in enumerate(numbers):
        offsets = support.CONTEXTS + n * kernels.NUMBER_CONTEXTS, support.SETS + n * kernels.NUMBER_SETS
        kernels.code_numbers(bits, *offsets, row)


def _same_samples(previous: tuple[Int64s, Int64s], indices: Int64s) -> tuple[Bools, Int64s]:
    """Find the samples that the frame before has, too.

    Returns bool [L], True for these samples, and their values there, int64 [2, n].
    """
    slots = np.searchsorted(previous[0], indices)
    is_shared = np.append(previous[0], -1)[slots] == indices
    return is_shared, previous[1][:, slots[is_shared]]


def _integrate(numbers: Int64s, is_shared: Bools, previous_values: Int64s) -> Int64s:
    """Values of a frame from differences, int64 [2, L].

    A difference is to `previous_values` for a shared sample, else to the preceding sample.
    """
    sums, latest = np.cumsum(numbers, axis=1), np.cumsum(is_shared)
    shift = np.append(
        np.zeros((2, 1), np.int64), previous_values + numbers[:, is_shared] - sums[:, is_shared], axis=1
    )
    values: Int64s = sums + shift[:, latest]  # the shift of the last shared sample at or before each sample
    return values


def _check_values(values: Int64s, low: int, high: int, quantity: str) -> None:
    if len(values) and not (low <= values.min() and values.max() <= high):
        wrong = values.min() if values.min() < low else values.max()
        raise CorruptFile(f"{_WHERE}, {quantity}", str(wrong), f"{low} to {high}", _CHANGED)


def _raster_indices(grid: Grid, positions: Int32s) -> Int64s:
    """Raster index of each sample, int64 [L]."""
    _, ny, nz = grid.shape
    x, y, z = positions.astype(np.int64).T
    indices: Int64s = (x * ny + y) * nz + z
    return indices


def _bricks_of(grid: Grid, positions: Int32s) -> Bricks:
    """The bricks of samples, and the mask of the samples in them."""
    brick_of_sample = positions // BRICK
    keys, slots = np.unique(brick_keys(grid, brick_of_sample), return_inverse=True)
    bricks = bricks_of(grid, keys)
    mask = np.zeros((len(keys), BRICK, BRICK, BRICK), np.bool_)
    local = positions % BRICK
    mask[slots.reshape(-1), local[:, 0], local[:, 1], local[:, 2]] = True
    return bricks, mask


def _positions(bricks: Int32s, mask: Bools) -> Int32s:
    """Positions of the samples of bricks in raster order, int32 [L, 3]."""
    brick, local = np.divmod(raster_slots(bricks, mask), BRICK**3)
    within = np.stack(np.unravel_index(local, (BRICK,) * 3), axis=-1)
    return (bricks[brick] * BRICK + within).astype(np.int32)
