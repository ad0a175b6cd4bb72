"""A lock for each unit of a device, so that two programs never drive the same one.

The lock is one of the system on a file in the user's runtime folder. The system frees it when the process
ends, however that happens, so that a crash leaves nothing to clean up.
"""

from __future__ import annotations

import os
import re
import sys
import tempfile
import weakref
from contextlib import suppress
from pathlib import Path
from typing import Final

from touchfield.errors import DeviceError, reason

_MAX_NAME: Final = 100
_PID_OFFSET: Final = 1
"""Place of the process id in the file; the byte before it is locked where a lock covers bytes."""


class UnitLock:
    """The lock of one unit, from its creation until `release` or the end of the process.

    `driver` and `unit` name the unit; `hint` is one sentence on how to name another one. Raises `DeviceError`
    if another process, or another device in this one, has the lock, or the runtime folder cannot be used.
    """

    def __init__(self, driver: str, unit: str, hint: str = "") -> None:
        name = re.sub(r"[^A-Za-z0-9.-]", "_", f"{driver}-{unit}")[:_MAX_NAME]
        try:
            path = _runtime_folder() / f"{name}.lock"
            file = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o600)
        except OSError as error:
            hint = "Set XDG_RUNTIME_DIR to a folder of yours."
            raise DeviceError(
                "lock of the device", reason(error), "a file that can be written", hint
            ) from error
        try:
            _lock(file)
        except OSError:
            owner = _process_of(file)
            os.close(file)
            found = f"that {owner} drives it"
            raise DeviceError(f"{driver} {unit}".strip(), found, "a unit that is free", hint) from None
        with suppress(OSError):  # only a message needs it
            os.ftruncate(file, 0)
            os.lseek(file, _PID_OFFSET, os.SEEK_SET)
            os.write(file, str(os.getpid()).encode())
        self._close = weakref.finalize(self, os.close, file)

    def release(self) -> None:
        """Free the unit; may be called twice."""
        self._close()


def _runtime_folder() -> Path:
    """Return the folder of the locks, which belongs to the user; raises OSError if there is none."""
    runtime = os.environ.get("XDG_RUNTIME_DIR", "")
    user = os.getuid() if hasattr(os, "getuid") else 0
    folder = Path(runtime) / "touchfield" if runtime else Path(tempfile.gettempdir()) / f"touchfield-{user}"
    folder.mkdir(mode=0o700, exist_ok=True)
    if hasattr(os, "getuid") and (folder.is_symlink() or folder.stat().st_uid != user):
        raise PermissionError(f"{folder} belongs to another user")
    return folder


def _process_of(file: int) -> str:
    """Return the process that wrote the file, as a text."""
    try:
        os.lseek(file, _PID_OFFSET, os.SEEK_SET)
        return f"process {int(os.read(file, 20))}"
    except (OSError, ValueError):
        return "another process"


if sys.platform == "win32":
    import msvcrt

    def _lock(file: int) -> None:
        msvcrt.locking(file, msvcrt.LK_NBLCK, _PID_OFFSET)
else:
    import fcntl

    def _lock(file: int) -> None:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
