"""The headers of the receiver, as programs in C and in C++ include them."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from second import CONFORMANCE

from touchfield.compute.native import native
from touchfield.render.block import layout
from touchfield.render.spec import RenderSpec

sys.path.insert(0, str(CONFORMANCE.parent / "tests" / "render"))
from player_makers import laid_out, numbered_medium

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


PROGRAM = """
#include "touch_render.h"
#include <stdio.h>
static int64_t memory[1 << 20];
int main(void) {
    touch_receiver *receiver = (touch_receiver *)memory;
    double position[3];
    int64_t now_ns = 0;
    size_t size = fread(memory, 1, sizeof memory, stdin);
    if (size < sizeof *receiver) return 1;
    FILE *path = fopen("path.bin", "rb");
    while (path && fread(position, sizeof position, 1, path)) {
        touch_vector hand = touch_vector_of(position[0], position[1], position[2]);
        touch_vector force = touch_receiver_tick(receiver, hand, now_ns += receiver->layout.tick_ns);
        fwrite(&force, sizeof force, 1, stdout);
    }
    return 0;
}
"""


@pytest.mark.parametrize(("compiler", "option"), [("cc", "-std=c99"), ("c++", "-std=c++11")])
def test_an_engine_gets_the_forces_of_the_player(compiler: str, option: str, tmp_path: Path) -> None:
    """A program includes the header, takes the memory of a session, and renders it."""
    if shutil.which(compiler) is None:
        pytest.skip(f"no {compiler}")
    source = tmp_path / ("program.c" if compiler == "cc" else "program.cc")
    source.write_text(PROGRAM)
    options = (option, "-O2", "-ffp-contract=off", f"-I{C}", "-o", str(tmp_path / "program"))
    subprocess.run([compiler, *options, str(source), "-lm"], check=True)
    session, memory = laid_out(numbered_medium(8), RenderSpec(friction=0.4))
    session.feeder(memory, is_timed=False).fill_lookahead(8)
    session.order(memory, mode=layout.PLAYING)
    path = 0.01 * np.sin(np.arange(300)[:, None] / np.array([7.0, 11.0, 13.0]))
    path.tofile(tmp_path / "path.bin")
    image = memory.bytes.tobytes()
    done = subprocess.run([tmp_path / "program"], input=image, check=True, capture_output=True, cwd=tmp_path)
    found = np.frombuffer(done.stdout).reshape(-1, 3)
    tick_ns = int(memory.receiver["layout"]["tick_ns"])
    expected = [native.cycle(memory.bytes, *hand, (n + 1) * tick_ns) for n, hand in enumerate(path)]
    assert len(image) <= 8 << 20 and np.abs(found).max() > 0.4
    assert np.array_equal(found, expected)
