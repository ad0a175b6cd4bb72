"""Depth pictures as PGM, as written by some robots: 16 bits, most significant first."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import depth_makers as make
from touchfield.errors import SourceError
from touchfield.sources.images.pictures import picture_header, read_picture
from touchfield.sources.options import SourceOptions
from touchfield.sources.registry import open_source


def write_pgm(path: Path, values: np.ndarray, largest: int, comment: str = "") -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    head = f"P5\n{comment}{values.shape[1]} {values.shape[0]}\n{largest}\n".encode("ascii")
    path.write_bytes(head + values.astype(">u2" if largest > 255 else "u1").tobytes())
    return path


@pytest.mark.parametrize(("largest", "sample"), [(65535, "uint16"), (256, "uint16"), (255, "uint8")])
def test_samples_are_unchanged(tmp_path: Path, largest: int, sample: str) -> None:
    values = np.arange(12).reshape(3, 4) * (largest // 12)
    path = write_pgm(tmp_path / "a.pgm", values, largest, "# a camera's\n")
    header = picture_header(path)
    assert (header.width, header.height, header.sample, header.channels) == (4, 3, sample, 1)
    read = read_picture(path)
    assert read.dtype == sample
    np.testing.assert_array_equal(read, values)


@pytest.mark.parametrize(
    "data",
    [b"P5\n4 3\n", b"P5\n4 3\n0\n" + bytes(24), b"P5\n4 3\n65535\n" + bytes(23), b"P5 999999 999999 255\n"],
)
def test_a_damaged_picture_is_refused(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "a.pgm"
    path.write_bytes(data)
    with pytest.raises(SourceError, match=r"a\.pgm"):
        read_picture(path)


def test_a_folder_of_pgm_is_read(tmp_path: Path) -> None:
    for i, depth in enumerate(make.depths_mm()):
        write_pgm(tmp_path / "depth" / f"{i + 1}.pgm", depth, 65535)
    make.write_intrinsics(tmp_path / "intrinsics.txt")
    scene = open_source(tmp_path, SourceOptions(depth_scale=1000))
    assert scene.frame_count == make.FRAMES
    np.testing.assert_allclose(scene.sequence.depth_m(1), make.depths_mm()[1] / 1000, rtol=1e-6)  # type: ignore[attr-defined]
