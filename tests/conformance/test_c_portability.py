"""The public headers of C as engines include them: after `windows.h`, in C++, and for other machines."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from shutil import which

import pytest

C = Path(__file__).resolve().parents[2] / "c"
# of a test; and what touch.h and touch_encode.h include
PRIVATE = ("watched_arena.h", "touch_model.h")
HEADERS = tuple(path.name for path in sorted(C.glob("*.h")) if path.name not in PRIVATE)
WRITERS = ("touch_encode.h", "touch_write.h")
WARNINGS = ("-Wall", "-Wextra", "-pedantic", "-Werror", "-fsyntax-only")
# what windows.h, windef.h, minwindef.h and rpcndr.h define, unless NOMINMAX is defined before
MACROS = """
#define near
#define far
#define small char
#define hyper long long
#define interface struct
#define min(a, b) (((a) < (b)) ? (a) : (b))
#define max(a, b) (((a) > (b)) ? (a) : (b))
"""
STANDARD = "".join(
    f"#include <{name}.h>\n" for name in ("float", "limits", "math", "stdint", "stdio", "stdlib", "string")
)
PROGRAM = """
#define TOUCH_IMPLEMENTATION
#include "touch_play.h"
static touch_play play;
touch_vector tick(touch_vector position_m, long long now_ns);
touch_vector tick(touch_vector position_m, long long now_ns) {
    (void)touch_play_decode(&play);
    return touch_receiver_tick(play.receiver, position_m, now_ns);
}
"""


def checked(compiler: str, source: Path, *options: str) -> None:
    """Check the syntax of a source; skip without the compiler, fail with what it reports."""
    if which(compiler) is None:
        pytest.skip(f"no {compiler}")
    command = [compiler, *WARNINGS, *options, f"-I{C}", str(source)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("header", HEADERS)
def test_a_header_follows_windows_h(header: str, tmp_path: Path) -> None:
    source = tmp_path / "program.c"
    part = "TOUCH_ENCODE_IMPLEMENTATION" if header in WRITERS else "TOUCH_IMPLEMENTATION"
    lines = f'#define {part}\n#include "{header}"\nint main(void) {{ return 0; }}\n'
    source.write_text(STANDARD + MACROS + lines)
    checked("cc", source, "-std=c99", "-D_DEFAULT_SOURCE", "-Wno-unused-function")


def test_the_receiver_for_engines_is_c_plus_plus_behind_windows_h(tmp_path: Path) -> None:
    source = tmp_path / "program.cc"
    source.write_text(STANDARD + MACROS + PROGRAM)
    checked("c++", source, "-std=c++11")


@pytest.mark.skipif(find_spec("ziglang") is None, reason="no ziglang, the compiler for other machines")
@pytest.mark.parametrize("target", ["x86_64-windows-gnu", "aarch64-linux-musl", "wasm32-wasi"])
def test_the_receiver_for_engines_compiles_for_another_machine(target: str, tmp_path: Path) -> None:
    source = tmp_path / "program.c"
    windows = "#include <windows.h>\n" if "windows" in target else ""
    source.write_text(windows + PROGRAM)
    strict = ("-std=c99", "-O1", "-Wall", "-Wextra", "-Werror", "-c")
    command = [sys.executable, "-m", "ziglang", "cc", "-target", target, *strict, f"-I{C}", str(source)]
    caches = {name: str(tmp_path / "zig") for name in ("ZIG_GLOBAL_CACHE_DIR", "ZIG_LOCAL_CACHE_DIR")}
    done = subprocess.run(
        [*command, "-o", str(tmp_path / "program.o")],
        capture_output=True, text=True, check=False, env={**os.environ, **caches},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "program.o").stat().st_size > 10_000
