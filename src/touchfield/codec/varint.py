"""Bounded variable-length integers: seven bits a byte, least significant first, as in LEB128.

Departure: the shortest form is the only one, so that equal values have equal bytes, and every read names the
bound its value must keep.
"""

from __future__ import annotations

from touchfield.errors import CorruptFile, InvalidArgument, TruncatedFile

__all__ = ["VARINT_LIMIT", "read_varint", "write_varint"]

VARINT_LIMIT = 1 << 56
"""Values lie below this: eight bytes at most."""


def write_varint(value: int) -> bytes:
    """`value`, 0 <= value < `VARINT_LIMIT`, as bytes: one below 128, two below 16384, and so on.

    Raises
    ------
    InvalidArgument
        If the value is out of range.
    """
    if not 0 <= value < VARINT_LIMIT:
        raise InvalidArgument("varint", repr(value), f"0 to {VARINT_LIMIT - 1}")
    out = bytearray()
    while value > 127:
        out.append(value & 127 | 128)
        value >>= 7
    out.append(value)
    return bytes(out)


def read_varint(data: bytes, offset: int, where: str = "varint", limit: int = VARINT_LIMIT) -> tuple[int, int]:
    """The value at `offset` of `data`, and the offset behind it.

    Parameters
    ----------
    data : bytes
    offset : int
    where : str, optional
        What the value is; for the message.
    limit : int, optional
        The value must lie below this.

    Raises
    ------
    TruncatedFile
        If the bytes end within the value.
    CorruptFile
        If the value is `limit` or more, or not in its shortest form.
    """
    value = 0
    for place in range(8):
        if offset + place >= len(data):
            raise TruncatedFile(where, f"the end of the bytes at offset {len(data)}", "a whole number")
        byte = data[offset + place]
        value |= (byte & 127) << (7 * place)
        if byte < 128:
            if byte == 0 and place:
                raise CorruptFile(where, f"a padded number at offset {offset}", "its shortest form")
            if value >= limit:
                raise CorruptFile(where, f"{value} at offset {offset}", f"a number below {limit}")
            return value, offset + place + 1
    raise CorruptFile(where, f"a number of more than 8 bytes at offset {offset}", f"a number below {limit}")
