"""Depth pictures in files: each form round-trips; damage and decompression bombs are one clear error."""

from __future__ import annotations

import struct
import zlib
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp
from PIL import Image

from touchfield.errors import SourceError
from touchfield.sources.images import pictures

shapes = hnp.array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=9)


@given(hnp.arrays(st.sampled_from([np.uint8, np.uint16]), shapes), st.sampled_from([".png", ".tif"]))
def test_integer_pictures_round_trip(
    tmp_path_factory: pytest.TempPathFactory, values: np.ndarray, suffix: str
) -> None:
    path = tmp_path_factory.mktemp("p") / f"a{suffix}"
    Image.fromarray(values).save(path)
    read = pictures.read_picture(path)
    assert read.dtype == values.dtype
    assert np.array_equal(read, values)


@given(
    hnp.arrays(
        st.sampled_from(["<u2", ">u2", "<f4", ">f8", "<i4", "u1", "<f2"]), shapes, elements=st.integers(0, 99)
    ),
    st.booleans(),
)
def test_npy_pictures_round_trip(
    tmp_path_factory: pytest.TempPathFactory, values: np.ndarray, is_fortran: bool
) -> None:
    path = tmp_path_factory.mktemp("p") / "a.npy"
    np.save(path, np.asfortranarray(values) if is_fortran else values)
    read = pictures.read_picture(path)
    assert np.array_equal(read, values)
    assert read.dtype.isnative and read.flags.c_contiguous and read.flags.writeable


def test_float_tiff_round_trips(tmp_path: Path) -> None:
    values = np.linspace(0, 3, 12, dtype=np.float32).reshape(3, 4)
    Image.fromarray(values).save(tmp_path / "a.tiff")
    assert np.array_equal(pictures.read_picture(tmp_path / "a.tiff"), values)
    assert pictures.picture_header(tmp_path / "a.tiff") == pictures.PictureHeader(4, 3, "float32", 1)


@pytest.mark.filterwarnings("ignore:Corrupt EXIF:UserWarning")
@pytest.mark.parametrize("suffix", [".png", ".npy", ".tif"])
def test_a_picture_cut_anywhere_is_a_source_error(tmp_path: Path, suffix: str) -> None:
    intact, cut = tmp_path / f"whole{suffix}", tmp_path / f"cut{suffix}"
    values = np.random.default_rng(1).integers(0, 65535, (6, 7)).astype(np.uint16)
    if suffix == ".npy":
        np.save(intact, values)
    else:
        Image.fromarray(values).save(intact)
    data = intact.read_bytes()
    needed = len(data) - (
        20 if suffix == ".png" else 0
    )  # all pixels are present even without the checksums and the last chunk
    for length in range(needed):
        cut.write_bytes(data[:length])
        with pytest.raises(SourceError, match="cut"):
            pictures.read_picture(cut)


@pytest.mark.filterwarnings("ignore::UserWarning")
@given(st.sampled_from([".png", ".npy", ".tif"]), st.integers(0, 400), st.integers(1, 255))
def test_a_flipped_byte_gives_an_array_or_a_source_error(
    tmp_path_factory: pytest.TempPathFactory, suffix: str, at: int, flip: int
) -> None:
    path = tmp_path_factory.mktemp("p") / f"a{suffix}"
    values = np.arange(42, dtype=np.uint16).reshape(6, 7) * 999
    if suffix == ".npy":
        np.save(path, values)
    else:
        Image.fromarray(values).save(path)
    data = bytearray(path.read_bytes())
    data[at % len(data)] ^= flip
    path.write_bytes(bytes(data))
    with suppress(SourceError):
        assert pictures.read_picture(path).ndim == 2


def _png_of(width: int, height: int) -> bytes:
    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    head = struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0)
    body = zlib.compress(bytes(1000))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", body) + chunk(b"IEND", b"")


@pytest.mark.parametrize(
    ("width", "height", "message"),
    [(60000, 60000, "at most"), (8000, 8000, "in .* bytes"), (0, 5, "at least one")],
)
def test_a_bomb_is_refused_from_its_header(tmp_path: Path, width: int, height: int, message: str) -> None:
    path = tmp_path / "bomb.png"
    path.write_bytes(_png_of(width, height))
    with pytest.raises(SourceError, match=message):
        pictures.read_picture(path)


@pytest.mark.parametrize("dtype", ["O", "<c8", "<U4", [("a", "<f4")]])
def test_an_npy_without_numbers_is_refused(tmp_path: Path, dtype: object) -> None:
    np.save(tmp_path / "a.npy", np.zeros((2, 2), dtype), allow_pickle=True)  # type: ignore[call-overload]
    with pytest.raises(SourceError, match="numbers"):
        pictures.read_picture(tmp_path / "a.npy")


def test_an_npy_with_a_too_large_header_is_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.zeros((2, 2), np.float64))
    intact = (tmp_path / "a.npy").read_bytes()
    data = intact.replace(b"(2, 2), }      ", b"(8000, 8000), }")
    assert b"8000" in data
    (tmp_path / "a.npy").write_bytes(data)
    with pytest.raises(SourceError, match=r"8000.* bytes"):
        pictures.read_picture(tmp_path / "a.npy")
    for data, message in (
        (intact + b"\0", r"161 bytes; expected numbers in 160 bytes"),
        (intact.replace(b"(2, 2), }  ", b"(-2, -2), }"), r"the shape \(-2, -2\)"),
        (intact.replace(b"(2, 2), }   ", b"(2, 2, 1, 1)}"), r"an array of shape \(2, 2, 1, 1\)"),
    ):
        (tmp_path / "a.npy").write_bytes(data)
        with pytest.raises(SourceError, match=message):
            pictures.read_picture(tmp_path / "a.npy")
