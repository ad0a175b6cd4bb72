"""Forces written as ``.vti`` and ``.pvd`` are read again; those of other programs, too."""

from __future__ import annotations

import base64
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest

from touchfield.errors import SourceError
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.medium.stores.vti import write_vti
from touchfield.medium.stores.vti_reader import read_vti
from touchfield.sources.registry import open_source

GRID = Grid((5, 9, 3), (0.1, 0.2, 0.3), (1.0, -2.0, 0.5))


def medium(frames: int) -> HapticMedium:
    rng = np.random.default_rng(3)
    fields = [ForceField.from_dense(GRID, rng.normal(size=(*GRID.shape, 3))) for _ in range(frames)]
    return HapticMedium.from_frames(fields, 12.5)


@pytest.mark.parametrize("frames", [1, 3])
def test_what_is_written_is_read_again(tmp_path: Path, frames: int) -> None:
    before = medium(frames)
    path = write_vti(tmp_path / "a.vti", before)
    after = read_vti(path)
    assert (after.grid, after.rate_hz, len(after), after.axes) == (GRID, 12.5, frames, before.axes)
    assert all(after[i] == before[i] for i in range(frames))
    scene = open_source(path)
    assert scene.stored is not None and scene.stored[0] == before[0]


def foreign(path: Path, form: str, is_compressed: bool) -> np.ndarray:
    """A file of another program: float64, sizes of 32 bits, an array that is no force first."""
    values = np.arange(3 * GRID.voxel_count, dtype="<f8")
    raw, text, appended = values.tobytes(), "", b""
    if is_compressed:
        blocks = [zlib.compress(raw[i : i + 500]) for i in range(0, len(raw), 500)]
        head = struct.pack(f"<{3 + len(blocks)}I", len(blocks), 500, len(raw) % 500, *map(len, blocks))
        parts = [head, b"".join(blocks)]
    else:
        parts = [struct.pack("<I", len(raw)) + raw]
    if form == "ascii":
        text = " ".join(map(str, values))
    elif form == "binary":
        text = "".join(base64.b64encode(part).decode() for part in parts)
    else:
        encoded = b"".join(parts if form == "raw" else map(base64.b64encode, parts))
        encoding = "raw" if form == "raw" else "base64"
        appended = f'<AppendedData encoding="{encoding}">_'.encode() + encoded + b"</AppendedData>"
    name = form if form in ("ascii", "binary") else "appended"
    compressor = ' compressor="vtkZLibDataCompressor"' if is_compressed else ""
    head_text = f"""<VTKFile type="ImageData" byte_order="LittleEndian"{compressor}>
<ImageData WholeExtent="0 4 0 8 0 2" Origin="1 -2 0.5" Spacing="0.1 0.2 0.3"><Piece Extent="0 4 0 8 0 2">
<PointData><DataArray type="Float64" Name="forces" NumberOfComponents="3" format="{name}" offset="0">{text}
</DataArray></PointData></Piece></ImageData>"""
    path.write_bytes(head_text.encode() + appended + b"</VTKFile>")
    return values.reshape(3, 9, 5, 3).transpose(2, 1, 0, 3)


@pytest.mark.parametrize("is_compressed", [False, True])
@pytest.mark.parametrize("form", ["ascii", "binary", "raw", "base64"])
def test_files_of_other_programs(tmp_path: Path, form: str, is_compressed: bool) -> None:
    expected = foreign(tmp_path / "a.vti", form, is_compressed)
    read = read_vti(tmp_path / "a.vti")
    assert read.grid == GRID
    np.testing.assert_array_equal(read[0].to_dense(), expected.astype(np.float32))


def test_faults_are_one_line_with_the_file(tmp_path: Path) -> None:
    path = tmp_path / "a.vti"
    foreign(path, "raw", True)
    whole = path.read_bytes()
    for broken in (whole[: len(whole) // 2], whole.replace(b"ImageData", b"PolyData"), b"nothing", b""):
        path.write_bytes(broken)
        with pytest.raises(SourceError, match=r"a\.vti"):
            read_vti(path)
