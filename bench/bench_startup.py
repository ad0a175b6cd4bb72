"""A newcomer's wait: the import, the first `touchfield encode` with nothing compiled yet, and the second.

The first also as one process, without helpers that compile ahead; and the seconds of all cores that each way takes.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median
from time import perf_counter

from machine import keep

BARS = {"import_touchfield_beyond_numpy_s": 0.5, "first_encode_s": 10.0}
"""Seconds, at most."""


def seconds(code: list[str], environment: dict[str, str] | None = None) -> float:
    """Wall seconds of a fresh interpreter."""
    began = perf_counter()
    subprocess.run([sys.executable, *code], check=True, env=environment, stdout=subprocess.DEVNULL)
    return perf_counter() - began


def main() -> None:
    bare, ours = (median(seconds(["-c", f"import {name}"]) for _ in range(7)) for name in ("numpy", "touchfield"))
    figures = {"import_numpy_s": bare, "import_touchfield_beyond_numpy_s": ours - bare}
    with tempfile.TemporaryDirectory() as folder:
        job = ["-m", "touchfield", "encode", "sample:terrain", str(Path(folder) / "out.touch")]
        for name, most in (("first_encode_alone", "0"), ("first_encode", "")):
            cache = str(Path(folder) / name)  # which is not there yet
            environment = {**os.environ, "NUMBA_CACHE_DIR": cache, "TOUCHFIELD_HELPERS": most}
            before = os.times()
            figures[f"{name}_s"] = seconds(job, environment)
            after = os.times()
            spent = after.children_user + after.children_system - before.children_user - before.children_system
            figures[f"{name}_cpu_s"] = spent
        figures["second_encode_s"] = min(seconds(job, environment) for _ in range(3))
    bars = [
        {"bar": name, "measured": figures[name], "limit": most, "met": figures[name] <= most}
        for name, most in BARS.items()
    ]
    for name, value in figures.items():
        bar = f"  at most {BARS[name]:g}: {'met' if value <= BARS[name] else 'NOT MET'}" if name in BARS else ""
        print(f"{name:36s} {value:7.3f}{bar}")
    keep("startup", {**figures, "bars": bars})


if __name__ == "__main__":
    main()
