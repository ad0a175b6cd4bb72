"""A glTF document: the JSON of a .gltf or .glb file, and the bytes of its buffers.

Source: Khronos, glTF 2.0 specification (2021), sections 3.6 (binary data) and 4 (GLB). A buffer is the binary chunk
of the GLB, base64 within the JSON, or a file beside it; no other place is looked at.
"""

from __future__ import annotations

import base64
import binascii
import json
import struct
from pathlib import Path
from typing import Any, BinaryIO, Final
from urllib.parse import unquote

from touchfield.errors import SourceError
from touchfield.sources.gltf.elements import Element

__all__ = ["Document", "is_animated", "is_damaged"]

_JSON, _BIN = 0x4E4F534A, 0x004E4942
_SPARE: Final = 1 << 20
_PER_BYTE: Final = 16
"""A document may ask for this many elements for each of its bytes, and `_SPARE` more (zeros need no bytes)."""

_HARMLESS: Final = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_", "KHR_mesh_quantization")
"""Required extensions that do not change where the triangles are, or that are understood."""


class Document:
    """A glTF document and its buffers.

    Attributes
    ----------
    root : Element; The JSON object of the whole document.

    Raises `SourceError` if the file cannot be read, is no glTF 2, or requires an extension that is not understood.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        members, self._chunk = _contents(path, needs_bytes=True)
        self.root = Element(str(path), members)
        self._elements = {key: self.root.children(key) for key in _LISTS}
        self._buffers: dict[int, memoryview] = {}
        self._files: dict[Path, bytes] = {}
        self._bytes = path.stat().st_size
        self._asked = 0
        asset = self.root.child("asset")
        version = asset.text("version") if asset else None
        if version is not None and not version.startswith("2."):
            raise self.root.fault(f"glTF version {version[:20]!r}", "version 2", "Convert it to glTF 2.0.")
        for name in self.root.texts("extensionsRequired"):
            if not name.startswith(_HARMLESS):
                found = f"the required extension {name[:60]!r}"
                raise self.root.fault(
                    found, "a mesh without it", "Export it again without compression or extensions."
                )

    def all(self, key: str) -> list[Element]:
        """The objects of a top-level list: accessors, nodes, ..."""
        return self._elements[key]

    def charge(self, elements: int, asker: Element) -> None:
        """Count elements that are about to be made; refuse what the bytes of the document do not justify."""
        self._asked += elements
        if self._asked > _PER_BYTE * self._bytes + _SPARE:
            raise asker.fault(f"{self._asked} elements asked of {self._bytes} bytes", "elements with their data")

    def view(self, index: int) -> tuple[memoryview, int | None]:
        """The bytes of a buffer view, and its byte stride where it has one."""
        element = self.all("bufferViews")[index]
        buffer = element.index("buffer", len(self.all("buffers")))
        if buffer is None:
            raise element.fault("no buffer", "the number of one")
        data = self._buffer(buffer)
        begin, length = element.integer("byteOffset", 0), element.count("byteLength", least=1)
        if begin + length > len(data):
            raise element.fault(f"bytes {begin} to {begin + length}", f"at most the {len(data)} of buffers[{buffer}]")
        return data[begin : begin + length], element.integer("byteStride", least=1)

    def _buffer(self, index: int) -> memoryview:
        if index not in self._buffers:
            element = self.all("buffers")[index]
            length = element.count("byteLength", least=1)
            uri = element.text("uri")
            if uri is None:
                data = self._chunk if index == 0 else b""
            elif uri.startswith("data:"):
                data = _embedded(element, uri)
            else:
                data = self._beside(element, uri)
            if len(data) < length:
                raise element.fault(f"{len(data)} bytes", f"the {length} it declares", "The file may be cut short.")
            self._buffers[index] = memoryview(data)[:length]
        return self._buffers[index]

    def _beside(self, element: Element, uri: str) -> bytes:
        """The bytes of a file in the folder of the document, or below it."""
        name = unquote(uri)
        folder = self._path.parent.resolve()
        try:
            path = (folder / name).resolve()
            if ":" in name.split("/")[0] or not path.is_relative_to(folder):
                raise element.fault(f"uri {name[:80]!r}", "a file in the folder of the document")
            if not path.is_file():
                raise element.fault(f"no file {name[:80]!r}", "the buffer beside the document", "Copy it there.")
            if path not in self._files:
                self._files[path] = path.read_bytes()
                self._bytes += len(self._files[path])
            return self._files[path]
        except (OSError, ValueError, RuntimeError) as error:
            text = getattr(error, "strerror", None) or "a name that is none"
            raise element.fault(f"{name[:80]!r}: {text}", "a file that can be read") from error


_LISTS = ("accessors", "animations", "bufferViews", "buffers", "meshes", "nodes", "scenes", "skins")


def is_animated(path: Path) -> bool:
    """Whether a file is a glTF document with an animation; reads its JSON only, and never raises."""
    try:
        members, _ = _contents(path, needs_bytes=False)
    except SourceError:
        return False
    animations = members.get("animations")
    return isinstance(animations, list) and len(animations) > 0


def is_damaged(path: Path) -> bool:
    """Whether a file is no whole glTF document; reads its JSON only, and never raises."""
    try:
        _contents(path, needs_bytes=False)
    except SourceError:
        return True
    return False


def _contents(path: Path, *, needs_bytes: bool) -> tuple[dict[str, Any], bytes]:
    """The JSON object of a file, and the binary chunk of a GLB (empty if there is none or it is not needed)."""
    try:
        if path.exists() and not path.is_file():
            raise SourceError(str(path), "a folder or a device", "one glTF file", "Name the file in it.")
        size = path.stat().st_size
        with path.open("rb") as stream:
            chunk = b""
            if stream.read(4) == b"glTF":
                text = _chunk_of(path, stream, size, _JSON)
                chunk = _chunk_of(path, stream, size, _BIN) if needs_bytes else b""
            else:
                stream.seek(0)
                text = stream.read(size)
    except OSError as error:
        raise SourceError(str(path), error.strerror or str(error), "a file that can be read") from error
    try:
        members = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise SourceError(str(path), "text that is not JSON", "a glTF document", "Export it again.") from error
    if not isinstance(members, dict):
        raise SourceError(str(path), "JSON that is not an object", "a glTF document")
    return members, chunk


def _chunk_of(path: Path, stream: BinaryIO, size: int, kind: int) -> bytes:
    """The next chunk of a GLB whose type is `kind`; for the binary one, empty where there is none."""
    if stream.tell() == 4:
        head = stream.read(8)
        version, length = struct.unpack("<II", head) if len(head) == 8 else (2, size + 1)
        if version != 2:
            raise SourceError(str(path), f"GLB version {version}", "version 2", "Convert it to glTF 2.0.")
        if length > size:
            raise SourceError(str(path), f"{size} bytes", f"the {length} its header declares", "Copy it again.")
    while len(head := stream.read(8)) == 8:
        length, found = struct.unpack("<II", head)
        if length > size - stream.tell():
            raise SourceError(
                str(path), f"a chunk of {length} bytes that is cut short", "whole chunks", "Copy it again."
            )
        if found == kind:
            return stream.read(length)
        stream.seek(length, 1)
    if kind == _JSON:
        raise SourceError(str(path), "no JSON chunk", "a GLB file", "Export it again.")
    return b""


def _embedded(element: Element, uri: str) -> bytes:
    head, comma, data = uri.partition(",")
    if not comma or not head.endswith(";base64"):
        raise element.fault(f"uri {head[:40]!r}", "data in base64")
    try:
        return base64.b64decode(data, validate=True)
    except (binascii.Error, ValueError) as error:
        raise element.fault("data that is not base64", "data in base64", "Export it again.") from error
