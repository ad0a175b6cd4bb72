"""The block that two processes share: a file in memory, mapped by both.

A file of its own name rather than `multiprocessing.shared_memory`: where the system allows it, the name is taken away
as soon as both have opened it, so that nothing is left behind whichever process is killed; room is reserved before it
is written, so that a full ``/dev/shm`` is an error and not a crash; and a view that somebody still holds keeps the
memory alive instead of raising when the block is closed.
"""

from __future__ import annotations

import contextlib
import errno
import mmap
import os
import tempfile
from pathlib import Path
from typing import Final

from touchfield.errors import InvalidArgument
from touchfield.render.memory import WORD, Memory

__all__ = ["Block", "free_bytes", "shared_folder"]

PREFIX: Final = "touchfield-servo-"
_STEP_BYTES: Final = 1 << 22
"""Room is reserved in steps of this size."""


def shared_folder() -> Path:
    """Where shared blocks lie: in memory where the system has such a folder."""
    folder = Path("/dev/shm")
    return folder if os.access(folder, os.W_OK) else Path(tempfile.gettempdir())


def free_bytes() -> int:
    """How much room there is for shared blocks; a large number where the system does not tell."""
    if not hasattr(os, "statvfs"):
        return 1 << 40
    told = os.statvfs(shared_folder())
    return told.f_bavail * told.f_frsize


class Block:
    """A block of memory by its file.

    Attributes
    ----------
    memory : Memory
    path : Path
    """

    def __init__(self, path: Path, descriptor: int, size: int) -> None:
        self.path, self._size = path, size
        self._descriptor, self._reserved = descriptor, 0
        self.memory = Memory.of(mmap.mmap(descriptor, size))

    @classmethod
    def create(cls, words: int) -> Block:
        """A new block of zeros; its room is reserved by `reserve`.

        Raises
        ------
        InvalidArgument
            If there is no room for it.
        """
        descriptor, name = tempfile.mkstemp(prefix=PREFIX, dir=shared_folder())
        try:
            os.truncate(descriptor, WORD * words)
            return cls(Path(name), descriptor, WORD * words)
        except OSError as error:
            _remove(Path(name), descriptor)
            raise _no_room(WORD * words) from error

    @classmethod
    def attach(cls, path: Path) -> Block:
        """The block that another process made."""
        descriptor = os.open(path, os.O_RDWR)
        return cls(path, descriptor, os.fstat(descriptor).st_size)

    def reserve(self, words: int) -> None:
        """See to it that the first `words` words can be written.

        Raises
        ------
        InvalidArgument
            If there is no room for them.
        """
        wanted = min(self._size, -(-WORD * words // _STEP_BYTES) * _STEP_BYTES)
        if wanted <= self._reserved or not hasattr(os, "posix_fallocate"):
            return
        try:
            os.posix_fallocate(self._descriptor, self._reserved, wanted - self._reserved)
        except OSError as error:
            if error.errno in (errno.ENOSPC, errno.ENOMEM, errno.EFBIG):
                raise _no_room(wanted) from error
            # a file system that cannot reserve: it is written as it is
        self._reserved = wanted

    def unlink(self) -> None:
        """Take the name away; those who have opened it keep it."""
        with contextlib.suppress(OSError):
            os.unlink(self.path)

    def close(self) -> None:
        """Let it go; the memory is given back with the last view of it. May be called twice."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1
            del self.memory


def _remove(path: Path, descriptor: int) -> None:
    os.close(descriptor)
    with contextlib.suppress(OSError):
        os.unlink(path)


def _no_room(needed: int) -> InvalidArgument:
    return InvalidArgument(
        "shared memory",
        f"{free_bytes() / 2**20:.0f} MiB free in {shared_folder()}",
        f"{needed / 2**20:.0f} MiB",
        "Ask for less memory, or make that folder larger.",
    )
