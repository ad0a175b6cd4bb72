"""Writes a file under a temporary name and renames it when it is complete.

A reader never sees a partial file, and an interrupted run leaves the older file unchanged.

A run that is killed leaves its temporary file or folder, ``.NAME.XXXXXXXX.touch``. The next write to the
same target removes it. One that another process writes now is kept: its writer holds a lock, which ends with
the process. Where there are no locks (Windows, some network file systems), nothing is removed.
"""

from __future__ import annotations

import os
import re
import secrets
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from touchfield.errors import InvalidArgument, SourceError
from touchfield.files import readable

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

_TEMPORARY: Final = re.compile(r"\..+\.[0-9a-f]{8}(\.[^.]*)?", re.DOTALL)


def is_temporary(name: str) -> bool:
    """Return True if a file or folder of this name is a temporary one of a run, or was left by one."""
    return _TEMPORARY.fullmatch(name) is not None


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Yield a temporary file in the folder of `path`, renamed to `path` if the block ends without an error.

    It exists and is empty when the block begins. Any error or interrupt removes it. Raises `InvalidArgument`
    if the folder does not exist or `path` is not a plain file; `SourceError` if the system refuses to write
    (permissions, disk full, name too long).
    """
    target = Path(os.path.realpath(path))  # a link stays a link: what it points to is replaced
    _require_folder(path, target.parent)
    if os.path.exists(target) and not os.path.isfile(target):
        raise InvalidArgument(str(path), "something that is not a plain file", "the name of a file")
    temporary, lock = _temporary_of(target), -1
    try:
        with suppress(FileNotFoundError):
            os.stat(target)  # report an invalid name now, not after the work
        _remove_leftovers(target)
        temporary, lock = _create(target, temporary)
        yield temporary
        handle = os.open(temporary, os.O_RDWR)
        try:
            os.fsync(handle)  # so that the new name cannot outlive the bytes in a power cut
        finally:
            os.close(handle)
        os.replace(temporary, target)
    except SourceError as error:
        if error.where != str(temporary):
            raise
        raise SourceError(str(path), error.found, error.expected, error.hint) from error  # of a writer within
    except OSError as error:
        reason = error.strerror or type(error).__name__
        elsewhere = error.filename is not None and Path(os.fsdecode(error.filename)) != temporary
        about = (
            f" ({error.filename!s})" if elsewhere and isinstance(error.filename, str | os.PathLike) else ""
        )
        has_older, found = os.path.lexists(target), f"that it cannot be written: {reason}{about}"
        hint = "The older file is untouched." if has_older else "Check the path and the permissions."
        raise SourceError(str(path), found, hint=hint) from error
    finally:
        with suppress(OSError):
            os.unlink(temporary)
        if lock >= 0:
            os.close(lock)


@contextmanager
def temporary_folder(path: Path) -> Iterator[Path]:
    """Yield an empty folder next to `path`, for files that are moved there when all of them are complete.

    It is removed when the block ends, with what is still in it. Raises `InvalidArgument` if the folder of
    `path` does not exist, `SourceError` if the system refuses to write there.
    """
    target = Path(os.path.realpath(path.parent), path.name)
    _require_folder(path, target.parent)
    with readable(path, "a folder that can be written"):
        _remove_leftovers(target, is_folder=True)
        temporary, lock = _create_folder(target)
    try:
        yield temporary
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
        if lock >= 0:
            os.close(lock)


def _require_folder(path: Path, folder: Path) -> None:
    """Raise `InvalidArgument` if the folder of a path to write does not exist."""
    if not os.path.isdir(folder):
        raise InvalidArgument(str(path), f"no folder {folder}", "a folder that is there", "Make it first.")


def _temporary_of(target: Path) -> Path:
    return target.with_name(f".{target.stem[:100]}.{secrets.token_hex(4)}{target.suffix}")


def _create(target: Path, temporary: Path) -> tuple[Path, int]:
    """Create an empty temporary file; return its path and the handle that locks it, -1 without locks."""
    while True:
        # exclusive, and with the rights that any new file of this user gets
        handle = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
        if fcntl is None:
            os.close(handle)
            return temporary, -1
        with suppress(OSError):  # a file system without locks, where nothing is removed
            fcntl.flock(handle, fcntl.LOCK_EX)
        if os.path.exists(temporary):
            return temporary, handle
        os.close(handle)  # another process took it for a leftover before it was locked
        temporary = _temporary_of(target)


def _create_folder(target: Path) -> tuple[Path, int]:
    """Create an empty temporary folder; return its path and the handle that locks it, -1 without locks."""
    while True:
        temporary = _temporary_of(target)
        temporary.mkdir()
        if fcntl is None:
            return temporary, -1
        handle = -1
        with suppress(OSError):  # also where another process took it for a leftover before it was locked
            handle = os.open(temporary, os.O_RDONLY)
            fcntl.flock(handle, fcntl.LOCK_EX)
        if os.path.exists(temporary):
            return temporary, handle
        if handle >= 0:
            os.close(handle)


def _remove_leftovers(target: Path, *, is_folder: bool = False) -> None:
    """Remove temporary files, or folders, of the same target that no process writes any more."""
    if fcntl is None:
        return
    prefix, suffix = f".{target.stem[:100]}.", target.suffix
    with suppress(OSError), os.scandir(target.parent) as entries:
        for entry in entries:
            name = entry.name
            middle = name[len(prefix) : len(name) - len(suffix)]
            if name.startswith(prefix) and name.endswith(suffix) and re.fullmatch("[0-9a-f]{8}", middle):
                with suppress(OSError):
                    _remove_unless_locked(entry.path, is_folder=is_folder)


def _remove_unless_locked(path: str, *, is_folder: bool) -> None:
    """Remove a plain file, or a folder, that no process has locked.

    Raises OSError if one has, or there are no locks.
    """
    is_kind = stat.S_ISDIR if is_folder else stat.S_ISREG
    if not is_kind(os.lstat(path).st_mode):
        return
    handle = os.open(path, (os.O_RDONLY if is_folder else os.O_RDWR) | os.O_NOFOLLOW)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        shutil.rmtree(path) if is_folder else os.unlink(path)
    finally:
        os.close(handle)
