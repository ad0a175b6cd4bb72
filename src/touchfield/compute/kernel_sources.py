"""Where compiled kernels are stored on disk: a folder named by a digest of all sources that enter them.

A kernel holds the machine code of the functions it calls, and the constants it reads, of other files as well.
numba's own cache compares the file of the called function alone, so that it goes on using old code of the
others.
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
    *("compute/jit.py", "compute/coder_jit.py", "compute/numba_internals.py"),
    *("medium/grid.py", "render/block/words.py", "render/tool.py"),
)
"""Other files whose constants or rules are compiled in; a test compares them with the imports."""
_MAX_FORMER: Final = 2
"""Folders of other versions that stay: whoever changes between branches compiles once."""
_PREFIX: Final = "kernels-"


def kernel_sources(package: Path = PACKAGE) -> tuple[Path, ...]:
    """All sources that are compiled into kernels, sorted; empty where the package is no folder of files."""
    files = {package / name for name in _CONSTANTS}
    files |= {
        path for path in package.rglob("*.py") if path.stem == "kernels" or path.parent.name == "kernels"
    }
    return tuple(sorted(path for path in files if path.is_file()))


class SourceState:
    """The kernel sources as they were when this was constructed, and their digest.

    versions : what else decides about the machine code, such as the version of the compiler.
    """

    def __init__(self, files: Iterable[Path], versions: str, package: Path = PACKAGE) -> None:
        self.files = tuple(files)
        self._package, self._versions = package, versions
        self._stamps = self._read_stamps()

    def _read_stamps(self) -> list[tuple[int, int]]:
        return [(stat.st_mtime_ns, stat.st_size) for stat in map(os.stat, self.files)]

    def is_current(self) -> bool:
        """Whether no file has changed since: a process may run longer than its sources last."""
        try:
            return self._stamps == self._read_stamps()
        except OSError:
            return False

    @cached_property
    def digest(self) -> str:
        """Sixteen hexadecimal digits of the names and the contents of all files, and of the versions."""
        total = sha256(self._versions.encode())
        for path in self.files:
            name, content = path.relative_to(self._package).as_posix().encode(), path.read_bytes()
            total.update(b"%d %d " % (len(name), len(content)) + name + content)
        return total.hexdigest()[:16]


def open_folder(root: Path, digest: str) -> Path:
    """Create the folder of these sources within `root`, and remove the oldest of other sources.

    Another process may use what is removed: it then compiles again (see `touchfield.compute.jit`). Raises
    OSError if the folder cannot be created.
    """
    folder = root / f"{_PREFIX}{digest}"
    is_new = not folder.is_dir()
    folder.mkdir(parents=True, exist_ok=True)
    with suppress(OSError):  # of another user
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
