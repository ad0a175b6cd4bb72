"""The end of an arithmetic code: all of it was there, and nothing is behind it."""

from __future__ import annotations

from touchfield.errors import CorruptFile, TruncatedFile

__all__ = ["check_end"]


def check_end(status: int, tail: tuple[int, bytes], data: bytes, where: str) -> None:
    """Refuse code that ended early, held a symbol that there is not, or is longer than what was read.

    Raises
    ------
    TruncatedFile, CorruptFile
    """
    from touchfield.codec.kernels import whole_numbers as kernels

    place, end = tail
    if status == kernels.ENDED or (status == kernels.DONE and len(data) < place + len(end)):
        raise TruncatedFile(where, f"the end of the code after {len(data)} bytes", "more of it")
    if status != kernels.DONE:
        raise CorruptFile(where, "a symbol that there is not", "a symbol of the code")
    if data[place:] != end:
        raise CorruptFile(where, "bytes behind the end of the code", f"{place + len(end)} bytes")
