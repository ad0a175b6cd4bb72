"""Measures the time of `make test` without compiled kernels, as in a new clone.

    python bench/bench_suite.py [--quick]

A Python loop is timed before and after, because the speed of a shared machine varies. A quick run tests one
file only.
"""

from __future__ import annotations

import os
import re
import resource
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

from machine import Bar, Figures, at_most, bench, figure

ROOT = Path(__file__).resolve().parents[1]
PYTEST_COMMAND = (sys.executable, "-m", "pytest", "tests/measure/test_partition.py")


def loop_s() -> float:
    """Return the seconds of 20 million iterations of a Python loop."""
    began, total = perf_counter(), 0
    for i in range(20_000_000):
        total += i * i % 7
    return perf_counter() - began


def measure(tests: str) -> Figures:
    """Run the tests once; RuntimeError with the names of failed tests."""
    before_s = loop_s()
    with TemporaryDirectory() as cache:
        began = perf_counter()
        command = ("make", "--no-print-directory", "test") if tests == "all" else PYTEST_COMMAND
        surroundings = {**os.environ, "NUMBA_CACHE_DIR": cache}
        done = subprocess.run(
            command, cwd=ROOT, env=surroundings, capture_output=True, text=True, check=False
        )
        clock_s = perf_counter() - began
    if done.returncode:
        failed = [line for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
        raise RuntimeError("\n".join([*failed, done.stderr[-2000:]]))
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    passed = sum(map(int, re.findall(r"(\d+) passed", done.stdout)))
    seconds = {"clock_s": clock_s, "processors_s": used.ru_utime + used.ru_stime, "loop_before_s": before_s}
    return {"passed": passed, "minutes": clock_s / 60, **seconds, "loop_after_s": loop_s()}


def bars(figures: Figures) -> list[Bar]:
    """Limit the time of `make test`."""
    return [at_most("minutes of make test", figure(figures, "minutes"), 8)]


if __name__ == "__main__":
    bench("suite", __doc__, measure, bars, reads=("src/**/*.py", "tests/**/*.py"), tests=("all", "one file"))
