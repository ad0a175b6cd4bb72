"""What machine a benchmark ran on, and where its last results are kept."""

from __future__ import annotations

import json
import os
import platform
import sys
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from time import perf_counter
from typing import Any

RESULTS = Path(__file__).parent / "results"


def machine() -> dict[str, Any]:
    """Processor, cores and versions."""
    model = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        names = [line.split(":", 1)[1].strip() for line in cpuinfo.read_text().splitlines() if "model name" in line]
        model = names[0] if names else model
    versions = {}
    for name in ("numpy", "numba", "touchfield"):
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            versions[name] = "from source"
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return {"processor": model, "cores": cores, "python": sys.version.split()[0], **versions}


def timed(call: Callable[[], Any], runs: int = 9, warm: int = 1) -> dict[str, float]:
    """Minimum and median milliseconds of `runs` calls after `warm` ones."""
    for _ in range(warm):
        call()
    times = []
    for _ in range(runs):
        began = perf_counter()
        call()
        times.append(1e3 * (perf_counter() - began))
    times.sort()
    return {"min_ms": times[0], "median_ms": times[len(times) // 2]}


def keep(name: str, figures: dict[str, Any]) -> None:
    """Write ``results/NAME.json`` with the machine beside the figures."""
    RESULTS.mkdir(exist_ok=True)
    text = json.dumps({"machine": machine(), **figures}, indent=1, default=float)
    (RESULTS / f"{name}.json").write_text(text + "\n")
