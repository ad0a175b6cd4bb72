"""Writes and reads whole numbers of variable length (varints, as in LEB128), and parts of bytes that are
preceded by their length. All coders use them in the bodies of segments.

Each byte holds seven bits, the least significant first. Departure from LEB128: only the shortest form is
valid, so that equal values have equal bytes. Every read states the bounds of its value.
"""

from __future__ import annotations

from touchfield.errors import CorruptFile, InvalidArgument, TruncatedFile

VARINT_LIMIT = 1 << 56  # values lie below this: eight bytes at most


def write_varint(value: int) -> bytes:
    """`value` as bytes: one below 128, two below 16384, and so on.

    InvalidArgument unless it is 0 to below `VARINT_LIMIT`.
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
    data: bytes, offset: int, where: str = "varint", limit: int = VARINT_LIMIT, minimum: int = 0
) -> tuple[int, int]:
    """The value at `offset` of `data`, and the offset after it.

    TruncatedFile or CorruptFile, naming `where`, unless the value is `minimum` or more, below `limit`, and in
    its shortest form.
    """
    value, expected = 0, f"a number from {minimum} to below {limit}"
    for index in range(8):
        if offset + index >= len(data):
            raise TruncatedFile(where, f"the end of the bytes at offset {len(data)}", "a whole number")
        byte = data[offset + index]
        value |= (byte & 127) << (7 * index)
        if byte < 128:
            if byte == 0 and index:
                raise CorruptFile(where, f"a padded number at offset {offset}", "its shortest form")
            if not minimum <= value < limit:
                raise CorruptFile(where, f"{value} at offset {offset}", expected)
            return value, offset + index + 1
    raise CorruptFile(where, f"a number of more than 8 bytes at offset {offset}", expected)


def chunk(data: bytes) -> bytes:
    """`data`, preceded by its length as a varint."""
    return write_varint(len(data)) + data


class Parts:
    """Sequential reader of bytes such as the body of a segment.

    Its errors, TruncatedFile and CorruptFile, name the source of the bytes (`where`) and the part that is
    wrong.
    """

    def __init__(self, data: bytes, where: str = "SEGM.body") -> None:
        self._data, self._where, self.position = data, where, 0

    @property
    def is_ended(self) -> bool:
        """True if no bytes are left."""
        return self.position == len(self._data)

    def take(self, count: int, part: str) -> bytes:
        """The next `count` bytes."""
        data = self._data[self.position : self.position + count]
        if len(data) < count:
            raise TruncatedFile(f"{self._where} {part}", f"{len(data)} bytes", f"{count} bytes")
        self.position += count
        return data

    def rest(self) -> bytes:
        """All remaining bytes."""
        return self.take(len(self._data) - self.position, "rest")

    def varint(self, part: str, limit: int = VARINT_LIMIT, minimum: int = 0) -> int:
        """The next whole number, from `minimum` to below `limit`."""
        number, self.position = read_varint(
            self._data, self.position, f"{self._where} {part}", limit, minimum
        )
        return number

    def chunk(self, part: str, minimum: int = 0) -> bytes:
        """The next bytes that are preceded by their length, `minimum` or more of them."""
        return self.take(self.varint(part, minimum=minimum), part)

    def check_end(self, part: str = "frame") -> None:
        """CorruptFile if bytes follow the last part."""
        if not self.is_ended:
            raise CorruptFile(
                self._where, f"{len(self._data) - self.position} bytes after the last {part}", "none"
            )
