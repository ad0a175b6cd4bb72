"""The list of bricks at the head of a frame: a support (`codec.support`) of bricks that are all full."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from touchfield.codec.support import decode_support, encode_support, whole_rows
from touchfield.codec.varint import read_varint, write_varint
from touchfield.errors import CorruptFile, TruncatedFile

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.codec.touch.fixed_field import FixedField
    from touchfield.medium import Grid

__all__ = ["read_bricks", "write_bricks"]


def write_bricks(grid: Grid, bricks: NDArray[np.int32], previous: FixedField | None = None) -> bytes:
    """A chunk that lists bricks, int32 [n, 3], ascending; `previous` is known to the decoder."""
    listed = encode_support(grid, bricks, _whole(grid, bricks), _before(grid, previous))
    return write_varint(len(listed)) + listed


def read_bricks(
    payload: bytes, at: int, grid: Grid, where: str, previous: FixedField | None = None
) -> tuple[NDArray[np.int32], int]:
    """The bricks of `write_bricks`, whose chunk begins at `at`, and where it ends.

    Raises
    ------
    CorruptFile, TruncatedFile
        If the bytes are not what it writes.
    """
    size, at = read_varint(payload, at, where, len(payload) + 1)
    end = at + size
    if end > len(payload):
        raise TruncatedFile(where, f"{len(payload)} bytes", f"{end} for the list of bricks")
    bricks, mask = decode_support(payload[at:end], grid, _before(grid, previous))
    if not np.array_equal(mask, _whole(grid, bricks)):
        raise CorruptFile(where, "a brick listed in part", "whole bricks")
    return bricks, end


def _before(grid: Grid, previous: FixedField | None) -> tuple[NDArray[np.int32], NDArray[np.bool_]] | None:
    return None if previous is None else (previous.bricks, _whole(grid, previous.bricks))


def _whole(grid: Grid, bricks: NDArray[np.int32]) -> NDArray[np.bool_]:
    """The samples of bricks that lie within the grid, bool [n, 8, 8, 8]."""
    bits = np.unpackbits(whole_rows(grid, bricks)[..., None], axis=-1, bitorder="little")
    return bits.view(np.bool_)
