"""Reading a payload from its first byte to its last, never beyond: what every field type decodes from."""

from __future__ import annotations

from touchfield.errors import CorruptFile

__all__ = ["Cursor"]


class Cursor:
    """How far the reading of a run of bytes has come.

    Parameters
    ----------
    data : bytes
        Bytes of a file.
    where : str
        What to call the file in messages.
    offset : int
        Position of the first of `data` in the file.
    begin, end : int, optional
        Which of `data` may be read, as in a slice, but without a copy.
    """

    def __init__(self, data: bytes, where: str, offset: int = 0, begin: int = 0, end: int | None = None) -> None:
        self._data, self._where, self._offset = data, where, offset
        self._place, self._end, _ = slice(begin, end).indices(len(data))

    @property
    def place(self) -> int:
        """Position of the next byte in the file."""
        return self._offset + self._place

    @property
    def remaining(self) -> int:
        """Bytes not yet read."""
        return self._end - self._place

    def take(self, size: int, field: str) -> bytes:
        """The next `size` bytes; CorruptFile if there are fewer."""
        if size > self.remaining:
            raise self.corrupt(field, f"{self.remaining} bytes left in the record", f"{size} bytes")
        self._place += size
        return self._data[self._place - size : self._place]

    def corrupt(self, field: str, found: str, expected: str, back: int = 0) -> CorruptFile:
        """The error of a field that begins `back` bytes before the place."""
        return CorruptFile(f"{self._where}: {field} at byte {self.place - back}", found, expected)
