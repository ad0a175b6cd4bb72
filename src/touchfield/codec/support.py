"""Codes, without loss, at which samples a frame has a force: the list of its bricks, and the samples
set in each. All coders use it.

Paper section 5.2 codes amplitudes and directions of the supported samples but not their positions.

The list of bricks is an octree, coded level by level: a box of 2^l bricks along each side is coded at level
l, and the boxes within it are coded only if it contains bricks. Each level is coded in raster order (x
slowest). When a box is coded, half of its neighbours are known; of the others it is known whether their
parents contain bricks. The samples of each brick follow, x slowest. The probability of each sample adapts to
its neighbours within two samples and, if there is one, to a reference support. Samples outside the grid are
not coded.

`encode_numbers` codes whole numbers with the same range coder (docs/format/bits.md), which is in C
(``c/touch_model.h``).
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Bools, Int32s, Int64s
from touchfield.compute.native import argument_errors, decoding_errors, native
from touchfield.errors import InvalidArgument
from touchfield.medium.grid import BRICK, Grid

# brick coordinates int32 [n, 3], ascending, and the mask of their samples, bool [n, 8, 8, 8]
Bricks = tuple[Int32s, Bools]
BRICKS_FREE: Final = 64
# a code of n bytes lists at most `BRICKS_FREE` + 16 n bricks; each takes 1.5 KiB while they are decoded
BRICKS_PER_BYTE: Final = 16
MAX_NUMBER: Final = (1 << 30) - 1  # largest magnitude of a coded number


def encode_support(grid: Grid, bricks: Int32s, mask: Bools, previous: Bricks | None = None) -> bytes:
    """Code a support on its own.

    `previous` is a reference support on the same grid, known to the decoder, or None. InvalidArgument if
    bricks do not ascend, or one is outside the grid, has a sample there, or has none.
    """
    with argument_errors("support"):
        return native.encode_support(grid.shape, _arrays(bricks, mask), previous and _arrays(*previous))


def decode_support(data: bytes, grid: Grid, previous: Bricks | None = None) -> Bricks:
    """The inverse of `encode_support`; TruncatedFile or CorruptFile for other bytes.

    Takes at most 40 KiB of memory per byte.
    """
    with decoding_errors("support"):
        bricks, samples = native.decode_support(grid.shape, data, previous and _arrays(*previous))
    mask = np.frombuffer(samples, np.bool_).reshape(-1, BRICK, BRICK, BRICK)
    return np.frombuffer(bricks, np.int32).reshape(-1, 3).copy(), mask.copy()


def _arrays(bricks: Int32s, mask: Bools) -> tuple[Int32s, NDArray[np.uint8]]:
    return np.ascontiguousarray(bricks, np.int32), np.ascontiguousarray(mask, np.bool_).view(np.uint8)


def encode_numbers(numbers: NDArray[np.integer]) -> bytes:
    """Code whole numbers [n]; InvalidArgument if a magnitude exceeds `MAX_NUMBER`."""
    values = np.ascontiguousarray(numbers, np.int64)
    if values.ndim != 1:
        raise InvalidArgument("numbers", f"shape {values.shape}", "one axis")
    with argument_errors("numbers"):
        return native.encode_numbers(values)


def decode_numbers(data: bytes, count: int) -> Int64s:
    """The inverse of `encode_numbers`, int64 [count].

    The caller must have checked `count`, because that much memory is allocated. TruncatedFile or CorruptFile
    for other bytes.
    """
    with decoding_errors("whole numbers"):
        return np.frombuffer(native.decode_numbers(data, count), np.int64).copy()
