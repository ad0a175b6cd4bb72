"""Files that strangers may name: opened only where they are plain files, and where they may lie.

A pipe would be waited for without end, a device read without end. A file that another one names lies in that
one's folder, or below it, unless the user allows more: who opens a stranger's scene does not expect it to
read elsewhere.
"""

from __future__ import annotations

import json
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from touchfield.errors import InvalidArgument, SourceError


def require_plain(path: str | os.PathLike[str], expected: str, *, or_folder: bool = False) -> None:
    """Refuse what is there and is no plain file: a pipe, a socket, a device, and a folder unless that is
    taken.

    Nothing is opened; that nothing is there is for who opens it to tell. Raises `SourceError`.
    """
    try:
        mode = os.stat(path).st_mode
    except (OSError, ValueError):
        return
    if stat.S_ISREG(mode) or (or_folder and stat.S_ISDIR(mode)):
        return
    kind = "a folder" if stat.S_ISDIR(mode) else "a pipe, a socket or a device"
    raise SourceError(os.fspath(path), kind, expected)


def is_same_file(a: str | os.PathLike[str], b: str | os.PathLike[str]) -> bool:
    """True where two names stand for one file that is there."""
    return os.path.exists(a) and os.path.exists(b) and os.path.samefile(a, b)


def keep_sources(out: str | os.PathLike[str], *sources: str | os.PathLike[str]) -> None:
    """Refuse to write over what is read, with `InvalidArgument`."""
    if any(is_same_file(source, out) for source in sources):
        raise InvalidArgument(
            str(out), "the file that is read", "another name", "Name a new file for the result."
        )


@contextmanager
def readable(where: Path, expected: str = "a file that can be read", mend: str = "") -> Iterator[None]:
    """Within it what the system refuses, an `OSError`, is a `SourceError`."""
    try:
        yield
    except OSError as error:
        raise SourceError(str(where), error.strerror or str(error), expected, mend) from error


def plain_size(path: Path, expected: str) -> int:
    """The length of a plain file, bytes; OSError if there is none, SourceError as `require_plain`."""
    require_plain(path, expected)
    return path.stat().st_size


def read_bytes(path: str | os.PathLike[str], most_bytes: int, what: str) -> bytes:
    """The bytes of a plain file of at most so many.

    Raises SourceError, which says `what` the file should be, if it cannot be read or is longer.
    """
    require_plain(path, what)
    try:
        with open(path, "rb") as file:
            data = file.read(most_bytes + 1)
    except (OSError, ValueError) as error:  # ValueError: a path with a NUL in it
        words = error.strerror if isinstance(error, OSError) else None
        raise SourceError(str(path), words or str(error), what, "Check path and rights.") from error
    if len(data) > most_bytes:
        raise SourceError(str(path), f"more than {most_bytes} bytes", f"{what} up to that")
    return data


def require_beside(folder: Path, name: str | os.PathLike[str], where: str, *, anywhere: bool = False) -> Path:
    """The path of a file that a scene file in `folder` names, relative to it or absolute; `where` names file
    and key.

    `SourceError` if it lies outside `folder`, by its name or through a link, unless the user allows files
    `anywhere`, as ``--allow-outside`` does.
    """
    path = folder / name
    if not anywhere:
        try:
            is_beside = path.resolve().is_relative_to(folder.resolve())
        except (OSError, ValueError, RuntimeError):  # a name that is none, or links in a ring
            is_beside = False
        if not is_beside:
            mend = "Copy it there; for models and scene files --allow-outside allows it."
            raise SourceError(
                where, repr(os.fspath(name))[:100], f"a file in the folder {folder} or below it", mend
            )
    return path


def json_of(text: str) -> Any:
    """Value of JSON text; a whole number of 19 digits or more is a float there, beyond the largest float
    infinite.
    """
    return json.loads(text, parse_int=lambda digits: int(digits) if len(digits) < 19 else float(digits))


def standard_input() -> IO[bytes]:
    """Standard input without a buffer, and so without a lock that a waiting thread could hold at the end."""
    return open(0, "rb", buffering=0, closefd=False)


def exactly(file: IO[bytes], count: int) -> bytes:
    """So many bytes of a pipe; fewer only at its end."""
    data = bytearray()
    while len(data) < count and (more := file.read(min(count - len(data), 1 << 20))):
        data += more
    return bytes(data)
