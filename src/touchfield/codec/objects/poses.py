"""Poses as whole numbers, and their decoder (paper section 4.3, the "object" source model).

The paper's rigid objects need one field and a pose a frame, and it leaves the coding of these "parameters of the
source model" open. Here a pose is seven whole numbers, multiples of two steps; each is predicted from those before
it, and the residuals are whole numbers (docs/format/objects.md).
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from typing import Final

import numpy as np

from touchfield.arrays import Bools, Int64s
from touchfield.codec.kernels.bits import Bits, fresh, reader
from touchfield.codec.kernels.whole_numbers import CONTEXTS, SETS, code_numbers
from touchfield.codec.support import check_end
from touchfield.errors import CorruptFile, InvalidArgument, TruncatedFile
from touchfield.medium.pose_track import PoseTrack

MOST_POSES: Final = (1 << 16) - 1  # poses in one piece of code; a segment of a file has no more frames
MOST_STEPS: Final = 1 << 50  # of a position; seven of them, as the quadratic predictor adds, stay exact
POSITION_POWERS: Final = (-40, 0)
QUATERNION_POWERS: Final = (-30, -2)
_CHANGED = "The file was changed or cut."


@dataclass(frozen=True)
class PoseSteps:
    """The steps whose multiples a coded track consists of, powers of two; InvalidArgument for others.

    Of positions from 2^-40 to 1 metres, of each component of the quaternion from 2^-30 to 2^-2.
    """

    position_m: float
    quaternion: float

    def __post_init__(self) -> None:
        for name, (low, high) in (("position_m", POSITION_POWERS), ("quaternion", QUATERNION_POWERS)):
            step = float(getattr(self, name))
            if not (2.0**low <= step <= 2.0**high) or math.frexp(step)[0] != 0.5:
                raise InvalidArgument(f"pose step {name}", repr(step), f"a power of two from 2^{low} to 2^{high}")
            object.__setattr__(self, name, step)

    def to_bytes(self) -> bytes:
        """Two bytes: the exponents of both steps as int8."""
        return struct.pack("bb", *(math.frexp(step)[1] - 1 for step in (self.position_m, self.quaternion)))

    @classmethod
    def from_bytes(cls, data: bytes, where: str = "pose steps") -> PoseSteps:
        """The inverse of `to_bytes`; TruncatedFile or CorruptFile, which call the bytes `where`, if it has none."""
        if len(data) != 2:
            error = TruncatedFile if len(data) < 2 else CorruptFile
            raise error(where, f"{len(data)} bytes", "2")
        powers = struct.unpack("bb", data)
        for power, (low, high) in zip(powers, (POSITION_POWERS, QUATERNION_POWERS), strict=True):
            if not low <= power <= high:
                raise CorruptFile(where, f"a step of 2^{power}", f"2^{low} to 2^{high}")
        return cls(2.0 ** powers[0], 2.0 ** powers[1])

    @property
    def limits(self) -> Int64s:
        """The largest |number| of each component, int64 [7]."""
        return np.array([MOST_STEPS] * 3 + [round(1 / self.quaternion)] * 4, np.int64)

    def are_units(self, turns: Int64s) -> Bools:
        """True for quaternions int64 [n, 4] within one step of length 1; rounding keeps to it."""
        one = round(1 / self.quaternion)
        squares = (turns * turns).sum(axis=1)
        held: Bools = (squares >= (one - 1) ** 2) & (squares <= (one + 1) ** 2)
        return held

    def track(self, numbers: Int64s) -> PoseTrack:
        """The poses that whole numbers int64 [n, 7] tell."""
        turns = numbers[:, 3:].astype(np.float64)
        unit = turns / np.sqrt((turns * turns).sum(axis=1, keepdims=True))
        return PoseTrack(unit, numbers[:, :3].astype(np.float64) * self.position_m)


# of a predictor: 0 for a number that never changes, 1 the number before, 2 a line, 3 a parabola through those
MOST_ORDER: Final = 3
MODELS: Final = 8 * CONTEXTS, 8 * SETS
"""Of the first pose and the predictors, and of what these leave of each component."""


def code_residuals(bits: Bits, component: int, residuals: Int64s) -> None:
    """Write or read what the predictor of a component leaves, int64 [n]."""
    code_numbers(bits, (1 + component) * CONTEXTS, (1 + component) * SETS, residuals)


def decode_poses(data: bytes, frame_count: int, steps: PoseSteps, where: str = "poses") -> PoseTrack:
    """The track that `encode_poses` has coded.

    `frame_count`: poses that were coded, 1 to `MOST_POSES`; some 120 bytes are taken for each. `where`: what to call
    the bytes in an error. TruncatedFile or CorruptFile if the bytes are not the code of so many poses.
    """
    if not 1 <= frame_count <= MOST_POSES:
        raise InvalidArgument("frame_count", repr(frame_count), f"1 to {MOST_POSES}")
    bits = reader(data, fresh(*MODELS))
    head = np.zeros(14, np.int64)
    code_numbers(bits, 0, 0, head)
    orders, numbers = head[:7].tolist(), np.tile(head[7:], (frame_count, 1))
    if not 0 <= min(orders) <= max(orders) <= MOST_ORDER:
        raise CorruptFile(where, f"predictors {orders}", f"0 to {MOST_ORDER} each", _CHANGED)
    for c, order in enumerate(orders):
        column = np.zeros(frame_count, np.int64)
        if order:
            code_residuals(bits, c, column[1:])
        for _ in range(order):
            column = np.cumsum(column)
        numbers[:, c] += column
    check_end(bits, 0, where)
    # a sum that goes round has left the limits before
    if ((numbers > steps.limits) | (numbers < -steps.limits)).any():
        raise CorruptFile(where, "a number beyond its limit", "positions to 2^50 steps, quaternions to 1", _CHANGED)
    odd = np.flatnonzero(~steps.are_units(numbers[:, 3:]))
    if len(odd):
        found = f"the quaternion {tuple(numbers[odd[0], 3:].tolist())} in steps"
        expected = f"one of length {round(1 / steps.quaternion)} within 1"
        raise CorruptFile(f"{where}, frame {odd[0]}", found, expected, _CHANGED)
    return steps.track(numbers)
