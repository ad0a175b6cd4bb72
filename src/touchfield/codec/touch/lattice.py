"""Units and step sizes of the coder `touch`, in integers.

Encoder and decoder use the same integers. Forces are multiples of a unit, and prediction works on these
multiples; newtons appear only in the last step (`FixedField.field`). The steps of the lattice grow with the
force, so that a cell fits the ball of the mask (paper section 4.2, Weber's law), whose radius is max(F_0, k
|F|); see `frame_encoder`. The lattice divides the space of force vectors, not the workspace.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from touchfield.arrays import Int32s, Int64s
from touchfield.codec.varint import Parts, write_varint
from touchfield.errors import CorruptFile
from touchfield.medium import ForceField, Grid
from touchfield.medium.field import field_without_empty_bricks

# length in units of the longest force of a segment, from which the encoder derives the unit
TOP: Final = 1 << 16


@dataclass(frozen=True)
class FixedField:
    """Vectors in units, sparse in bricks of 8x8x8 samples."""

    # [n, 3]; in ascending order (x slowest, z fastest), as in `ForceField`; a brick may have no force
    bricks: Int32s
    # [n, 8, 8, 8, 3]; axes (brick, x, y, z, component), units; each component within 2^17 - 1
    vectors: Int32s

    def field(self, grid: Grid, unit_n: float) -> ForceField:
        """The forces in newtons.

        Each is one float32 product, the only floating-point step of the decoder.
        """
        forces = np.multiply(self.vectors, np.float32(unit_n), dtype=np.float32, casting="unsafe")
        return field_without_empty_bricks(grid, self.bricks, forces)


MIN_FLOOR: Final = 21
MIN_RATE: Final = 64
"""A lattice has a floor of at least `MIN_FLOOR` units or a rate of at least `MIN_RATE`.

This bounds its table of warped lengths to 200,000 entries for any file: 2^22 / floor where it is uniform, and
2^20 / rate (1 + ln(4 rate / floor)) where it is not.
"""

FLOOR_LIMIT: Final = 1 << 16
RATE_LIMIT: Final = 1 << 17

# smallest normal float32: products with it are exact also on machines that flush subnormal numbers to zero
SMALLEST_UNIT_N: Final = 2.0**-126
MAX_NEWTONS: Final = 2.0**120  # largest force that can be coded; three times as much still fits in a float32


@dataclass(frozen=True)
class Lattice:
    """Steps of the residual along and across the prediction.

    At a force of `a` units the step along it is max(`floor`, `rate` * a / 65536), and across it
    max(`cross_floor`, `cross_rate` * a / 65536); at least 1. Rates of 0 make it uniform.
    """

    unit_n: float  # newtons of one unit; a float32
    floor: int  # units, 1 to 65535
    rate: int  # 0 to 131071: steps of up to twice the force
    cross_floor: int
    cross_rate: int

    def to_bytes(self) -> bytes:
        """The lattice in the body of a segment."""
        steps = self.floor, self.rate, self.cross_floor, self.cross_rate
        return struct.pack("<f", self.unit_n) + b"".join(map(write_varint, steps))

    @classmethod
    def read(cls, parts: Parts) -> Lattice:
        """Read what `to_bytes` writes; CorruptFile if a number is out of bounds."""
        (unit_n,) = struct.unpack("<f", parts.take(4, "unit"))
        if not SMALLEST_UNIT_N <= unit_n <= MAX_NEWTONS / 65536:
            raise CorruptFile("SEGM.body unit", f"{unit_n} N", "2^-126 to 2^104 N")
        floor, rate = parts.varint("floor", FLOOR_LIMIT, 1), parts.varint("rate", RATE_LIMIT)
        cross_floor, cross_rate = (
            parts.varint("cross floor", FLOOR_LIMIT, 1),
            parts.varint("cross rate", RATE_LIMIT),
        )
        if floor < MIN_FLOOR and rate < MIN_RATE:
            found = f"a floor of {floor} with a rate of {rate}"
            raise CorruptFile("SEGM.body lattice", found, f"{MIN_FLOOR} or {MIN_RATE} at least")
        return cls(unit_n, floor, rate, cross_floor, cross_rate)


@lru_cache(maxsize=8)
def warp_of(floor: int, rate: int) -> Int64s:
    """Amplitude at each sixteenth of a step, int64 [n], in 1/256 units; read-only.

    It ascends from 0. Each sixteenth adds max(256 * floor, border * rate >> 16) >> 4, at least 1, to the
    border, until that exceeds 2^18 units.
    """
    borders = [0]
    while borders[-1] <= 1 << 26:
        borders.append(borders[-1] + max(1, max(floor << 8, borders[-1] * rate >> 16) >> 4))
    return np.array(borders, np.int64)
