"""Bounded variable-length integers: seven bits a byte, least significant first, as in LEB128.

Departure: the shortest form is the only one, so that equal values have equal bytes, and every read names the
bound its value must keep.
"""

from __future__ import annotations

from touchfield.errors import CorruptFile, InvalidArgument, TruncatedFile

VARINT_LIMIT = 1 << 56  # values lie below this: eight bytes at most


def write_varint(value: int) -> bytes:
    """`value`, 0 to below `VARINT_LIMIT` (else InvalidArgument), as bytes: one below 128, two below 16384,
    ...
    """
    if not 0 <= value < VARINT_LIMIT:
        raise InvalidArgument("varint", repr(value), f"0 to {VARINT_LIMIT - 1}")
    out = bytearray()
    while value > 127:
        out.append(value & 127 | 128)
        value >>= 7
    out.append(value)
    return bytes(out)


def read_varint(
    data: bytes, offset: int, where: str = "varint", limit: int = VARINT_LIMIT, least: int = 0
) -> tuple[int, int]:
    """The value at `offset` of `data`, and the offset behind it; TruncatedFile or CorruptFile, which name
    `where`.

    It must be `least` or more, below `limit`, and in its shortest form.
    """
    value, expected = 0, f"a number from {least} to below {limit}"
    for place in range(8):
        if offset + place >= len(data):
            raise TruncatedFile(where, f"the end of the bytes at offset {len(data)}", "a whole number")
        byte = data[offset + place]
        value |= (byte & 127) << (7 * place)
        if byte < 128:
            if byte == 0 and place:
                raise CorruptFile(where, f"a padded number at offset {offset}", "its shortest form")
            if not least <= value < limit:
                raise CorruptFile(where, f"{value} at offset {offset}", expected)
            return value, offset + place + 1
    raise CorruptFile(where, f"a number of more than 8 bytes at offset {offset}", expected)


def chunk(data: bytes) -> bytes:
    """Bytes behind their number."""
    return write_varint(len(data)) + data


class Parts:
    """Bytes, such as the body of a segment, read from front to end.

    TruncatedFile or CorruptFile name `where` the bytes stand, and what the part is.
    """

    def __init__(self, data: bytes, where: str = "SEGM.body") -> None:
        self._data, self._where, self.at = data, where, 0

    @property
    def is_ended(self) -> bool:
        """True when all was read."""
        return self.at == len(self._data)

    def take(self, count: int, what: str) -> bytes:
        """The next `count` bytes."""
        taken = self._data[self.at : self.at + count]
        if len(taken) < count:
            raise TruncatedFile(f"{self._where} {what}", f"{len(taken)} bytes", f"{count} bytes")
        self.at += count
        return taken

    def rest(self) -> bytes:
        """All bytes that are left."""
        return self.take(len(self._data) - self.at, "rest")

    def varint(self, what: str, limit: int = VARINT_LIMIT, least: int = 0) -> int:
        """The next whole number, from `least` to below `limit`."""
        number, self.at = read_varint(self._data, self.at, f"{self._where} {what}", limit, least)
        return number

    def chunk(self, what: str, least: int = 0) -> bytes:
        """Bytes behind their number, `least` of them or more."""
        return self.take(self.varint(what, least=least), what)

    def check_end(self, what: str = "frame") -> None:
        """Refuse bytes behind the last part."""
        if not self.is_ended:
            raise CorruptFile(self._where, f"{len(self._data) - self.at} bytes after the last {what}", "none")
