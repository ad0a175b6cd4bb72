"""Lossless code of the support: bricks of a frame and their supported samples.

Paper section 5.2 codes amplitudes and directions of the supported samples but not their positions.

The list of bricks is an octree, coded level by level: a box of 2^l bricks along each side is coded at level
l, and the boxes within it are coded only if it contains bricks. Each level is coded in raster order (x
slowest). When a box is coded, half of its neighbours are known; of the others it is known whether their
parents contain bricks. The samples of each brick follow, x slowest. The probability of each sample adapts to
its neighbours within two samples and, if there is one, to a reference support. Samples outside the grid are
not coded.

`encode_numbers` codes whole numbers with the same range coder.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Bools, Int32s, Int64s
from touchfield.codec import kernels
from touchfield.codec.kernels import (
    BYTES_PER_NUMBER,
    NEIGHBOURS,
    NUMBER_CONTEXTS,
    NUMBER_SETS,
    POSITION,
    READING,
    TASK,
    UNKNOWN,
    Bits,
    Level,
    code,
    code_level,
    code_numbers,
    finish,
    new_models,
    reader,
    writer,
)
from touchfield.errors import CorruptFile, InvalidArgument, TruncatedFile
from touchfield.medium.field import neighbour_slots
from touchfield.medium.grid import BRICK, Grid

# brick coordinates int32 [n, 3], ascending, and the mask of their samples, bool [n, 8, 8, 8]
Bricks = tuple[Int32s, Bools]
BRICKS_FREE: Final = 64
# a payload of n bytes lists at most `BRICKS_FREE` + 16 n bricks; each takes 6 KiB when decoded
BRICKS_PER_BYTE: Final = 16
_CHILDREN = np.stack(np.unravel_index(np.arange(8), (2, 2, 2)), axis=-1)


def pad_payload(payload: bytes, count: int) -> bytes:
    """Pad the payload of a frame of `count` bricks with zeros to its minimum length."""
    return payload.ljust(-(-(count - BRICKS_FREE) // BRICKS_PER_BYTE), b"\0")


def code_bricks(
    bits: Bits, contexts_at: int, sets_at: int, brick_shape: tuple[int, int, int],
    bricks: Int32s | None, previous: Int32s | None,
) -> Int32s:  # fmt: skip
    """Write or read a list of bricks.

    When reading, the length of the frame's payload bounds the number of bricks; when writing, `bits` needs a
    capacity of 320 bytes per brick. The models of the list are `LIST_CONTEXTS` probabilities from index
    `contexts_at` and `LIST_SETS` sets of weights from index `sets_at`. The grid has at most 2^20 bricks along
    an axis.

    `bricks`, int32 [n, 3], are distinct and within the grid; None when reading. `previous`, int32 [m, 3], is
    a reference list known to both sides, or None. Returns int32 [n, 3], ascending, x slowest. CorruptFile if
    the list exceeds its bound.
    """
    empty = np.zeros((0, 3), np.int32)
    target, reference = empty if bricks is None else bricks, empty if previous is None else previous
    max_bricks = BRICKS_FREE + BRICKS_PER_BYTE * len(bits.buffer)
    size = np.array(brick_shape, np.int64)
    boxes = np.zeros((int(code(bits, contexts_at, int(len(target) > 0))), 3), np.int64)
    for level in range(int(size.max() - 1).bit_length() - 1, -1, -1):
        boxes, is_occupied, level_boxes = _next_level(
            boxes, ((size - 1) >> level) + 1, target >> level, reference >> level
        )
        code_level(bits, level_boxes, contexts_at, sets_at, is_occupied)
        boxes = boxes[level_boxes.state[:-1] == 1]
        if bits.state[TASK] == READING and len(boxes) > max_bricks:
            expected = f"{max_bricks} at most in {len(bits.buffer)} bytes"
            raise CorruptFile("list of bricks", f"{len(boxes)} or more", expected)
    return boxes.astype(np.int32)


def _next_level(
    parents: Int64s, size: Int64s, target: NDArray[np.integer[Any]], previous: NDArray[np.integer[Any]]
) -> tuple[Int64s, NDArray[np.uint8], Level]:
    """Boxes of the next level, and the arguments of the kernel that codes them.

    Returns the boxes, int64 [n, 3], ascending; uint8 [n], 1 for boxes that contain bricks; and the `Level`.
    """
    boxes = (2 * parents[:, None] + _CHILDREN).reshape(-1, 3)
    order = np.flatnonzero((boxes < size).all(axis=1))
    steps = np.array(
        [(size[1] + 2) * (size[2] + 2), size[2] + 2, 1]
    )  # rows are padded, so that neighbours outside the grid have keys that belong to no box
    keys = boxes[order] @ steps
    ascending = np.argsort(keys)
    order, keys = order[ascending], keys[ascending]
    zero = np.zeros(1, np.uint8)
    return boxes[order], np.isin(keys, target @ steps).astype(np.uint8), Level(
        keys, order >> 3, np.bincount(order >> 3, minlength=len(parents)), np.zeros(len(parents), np.int64),
        np.append(np.isin(keys, previous @ steps), zero),
        np.append(np.full(len(keys), UNKNOWN, np.uint8), zero),
        np.array(NEIGHBOURS) @ steps, np.zeros(len(NEIGHBOURS), np.int64),
    )  # fmt: skip


def check_read(bits: Bits, where: str) -> None:
    """TruncatedFile if a payload ends before its code."""
    size, used = len(bits.buffer), int(bits.state[POSITION])
    if size < used - 6:  # six bytes are in the interval; trailing zeros are omitted
        raise TruncatedFile(where, f"the end of the code after {size} bytes", f"{used - 6} or more")


def check_end(bits: Bits, count: int, where: str) -> None:
    """Check that a payload ends with its code and the zeros of `pad_payload`.

    TruncatedFile if it ends earlier, CorruptFile if other bytes follow.
    """
    check_read(bits, where)
    size, used = len(bits.buffer), int(bits.state[POSITION])
    if size > max(used, len(pad_payload(b"", count))) or bits.buffer[used:].any():
        raise CorruptFile(where, "bytes behind the end of the code", f"{used} at most")


CONTEXTS: Final = kernels.LIST_CONTEXTS + kernels.SAMPLE_CONTEXTS
SETS: Final = kernels.LIST_SETS + kernels.SAMPLE_SETS

# capacity of a writer for each brick: a bit costs at most 14 bits, its probability being at least 4 / 65536
BYTES_PER_BRICK: Final = 320 + 14 * BRICK**3 // 8
_WHERE: Final = "support"


def code_support(
    bits: Bits, contexts_at: int, sets_at: int, grid: Grid, target: Bricks | None, previous: Bricks | None
) -> Bricks:
    """Write or read a support.

    When reading, the length of the code bounds the number of bricks (`code_bricks`); when writing, `bits`
    needs a capacity of `BYTES_PER_BRICK` bytes per brick, plus 64. The models are `CONTEXTS` probabilities
    from index `contexts_at` and `SETS` sets of weights from index `sets_at`.

    `target` is None when reading; otherwise its bricks ascend, each has a sample, and none is outside the
    grid. `previous` is a reference support on the same grid, known to both sides, or None. TruncatedFile or
    CorruptFile if the code ends too early, or lists too many bricks or one without a sample.
    """
    empty = np.zeros((0, 3), np.int32), np.zeros((0, BRICK, BRICK, BRICK), np.bool_)
    reference = empty if previous is None else previous
    bricks = code_bricks(bits, contexts_at, sets_at, grid.brick_shape, target and target[0], reference[0])
    reference_rows = np.append(_rows(reference[1]), np.zeros((1, BRICK**3), np.uint8), axis=0)
    supported = np.zeros((len(bricks) + 1, BRICK**3), np.uint8)
    samples = kernels.Samples(
        supported, reference_rows,
        neighbour_slots(bricks, bricks, grid.brick_shape),
        neighbour_slots(bricks, reference[0], grid.brick_shape),
        np.minimum(np.array(grid.shape) - BRICK * bricks.astype(np.int64), BRICK),
        np.zeros(1728, np.uint8), np.zeros(1728, np.uint8),
    )  # fmt: skip
    target_rows = supported[:-1] if target is None else _rows(target[1])
    offsets = contexts_at + kernels.LIST_CONTEXTS, sets_at + kernels.LIST_SETS
    kernels.code_samples(bits, *offsets, samples, target_rows)
    mask = supported[:-1].view(np.bool_).reshape(-1, BRICK, BRICK, BRICK)
    if bits.state[TASK] == READING:
        check_read(bits, _WHERE)
        if not mask.any(axis=(1, 2, 3)).all():
            raise CorruptFile(_WHERE, "a brick without samples", "none")
    return bricks, mask


def _rows(mask: Bools) -> NDArray[np.uint8]:
    return np.array(mask.reshape(-1, BRICK**3), np.uint8)


def encode_support(grid: Grid, bricks: Int32s, mask: Bools, previous: Bricks | None = None) -> bytes:
    """Code a support on its own.

    InvalidArgument if `code_support` cannot represent it.
    """
    bits = writer(len(bricks) * BYTES_PER_BRICK + 64, new_models(CONTEXTS, SETS))
    coded = code_support(bits, 0, 0, grid, (bricks, mask), previous)
    if not (
        np.array_equal(coded[0], bricks) and np.array_equal(coded[1], mask) and mask.any(axis=(1, 2, 3)).all()
    ):
        raise InvalidArgument(
            "support", "bricks out of order, or samples beyond the grid", "those of a field"
        )
    return pad_payload(finish(bits), len(bricks))


def decode_support(data: bytes, grid: Grid, previous: Bricks | None = None) -> Bricks:
    """The inverse of `encode_support`; TruncatedFile or CorruptFile for other bytes.

    Takes at most 40 KiB of memory per byte.
    """
    bits = reader(data, new_models(CONTEXTS, SETS))
    support = code_support(bits, 0, 0, grid, None, previous)
    check_end(bits, len(support[0]), _WHERE)
    return support


MAX_NUMBER: Final = (1 << 30) - 1  # largest magnitude of a coded number


def encode_numbers(numbers: NDArray[np.integer]) -> bytes:
    """Code whole numbers [n]; InvalidArgument if a magnitude exceeds `MAX_NUMBER`."""
    values = np.array(numbers, np.int64)
    if values.ndim != 1 or (len(values) and np.abs(values).max() > MAX_NUMBER):
        raise InvalidArgument(
            "numbers", f"shape {values.shape}, or one beyond 2^30 - 1", "one axis of smaller ones"
        )
    bits = writer(BYTES_PER_NUMBER * len(values) + 64, new_models(NUMBER_CONTEXTS, NUMBER_SETS))
    code_numbers(bits, 0, 0, values)
    return finish(bits)


def decode_numbers(data: bytes, count: int) -> Int64s:
    """The inverse of `encode_numbers`, int64 [count].

    The caller must have checked `count`, because that much memory is allocated. TruncatedFile or CorruptFile
    for other bytes.
    """
    bits, numbers = reader(data, new_models(NUMBER_CONTEXTS, NUMBER_SETS)), np.zeros(count, np.int64)
    code_numbers(bits, 0, 0, numbers)
    check_end(bits, 0, "whole numbers")
    if count and np.abs(numbers).max() > MAX_NUMBER:
        raise CorruptFile("whole numbers", f"{np.abs(numbers).max()}", f"{MAX_NUMBER} at most")
    return numbers
