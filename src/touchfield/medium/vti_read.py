"""Reads forces out of VTK ImageData: our own ``.vti`` and ``.pvd`` and ordinary ones of other programs.

Format: "VTK File Formats", XML formats. Values as text, base64 in place, or appended (raw or base64); plain or
in zlib blocks; sizes of 32 or 64 bits. One piece that fills the extent, no rotation.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.errors import InvalidArgument, SourceError
from touchfield.files import require_beside
from touchfield.medium.field import ForceField
from touchfield.medium.grid import Grid
from touchfield.medium.medium import HapticMedium
from touchfield.medium.slabs import field_of_slabs, slab_depths
from touchfield.medium.vtk_xml import DEFLATE_LIMIT, BlockStream, Node, VtkFile, whole_numbers

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["read_vti"]

DEFAULT_RATE_HZ: Final = 30.0
UNTURNED: Final = "1 0 0 0 1 0 0 0 1"
TYPES: Final = {
    "Float32": "f4", "Float64": "f8", "Int8": "i1", "Int16": "i2", "Int32": "i4", "Int64": "i8",
    "UInt8": "u1", "UInt16": "u2", "UInt32": "u4", "UInt64": "u8",
}  # fmt: skip
_SMALL: Final = 4096


def read_vti(path: str | Path, *, to_the_bit: bool = False) -> HapticMedium:
    """Open a ``.vti`` (one frame) or a ``.pvd`` (frames over time); values are read when asked for.

    The forces are the point vectors whose name begins with "force", or else the first array of three
    components, taken as newtons; origin and spacing are taken as metres. With
    `to_the_bit` a brick of nothing but -0.0, which is no force, is kept as well.

    Raises `SourceError` if the file is no such image, is cut short or damaged, or (when a frame is read) a force is
    not finite.
    """
    path = Path(path)
    file = VtkFile(path)
    if file.root.attributes.get("type") == "Collection":
        return _collection(file, to_the_bit)
    image = _Image(file)
    rate = image.rate_hz or DEFAULT_RATE_HZ
    return HapticMedium(image.grid, rate, 1, lambda _i: image.field(to_the_bit), image.axes)


def _collection(file: VtkFile, to_the_bit: bool) -> HapticMedium:
    steps = [
        (_number(file, node, "timestep"), node) for c in file.root.all("Collection") for node in c.all("DataSet")
    ]
    if not steps:
        raise file.fault("no DataSet", "at least one")
    steps.sort(key=lambda step: step[0])
    paths = [_beside(file, node) for _, node in steps]
    first = _Image(VtkFile(paths[0]))
    duration = steps[-1][0] - steps[0][0]
    rate = first.rate_hz or ((len(steps) - 1) / duration if duration > 0 else DEFAULT_RATE_HZ)

    def make_frame(index: int) -> ForceField:
        image = _Image(VtkFile(paths[index]))
        if image.grid != first.grid:
            raise SourceError(str(paths[index]), "another grid", f"that of {paths[0]}")
        return image.field(to_the_bit)

    return HapticMedium(first.grid, rate, len(paths), make_frame, first.axes)


def _number(file: VtkFile, node: Node, name: str) -> float:
    try:
        value = float(node.attributes.get(name, ""))
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise file.fault(f"{name} = {node.attributes.get(name, '')[:40]!r}", "a number")
    return value


def _beside(file: VtkFile, node: Node) -> Path:
    name = node.attributes.get("file", "")
    parts = PurePosixPath(name.replace("\\", "/"))
    if not name or parts.is_absolute() or ".." in parts.parts or parts.suffix.lower() != ".vti":
        raise file.fault(f"the data set {name[:80]!r}", "a .vti in the same folder or below it")
    return require_beside(file.path.parent, parts, str(file.path))


@dataclass(frozen=True)
class _Values:
    """How the values of this file are stored."""

    order: str
    size_type: np.dtype[np.unsignedinteger]
    is_zlib: bool


class _Image:
    """One ``.vti``: its grid, and its forces when asked for."""

    def __init__(self, file: VtkFile) -> None:
        self._file = file
        self._values = self._storage()
        images = file.root.all("ImageData")
        if file.root.attributes.get("type") != "ImageData" or len(images) != 1:
            found = f"VTK data of type {file.root.attributes.get('type')}"
            raise file.fault(found, "ImageData", "Resample it to an image first.")
        self._image = images[0]
        self.grid = self._grid()
        self._array = self._forces()
        self.rate_hz = self._rate_hz()
        self.axes = self._axes()

    def _storage(self) -> _Values:
        said = self._file.root.attributes
        orders, widths = {"LittleEndian": "<", "BigEndian": ">"}, {"UInt32": "u4", "UInt64": "u8"}
        order = orders.get(said.get("byte_order", "LittleEndian"))
        width = widths.get(said.get("header_type", "UInt32"))
        compressor = said.get("compressor", "")
        if order is None or width is None:
            raise self._file.fault("an unknown byte_order or header_type", "little or big endian, UInt32 or UInt64")
        if compressor not in ("", "vtkZLibDataCompressor"):
            raise self._file.fault(f"the compressor {compressor[:40]}", "zlib or none", "Write it anew with zlib.")
        return _Values(order, np.dtype(order + width), bool(compressor))

    def _triple(self, name: str, default: tuple[float, float, float]) -> tuple[float, float, float]:
        text = self._image.attributes.get(name)
        if text is None:
            return default
        try:
            x, y, z = (float(word) for word in text.split())
        except ValueError as error:
            raise self._file.fault(f"{name} {text[:60]!r}", "three numbers") from error
        return (x, y, z)

    def _grid(self) -> Grid:
        extent = whole_numbers(self._image.attributes.get("WholeExtent", ""), 6)
        if extent is None:
            raise self._file.fault("no WholeExtent", "six whole numbers")
        turned = self._image.attributes.get("Direction", UNTURNED)
        if turned.split() != UNTURNED.split():
            raise self._file.fault("a rotated image", f"the direction {UNTURNED}", "Resample it to the axes.")
        low, high = extent[::2], extent[1::2]
        spacing = self._triple("Spacing", (1.0, 1.0, 1.0))
        origin = self._triple("Origin", (0.0, 0.0, 0.0))
        x, y, z = (o + a * h for o, a, h in zip(origin, low, spacing, strict=True))
        nx, ny, nz = (b - a + 1 for a, b in zip(low, high, strict=True))
        try:
            return Grid((nx, ny, nz), spacing, (x, y, z))
        except InvalidArgument as error:
            raise self._file.fault(f"{error.where} {error.found}", error.expected) from error

    def _forces(self) -> Node:
        pieces = self._image.all("Piece")
        whole = self._image.attributes.get("WholeExtent", "").split()
        if len(pieces) != 1 or pieces[0].attributes.get("Extent", "").split() != whole:
            raise self._file.fault(f"{len(pieces)} pieces", "one that fills the extent", "Write it as one piece.")
        arrays = [a for data in pieces[0].all("PointData") for a in data.all("DataArray")]
        triples = [a for a in arrays if a.attributes.get("NumberOfComponents", "1").strip() == "3"]
        named = [a for a in triples if a.attributes.get("Name", "").lower().startswith("force")]
        if not triples:
            names = ", ".join(a.attributes.get("Name", "?") for a in arrays)[:120]
            raise self._file.fault(f"the point data {names or '(none)'}", "point vectors of three components")
        chosen = (named or triples)[0]
        if "TimeStep" in chosen.attributes:
            raise self._file.fault("time steps within one file", "one file a step", "Write a .pvd with .vti files.")
        return chosen

    def _dtype(self, array: Node) -> np.dtype[Any]:
        name = array.attributes.get("type", "")
        if name not in TYPES:
            raise self._file.fault(f"values of type {name[:40]!r}", f"one of {', '.join(TYPES)}")
        return np.dtype(self._values.order + TYPES[name])

    def _reader(self, array: Node, count: int) -> Callable[[int], NDArray[Any]]:
        """A function that gives the next so many values of an array of `count`."""
        where = f"{self._file.path}, array {array.attributes.get('Name', '?')}"
        if array.attributes.get("format") == "ascii":
            return _text_reader("".join(array.text), count, where)
        dtype = self._dtype(array)
        blob = self._file.blob(array)
        if count * dtype.itemsize > DEFLATE_LIMIT * len(blob):
            raise SourceError(where, f"{len(blob)} bytes", f"{count} values", "The file is cut short or damaged.")
        stream = BlockStream(blob, count * dtype.itemsize, self._values.size_type, self._values.is_zlib, where)
        return lambda n: np.frombuffer(stream.read(n * dtype.itemsize), dtype)

    def field(self, to_the_bit: bool) -> ForceField:
        """The forces as a sparse field."""
        reader = self._reader(self._array, 3 * self.grid.voxel_count)
        return field_of_slabs(self.grid, self._slabs(reader), 2, to_the_bit=to_the_bit)

    def _slabs(self, reader: Callable[[int], NDArray[Any]]) -> Iterator[NDArray[np.float32]]:
        nx, ny, _ = self.grid.shape
        for depth in slab_depths(self.grid, 2):
            with np.errstate(over="ignore", invalid="ignore"):
                slab = reader(3 * nx * ny * depth).astype(np.float32).reshape(depth, ny, nx, 3)
            if not np.isfinite(slab).all():
                raise self._file.fault("a force that is not finite", "finite newtons")
            yield np.ascontiguousarray(slab.transpose(2, 1, 0, 3))

    def _note(self, name: str) -> Node | None:
        arrays = [a for data in self._image.all("FieldData") for a in data.all("DataArray", "Array")]
        return next((a for a in arrays if a.attributes.get("Name") == name), None)

    def _rate_hz(self) -> float | None:
        node = self._note("rate_hz")
        if node is None:
            return None
        rate = float(self._reader(node, 1)(1)[0])
        if not (rate > 0 and math.isfinite(rate)):
            raise self._file.fault(f"rate_hz {rate}", "a positive number")
        return rate

    def _axes(self) -> str:
        node = self._note("axes")
        words = "".join(node.text).split()[:_SMALL] if node is not None else []
        if (
            node is None
            or node.attributes.get("format") != "ascii"
            or not all(w.lstrip("-").isdigit() for w in words)
        ):
            return "x, y, z"
        return bytes(int(w) % 256 for w in words if int(w)).decode("utf-8", "replace")


def _text_reader(text: str, count: int, where: str) -> Callable[[int], NDArray[Any]]:
    words = text.split()
    try:
        values = np.array(words, np.float64)
    except ValueError as error:
        raise SourceError(where, f"text that is no number ({error})", "numbers") from error
    if len(values) != count:
        raise SourceError(where, f"{len(values)} values", f"{count}, as the extent says")
    position = 0

    def take(n: int) -> NDArray[Any]:
        nonlocal position
        position += n
        return values[position - n : position]

    return take
