"""Measures the decoder in C, `c/touch.h`: frames per second, time of a force query, and a first decoding.

    python bench/bench_c.py [--quick]

Three things are measured: frames decoded per processor second, the time of one force query in C, and the wall
time of `touchfield decode` with an empty kernel cache. The benchmark is skipped without a C compiler.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from shutil import which
from statistics import median
from time import perf_counter, process_time
from typing import Any

import touchfield as tf
from machine import Bar, Figures, at_least, at_most, bench, figure, leave_out
from touchfield.pipeline.decoding import open_file
from touchfield.pipeline.stream import VoxelStream

ROOT = Path(__file__).resolve().parents[1]

SOURCES = {"terrain": "sample:terrain", "motorcycle": "sample:motorcycle"}
QUERIES = 1_000_000
NUMBA_FRAMES_PER_S = {"terrain": 15.98, "motorcycle": 19.02}
"""The decoder in numba, which this one replaced, on an AMD EPYC (commit d1772591c6d0)."""


def require_compiler() -> None:
    """Skip the benchmark without a compiler for the program of queries."""
    if which("cc") is None:
        leave_out("no C compiler (cc)")


def frames_per_cpu_s(stream: Path, runs: int) -> float:
    """Return frames decoded per processor second on one thread, the best of `runs`.

    Each run decodes the whole file.
    """
    best = 0.0
    for _ in range(runs):
        with open_file(stream) as opened:
            assert isinstance(opened, VoxelStream)
            reader, decoder = opened.reader, opened.decoder
            began = process_time()
            for n, entry in enumerate(reader.segments):
                for _ in decoder.frames(reader.read_segment(n), entry.frame_count):
                    pass
            best = max(best, reader.head.frame_count / (process_time() - began))
    return best


def cold_s(stream: Path, folder: Path, runs: int) -> float:
    """Return the median wall time of `touchfield decode` with an empty cache of compiled kernels, s."""
    times = []
    for n in range(runs):
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder / f"cache-{n}")}
        began = perf_counter()
        arguments = ["decode", str(stream), str(folder / "out.npz")]
        subprocess.run(
            [sys.executable, "-c", "from touchfield.cli.main import run; run()", *arguments],
            check=True,
            env=environment,
            stdout=subprocess.DEVNULL,
        )
        times.append(perf_counter() - began)
    return median(times)


def query_us(stream: Path, folder: Path, runs: int) -> tuple[float, float]:
    """Return the median and 99.9th percentile of one query, of the best run, us."""
    program = folder / "c_query"
    options = ["-O2", "-std=gnu99", f"-I{ROOT / 'c'}"]
    subprocess.run(["cc", *options, "-o", str(program), str(ROOT / "bench" / "c_query.c"), "-lm"], check=True)
    measured = []
    for _ in range(runs):
        line = subprocess.run(
            [program, stream, str(QUERIES)], check=True, capture_output=True, text=True
        ).stdout
        middle, late = (float(n) / 1e3 for n in line.split()[:2])
        measured.append((middle, late))
    return min(measured)


def measure(runs: int) -> Figures:
    """Measure decoding, queries, and the first decode of a fresh machine."""
    require_compiler()
    figures: dict[str, Any] = {"decode": {}}
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for name, source in SOURCES.items():
            stream = folder / f"{name}.touch"
            tf.encode(source, stream)
            figures["decode"][name] = frames_per_cpu_s(stream, runs)
        stream = folder / "terrain.touch"
        figures["query_p50_us"], figures["query_p999_us"] = query_us(stream, folder, runs)
        figures["cold_decode_s"] = cold_s(stream, folder, runs)
    ratios = (figures["decode"][name] / numba for name, numba in NUMBA_FRAMES_PER_S.items())
    figures["decode_times_numba"] = min(ratios)
    return figures


def bars(figures: Figures) -> list[Bar]:
    """Require 1.4 times numba's speed, queries within a tick, and a first decoding in 0.5 s."""
    return [
        at_least("frames a second over numba's", figure(figures, "decode_times_numba"), 1.4),
        at_most("a query, median", figure(figures, "query_p50_us"), 0.3, "us"),
        at_most("a query, p99.9", figure(figures, "query_p999_us"), 1.0, "us"),
        at_most("first decode, nothing compiled", figure(figures, "cold_decode_s"), 0.5, "s"),
    ]


if __name__ == "__main__":
    bench(
        "c",
        __doc__,
        measure,
        bars,
        runs=(5, 1),
        reads=(
            "c/*.h",
            "c/python/*",
            "build_backend/compiler.py",
            "build_backend/hook.py",
            "build_backend/targets.py",
            "bench/*.c",
        ),
    )
