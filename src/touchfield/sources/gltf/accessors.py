"""Accessors: typed arrays in the bytes of a glTF document, with strides, normalised integers and sparse changes.

Source: Khronos, glTF 2.0 specification (2021), section 3.6.2.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.sources.gltf.document import Document

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.sources.gltf.elements import Element

__all__ = ["Accessors"]

_COMPONENTS: Final = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS: Final = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


class Accessors:
    """The accessors of a document; each is read once."""

    def __init__(self, document: Document) -> None:
        self._document = document
        self._all = document.all("accessors")
        self._floats: dict[int, NDArray[np.float64]] = {}
        self._indices: dict[int, NDArray[np.int64]] = {}

    def __len__(self) -> int:
        return len(self._all)

    def floats(self, index: int, kind: str) -> NDArray[np.float64]:
        """Numbers, normalised integers too, float64 [count, width], read-only.

        Raises `SourceError` if the accessor is of another type than `kind`, its data are not there, or one of them
        is not finite.
        """
        element = self._checked(index, kind)
        if index not in self._floats:
            stored = self._data(element, _WIDTHS[kind])
            values = stored.astype(np.float64)
            if element.members.get("normalized") is True and stored.dtype.kind in "iu":
                values = np.maximum(values / np.iinfo(stored.dtype).max, -1.0)
            bad = values.size - int(np.count_nonzero(np.isfinite(values)))
            if bad:
                raise element.fault(f"{bad} numbers that are NaN or infinite", "finite numbers")
            values.flags.writeable = False
            self._floats[index] = values
        return self._floats[index]

    def indices(self, index: int, kind: str, below: int) -> NDArray[np.int64]:
        """Unsigned whole numbers, each below `below`, int64 [count, width], read-only.

        Raises `SourceError` if the accessor is of another type than `kind`, its data are not there, or one of them
        is too large.
        """
        element = self._checked(index, kind)
        if index not in self._indices:
            stored = self._data(element, _WIDTHS[kind])
            if stored.dtype.kind != "u":
                raise element.fault("numbers with a sign or a fraction", "unsigned integers")
            values = stored.astype(np.int64)
            values.flags.writeable = False
            self._indices[index] = values
        most = int(self._indices[index].max())
        if most >= below:
            raise element.fault(f"the number {most}", f"0 to {below - 1}")
        return self._indices[index]

    def has_data(self, index: int) -> bool:
        """Whether an accessor says where its numbers are; without, they are zeros."""
        return "bufferView" in self._all[index] or "sparse" in self._all[index]

    def _checked(self, index: int, kind: str) -> Element:
        element = self._all[index]
        found = element.text("type")
        if found != kind:
            raise element.fault(f"type {(found or 'none')[:20]}", kind)
        return element

    def _data(self, element: Element, width: int) -> NDArray[Any]:
        count = element.count("count", least=1)
        component = _component(element)
        if "bufferView" in element:
            values = self._dense(element, count, width, component)
        else:
            self._document.charge(count, element)
            values = np.zeros((count, width), component)
        sparse = element.child("sparse")
        if sparse is not None:
            changed = sparse.count("count", least=1)
            if changed > count:
                raise sparse.fault(f"{changed} changes", f"at most the {count} elements there are")
            places, news = sparse.child("indices"), sparse.child("values")
            if places is None or news is None:
                raise sparse.fault("no indices or no values", "both")
            rows = self._dense(places, changed, 1, _component(places))[:, 0]
            if rows.dtype.kind != "u" or int(rows.max()) >= count or (rows[1:] <= rows[:-1]).any():
                raise places.fault("indices that do not ascend, or are too large", f"ascending ones below {count}")
            values[rows] = self._dense(news, changed, width, component)
        return values

    def _dense(self, element: Element, count: int, width: int, component: np.dtype[Any]) -> NDArray[Any]:
        """A copy of the elements in the buffer view that `element` names."""
        index = element.index("bufferView", len(self._document.all("bufferViews")))
        if index is None:
            raise element.fault("no bufferView", "the number of one")
        data, stride = self._document.view(index)
        size = width * component.itemsize
        stride = size if stride is None else stride
        begin = element.integer("byteOffset", 0)
        if stride < size:
            raise element.fault(f"elements of {size} bytes every {stride}", "a byteStride that holds them")
        if begin + stride * (count - 1) + size > len(data):
            found = f"{count} elements, {stride} bytes each from byte {begin} on"
            raise element.fault(found, f"no more than the {len(data)} bytes of bufferViews[{index}]")
        self._document.charge(count, element)  # many accessors may name the same bytes
        strides = (stride, component.itemsize)
        return np.ndarray((count, width), component, data, begin, strides).copy()


def _component(element: Element) -> np.dtype[Any]:
    code = element.count("componentType")
    if code not in _COMPONENTS:
        raise element.fault(f"componentType {code}", "5120 to 5123, 5125 or 5126")
    return np.dtype(_COMPONENTS[code])
