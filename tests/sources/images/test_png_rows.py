"""PNG files whose data has fewer rows than their header states, which Pillow fills with zeros, in silence."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest

from touchfield.errors import SourceError
from touchfield.sources.images import movies, pictures

PASSES = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2))


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png(samples: np.ndarray, kept: float = 1.0, interlaced: bool = False) -> bytes:
    """Grey samples of 8 or 16 bits, or RGB of 8, of whose data the first part is `kept`."""
    bits, colour = 8 * samples.itemsize, 2 if samples.ndim == 3 else 0
    big = samples.astype(samples.dtype.newbyteorder(">"))
    parts = [big[y::dy, x::dx] for x, y, dx, dy in PASSES] if interlaced else [big]
    raw = b"".join(b"\0" + row.tobytes() for part in parts if part.size for row in part)
    height, width = samples.shape[:2]
    head = struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, int(interlaced))
    data = zlib.compress(raw[: round(kept * len(raw))])
    pieces = [chunk(b"IDAT", data[:20]), chunk(b"IDAT", data[20:])]
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + b"".join(pieces) + chunk(b"IEND", b"")


@pytest.mark.parametrize("interlaced", [False, True])
@pytest.mark.parametrize(("height", "width"), [(1, 1), (3, 9), (8, 8), (13, 5)])
def test_whole_pictures_are_read_whatever_their_last_row(
    tmp_path: Path, interlaced: bool, height: int, width: int
) -> None:
    samples = np.random.default_rng(2).integers(1, 60000, (height, width)).astype(np.uint16)
    for last in (samples[-1].copy(), 0):
        samples[-1] = last
        (tmp_path / "a.png").write_bytes(png(samples, interlaced=interlaced))
        assert np.array_equal(pictures.read_picture(tmp_path / "a.png"), samples)


def test_missing_rows_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "depth.png"
    path.write_bytes(png(np.full((40, 9), 1200, np.uint16), kept=0.5))
    with pytest.raises(SourceError, match=r"depth\.png: found data of 380 bytes for 9 x 40 pixels"):
        pictures.read_picture(path)


def test_missing_passes_are_refused(tmp_path: Path) -> None:
    """Pillow itself reports these."""
    (tmp_path / "a.png").write_bytes(png(np.full((40, 9), 1200, np.uint16), kept=0.5, interlaced=True))
    with pytest.raises(SourceError, match=r"a\.png: found a picture that is damaged"):
        pictures.read_picture(tmp_path / "a.png")


def test_missing_rows_of_colours_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "colours.png"
    path.write_bytes(png(np.full((4, 6, 3), 90, np.uint8), kept=0.75))
    with pytest.raises(SourceError, match="found data of 57 bytes for 6 x 4 pixels"):
        pictures.read_map(path)
    with pytest.raises(SourceError, match="found data of 57 bytes for 6 x 4 pixels"):
        movies.ColourPictures((path,))
