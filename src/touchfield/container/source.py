"""Bytes at a place of a file, here or elsewhere: all reading of a ``.touch`` file passes here, from many threads."""

from __future__ import annotations

import io
import os
from pathlib import Path
from threading import Lock
from typing import BinaryIO

from touchfield.container.remote import RemoteFile, is_remote
from touchfield.errors import InvalidArgument, SourceError, TruncatedFile
from touchfield.files import require_plain

__all__ = ["ByteSource"]


class ByteSource:
    """A file that is read at given places.

    Parameters
    ----------
    file : str, path or open binary file
        A path, or an address such as https://host/x.touch. A file that is already open must be seekable; it is read
        from its first byte and left open.

    Attributes
    ----------
    name : str
        What to call it in messages.
    size : int
        Its length, bytes.
    remote : RemoteFile or None
        Where it lies elsewhere.

    Raises
    ------
    SourceError
        If it cannot be opened or read.
    InvalidArgument
        If it is neither a path nor an open, seekable, binary file.
    """

    def __init__(self, file: str | os.PathLike[str] | BinaryIO) -> None:
        self._lock = Lock()
        self.remote = RemoteFile(str(file)) if is_remote(file) else None
        if self.remote is not None:
            self.name, self.size = self.remote.name, self.remote.size
            return
        self._owned = isinstance(file, (str, os.PathLike))
        if isinstance(file, (str, os.PathLike)):
            self.name = os.fspath(file)
            self._file = _opened(Path(file))
        else:
            self.name = str(getattr(file, "name", "open file"))
            if isinstance(file, io.TextIOBase):
                raise InvalidArgument(self.name, "a file that is open for text", mend='Open it with the mode "rb".')
            self._file = file
        try:
            self.size = self._file.seek(0, os.SEEK_END)
        except (OSError, ValueError, AttributeError, TypeError) as error:
            self.close()
            raise InvalidArgument(self.name, reason(error), "a path or an open, seekable, binary file") from None

    def read_at(self, offset: int, size: int) -> bytes:
        """`size` bytes from `offset` on; TruncatedFile if the file ends before.

        The size is compared with the file's before anything is allocated.
        """
        if offset + size > self.size:
            found = f"{max(0, self.size - offset)} bytes at byte {offset}, then the end of the file"
            raise TruncatedFile(self.name, found, f"{size} bytes", "Fetch or write the file again.")
        if self.remote is not None:
            return self.remote.read_at(offset, size)
        try:
            with self._lock:
                self._file.seek(offset)
                data = self._file.read(size)
                while len(data) < size and (more := self._file.read(size - len(data))):
                    data += more
        except (OSError, ValueError, TypeError, MemoryError) as error:
            raise SourceError(self.name, reason(error), f"{size} readable bytes at byte {offset}") from None
        if len(data) < size:
            found = f"{len(data)} bytes at byte {offset}, where there were more before"
            raise TruncatedFile(self.name, found, f"{size} bytes", "Let nothing write to the file while it is read.")
        return data

    def expect(self, begin: int, end: int) -> None:
        """Have bytes `begin` to `end` fetched at once, where they lie elsewhere."""
        if self.remote is not None:
            self.remote.fetch(begin, end)

    def close(self) -> None:
        """Close the file, unless it was open before."""
        if self.remote is not None:
            self.remote.close()
        elif self._owned:
            self._file.close()


def _opened(path: Path) -> BinaryIO:
    """The file at `path`, open for reading."""
    try:
        require_plain(path, "a .touch file")
        return path.open("rb")
    except FileNotFoundError:
        raise SourceError(str(path), "no such file", "a .touch file", "Check the path.") from None
    except (OSError, ValueError) as error:
        raise SourceError(str(path), reason(error), "a readable .touch file") from None


def reason(error: Exception) -> str:
    """Why the system refused, in its own words."""
    return (isinstance(error, OSError) and error.strerror) or str(error) or type(error).__name__
