"""The mathematics of the page's C equal that of Python to about a unit in the last place."""

from __future__ import annotations

import math
import os
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from browser import ROOT

FREESTANDING = ROOT / "web" / "freestanding"
NODE = shutil.which("node")
SOURCE = """
#include "math.h"
__attribute__((export_name("value"))) double value(int n, double x) {
    int power = 0;
    double mantissa = frexp(x, &power);
    const double both[2] = {mantissa, (double)power};
    if (n < 2) return both[n];
    if (n < 4) return n == 2 ? sqrt(fabs(x)) : rint(x);
    if (n < 6) return n == 4 ? log2(fabs(x)) : asin(x / (1 + fabs(x)));
    if (n < 8) return n == 6 ? atan2(x, 1.5) : ldexp(mantissa, power);
    const double small = x / (1 + fabs(x)), angle = 10 * small; /* arguments of a tick */
    if (n < 10) return n == 8 ? sin(angle) : cos(angle);
    if (n < 12) return n == 10 ? acos(small) : exp(angle);
    if (n < 14) return n == 12 ? expm1(small) : pow(2.0, angle);
    return n == 14 ? fmod(x, 0.7) : fmax(x, mantissa);
}
"""


def values(folder: Path, numbers: np.ndarray) -> np.ndarray:
    """Functions of numbers, in the order of SOURCE, [numbers, 16]."""
    (folder / "value.c").write_text(SOURCE)
    (folder / "in").write_bytes(numbers.astype("<f8").tobytes())
    python = os.environ.get("TOUCHFIELD_ZIG_PYTHON", sys.executable)
    command = [
        python, "-m", "ziglang", "cc", "-target", "wasm32-freestanding", "-mcpu=generic+bulk_memory", "-O2",
        "-fno-builtin", "-nostdlib", "-fno-sanitize=all", f"-I{FREESTANDING}", "-Wl,--no-entry",
        "-o", str(folder / "value.wasm"), str(folder / "value.c"), str(FREESTANDING / "library.c"),
    ]  # fmt: skip
    subprocess.run(command, check=True)
    script = ROOT / "tests" / "viewer" / "math_values.mjs"
    files = (folder / name for name in ("value.wasm", "in", "out"))
    subprocess.run([str(NODE), str(script), *map(str, files)], check=True)
    return np.frombuffer((folder / "out").read_bytes(), "<f8").reshape(-1, 16)


@pytest.mark.skipif(NODE is None, reason="there is no node here")
@pytest.mark.skipif(
    find_spec("ziglang") is None and "TOUCHFIELD_ZIG_PYTHON" not in os.environ,
    reason="zig is not here: pip install 'touchfield[web]'",
)
def test_functions_equal_those_of_python(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    numbers = np.concatenate(
        [
            rng.standard_normal(300) * 10.0 ** rng.uniform(-12, 12, 300),
            [0.5, 1.5, 2.5, -2.5, 1.0, 2.0**48, 2.0**-1022, 5e-324, -1e-310, 1.7e308],
        ]
    )
    got = values(tmp_path, numbers)
    assert [tuple(row[:2]) for row in got] == [math.frexp(x) for x in numbers]
    assert got[:, 2].tolist() == [math.sqrt(abs(x)) for x in numbers]
    assert got[:, 3].tolist() == np.rint(numbers).tolist()
    assert got[:, 7].tolist() == numbers.tolist()
    expected = np.array(
        [(math.log2(abs(x)), math.asin(x / (1 + abs(x))), math.atan2(x, 1.5)) for x in numbers]
    )
    ulps = np.abs(got[:, 4:7] - expected) / np.spacing(np.abs(expected))
    assert ulps.max() <= 2
    small = [x / (1 + abs(x)) for x in numbers]
    expected = np.array(
        [
            (math.sin(10 * x), math.cos(10 * x), math.acos(x), math.exp(10 * x), math.expm1(x), 2 ** (10 * x))
            for x in small
        ]
    )
    ulps = np.abs(got[:, 8:14] - expected) / np.spacing(np.abs(expected))
    assert ulps.max() <= 2
    assert got[:, 14].tolist() == [math.fmod(x, 0.7) for x in numbers]
    assert got[:, 15].tolist() == np.fmax(numbers, got[:, 0]).tolist()
