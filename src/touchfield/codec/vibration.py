"""Encodes and decodes the vibration of a segment: the samples that vibrate, their amplitudes and their
frequencies (paper section 6.4).

The amplitude has four steps per octave, so that its error is at most one ninth: less than the just noticeable
difference (a fifth, perception/human.toml). The frequency is in whole hertz. The vibrating samples are coded
as a support like that of the force, predicted from the support of the frame before. Amplitude and frequency
are coded as differences to the same sample of the frame before or, if that did not vibrate, to the preceding
sample. docs/format/vibration.md defines the bytes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from touchfield.arrays import Float32s, Int32s
from touchfield.compute.native import argument_errors, decoding_errors, native
from touchfield.medium.budget import memory_budget_bytes
from touchfield.medium.grid import Grid
from touchfield.medium.medium import VibrationFrame

_IN_OCTAVE: Final = 4
_MIN_EXPONENT: Final = -22
# step s is (4 + s mod 4) 2^(s // 4 - 22) newtons: 1 micronewton to 0.9 meganewton
AMPLITUDE_STEPS: Final = 160
MAX_RELATIVE_ERROR: Final = 1 / 9  # of an amplitude, reached half-way between steps 4 and 5 of an octave
_BYTES_PER_SAMPLE: Final = 128  # peak memory of decoding
_WHERE: Final = "VIBR.body"


def encode_vibration(frames: Sequence[VibrationFrame]) -> bytes:
    """Body of VIBR for the frames of one segment: at least one, all on one grid.

    Amplitudes are rounded to the nearest step. Samples below the lowest one, 1 micronewton, are removed;
    InvalidArgument if one is above the highest.
    """
    sources = [
        (
            np.ascontiguousarray(frame.positions, np.int32),
            np.ascontiguousarray(frame.amplitudes_n, np.float32),
            np.ascontiguousarray(frame.frequencies_hz, np.float32),
        )
        for frame in frames
    ]
    with argument_errors("vibration"):
        return native.encode_vibration(frames[0].grid.shape, sources)


def decode_vibration(body: bytes, grid: Grid, frame_count: int) -> list[VibrationFrame]:
    """The inverse of `encode_vibration`, up to quantisation.

    Each byte yields at most 8192 samples; the first yields up to 32768. TruncatedFile or CorruptFile if the
    bytes are invalid. InvalidArgument if the samples would take more memory than `memory_budget_bytes`.
    """
    max_samples = int(memory_budget_bytes() / _BYTES_PER_SAMPLE)
    with decoding_errors(_WHERE, limit_hint="Set TOUCHFIELD_MEMORY_GIB."):
        frames = native.decode_vibration(grid.shape, body, frame_count, max_samples)
    return [
        VibrationFrame(
            grid,
            np.frombuffer(positions, np.int32).reshape(-1, 3).copy(),
            _amplitudes_n(np.frombuffer(steps, np.int32)),
            np.frombuffer(hertz, np.int32).astype(np.float32),
        )
        for positions, steps, hertz in frames
    ]


def _amplitudes_n(steps: Int32s) -> Float32s:
    octaves, step_in_octave = np.divmod(steps, _IN_OCTAVE)
    mantissas = (_IN_OCTAVE + step_in_octave).astype(np.float32)
    amplitudes: Float32s = np.ldexp(mantissas, octaves + _MIN_EXPONENT)
    return amplitudes
