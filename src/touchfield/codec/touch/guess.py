"""A field that is guessed of a frame before its voxels are told: by a spline, or column by column."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from touchfield.codec.touch import columns, spline
from touchfield.errors import CorruptFile, TruncatedFile

if TYPE_CHECKING:
    from touchfield.codec.touch.fixed_field import FixedField
    from touchfield.medium import Grid

__all__ = ["COLUMNS", "SPLINE", "synthesise"]

SPLINE: Final = 0
COLUMNS: Final = 1
"""The first byte of a guess."""


def synthesise(data: bytes, grid: Grid) -> FixedField:
    """The guess from its bytes; whole numbers throughout.

    Some 400 KiB are taken for each byte at most, beside 6 MiB.

    Raises
    ------
    TruncatedFile, CorruptFile
        If the bytes are not what the encoder writes.
    """
    if not data:
        raise TruncatedFile("guess", "no bytes", "its kind")
    if data[0] == SPLINE:
        return spline.synthesise(data[1:], grid)
    if data[0] == COLUMNS:
        return columns.synthesise(data[1:], grid)
    raise CorruptFile("guess", f"kind {data[0]}", f"{SPLINE} or {COLUMNS}")
