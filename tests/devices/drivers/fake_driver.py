"""Fake drivers: shared libraries built from C files in this folder, which record the calls they get."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

FOLDER = Path(__file__).resolve().parent


def built(name: str, folder: Path) -> Path:
    """Build ``NAME.c`` as a shared library in `folder`; skip if there is no C compiler."""
    compiler = next((c for c in ("cc", "gcc", "clang") if shutil.which(c)), None)
    if compiler is None:
        pytest.skip("no C compiler (cc, gcc or clang), which builds the fake driver")
    library = folder / f"lib{name}.so"
    command = [
        compiler,
        "-O1",
        "-shared",
        "-fPIC",
        "-o",
        str(library),
        str(FOLDER / f"{name}.c"),
        "-lpthread",
        "-lm",
    ]
    subprocess.run(command, check=True, capture_output=True, text=True)
    return library


class FakeDriver:
    """The library that the adapter loads; it is loaded once per process."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.library = ctypes.CDLL(str(path))
        for text in ("fake_faults", "fake_log", "fake_configuration"):
            if hasattr(self.library, text):
                getattr(self.library, text).restype = ctypes.c_char_p
        self.library.fake_forces.restype = ctypes.POINTER(ctypes.c_double)
        if hasattr(self.library, "fake_mass"):
            self.library.fake_mass.restype = ctypes.c_double
        self.library.fake_reset()

    def fail(self, function: str, code: int) -> None:
        """Make a function fail."""
        self.library.fake_fail(function.encode(), code)

    @property
    def forces(self) -> np.ndarray:
        """All forces that were set, newtons, [n, 3]."""
        count = self.library.fake_count()
        return np.ctypeslib.as_array(self.library.fake_forces(), (max(1, count), 3))[:count].copy()

    @property
    def log(self) -> str:
        """One letter per call."""
        return self.library.fake_log().decode()

    @property
    def faults(self) -> str:
        """The first call that was out of order, or ""."""
        return self.library.fake_faults().decode()
