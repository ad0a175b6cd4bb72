"""The headers of the receiver, as programs in C and in C++ include them."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from second import CONFORMANCE

C = CONFORMANCE.parent / "c"
HEADERS = (
    *("vector", "receiver", "cells", "query", "tool", "batch", "placed", "slopes", "segment_blend"),
    *("proxy", "effects", "render", "openhaptics"),
)
WARNINGS = ("-Wall", "-Wextra", "-pedantic", "-Werror", "-fsyntax-only")


@pytest.mark.parametrize("header", HEADERS)
@pytest.mark.parametrize(
    ("compiler", "options"),
    [("cc", ("-std=c99", "-D_DEFAULT_SOURCE", "-Wconversion")), ("c++", ("-std=c++11",))],
)
def test_a_header_compiles_on_its_own(
    header: str, compiler: str, options: tuple[str, ...], tmp_path: Path
) -> None:
    if shutil.which(compiler) is None:
        pytest.skip(f"no {compiler}")
    source = tmp_path / ("program.c" if compiler == "cc" else "program.cc")
    source.write_text(f'#include "touch_{header}.h"\nint main(void) {{ return 0; }}\n')
    subprocess.run([compiler, *options, *WARNINGS, f"-I{C}", str(source)], check=True)


def test_the_layout_for_python_is_that_of_the_header() -> None:
    subprocess.run([sys.executable, str(C / "python" / "receiver_layout.py"), "--check"], check=True)
