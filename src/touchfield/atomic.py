"""Writes a file under a temporary name and renames it when it is complete.

A reader never sees a partial file, and an interrupted run leaves the older file unchanged.
"""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from touchfield.errors import InvalidArgument, SourceError


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Yield a temporary file in the folder of `path`, renamed to `path` if the block ends without an error.

    It exists and is empty when the block begins. Any error or interrupt removes it. Raises `InvalidArgument`
    if the folder does not exist or `path` is not a plain file; `SourceError` if the system refuses to write
    (permissions, disk full, name too long).
    """
    target = Path(os.path.realpath(path))  # a link stays a link: what it points to is replaced
    if not os.path.isdir(target.parent):
        raise InvalidArgument(
            str(path), f"no folder {target.parent}", "a folder that is there", "Make it first."
        )
    if os.path.exists(target) and not os.path.isfile(target):
        raise InvalidArgument(str(path), "something that is not a plain file", "the name of a file")
    temporary = target.with_name(f".{target.stem[:100]}.{secrets.token_hex(4)}{target.suffix}")
    try:
        with suppress(FileNotFoundError):
            os.stat(target)  # report an invalid name now, not after the work
        # exclusive, and with the rights that any new file of this user gets
        os.close(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
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
        found, hint = f"that it cannot be written: {reason}{about}", "The older file is untouched."
        raise SourceError(str(path), found, hint=hint) from error
    finally:
        with suppress(OSError):
            os.unlink(temporary)
