"""Opens and reads files safely when their names come from untrusted input, such as a scene file that names
meshes.

Only plain files are opened: reading a pipe may block and reading a device may never end. A file that a scene
file names must lie in the folder of that scene file or below it, unless the user allows more.
"""

from __future__ import annotations

import json
import os
import re
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import IO, Any, Final

from touchfield.errors import InvalidArgument, SourceError, TouchfieldError, reason

_MORE_BYTES: Final = 1 << 20
"""Read at once of a file that is longer than the system states."""


def require_plain(path: str | os.PathLike[str], expected: str, *, or_folder: bool = False) -> None:
    """Raise `SourceError` if `path` exists and is a pipe, a socket, a device, or a folder (see `or_folder`).

    Nothing is opened. A missing file passes: opening it reports the error.
    """
    try:
        mode = os.stat(path).st_mode
    except (OSError, ValueError):
        return
    if stat.S_ISREG(mode) or (or_folder and stat.S_ISDIR(mode)):
        return
    kind = "a folder" if stat.S_ISDIR(mode) else "a pipe, a socket or a device"
    raise SourceError(os.fspath(path), kind, expected)


_ADDRESS: Final = re.compile(r"[a-z][a-z0-9+.-]+://", re.IGNORECASE)


def is_remote(name: object) -> bool:
    """True for an address such as https://host/x.touch or s3://bucket/x.touch."""
    return isinstance(name, str) and _ADDRESS.match(name) is not None


def url_path(url: str) -> str:
    """The path of an address, without query and fragment; also of one that `urllib.parse` refuses."""
    rest = re.split("[?#]", url.partition("://")[2])[0]
    return "".join(rest.partition("/")[1:])


def without_secret(url: str) -> str:
    """An address for messages, without the password and the query.

    A query may contain a token.
    """
    scheme, _, rest = url.partition("://")
    host, slash, path = rest.partition("/")
    return f"{scheme}://{host.rpartition('@')[2]}{slash}{path.partition('?')[0]}"


def is_same_file(a: str | os.PathLike[str], b: str | os.PathLike[str]) -> bool:
    """Return True if both names refer to one existing file."""
    return os.path.exists(a) and os.path.exists(b) and os.path.samefile(a, b)


def refuse_overwriting(out: str | os.PathLike[str], *sources: str | os.PathLike[str]) -> None:
    """Raise `InvalidArgument` if the output is one of the files that are read."""
    if any(is_same_file(source, out) for source in sources):
        raise InvalidArgument(
            str(out), "the file that is read", "another name", "Name a new file for the result."
        )


_RECORDED: ContextVar[set[Path] | None] = ContextVar("_RECORDED", default=None)


@contextmanager
def recorded_reads() -> Iterator[set[Path]]:
    """Within the block, collect the resolved paths of the files that `record_read` names."""
    paths: set[Path] = set()
    token = _RECORDED.set(paths)
    try:
        yield paths
    finally:
        _RECORDED.reset(token)


def record_read(path: Path) -> None:
    """Name a file that is read, for `recorded_reads`."""
    paths = _RECORDED.get()
    if paths is not None:
        paths.add(path.resolve())


@contextmanager
def library_faults(
    where: str | os.PathLike[str], found: str, expected: str, hint: str = ""
) -> Iterator[None]:
    """Within the block, where a library reads untrusted bytes, convert any of its errors to a `SourceError`.

    Libraries do not document what they raise for invalid bytes: fuzzing found an UnboundLocalError of SciPy
    and errors of decompressors below a library. `found` describes the file; the library's message follows it.
    """
    try:
        yield
    except TouchfieldError:
        raise
    except MemoryError as error:
        raise SourceError(os.fspath(where), f"{found} (it takes too much memory)", expected, hint) from error
    except Exception as error:
        raise SourceError(os.fspath(where), f"{found} ({reason(error)})", expected, hint) from error


_SYSTEM_ERRORS: Final[tuple[tuple[type[OSError], str, str], ...]] = (
    (FileNotFoundError, "no such file", "Check the path."),
    (NotADirectoryError, "no such file", "Check the path: a part of it is no folder."),
    (IsADirectoryError, "a folder", "Name a file."),
    (PermissionError, "no permission", "Check its permissions, and those of its folder."),
)
"""What the system reports, what that means, and how to fix it."""


def file_error(
    where: str | os.PathLike[str], error: OSError | ValueError, expected: str, hint: str = ""
) -> SourceError:
    """Return the error of a file that the system does not open or read, with what helps if `hint` is empty.

    A ValueError is that of a name with a NUL in it.
    """
    found, usual_hint = reason(error), "Check the path and the permissions."
    for kind, wording, kind_hint in _SYSTEM_ERRORS:
        if isinstance(error, kind):
            found, usual_hint = wording, kind_hint
    return SourceError(os.fspath(where), found, expected, hint or usual_hint)


@contextmanager
def readable(where: Path, expected: str = "a file that can be read", hint: str = "") -> Iterator[None]:
    """Within the block, convert an `OSError` to a `SourceError`, as `file_error`."""
    try:
        yield
    except OSError as error:
        raise file_error(where, error, expected, hint) from error


def plain_size(path: Path, expected: str) -> int:
    """Return the length of a plain file, bytes; OSError if it is missing, SourceError as `require_plain`."""
    require_plain(path, expected)
    return path.stat().st_size


def read_bytes(path: str | os.PathLike[str], max_bytes: int, expected: str) -> bytes:
    """Read a plain file of at most `max_bytes`.

    Raises SourceError, which names what was `expected`, if it cannot be read or is longer.
    """
    require_plain(path, expected)
    try:
        with open(path, "rb") as file:
            size = min(os.fstat(file.fileno()).st_size, max_bytes)  # 0 for files of the system, such as /proc
            data = file.read(size + 1)  # which allocates that much before it reads
            while size < len(data) <= max_bytes and (part := file.read(_MORE_BYTES)):
                data += part
    except (OSError, ValueError) as error:  # ValueError: a path with a NUL in it
        raise file_error(path, error, expected) from error
    if len(data) > max_bytes:
        raise SourceError(str(path), f"more than {max_bytes} bytes", f"{expected} up to that")
    return data


def require_in_folder(
    folder: Path, name: str | os.PathLike[str], where: str, *, anywhere: bool = False
) -> Path:
    """Return the path of a file that a scene file in `folder` names; `where` names that file and its key.

    `name` is relative to `folder` or absolute. Raises `SourceError` if the file lies outside `folder`,
    directly or through a link, unless `anywhere` is set (``--allow-outside``).
    """
    path = folder / name
    if not anywhere:
        try:
            is_inside = path.resolve().is_relative_to(folder.resolve())
        except (OSError, ValueError, RuntimeError):  # an invalid name, or a cycle of links
            is_inside = False
        if not is_inside:
            hint = "Copy it there; for models and scene files --allow-outside allows it."
            raise SourceError(
                where, repr(os.fspath(name))[:100], f"a file in the folder {folder} or below it", hint
            )
    return path


def json_of(text: str) -> Any:
    """Parse JSON text; integers of 19 digits or more become floats, infinite beyond the largest float."""
    return json.loads(text, parse_int=lambda digits: int(digits) if len(digits) < 19 else float(digits))


def standard_input() -> IO[bytes]:
    """Open standard input unbuffered, so that a waiting thread holds no lock at exit."""
    return open(0, "rb", buffering=0, closefd=False)


def read_up_to(file: IO[bytes], count: int) -> bytes:
    """Read `count` bytes of a pipe; fewer only at its end."""
    data = bytearray()
    while len(data) < count and (chunk := file.read(min(count - len(data), 1 << 20))):
        data += chunk
    return bytes(data)
