"""Measures start-up times: import, a first `touchfield encode`, and a second.

    python bench/bench_startup.py [--quick]

The first encoding finds no compiled kernels. It is measured with the helper processes that compile ahead, and
without them in a single process ("alone"). Wall seconds and the processor seconds of all cores are given. A
quick run uses kernels that are already compiled.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median
from time import perf_counter

from machine import Bar, Figures, at_most, bench


def seconds(code: list[str], environment: dict[str, str] | None = None) -> float:
    """Return the wall seconds of a fresh interpreter."""
    began = perf_counter()
    subprocess.run([sys.executable, *code], check=True, env=environment, stdout=subprocess.DEVNULL)
    return perf_counter() - began


def measure(is_cold: int) -> Figures:
    """Measure the import and three encodings."""
    bare, ours = (
        median(seconds(["-c", f"import {name}"]) for _ in range(7)) for name in ("numpy", "touchfield")
    )
    figures = {"import_numpy_s": bare, "import_touchfield_beyond_numpy_s": ours - bare}
    with tempfile.TemporaryDirectory() as folder:
        job = ["-m", "touchfield", "encode", "sample:terrain", str(Path(folder) / "out.touch")]
        for name, helpers in (("first_encode_alone", "0"), ("first_encode", "")):
            cache = {"NUMBA_CACHE_DIR": str(Path(folder) / name)} if is_cold else {}  # an empty cache
            environment = {**os.environ, **cache, "TOUCHFIELD_HELPERS": helpers}
            before = os.times()
            figures[f"{name}_s"] = seconds(job, environment)
            after = os.times()
            spent = (
                after.children_user + after.children_system - before.children_user - before.children_system
            )
            figures[f"{name}_cpu_s"] = spent
        figures["second_encode_s"] = min(seconds(job, environment) for _ in range(3))
    return figures


def bars(figures: Figures) -> list[Bar]:
    """Limit the time of the import, and of the first and second encoding."""
    return [
        at_most("import, beyond numpy's", figures["import_touchfield_beyond_numpy_s"], 0.5, "s"),
        at_most("first encode, nothing compiled", figures["first_encode_s"], 10.0, "s"),
        at_most("second encode", figures["second_encode_s"], 3.0, "s"),
    ]


if __name__ == "__main__":
    bench("startup", __doc__, measure, bars, is_cold=(1, 0))
