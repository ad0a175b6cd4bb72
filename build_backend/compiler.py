"""Finds a C compiler and compiles `touchfield._native` from ``c/python/module.c``.

The compiler is the one that ``CC`` names, else ``cc``, ``gcc`` or ``clang``, else the package `ziglang`, a
compiler in a wheel. It must compile a file that includes the headers that the module needs: some systems have
a compiler without the headers of the C library.
"""

from __future__ import annotations

import importlib.util
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "c" / "python" / "module.c"
ZIGLANG = "ziglang>=0.16"
# no fused products: encoders on all machines are to decide alike; errno and traps, which nobody reads, would
# keep loops with square roots and comparisons from being vectorised
_NUMBERS = ("-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math")
# zig adds debug information, five sixths of a wheel's module, where it is not told otherwise
OPTIONS = ("-O3", "-g0", "-std=c99", *_NUMBERS, "-shared", "-fPIC", "-fvisibility=hidden")

_PROBE = "#include <math.h>\n#include <stdlib.h>\n#include <string.h>\nint probe(void) { return 0; }\n"


class NoCompiler(Exception):
    """There is no C compiler on this machine, or none works."""


def find_compiler() -> list[str]:
    """Return the command of a C compiler that works; raise `NoCompiler` if there is none."""
    named = os.environ.get("CC")
    candidates = [shlex.split(named)] if named else [[name] for name in ("cc", "gcc", "clang")]
    for command in candidates:
        if command and shutil.which(command[0]) and _compiles(command):
            return command
    if importlib.util.find_spec("ziglang") is not None:
        return [sys.executable, "-m", "ziglang", "cc"]
    raise NoCompiler(f"no C compiler works (tried {', '.join(' '.join(c) for c in candidates)}, ziglang)")


def requirements() -> list[str]:
    """Packages that a build needs on this machine: `ziglang` if there is no other compiler."""
    try:
        find_compiler()
    except NoCompiler:
        return [ZIGLANG]
    return []


def compile_module(folder: Path, target: str | None = None) -> Path:
    """Compile the module into `folder`; return its path.

    `target` is a target of zig such as ``aarch64-linux-gnu.2.17`` (see `targets`), by default this machine.
    Raises `NoCompiler`, or `subprocess.CalledProcessError` if the compiler refuses the source.
    """
    zig = [sys.executable, "-m", "ziglang", "cc"]
    compiler = find_compiler() if target is None else [*zig, "-target", target]
    path = folder / f"_native{module_suffix(target)}"
    source = SOURCE.relative_to(ROOT)
    print(f"touchfield: {' '.join(compiler)} compiles {source}", file=sys.stderr, flush=True)
    command = [*compiler, *OPTIONS, *_link_options(target), "-o", str(path), str(SOURCE)]
    with tempfile.TemporaryDirectory() as scratch:
        subprocess.run([*command, *_libraries(target, Path(scratch))], check=True)
    return path


def module_suffix(target: str | None) -> str:
    """Suffix of a module of the stable ABI."""
    is_windows = sys.platform == "win32" if target is None else "windows" in target
    return ".pyd" if is_windows else ".abi3.so"


def _compiles(command: list[str]) -> bool:
    with tempfile.TemporaryDirectory() as folder:
        source, out = Path(folder) / "probe.c", Path(folder) / "probe.so"
        source.write_text(_PROBE)
        try:
            done = subprocess.run(
                [*command, "-shared", "-fPIC", "-o", str(out), str(source)], capture_output=True, check=False
            )
        except OSError:
            return False
        return done.returncode == 0 and out.exists()


def _link_options(target: str | None) -> list[str]:
    """Options that leave the symbols of Python to be found when the module is loaded."""
    is_mac = sys.platform == "darwin" if target is None else "macos" in target
    return ["-Wl,-undefined,dynamic_lookup"] if is_mac else []


def _libraries(target: str | None, scratch: Path) -> list[str]:
    is_windows = sys.platform == "win32" if target is None else "windows" in target
    return [str(_import_library(scratch))] if is_windows else ["-lm"]


def _import_library(folder: Path) -> Path:
    """Import library of python3.dll in a folder, made from the names that the module uses."""
    definition = SOURCE.with_name("python3.def")
    library = folder / "python3.lib"
    command = [sys.executable, "-m", "ziglang", "dlltool", "-m", "i386:x86-64", "-D", "python3.dll"]
    subprocess.run([*command, "-d", str(definition), "-l", str(library)], check=True)
    return library
