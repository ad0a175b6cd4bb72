"""Writes a medium as VTK ImageData (``.vti``), for ParaView and other VTK programs.

Format: "VTK File Formats", XML formats, ImageData; raw appended data in zlib blocks, 64-bit sizes. The format
allows several time steps in one file, but VTK 9.7 does not write or read those of an ImageData correctly (its
reader returns the first step for all). A medium of several frames is therefore written as numbered ``.vti``
files and a ``.pvd`` collection, which lists their times.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import IO, Any, Final
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from touchfield.atomic import atomic_path
from touchfield.compute.threads import Progress, silent
from touchfield.medium.medium import HapticMedium

BLOCK_BYTES: Final = 1 << 20
DEFLATE_LEVEL: Final = 1


def write_vti(
    path: str | Path,
    medium: HapticMedium,
    report: Progress = silent,
    attributes: Mapping[str, Sequence[float]] = MappingProxyType({}),
) -> Path:
    """Write a medium for ParaView.

    path : str or Path; a single frame is written to this file. Several frames are written to
        ``NAME_00000.vti`` and so on, and ``NAME.pvd`` is the file to open.
    report : callable; called as ``report(written, frames)`` after each frame.
    attributes : mapping of str to numbers; further field data.
    Returns the path of the file to open. Raises `InvalidArgument` if the folder does not exist; `SourceError`
    if a file cannot be written.
    """
    path = Path(path)
    is_single = len(medium) == 1
    files = [path if is_single else path.with_name(f"{path.stem}_{i:05d}.vti") for i in range(len(medium))]
    for i, file in enumerate(files):
        _write_frame(file, medium, i, attributes)
        report(i + 1, len(medium))
    if is_single:
        return path
    collection = path.with_suffix(".pvd")
    sets = "".join(
        f'    <DataSet timestep="{i / medium.rate_hz!r}" part="0" file={quoteattr(file.name)}/>\n'
        for i, file in enumerate(files)
    )
    text = (
        '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1" byte_order="LittleEndian">\n'
        f"  <Collection>\n{sets}  </Collection>\n</VTKFile>\n"
    )
    with atomic_path(collection) as temporary:
        temporary.write_text(text, "utf-8")
    return collection


def _write_frame(
    path: Path, medium: HapticMedium, index: int, attributes: Mapping[str, Sequence[float]]
) -> None:
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        stream.write(_head(medium, index, attributes))
        # VTK stores x fastest: slabs along z
        _write_blocks(
            stream, 12 * medium.grid.voxel_count, (s.transpose(2, 1, 0, 3) for s in medium[index].slabs(2))
        )
        stream.write(b"\n  </AppendedData>\n</VTKFile>\n")


def _head(medium: HapticMedium, index: int, attributes: Mapping[str, Sequence[float]]) -> bytes:
    """Return the part of the file before the forces."""
    grid = medium.grid
    extent = " ".join(f"0 {n - 1}" for n in grid.shape)
    origin, spacing = (" ".join(repr(x) for x in triple) for triple in (grid.origin_m, grid.spacing_m))
    axes = " ".join(str(byte) for byte in (*medium.axes.encode("utf-8"), 0))
    number = 'DataArray type="Float64" NumberOfTuples="1" format="ascii"'
    more = "".join(
        f'      <DataArray type="Float64" NumberOfTuples="{len(values)}" format="ascii" '
        f"Name={quoteattr(name)}>"
        f"{' '.join(repr(float(v)) for v in values)}</DataArray>\n"
        for name, values in attributes.items()
    )
    text = f"""<?xml version="1.0"?>
<VTKFile type="ImageData" version="1.0" byte_order="LittleEndian" header_type="UInt64" \
compressor="vtkZLibDataCompressor">
  <ImageData WholeExtent="{extent}" Origin="{origin}" Spacing="{spacing}">
    <FieldData>
      <{number} Name="TimeValue">{index / medium.rate_hz!r}</DataArray>
      <{number} Name="rate_hz">{float(medium.rate_hz)!r}</DataArray>
      <Array type="String" Name="axes" NumberOfTuples="1" format="ascii">{axes}</Array>
{more}    </FieldData>
    <Piece Extent="{extent}">
      <PointData Vectors="force_n">
        <DataArray type="Float32" Name="force_n" NumberOfComponents="3" format="appended" offset="0"/>
      </PointData>
    </Piece>
  </ImageData>
  <AppendedData encoding="raw">
   _"""
    return text.encode("utf-8")


def _write_blocks(stream: IO[bytes], total: int, pieces: Iterable[NDArray[Any]]) -> None:
    """Write an array: the table of block sizes, then the compressed blocks.

    `total` is the size of the array in bytes before compression.
    """
    blocks = -(-total // BLOCK_BYTES)
    table = stream.tell()
    stream.write(bytes(8 * (3 + blocks)))
    sizes = [blocks, BLOCK_BYTES, total % BLOCK_BYTES]
    waiting = bytearray()
    for piece in pieces:
        waiting += np.ascontiguousarray(piece, "<f4").data.cast("B")
        while len(waiting) >= BLOCK_BYTES:
            sizes.append(stream.write(zlib.compress(waiting[:BLOCK_BYTES], DEFLATE_LEVEL)))
            del waiting[:BLOCK_BYTES]
    if waiting:
        sizes.append(stream.write(zlib.compress(waiting, DEFLATE_LEVEL)))
    end = stream.tell()
    stream.seek(table)
    stream.write(struct.pack(f"<{len(sizes)}Q", *sizes))
    stream.seek(end)
