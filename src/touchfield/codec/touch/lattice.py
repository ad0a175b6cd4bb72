"""Units and lattice of the coder `touch`: whole numbers, which encoder and decoder both hold, bit for bit the
same.

Forces are multiples of a unit; all that predicts one force from others works on them, and newtons appear only
at the very end (`FixedField.field`). The lattice has steps that grow with the force, so that a cell fits the
mask's ball (paper section 4.2, a Weber law of what is felt; docs/theory.md 31): half diagonal max(F_0, k
|F|).
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
from touchfield.medium.field import field_that_holds

TOP: Final = 1 << 16  # an encoder takes the unit so that the longest original of a segment has this length


@dataclass(frozen=True)
class FixedField:
    """Vectors in units, sparse in bricks of 8x8x8 samples."""

    # [n, 3]; in ascending order (x slowest, z fastest), as in `ForceField`; a brick may hold no force at all
    bricks: Int32s
    # [n, 8, 8, 8, 3]; axes (brick, x, y, z, component), units; each component within 2^17 - 1
    vectors: Int32s

    def field(self, grid: Grid, unit_n: float) -> ForceField:
        """The forces in newtons: one float32 product each, the only floating-point step of decoding."""
        forces = np.multiply(self.vectors, np.float32(unit_n), dtype=np.float32, casting="unsafe")
        return field_that_holds(grid, self.bricks, forces)


LEAST_UNIFORM: Final = 21
LEAST_RATE: Final = 64
"""A lattice has a floor of at least `LEAST_UNIFORM` units or a rate of at least `LEAST_RATE`.

So its table of warped lengths has at most 200,000 entries, whatever a file asks for: 2^22 / floor where it is
uniform, and 2^20 / rate (1 + ln(4 rate / floor)) where it is not.
"""

FLOOR_LIMIT: Final = 1 << 16
RATE_LIMIT: Final = 1 << 17

# the least normal float32: products with it are exact on machines that flush smaller numbers, too
SMALLEST_UNIT_N: Final = 2.0**-126
MOST_NEWTONS: Final = 2.0**120  # no longer force is coded: three times as much is still a float32


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
        """The inverse of `to_bytes`, at the place where the body is read."""
        (unit_n,) = struct.unpack("<f", parts.take(4, "unit"))
        if not SMALLEST_UNIT_N <= unit_n <= MOST_NEWTONS / 65536:
            raise CorruptFile("SEGM.body unit", f"{unit_n} N", "2^-126 to 2^104 N")
        floor, rate = parts.varint("floor", FLOOR_LIMIT, 1), parts.varint("rate", RATE_LIMIT)
        cross_floor, cross_rate = (
            parts.varint("cross floor", FLOOR_LIMIT, 1),
            parts.varint("cross rate", RATE_LIMIT),
        )
        if floor < LEAST_UNIFORM and rate < LEAST_RATE:
            found = f"a floor of {floor} with a rate of {rate}"
            raise CorruptFile("SEGM.body lattice", found, f"{LEAST_UNIFORM} or {LEAST_RATE} at least")
        return cls(unit_n, floor, rate, cross_floor, cross_rate)


@lru_cache(maxsize=8)
def warp_of(floor: int, rate: int) -> Int64s:
    """The amplitude at each sixteenth of a step, int64 [n], ascending; nobody writes into it.

    It begins at 0; each sixteenth adds max(256 * floor, border * rate >> 16) >> 4, at least 1, to the border,
    which is in 1/256 units, until it is past 2^18 units.
    """
    borders = [0]
    while borders[-1] <= 1 << 26:
        borders.append(borders[-1] + max(1, max(floor << 8, borders[-1] * rate >> 16) >> 4))
    return np.array(borders, np.int64)
