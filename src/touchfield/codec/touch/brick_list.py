"""The list of bricks at the head of a frame: a support (`codec.support`) of bricks that are all full."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from touchfield.codec.support import decode_support, encode_support
from touchfield.codec.varint import read_varint, write_varint
from touchfield.errors import CorruptFile, TruncatedFile
from touchfield.medium.grid import BRICK

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.codec.touch.frame_model import Known
    from touchfield.medium import Grid

__all__ = ["read_bricks", "write_bricks"]


def write_bricks(known: Known, bricks: NDArray[np.int32]) -> bytes:
    """A chunk that lists bricks, int32 [n, 3], ascending."""
    listed = encode_support(known.grid, bricks, _whole(known.grid, bricks), _before(known))
    return write_varint(len(listed)) + listed


def read_bricks(payload: bytes, known: Known, where: str) -> tuple[NDArray[np.int32], int]:
    """The bricks of `write_bricks`, and where the chunk ends.

    Raises
    ------
    CorruptFile, TruncatedFile
        If the bytes are not what it writes.
    """
    size, at = read_varint(payload, 0, where, len(payload) + 1)
    end = at + size
    if end > len(payload):
        raise TruncatedFile(where, f"{len(payload)} bytes", f"{end} for the list of bricks")
    bricks, mask = decode_support(payload[at:end], known.grid, _before(known))
    if not np.array_equal(mask, _whole(known.grid, bricks)):
        raise CorruptFile(where, "a brick listed in part", "whole bricks")
    return bricks, end


def _before(known: Known) -> tuple[NDArray[np.int32], NDArray[np.bool_]] | None:
    if known.previous is None:
        return None
    return known.previous.bricks, _whole(known.grid, known.previous.bricks)


def _whole(grid: Grid, bricks: NDArray[np.int32]) -> NDArray[np.bool_]:
    """The samples of bricks that lie within the grid, bool [n, 8, 8, 8]."""
    left = np.asarray(grid.shape) - bricks.astype(np.int64) * BRICK
    if len(bricks) == 0 or left.min() >= BRICK:
        return np.ones((len(bricks), BRICK, BRICK, BRICK), np.bool_)
    x, y, z = (np.arange(BRICK) < left[:, axis, None] for axis in range(3))
    return x[:, :, None, None] & y[:, None, :, None] & z[:, None, None, :]
