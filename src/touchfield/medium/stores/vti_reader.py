"""Reads forces from VTK ImageData: ``.vti`` and ``.pvd`` files of this package, ParaView and other programs.

Format: "VTK File Formats", XML formats. Values as text, base64 or appended (raw or base64), plain or in zlib
blocks, sizes of 32 or 64 bits; one piece, no rotation. Forces are the point vectors whose name starts with
"force", else the only array of three components, in newtons; lengths are metres.
"""

from __future__ import annotations

import base64
import math
import re
import zlib
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from touchfield.errors import SourceError, TouchfieldError, as_source_error, reason
from touchfield.files import read_bytes, require_in_folder
from touchfield.medium.budget import require_memory
from touchfield.medium.field import ForceField
from touchfield.medium.grid import Grid
from touchfield.medium.medium import HapticMedium

RATE_HZ: Final = 30.0
"""Frames a second of a file that does not state them."""

_MAX_BYTES: Final = 1 << 32
_TYPES: Final = {
    "Float32": "f4", "Float64": "f8", "Int8": "i1", "Int16": "i2", "Int32": "i4", "Int64": "i8",
    "UInt8": "u1", "UInt16": "u2", "UInt32": "u4", "UInt64": "u8",
}  # fmt: skip
_APPENDED: Final = re.compile(rb"<AppendedData[^>]*>\s*_")
_NO_TURN: Final = "1 0 0 0 1 0 0 0 1"


def read_vti(path: str | Path, *, to_the_bit: bool = False) -> HapticMedium:
    """Open a ``.vti`` (one frame) or a ``.pvd`` (frames over time); later frames are read on access.

    `to_the_bit`: bricks that hold only -0.0 are kept. Raises `SourceError` if a file is not such an image, is
    damaged, or has a force that is not finite.
    """
    path = Path(path)
    files, rate_hz = _frames(path) if path.suffix.lower() == ".pvd" else ([path], RATE_HZ)
    image = _Image(files[0])
    first = image.field(to_the_bit)

    def frame(index: int) -> ForceField:
        if index == 0:
            return first
        other = _Image(files[index])
        if other.grid != image.grid:
            raise SourceError(str(files[index]), "another grid", f"that of {files[0]}")
        return other.field(to_the_bit)

    return HapticMedium(image.grid, image.number("rate_hz") or rate_hz, len(files), frame, image.axes)


def _frames(path: Path) -> tuple[list[Path], float]:
    """Return the files of a collection in the order of their times, and the frames a second."""
    root, _ = _parse(path)
    sets = root.findall("./Collection/DataSet")
    try:
        steps = sorted((float(s.get("timestep", "nan")), s.get("file", "")) for s in sets)
    except ValueError as error:
        raise SourceError(f"{path}, timestep", str(error), "a number") from error
    if not steps or not all(math.isfinite(time) for time, _ in steps):
        raise SourceError(str(path), f"{len(steps)} data sets with a time", "at least one")
    files = [require_in_folder(path.parent, name, f"{path}, DataSet") for _, name in steps]
    duration = steps[-1][0] - steps[0][0]
    return files, (len(steps) - 1) / duration if duration > 0 else RATE_HZ


def _parse(path: Path) -> tuple[Element, bytes]:
    """Return the elements of a file, and its appended data."""
    data, appended = read_bytes(path, _MAX_BYTES, "a VTK file"), b""
    match = _APPENDED.search(data)
    if match:  # raw bytes are no XML
        appended = data[match.end() : data.rfind(b"</AppendedData>")]
        data = data[: match.end()] + b"</AppendedData></VTKFile>"
    try:
        root = ElementTree.fromstring(data)
    except (ElementTree.ParseError, LookupError, ValueError) as error:  # LookupError: an unknown encoding
        raise SourceError(
            str(path), f"no VTK file ({reason(error)})", "VTK ImageData", "Copy the file again."
        ) from error
    return root, appended


class _Image:
    """One ``.vti``: its grid, and its forces on request."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._root, self._appended = _parse(path)
        image = self._root.find("ImageData")
        if self._root.tag != "VTKFile" or image is None:
            found = f"VTK data of type {self._root.get('type', '?')[:40]}"
            raise SourceError(str(path), found, "ImageData", "In ParaView: Resample To Image, then save.")
        self._image = image
        if " ".join(image.get("Direction", _NO_TURN).split()) != _NO_TURN:
            raise SourceError(str(path), "a rotated image", "no Direction", "Resample it to the axes.")
        extent = [int(v) for v in self._floats("WholeExtent", "", 6)]
        origin, spacing = self._floats("Origin", "0 0 0", 3), self._floats("Spacing", "1 1 1", 3)
        corner = [o + low * step for o, low, step in zip(origin, extent[::2], spacing, strict=True)]
        shape = [high - low + 1 for low, high in zip(extent[::2], extent[1::2], strict=True)]
        with as_source_error(f"{path}, "):
            self.grid = Grid(tuple(shape), tuple(spacing), tuple(corner))  # type: ignore[arg-type]

    def _floats(self, name: str, default: str, count: int) -> list[float]:
        text = self._image.get(name, default)
        try:
            values = [float(word) for word in text.split()]
        except ValueError:
            values = []
        if len(values) != count or not all(map(math.isfinite, values)):
            raise SourceError(f"{self._path}, {name}", repr(text[:60]), f"{count} numbers")
        return values

    def number(self, name: str) -> float | None:
        """Return a positive number of the field data; None if there is none."""
        for array in self._image.findall("./FieldData/DataArray"):
            if array.get("Name") == name and array.get("format") == "ascii":
                value = float((array.text or "nan").split()[0])
                return value if value > 0 and math.isfinite(value) else None
        return None

    @property
    def axes(self) -> str:
        """Directions of the axes, as this package writes them; "" if they are not stated."""
        for array in self._image.findall("./FieldData/Array"):
            if array.get("Name") == "axes" and array.get("format") == "ascii":
                codes = bytes(int(word) % 256 for word in (array.text or "").split())
                return codes.partition(b"\0")[0].decode("utf-8", "replace")
        return ""

    def field(self, to_the_bit: bool) -> ForceField:
        """Return the forces."""
        pieces = self._image.findall("Piece")
        if (
            len(pieces) != 1
            or pieces[0].get("Extent", "").split() != self._image.get("WholeExtent", "").split()
        ):
            found = f"{len(pieces)} pieces"
            raise SourceError(str(self._path), found, "one that fills the extent", "Write it as one piece.")
        arrays = pieces[0].findall("./PointData/DataArray")
        vectors = [a for a in arrays if a.get("NumberOfComponents", "1").strip() == "3"]
        named = [a for a in vectors if a.get("Name", "").lower().startswith("force")]
        if not named and len(vectors) != 1:
            names = ", ".join(a.get("Name", "?") for a in arrays)[:120] or "(none)"
            expected = "point vectors named force, or a single array of three components"
            raise SourceError(str(self._path), f"the point data {names}", expected)
        array = (named or vectors)[0]
        where = f"{self._path}, array {array.get('Name', '?')}"
        require_memory(where, "dense forces", 12 * self.grid.voxel_count, "Write a coarser lattice.")
        try:
            values = self._values(array, 3 * self.grid.voxel_count)
        except TouchfieldError:
            raise
        except (ValueError, zlib.error, KeyError, OverflowError) as error:
            raise SourceError(where, f"damaged values ({reason(error)})", "a whole file") from error
        nx, ny, nz = self.grid.shape
        with np.errstate(over="ignore", invalid="ignore"):
            forces = values.astype(np.float32).reshape(nz, ny, nx, 3).transpose(2, 1, 0, 3)
        if not np.isfinite(forces).all():
            raise SourceError(where, "a force that is not finite", "finite newtons")
        return ForceField.from_slabs(self.grid, [np.ascontiguousarray(forces)], to_the_bit=to_the_bit)

    def _values(self, array: Element, count: int) -> NDArray[Any]:
        kind = np.dtype(self._order + _TYPES[array.get("type", "")])
        form, text = array.get("format", "ascii"), (array.text or "").strip()
        if form == "ascii":
            values = np.array(text.split(), np.float64)
        else:
            data, is_text = text.encode(), form == "binary"
            if form == "appended":
                appended = self._root.find("AppendedData")
                is_text = appended is not None and appended.get("encoding", "base64") == "base64"
                data = self._appended[int(array.get("offset", "0")) :]
            values = np.frombuffer(self._decoded(data, is_text, count * kind.itemsize), kind)
        if len(values) < count:
            raise ValueError(f"{len(values)} of {count} numbers")
        return values[:count]

    @property
    def _order(self) -> str:
        return ">" if self._root.get("byte_order") == "BigEndian" else "<"

    def _decoded(self, data: bytes, is_text: bool, size: int) -> bytes:
        """Return at most `size` bytes of an array: its header of sizes, then plain or compressed blocks."""
        width = 8 if self._root.get("header_type", "UInt32") == "UInt64" else 4
        compressor = self._root.get("compressor", "")
        if compressor not in ("", "vtkZLibDataCompressor"):
            raise ValueError(f"the compressor {compressor[:40]}; write it with zlib or none")

        def sizes(start: int, count: int) -> list[int]:
            raw = data[start : start + count * width]
            if is_text:
                first, last = start // 3 * 4, -(-(start + count * width) // 3) * 4
                raw = base64.b64decode(data[first:last])[start % 3 :][: count * width]
            return [int(v) for v in np.frombuffer(raw, f"{self._order}u{width}", count)]

        if not compressor:  # header and values are encoded together
            return (base64.b64decode(data[: (size + width + 2) // 3 * 4]) if is_text else data)[width:][:size]
        count = sizes(0, 1)[0]
        if count > len(data):
            raise ValueError(f"{count} blocks in {len(data)} bytes")
        head = (3 + count) * width
        blocks, start = sizes(3 * width, count), head
        if is_text:  # the header is encoded on its own
            data, start = base64.b64decode(data[-(-head // 3) * 4 :][: (sum(blocks) + 2) // 3 * 4]), 0
        parts, left = [], size
        for block in blocks:
            parts.append(zlib.decompressobj().decompress(data[start : start + block], max(left, 1)))
            start, left = start + block, left - len(parts[-1])
        return b"".join(parts)
