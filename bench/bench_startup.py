"""What a newcomer waits for: the import, the first `touchfield encode` on an empty cache, and the second."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median
from time import perf_counter

from machine import keep


def seconds(code: list[str], environment: dict[str, str] | None = None) -> float:
    """Wall seconds of a fresh interpreter."""
    began = perf_counter()
    subprocess.run([sys.executable, *code], check=True, env=environment, stdout=subprocess.DEVNULL)
    return perf_counter() - began


def main() -> None:
    bare, ours = (median(seconds(["-c", f"import {name}"]) for _ in range(7)) for name in ("numpy", "touchfield"))
    figures = {"import_numpy_s": bare, "import_touchfield_beyond_numpy_s": ours - bare}
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(Path(folder) / "cache")}
        job = ["-m", "touchfield", "encode", "sample:terrain", str(Path(folder) / "out.touch")]
        figures["first_encode_s"] = seconds(job, environment)
        figures["second_encode_s"] = min(seconds(job, environment) for _ in range(3))
    for name, value in figures.items():
        print(f"{name:36s} {value:7.3f}")
    print("bar: import at most 0.5 s beyond numpy's own")
    keep("startup", figures)


if __name__ == "__main__":
    main()
