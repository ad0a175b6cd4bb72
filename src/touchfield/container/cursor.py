"""Reading a payload from its first byte to its last, never beyond: what every field type decodes from."""

from __future__ import annotations

from touchfield.errors import CorruptFile

__all__ = ["Cursor"]


class Cursor:
    """How far the reading of a run of bytes has come.

    Parameters
    ----------
    payload : bytes
        All the bytes that may be read.
    where : str
        What to call them in messages: the file.
    offset : int
        Position of the first of them in the file.
    """

    def __init__(self, payload: bytes, where: str, offset: int = 0) -> None:
        self._payload, self._where, self._offset = payload, where, offset
        self._place = 0

    @property
    def place(self) -> int:
        """Position of the next byte in the file."""
        return self._offset + self._place

    @property
    def remaining(self) -> int:
        """Bytes not yet read."""
        return len(self._payload) - self._place

    def take(self, size: int, field: str) -> bytes:
        """The next `size` bytes; CorruptFile if there are fewer."""
        if size > self.remaining:
            raise self.corrupt(field, f"{self.remaining} bytes left in the record", f"{size} bytes")
        self._place += size
        return self._payload[self._place - size : self._place]

    def corrupt(self, field: str, found: str, expected: str, back: int = 0) -> CorruptFile:
        """The error of a field that begins `back` bytes before the place."""
        return CorruptFile(f"{self._where}: {field} at byte {self.place - back}", found, expected)
