"""Finds the folder on disk for the machine code of compiled kernels. Its name is a digest of all kernel
sources, so that a change in any of them leads to a new folder.

The machine code of a kernel contains that of the functions it calls and the constants it reads, also from
other files. numba's own cache only checks the file of the called function, so that it would keep using old
code from the others.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable
from contextlib import suppress
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import Final

PACKAGE: Final = Path(__file__).parents[1]
_CONSTANTS: Final = (
    *("compute/jit.py", "compute/numba_internals.py"),
    *("medium/grid.py", "render/block/layout.py"),
)
"""Other files whose constants or rules are compiled in; a test compares this list with the imports."""
_MAX_FORMER: Final = 2
"""Number of folders of other versions that are kept, so that changing between branches compiles only once."""
_PREFIX: Final = "kernels-"


def kernel_sources(package: Path = PACKAGE) -> tuple[Path, ...]:
    """All sources that are compiled into kernels, sorted.

    Empty if the package is not a folder of files.
    """
    files = {package / name for name in _CONSTANTS}
    files |= {
        path for path in package.rglob("*.py") if path.stem == "kernels" or path.parent.name == "kernels"
    }
    return tuple(sorted(path for path in files if path.is_file()))


class SourceState:
    """The kernel sources at the time of construction, and their digest.

    versions : other inputs of the machine code, such as the version of the compiler.
    """

    def __init__(self, files: Iterable[Path], versions: str, package: Path = PACKAGE) -> None:
        self.files = tuple(files)
        self._package, self._versions = package, versions
        self._stamps = self._read_stamps()

    def _read_stamps(self) -> list[tuple[int, int]]:
        return [(stat.st_mtime_ns, stat.st_size) for stat in map(os.stat, self.files)]

    def is_current(self) -> bool:
        """True if no file has changed since construction, as it may in a long process."""
        try:
            return self._stamps == self._read_stamps()
        except OSError:
            return False

    @cached_property
    def digest(self) -> str:
        """Sixteen hexadecimal digits of a hash over all files and the versions.

        Names and contents of the files are included.
        """
        total = sha256(self._versions.encode())
        for path in self.files:
            name, content = path.relative_to(self._package).as_posix().encode(), path.read_bytes()
            total.update(b"%d %d " % (len(name), len(content)) + name + content)
        return total.hexdigest()[:16]


def open_folder(root: Path, digest: str) -> Path:
    """Create the folder of these sources within `root`, and remove the oldest others.

    Another process may use a removed folder: it then compiles again (see `touchfield.compute.jit`). Raises
    OSError if the folder cannot be created.
    """
    folder = root / f"{_PREFIX}{digest}"
    is_new = not folder.is_dir()
    folder.mkdir(parents=True, exist_ok=True)
    with suppress(OSError):  # the folder may belong to another user
        os.utime(folder)  # folders last used longest ago are removed first
    if is_new:
        others = sorted((path for path in root.glob(f"{_PREFIX}*") if path != folder), key=_last_use)
        for path in others[: max(0, len(others) - _MAX_FORMER)]:
            shutil.rmtree(path, ignore_errors=True)
    return folder


def _last_use(folder: Path) -> float:
    try:
        return folder.stat().st_mtime
    except OSError:  # another process has removed it
        return 0.0
