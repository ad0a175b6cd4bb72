"""Reads a glTF or GLB file: checks its JSON, and returns the typed arrays that its buffers contain.

Source: Khronos, glTF 2.0 specification (2021), sections 3.6 (binary data, accessors with strides, normalised
integers and sparse changes) and 4 (GLB). A buffer is the binary chunk of the GLB, base64 within the JSON, or
a file beside it; no other locations are read.
"""

from __future__ import annotations

import base64
import binascii
import os
import struct
from pathlib import Path
from typing import Any, Final
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Float64s, Int64s
from touchfield.errors import SourceError
from touchfield.files import readable, require_in_folder, require_plain
from touchfield.json_values import JsonValue, parsed
from touchfield.sources.unread_files import compressed_mesh

_JSON, _BIN = 0x4E4F534A, 0x004E4942
_FREE_ELEMENTS: Final = 1 << 20
_ELEMENTS_PER_BYTE: Final = 16
"""A document may declare this many elements per byte, and `_FREE_ELEMENTS` more (zeros need no bytes)."""

_LARGEST: Final = 1 << 53  # larger JSON numbers are not exact integers
_LISTS: Final = ("accessors", "animations", "bufferViews", "buffers", "meshes", "nodes", "scenes", "skins")
_COMPONENTS: Final = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS: Final = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
COMPRESSIONS: Final = ("KHR_draco_mesh_compression", "EXT_meshopt_compression")
HARMLESS: Final = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_", "KHR_mesh_quantization")
"""Extensions that do not change the triangles, or that are supported."""


class Element(JsonValue):
    """A JSON value of the document `owner`."""

    owner: Document

    def __contains__(self, key: str) -> bool:
        return key in self.members()

    def number_of(self, of: str | int) -> int:
        """Return this value as an index.

        `of` is the name of a list of the document, or a number that the index must be below.
        """
        count = len(self.owner.all(of)) if isinstance(of, str) else of
        if not count:
            raise self.refused("none, as there are no such things")
        return self.bounded_integer(0, count - 1)

    def index(self, key: str, of: str | int) -> int | None:
        """Return the index at `key`; None if there is none."""
        value = self.get(key)
        return None if value is None else value.number_of(of)

    def indices(self, key: str, of: str | int) -> list[int]:
        """Return the indices at `key`; empty if there is no list."""
        return [value.number_of(of) for value in self.at(key, []).elements()]

    def integer(self, key: str, default: int = -1, minimum: int = 0) -> int:
        """Return an integer of at least `minimum`; without a default it is required."""
        return (
            default if default >= 0 and key not in self else self.at(key).bounded_integer(minimum, _LARGEST)
        )

    def numbers(self, key: str, count: int) -> list[float] | None:
        """Return `count` finite numbers; None if there is no list."""
        value = self.get(key)
        if value is not None and len(value.items()) != count:
            raise value.wrong(f"{len(value.items())} numbers", f"{count} finite numbers")
        return None if value is None else [number.number() for number in value.elements()]

    def word(self, key: str) -> str | None:
        """Return a string; None if there is none."""
        value = self.get(key)
        return None if value is None else value.text()

    def floats(self, key: str, kind: str) -> Float64s | None:
        """Return the numbers of the accessor at `key`, float64 [count, width], read-only.

        Returns None without one.

        Normalised integers are converted. Raises `SourceError` if the accessor has another type than `kind`,
        its data are missing, or a number is not finite.
        """
        number = self.index(key, "accessors")
        return None if number is None else self.owner.array(number, kind)

    def unsigned(self, key: str, kind: str, below: int) -> Int64s | None:
        """Return the unsigned integers of the accessor at `key`, int64 [count, width].

        They must be less than `below`. Returns None without an accessor.
        """
        number = self.index(key, "accessors")
        return None if number is None else self.owner.array(number, kind, below)


class Document:
    """A glTF document, its buffers and its accessors, each read once.

    `root` is the JSON object of the document; `size_bytes` the length of the file and of the files read so
    far.

    Raises `SourceError` if the file cannot be read, is not glTF 2, or requires an unsupported extension.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        members, self._chunk = contents(path)
        self.root = Element(members, str(path), owner=self)
        self._buffers: dict[int, memoryview] = {}
        self._files: dict[Path, bytes] = {}
        self._arrays: dict[tuple[int, bool], Any] = {}
        self.size_bytes = path.stat().st_size
        self._charged = 0
        asset = self.root.get("asset")
        version = asset.word("version") if asset else None
        if version is not None and not version.startswith("2."):
            raise self.root.wrong(f"glTF version {version[:20]!r}", "version 2", "Convert it to glTF 2.0.")
        for name in map(str, self.root.at("extensionsRequired", []).items()):
            if name in COMPRESSIONS:
                raise compressed_mesh(path, name)
            if not name.startswith(HARMLESS):
                found = f"the required extension {name[:60]!r}"
                raise self.root.wrong(found, "a mesh without it", "Export it without extensions.")
        self._elements = {key: [*self.root.at(key, []).elements()] for key in _LISTS}

    def all(self, key: str) -> list[Element]:
        """Return the objects of a top-level list, such as accessors or nodes."""
        return self._elements[key]

    def charge(self, elements: int, element: Element) -> None:
        """Count elements before allocation.

        Raise if they exceed the limit for the size of the document.
        """
        self._charged += elements
        if self._charged > _ELEMENTS_PER_BYTE * self.size_bytes + _FREE_ELEMENTS:
            raise element.wrong(
                f"{self._charged} elements declared in {self.size_bytes} bytes", "elements with their data"
            )

    def array(self, index: int, kind: str, below: int | None = None) -> Any:
        """Return the values of an accessor, [count, width], read-only and cached.

        They are int64 if `below` is given, which they must be less than; else float64.
        """
        element = self.all("accessors")[index]
        stored_type = element.word("type")
        if stored_type != kind:
            raise element.wrong(f"type {(stored_type or 'none')[:20]}", kind)
        key = index, below is None
        if key not in self._arrays:
            stored = self._data(element, _WIDTHS[kind])
            if below is not None and stored.dtype.kind != "u":
                raise element.wrong("numbers with a sign or a fraction", "unsigned integers")
            values = stored.astype(np.float64 if below is None else np.int64)
            if below is None and element.members().get("normalized") is True and stored.dtype.kind in "iu":
                values = np.maximum(values / np.iinfo(stored.dtype).max, -1.0)
            bad = values.size - int(np.count_nonzero(np.isfinite(values)))
            if bad:
                raise element.wrong(f"{bad} numbers that are NaN or infinite", "finite numbers")
            values.flags.writeable = False
            self._arrays[key] = values
        values = self._arrays[key]
        if below is not None and int(values.max()) >= below:
            raise element.wrong(f"the number {int(values.max())}", f"0 to {below - 1}")
        return values

    def _data(self, element: Element, width: int) -> NDArray[Any]:
        count, component = element.integer("count", minimum=1), _component(element)
        if "bufferView" in element:
            values = self._dense(element, count, width, component)
        else:
            self.charge(count, element)
            values = np.zeros((count, width), component)
        sparse = element.get("sparse")
        if sparse is not None:
            changed = sparse.integer("count", minimum=1)
            if changed > count:
                raise sparse.wrong(f"{changed} changes", f"at most the {count} elements there are")
            indices, replacements = sparse.get("indices"), sparse.get("values")
            if indices is None or replacements is None:
                raise sparse.wrong("no indices or no values", "both")
            rows = self._dense(indices, changed, 1, _component(indices))[:, 0]
            if rows.dtype.kind != "u" or int(rows.max()) >= count or (rows[1:] <= rows[:-1]).any():
                raise indices.wrong(
                    "indices that do not ascend, or are too large", f"ascending ones below {count}"
                )
            values[rows] = self._dense(replacements, changed, width, component)
        return values

    def _dense(self, element: Element, count: int, width: int, component: np.dtype[Any]) -> NDArray[Any]:
        """Copy the elements from the buffer view that `element` names."""
        index = element.index("bufferView", "bufferViews")
        if index is None:
            raise element.wrong("no bufferView", "the number of one")
        view, size = self.all("bufferViews")[index], width * component.itemsize
        buffer = view.index("buffer", "buffers")
        if buffer is None:
            raise view.wrong("no buffer", "the number of one")
        data = self._buffer(buffer)
        start, length = view.integer("byteOffset", 0), view.integer("byteLength", minimum=1)
        if start + length > len(data):
            raise view.wrong(
                f"bytes {start} to {start + length}", f"at most the {len(data)} of buffers[{buffer}]"
            )
        data, stride = data[start : start + length], view.integer("byteStride", size, minimum=1)
        start = element.integer("byteOffset", 0)
        if stride < size:
            raise element.wrong(f"elements of {size} bytes every {stride}", "a byteStride that holds them")
        if start + stride * (count - 1) + size > len(data):
            found = f"{count} elements, {stride} bytes each from byte {start} on"
            raise element.wrong(found, f"no more than the {len(data)} bytes of bufferViews[{index}]")
        self.charge(count, element)  # many accessors may name the same bytes
        strides = (stride, component.itemsize)
        return np.ndarray((count, width), component, data, start, strides).copy()

    def _buffer(self, index: int) -> memoryview:
        if index not in self._buffers:
            element = self.all("buffers")[index]
            length, uri = element.integer("byteLength", minimum=1), element.word("uri")
            if uri is None:
                data = self._chunk if index == 0 else b""
            elif uri.startswith("data:"):
                head, _, text = uri.partition(",")
                if not head.endswith(";base64"):
                    raise element.wrong(f"uri {head[:40]!r}", "data in base64")
                try:
                    data = base64.b64decode(text, validate=True)
                except (binascii.Error, ValueError) as error:
                    raise element.wrong(
                        "data that is not base64", "data in base64", "Export it again."
                    ) from error
            else:
                data = self._file_bytes(element, uri)
            if len(data) < length:
                raise element.wrong(
                    f"{len(data)} bytes", f"the {length} it declares", "The file may be cut short."
                )
            self._buffers[index] = memoryview(data)[:length]
        return self._buffers[index]

    def _file_bytes(self, element: Element, uri: str) -> bytes:
        """Read a file in the folder of the document, or below it."""
        name = unquote(uri)
        path = require_in_folder(self._path.parent, name, f"{element.file}: {element.location}.uri").resolve()
        if not os.path.isfile(path):
            raise element.wrong(f"no file {name[:80]!r}", "the buffer next to the document", "Copy it there.")
        if path not in self._files:
            with readable(path):
                self._files[path] = path.read_bytes()
            self.size_bytes += len(self._files[path])
        return self._files[path]


def _component(element: Element) -> np.dtype[Any]:
    code = element.integer("componentType")
    if code not in _COMPONENTS:
        raise element.wrong(f"componentType {code}", "5120 to 5123, 5125 or 5126")
    return np.dtype(_COMPONENTS[code])


def contents(path: Path, *, with_binary: bool = True) -> tuple[dict[str, Any], bytes]:
    """Read the unchecked JSON object of a file, and the binary chunk of a GLB.

    The chunk is empty for other files.
    """
    require_plain(path, "one glTF file")
    chunks = dict[int, bytes]()
    with readable(path), path.open("rb") as file:
        head, size = file.read(12), path.stat().st_size
        if head.startswith(b"glTF"):
            version, length = struct.unpack_from("<II", head, 4) if size >= 12 else (2, size + 1)
            if version != 2:
                raise SourceError(str(path), f"GLB version {version}", "version 2", "Convert it to glTF 2.0.")
            if length > size:
                raise SourceError(
                    str(path), f"{size} bytes", f"the {length} its header declares", "Copy it again."
                )
            while (with_binary or _JSON not in chunks) and len(chunk_head := file.read(8)) == 8:
                length, kind = struct.unpack("<II", chunk_head)
                if length > size - file.tell():
                    found = f"a chunk of {length} bytes that is cut short"
                    raise SourceError(str(path), found, "whole chunks", "Copy it again.")
                chunks.setdefault(kind, file.read(length))
            if _JSON not in chunks:
                raise SourceError(str(path), "no JSON chunk", "a GLB file", "Export it again.")
        else:
            chunks[_JSON] = head + file.read()
    members = parsed(chunks[_JSON], str(path), "a glTF document")
    if not isinstance(members, dict):
        raise SourceError(str(path), "JSON that is not an object", "a glTF document")
    return members, chunks.get(_BIN, b"")
