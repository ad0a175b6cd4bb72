"""The support, coded without loss: which samples of a frame hold a force.

Paper section 5.2 codes amplitudes and directions of the supported samples and forgets to say where they are
(docs/theory.md 42). Here the bricks are told as a list (`brick_list`), then the samples of each, x slowest, each with
a chance learnt from its neighbours within two samples and, where it is given, from a support that is known already.
Samples beyond the grid are not coded.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.codec import brick_list
from touchfield.codec.brick_list import check_end, code_bricks, padded
from touchfield.codec.kernels import support as kernels
from touchfield.codec.kernels.bits import READING, TASK, Bits, end_of, fresh, reader, writer
from touchfield.errors import CorruptFile, InvalidArgument, TruncatedFile
from touchfield.medium.field import slots_around
from touchfield.medium.grid import BRICK, Grid

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Int32s = NDArray[np.int32]
    Int64s = NDArray[np.int64]
    Bricks = tuple[Int32s, NDArray[np.bool_]]
    """Brick coordinates int32 [n, 3], ascending, and the mask of their samples, bool [n, 8, 8, 8]."""

__all__ = ["CONTEXTS", "ROOM", "SETS", "code_support", "decode_support", "encode_support"]

CONTEXTS: Final = brick_list.CONTEXTS + kernels.CONTEXTS
SETS: Final = brick_list.SETS + kernels.SETS

ROOM: Final = 320 + 14 * BRICK**3 // 8
"""Bytes that a writer has for each brick: a bit costs 14 bits at most, as its chance is 4 of 65536 at least."""

_WHERE: Final = "support"


def code_support(
    bits: Bits, contexts_at: int, sets_at: int, grid: Grid, wanted: Bricks | None, before: Bricks | None
) -> Bricks:
    """Write or read a support.

    Parameters
    ----------
    bits : Bits
        A reader's length bounds the bricks, as `code_bricks` says. A writer has `ROOM` bytes a brick, and 64.
    contexts_at, sets_at : int
        Where its `CONTEXTS` chances and `SETS` weights begin.
    grid : Grid
    wanted : (int32 [n, 3], bool [n, 8, 8, 8]) or None
        Bricks in ascending order, with a sample in each and none beyond the grid; None when reading.
    before : (int32 [m, 3], bool [m, 8, 8, 8]) or None
        A support that both sides know, of the same grid.

    Raises
    ------
    TruncatedFile, CorruptFile
        If the code ends too early, lists more bricks than it may, or one without a sample.
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
    at = contexts_at + brick_list.CONTEXTS, sets_at + brick_list.SETS
    if not kernels.code_samples(bits, *at, samples, truth):
        raise TruncatedFile(_WHERE, f"the end of the code after {len(bits.buffer)} bytes", f"{len(bricks)} bricks")
    mask = held[:-1].view(np.bool_).reshape(-1, BRICK, BRICK, BRICK)
    if bits.state[TASK] == READING and not mask.any(axis=(1, 2, 3)).all():
        raise CorruptFile(_WHERE, "a brick without samples", "none")
    return bricks, mask


def _rows(mask: NDArray[np.bool_]) -> NDArray[np.uint8]:
    return np.array(mask.reshape(-1, BRICK**3), np.uint8)


def encode_support(grid: Grid, bricks: Int32s, mask: NDArray[np.bool_], previous: Bricks | None = None) -> bytes:
    """The bytes of a support by itself; see `code_support`.

    InvalidArgument if bricks are out of order or without a sample, or a sample is beyond the grid.
    """
    bits = writer(len(bricks) * ROOM + 64, fresh(CONTEXTS, SETS))
    told = code_support(bits, 0, 0, grid, (bricks, mask), previous)
    if not (np.array_equal(told[0], bricks) and np.array_equal(told[1], mask) and mask.any(axis=(1, 2, 3)).all()):
        raise InvalidArgument("support", "bricks out of order, or samples beyond the grid", "those of a field")
    return padded(end_of(bits), len(bricks))


def decode_support(data: bytes, grid: Grid, previous: Bricks | None = None) -> Bricks:
    """The inverse of `encode_support`: bricks, int32 [n, 3], and mask, bool [n, 8, 8, 8].

    TruncatedFile or CorruptFile for other bytes than it writes, each of which takes 40 KiB at most.
    """
    bits = reader(data, fresh(CONTEXTS, SETS))
    found = code_support(bits, 0, 0, grid, None, previous)
    check_end(bits, len(found[0]), _WHERE)
    return found
