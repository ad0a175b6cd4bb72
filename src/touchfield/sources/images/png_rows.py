"""Checks that the data of a PNG has all its rows: Pillow fills rows that are missing with zeros, in silence.

Source: the PNG specification (third edition), sections 9 and 10 (filtering, compression).
"""

from __future__ import annotations

import struct
import zlib
from typing import IO, Any, Final

from numpy.typing import NDArray

from touchfield.errors import SourceError

_SIGNATURE_BYTES: Final = 8
_PIECE: Final = 1 << 16  # bytes that are decompressed at once
_CHANNELS: Final = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}


def require_all_rows(where: str, stream: IO[bytes], values: NDArray[Any] | None = None) -> None:
    """Raise `SourceError`, which names `where`, if the data of a PNG ends before its last row.

    `values` is the decoded picture, if it is there: if its last row has a sample other than 0, the data is
    whole. An interlaced picture that is cut is refused by Pillow itself.
    """
    stream.seek(_SIGNATURE_BYTES + 8)
    width, height, bits, colour, _, _, interlaced = struct.unpack(">IIBBBBB", stream.read(13))
    if interlaced or (values is not None and values[-1].any()):
        return
    needed = height * (1 + (width * bits * _CHANNELS.get(colour, 4) + 7) // 8)  # with the filter of each row
    found = _decompressed_bytes(stream, needed)
    if found < needed:
        held = f"data of {found} bytes for {width} x {height} pixels"
        raise SourceError(where, held, f"{needed} bytes, all rows", "Copy the file again.")


def _decompressed_bytes(stream: IO[bytes], enough: int) -> int:
    """Return how many bytes the data chunks hold, counted until there are `enough`."""
    decoder, count = zlib.decompressobj(), 0
    stream.seek(_SIGNATURE_BYTES)
    while count < enough and not decoder.eof:
        head = stream.read(8)
        if len(head) < 8:
            break
        size, kind = struct.unpack(">I4s", head)
        if kind != b"IDAT":
            stream.seek(size + 4, 1)
            continue
        data = stream.read(size)
        while data and count < enough and not decoder.eof:
            count += len(decoder.decompress(data, _PIECE))
            data = decoder.unconsumed_tail
        stream.seek(4, 1)
    return count
