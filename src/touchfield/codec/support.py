"""The support, coded without loss: which bricks of a frame there are, and which of their samples hold a
force.

Paper section 5.2 codes amplitudes and directions of the supported samples and forgets to say where they are
(docs/theory.md 42). The list of bricks is an octree, box by box and level by level: a box of 2^l bricks a
side is told at level l; those below it only where it holds bricks. Each level runs in raster order (x
slowest), so that a box knows half of its neighbours; of the others it knows whether their parents hold any.
Then come the samples of each brick, x slowest, each with a chance learnt from its neighbours within two
samples and, where it is given, from a support that is known already. Samples beyond the grid are not coded.

Whole numbers are bytes by the same arithmetic code (`encode_numbers`).
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Bools, Int32s, Int64s
from touchfield.codec import kernels
from touchfield.codec.kernels import (
    NEIGHBOURS,
    NUMBER_CONTEXTS,
    NUMBER_ROOM,
    NUMBER_SETS,
    PLACE,
    READING,
    TASK,
    UNKNOWN,
    Bits,
    Level,
    code,
    code_level,
    code_numbers,
    end_of,
    fresh,
    reader,
    writer,
)
from touchfield.errors import CorruptFile, InvalidArgument, TruncatedFile
from touchfield.medium.field import slots_around
from touchfield.medium.grid import BRICK, Grid

# brick coordinates int32 [n, 3], ascending, and the mask of their samples, bool [n, 8, 8, 8]
Bricks = tuple[Int32s, Bools]
BRICKS_FREE: Final = 64
# A payload of n bytes lists at most `BRICKS_FREE` + 16 n bricks, of 6 KiB each when decoded
BRICKS_PER_BYTE: Final = 16
_CHILDREN = np.stack(np.unravel_index(np.arange(8), (2, 2, 2)), axis=-1)


def padded(payload: bytes, count: int) -> bytes:
    """The payload of a frame of `count` bricks, with zeros where it is too short for them."""
    return payload.ljust(-(-(count - BRICKS_FREE) // BRICKS_PER_BYTE), b"\0")


def code_bricks(
    bits: Bits, contexts_at: int, sets_at: int, brick_shape: tuple[int, int, int],
    bricks: Int32s | None, before: Int32s | None,
) -> Int32s:  # fmt: skip
    """Write or read a list of bricks.

    A reader holds the whole payload of the frame, whose length bounds the list; a writer has room for 320
    bytes a brick. `LIST_CONTEXTS` chances and `LIST_SETS` weights of the list begin at `contexts_at` and
    `sets_at`; the grid has 2^20 bricks along an axis at most. `bricks`, int32 [n, 3], are distinct and within
    it, or None when reading; `before`, int32 [m, 3], a list that both sides know. Returns int32 [n, 3],
    ascending, x slowest. CorruptFile if the bytes tell of more bricks than they may.
    """
    none = np.zeros((0, 3), np.int32)
    wanted, known = none if bricks is None else bricks, none if before is None else before
    most = BRICKS_FREE + BRICKS_PER_BYTE * len(bits.buffer)
    size = np.array(brick_shape, np.int64)
    boxes = np.zeros((int(code(bits, contexts_at, int(len(wanted) > 0))), 3), np.int64)
    for level in range(int(size.max() - 1).bit_length() - 1, -1, -1):
        boxes, truth, made = _level(boxes, ((size - 1) >> level) + 1, wanted >> level, known >> level)
        code_level(bits, made, contexts_at, sets_at, truth)
        boxes = boxes[made.state[:-1] == 1]
        if bits.state[TASK] == READING and len(boxes) > most:
            expected = f"{most} at most in {len(bits.buffer)} bytes"
            raise CorruptFile("list of bricks", f"{len(boxes)} or more", expected)
    return boxes.astype(np.int32)


def _level(
    parents: Int64s, size: Int64s, wanted: NDArray[np.integer[Any]], before: NDArray[np.integer[Any]]
) -> tuple[Int64s, NDArray[np.uint8], Level]:
    """The boxes of a level, int64 [n, 3] ascending, those that are wanted, and what the kernel needs."""
    boxes = (2 * parents[:, None] + _CHILDREN).reshape(-1, 3)
    order = np.flatnonzero((boxes < size).all(axis=1))
    steps = np.array([(size[1] + 2) * (size[2] + 2), size[2] + 2, 1])  # with room between the rows
    keys = boxes[order] @ steps
    ascending = np.argsort(keys)
    order, keys = order[ascending], keys[ascending]
    none = np.zeros(1, np.uint8)
    return boxes[order], np.isin(keys, wanted @ steps).astype(np.uint8), Level(
        keys, order >> 3, np.bincount(order >> 3, minlength=len(parents)), np.zeros(len(parents), np.int64),
        np.append(np.isin(keys, before @ steps), none), np.append(np.full(len(keys), UNKNOWN, np.uint8), none),
        np.array(NEIGHBOURS) @ steps, np.zeros(len(NEIGHBOURS), np.int64),
    )  # fmt: skip


def check_read(bits: Bits, where: str) -> None:
    """Refuse a payload that ends before its code does."""
    size, used = len(bits.buffer), int(bits.state[PLACE])
    if size < used - 6:  # what is held in the interval, and left away where it is zero
        raise TruncatedFile(where, f"the end of the code after {size} bytes", f"{used - 6} or more")


def check_end(bits: Bits, count: int, where: str) -> None:
    """Refuse a payload that ends before its code does, or goes on behind it and the zeros of `padded`."""
    check_read(bits, where)
    size, used = len(bits.buffer), int(bits.state[PLACE])
    if size > max(used, len(padded(b"", count))) or bits.buffer[used:].any():
        raise CorruptFile(where, "bytes behind the end of the code", f"{used} at most")


CONTEXTS: Final = kernels.LIST_CONTEXTS + kernels.SAMPLE_CONTEXTS
SETS: Final = kernels.LIST_SETS + kernels.SAMPLE_SETS

# bytes that a writer has for each brick: a bit costs 14 bits at most, as its chance is 4 of 65536 at least
ROOM: Final = 320 + 14 * BRICK**3 // 8
_WHERE: Final = "support"


def code_support(
    bits: Bits, contexts_at: int, sets_at: int, grid: Grid, wanted: Bricks | None, before: Bricks | None
) -> Bricks:
    """Write or read a support.

    A reader's length bounds the bricks, as `code_bricks` says; a writer has `ROOM` bytes a brick, and 64.
    `CONTEXTS` chances and `SETS` weights begin at `contexts_at` and `sets_at`. The bricks `wanted` ascend,
    with a sample in each and none beyond the grid, or are None when reading; `before` is a support that both
    sides know, of the same grid. TruncatedFile or CorruptFile if the code ends too early, lists more bricks
    than it may, or one without a sample.
    """
    none = np.zeros((0, 3), np.int32), np.zeros((0, BRICK, BRICK, BRICK), np.bool_)
    known = none if before is None else before
    bricks = code_bricks(bits, contexts_at, sets_at, grid.brick_shape, wanted and wanted[0], known[0])
    listed = np.append(_rows(known[1]), np.zeros((1, BRICK**3), np.uint8), axis=0)
    held = np.zeros((len(bricks) + 1, BRICK**3), np.uint8)
    samples = kernels.Samples(
        held, listed,
        slots_around(bricks, bricks, grid.brick_shape), slots_around(bricks, known[0], grid.brick_shape),
        np.minimum(np.array(grid.shape) - BRICK * bricks.astype(np.int64), BRICK),
        np.zeros(1728, np.uint8), np.zeros(1728, np.uint8),
    )  # fmt: skip
    truth = held[:-1] if wanted is None else _rows(wanted[1])
    at = contexts_at + kernels.LIST_CONTEXTS, sets_at + kernels.LIST_SETS
    kernels.code_samples(bits, *at, samples, truth)
    mask = held[:-1].view(np.bool_).reshape(-1, BRICK, BRICK, BRICK)
    if bits.state[TASK] == READING:
        check_read(bits, _WHERE)
        if not mask.any(axis=(1, 2, 3)).all():
            raise CorruptFile(_WHERE, "a brick without samples", "none")
    return bricks, mask


def _rows(mask: Bools) -> NDArray[np.uint8]:
    return np.array(mask.reshape(-1, BRICK**3), np.uint8)


def encode_support(grid: Grid, bricks: Int32s, mask: Bools, previous: Bricks | None = None) -> bytes:
    """The bytes of a support by itself; InvalidArgument if it is none that `code_support` takes."""
    bits = writer(len(bricks) * ROOM + 64, fresh(CONTEXTS, SETS))
    told = code_support(bits, 0, 0, grid, (bricks, mask), previous)
    if not (
        np.array_equal(told[0], bricks) and np.array_equal(told[1], mask) and mask.any(axis=(1, 2, 3)).all()
    ):
        raise InvalidArgument(
            "support", "bricks out of order, or samples beyond the grid", "those of a field"
        )
    return padded(end_of(bits), len(bricks))


def decode_support(data: bytes, grid: Grid, previous: Bricks | None = None) -> Bricks:
    """The inverse of `encode_support`; TruncatedFile or CorruptFile for other bytes. A byte takes 40 KiB at
    most.
    """
    bits = reader(data, fresh(CONTEXTS, SETS))
    found = code_support(bits, 0, 0, grid, None, previous)
    check_end(bits, len(found[0]), _WHERE)
    return found


LARGEST: Final = (1 << 30) - 1  # no number is farther from zero


def encode_numbers(numbers: NDArray[np.integer]) -> bytes:
    """The code of whole numbers [n]. InvalidArgument if one is beyond `LARGEST`."""
    told = np.array(numbers, np.int64)
    if told.ndim != 1 or (len(told) and np.abs(told).max() > LARGEST):
        raise InvalidArgument(
            "numbers", f"shape {told.shape}, or one beyond 2^30 - 1", "one axis of smaller ones"
        )
    bits = writer(NUMBER_ROOM * len(told) + 64, fresh(NUMBER_CONTEXTS, NUMBER_SETS))
    code_numbers(bits, 0, 0, told)
    return end_of(bits)


def decode_numbers(data: bytes, count: int) -> Int64s:
    """The inverse of `encode_numbers`: int64 [count], a sound one; TruncatedFile or CorruptFile for other
    bytes.
    """
    bits, numbers = reader(data, fresh(NUMBER_CONTEXTS, NUMBER_SETS)), np.zeros(count, np.int64)
    code_numbers(bits, 0, 0, numbers)
    check_end(bits, 0, "whole numbers")
    if count and np.abs(numbers).max() > LARGEST:
        raise CorruptFile("whole numbers", f"{np.abs(numbers).max()}", f"{LARGEST} at most")
    return numbers
