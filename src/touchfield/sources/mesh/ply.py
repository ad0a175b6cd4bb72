"""The header of a PLY file: its format, and the elements that follow it."""

from __future__ import annotations

import re
from typing import Any, Final, NamedTuple

import numpy as np

_CODES: Final = "bBhHiIfd"  # NumPy's codes; PLY has old names and NumPy's longer ones
_TYPES: Final = dict(zip(["char", "uchar", "short", "ushort", "int", "uint", "float", "double"], _CODES))
_TYPES.update((np.dtype(code).name, code) for code in _CODES)
_END: Final = re.compile(rb"\nend_header[ \t]*\r?\n")
_FORMATS: Final = {"ascii", "binary_little_endian", "binary_big_endian"}

Properties = list[tuple[str, list[np.dtype[Any]]]]
"""Name and types of each property; a list has the type of its length first."""


class PlyHeader(NamedTuple):
    """A header.

    is_text : bool; The values of a text are read as float64, whatever type is declared.
    elements : list of (name, count, properties), in the order of the file.
    size : int; Bytes of the header.
    """

    is_text: bool
    elements: list[tuple[str, int, Properties]]
    size: int

    def count_of(self, *names: str) -> int:
        """Return how many elements with these names are declared."""
        return sum(count for name, count, _ in self.elements if name in names)


def parse_header(data: bytes) -> PlyHeader:
    """Parse the header at the start of `data`; LookupError or ValueError if there is none."""
    end = _END.search(data)
    head = data[: end.start()] if end else b""
    (kind, *_), form, *lines = [line.split() for line in head.decode("latin-1").splitlines()] + [[""], [""]]
    if kind != "ply" or end is None or not _FORMATS & {*form}:
        raise ValueError("no PLY with a format and an end_header")
    is_text, order = "ascii" in form, ">" if "binary_big_endian" in form else "<"
    elements: list[tuple[str, int, Properties]] = []
    for first, *tokens in filter(None, lines):
        if first == "element":
            elements.append((tokens[0], int(tokens[1]), []))
        elif first == "property":
            types = [
                np.dtype(order + ("d" if is_text else _TYPES[token]))
                for token in tokens[:-1]
                if token != "list"
            ]
            elements[-1][2].append((tokens[-1], types))
    return PlyHeader(is_text, elements, end.end())
