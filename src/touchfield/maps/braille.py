"""Braille by liblouis, the library that screen readers use: cells of a text by the table of a language.

The library is loaded when a text is translated. It is not a Python package: systems install it
(``apt install liblouis20 liblouis-data``, ``brew install liblouis``).
"""

from __future__ import annotations

import ctypes
import ctypes.util
import os
import sys
from collections.abc import Sequence
from functools import cache
from typing import Any, Final

import numpy as np

from touchfield.arrays import Bools
from touchfield.errors import InvalidArgument

TABLES: Final = {
    "en": "en-ueb-g1.ctb", "de": "de-g0.utb", "fr": "fr-bfu-comp6.utb", "es": "es-g1.ctb",
    "it": "it-it-comp6.utb", "nl": "nl-NL-g0.utb", "pl": "Pl-Pl-g1.utb", "pt": "pt-pt-g1.utb",
    "ru": "ru-litbrl.ctb", "sv": "sv-g0.utb", "da": "da-dk-g16.ctb",
}  # fmt: skip
"""Table of uncontracted Braille, of liblouis, for each language."""
VARIABLE: Final = "TOUCHFIELD_LIBLOUIS"
"""Environment variable that names the file of the library if it is elsewhere."""
MAX_CELLS: Final = 1024
_NO_UNDEFINED: Final = 128
_UNICODE: Final = 64
_DOTS: Final = 4
_LOG_OFF: Final = 60000
_FIRST_CELL: Final = 0x2800
"""The empty cell in Unicode; dot n adds bit n - 1."""
_HINT: Final = (
    "Install it (apt install liblouis20 liblouis-data, brew install liblouis), name its file in "
    f"{VARIABLE}, or do without Braille: --no-labels."
)


class Braille:
    """Translates texts to Braille of six dots.

    Parameters
    ----------
    language : str
        A key of `TABLES`, or the name of a table of liblouis, such as ``en-ueb-g2.ctb``.

    Raises
    ------
    InvalidArgument
        If the library is missing, or the language or the table unknown.
    """

    def __init__(self, language: str) -> None:
        self.table = TABLES.get(language, language)
        if "." not in self.table or "," in self.table:
            expected = f"one of {', '.join(TABLES)}, or the name of a table of liblouis such as en-ueb-g2.ctb"
            raise InvalidArgument("language", repr(language), expected)
        self._library = _library()
        if not self._library.lou_checkTable(self.table.encode()):
            hint = "Install its tables (apt install liblouis-data), or name their folder in LOUIS_TABLEPATH."
            raise InvalidArgument("language", f"no table {self.table}", "a table of liblouis", hint)
        self.unknown: set[str] = set()

    def cells(self, text: str) -> tuple[int, ...]:
        """Return the dots of each cell: bit n is dot n + 1.

        Letters that the table does not have are left out, and their texts collected in `unknown`. Raises
        `InvalidArgument` for a table of eight dots.
        """
        cells = self._translate(text, _NO_UNDEFINED)
        if cells != self._translate(text, 0):
            self.unknown.add(text)
        if any(cell >> 6 for cell in cells):
            expected = "a table of six dots, as pins of three rows show"
            raise InvalidArgument("language", f"{self.table}, which writes dots 7 and 8", expected)
        return cells

    def _translate(self, text: str, mode: int) -> tuple[int, ...]:
        size = self._library.lou_charSize()
        encoding = f"utf-{8 * size}-{'le' if sys.byteorder == 'little' else 'be'}"
        data = text.encode(encoding, "replace")
        incoming = ctypes.create_string_buffer(data, len(data) + size)
        outgoing = ctypes.create_string_buffer(MAX_CELLS * size)
        count, made = ctypes.c_int(len(data) // size), ctypes.c_int(MAX_CELLS)
        lengths = ctypes.byref(count), ctypes.byref(made)
        is_done = self._library.lou_translateString(
            self.table.encode(), incoming, lengths[0], outgoing, lengths[1], None, None,
            mode | _UNICODE | _DOTS,
        )  # fmt: skip
        if not is_done:
            raise InvalidArgument("language", f"that {self.table} does not translate {text!r:.60}", "Braille")
        codes = outgoing.raw[: made.value * size].decode(encoding, "replace")
        return tuple(0 if code == " " else ord(code) - _FIRST_CELL & 0xFF for code in codes)


def has_braille() -> bool:
    """Return whether liblouis, which writes Braille, is installed."""
    try:
        _library()
    except InvalidArgument:
        return False
    return True


@cache
def _library() -> Any:
    """Load liblouis and declare the functions that are used, as its manual gives them."""
    override = os.environ.get(VARIABLE)
    names = [override] if override else [ctypes.util.find_library("louis"), *_FILES.get(sys.platform, _LINUX)]
    for name in filter(None, names):
        try:
            library = ctypes.CDLL(name)
            declared = {
                "lou_charSize": (ctypes.c_int, []),
                "lou_checkTable": (ctypes.c_int, [ctypes.c_char_p]),
                "lou_setLogLevel": (None, [ctypes.c_int]),
                "lou_translateString": (ctypes.c_int, _TRANSLATE),
            }
            for function, (result, arguments) in declared.items():
                entry = getattr(library, function)
                entry.restype, entry.argtypes = result, arguments
        except (OSError, ValueError, AttributeError):  # ValueError: a name with a NUL in it
            continue
        library.lou_setLogLevel(_LOG_OFF)
        return library
    found = (
        f"no liblouis in {override}" if override else "that liblouis, which writes Braille, is not installed"
    )
    raise InvalidArgument("labels", found, "liblouis", _HINT)


_LINUX: Final = ("liblouis.so.20", "liblouis.so")
_FILES: Final = {"win32": ("liblouis.dll",), "darwin": ("liblouis.20.dylib", "liblouis.dylib")}
_TRANSLATE: Final = [
    ctypes.c_char_p, ctypes.c_void_p, ctypes.POINTER(ctypes.c_int), ctypes.c_void_p,
    ctypes.POINTER(ctypes.c_int), ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int,
]  # fmt: skip


def pins_of(cells: Sequence[int], cell_pins: int) -> Bools:
    """Return cells as pins, bool [3, columns], with `cell_pins` columns from one cell to the next."""
    pins = np.zeros((3, max(cell_pins * (len(cells) - 1) + 2, 0)), np.bool_)
    for n, cell in enumerate(cells):
        for dot in range(6):
            pins[dot % 3, cell_pins * n + dot // 3] = bool(cell >> dot & 1)
    return pins


def cells_of(pins: Bools, cell_pins: int) -> tuple[int, ...]:
    """Return the cells that pins show, the inverse of `pins_of`."""
    starts = range(0, pins.shape[1], cell_pins)
    return tuple(sum(int(pins[dot % 3, start + dot // 3]) << dot for dot in range(6)) for start in starts)
