"""The list of bricks of a frame: an octree of the grid's bricks, box by box and level by level.

A box of 2^l bricks a side is told at level l; those below it only where it holds bricks. Each level runs in raster
order (x slowest), so that a box knows half of its neighbours; of the others it knows whether their parents hold any.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.codec.kernels.bits import PLACE, READING, TASK, Bits, code
from touchfield.codec.kernels.brick_list import CONTEXTS, NEIGHBOURS, SETS, UNKNOWN, Level, code_level
from touchfield.errors import CorruptFile, TruncatedFile

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Bricks = NDArray[np.int32]
    Int64s = NDArray[np.int64]

__all__ = ["BRICKS_FREE", "BRICKS_PER_BYTE", "CONTEXTS", "SETS", "check_end", "code_bricks", "padded"]

BRICKS_FREE: Final = 64
BRICKS_PER_BYTE: Final = 16
"""A payload of n bytes lists at most `BRICKS_FREE` + 16 n bricks, of 6 KiB each when decoded."""

_CHILDREN = np.stack(np.unravel_index(np.arange(8), (2, 2, 2)), axis=-1)


def padded(payload: bytes, count: int) -> bytes:
    """The payload of a frame of `count` bricks, with zeros where it is too short for them."""
    return payload.ljust(-(-(count - BRICKS_FREE) // BRICKS_PER_BYTE), b"\0")


def code_bricks(
    bits: Bits, contexts_at: int, sets_at: int, brick_shape: tuple[int, int, int],
    bricks: Bricks | None, before: Bricks | None,
) -> Bricks:  # fmt: skip
    """Write or read a list of bricks.

    Parameters
    ----------
    bits : Bits
        A reader holds the whole payload of the frame, whose length bounds the list. A writer has room for 320 bytes
        a brick.
    contexts_at, sets_at : int
        Where `CONTEXTS` chances and `SETS` weights of the list begin.
    brick_shape : (int, int, int)
        Bricks of the grid along each axis, 2^20 at most.
    bricks : int32 [n, 3] or None
        Distinct and within the grid; None when reading.
    before : int32 [m, 3] or None
        A list that both sides know, of the same grid.

    Returns
    -------
    int32 [n, 3]
        Ascending, x slowest.

    Raises
    ------
    CorruptFile
        If the bytes tell of more bricks than they may.
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
            raise CorruptFile(
                "list of bricks", f"{len(boxes)} or more", f"{most} at most in {len(bits.buffer)} bytes"
            )
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


def check_end(bits: Bits, count: int, where: str) -> None:
    """Refuse a payload that ends before its code does, or goes on behind it and the zeros of `padded`.

    Raises
    ------
    TruncatedFile, CorruptFile
    """
    size, used = len(bits.buffer), int(bits.state[PLACE])
    if size < used - 6:
        raise TruncatedFile(where, f"{size} bytes", f"{used - 6} or more")
    if size > max(used, len(padded(b"", count))) or bits.buffer[used:].any():
        raise CorruptFile(where, "bytes behind the end of the code", f"{used} at most")
