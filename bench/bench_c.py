"""`c/touch.h` against numba: decoding speed, query time, and a first decoding.

    python bench/bench_c.py [--quick]

The Python module `touchfield_core` is built for the run with the options of `core/setup.py`. Three things are
measured: frames decoded per processor second by C and by numba, the time of one force query in C, and the
wall time of `touchfield decode` with an empty kernel cache. Without a C compiler or Python's headers the
benchmark is skipped.
"""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path
from shutil import which
from statistics import median
from time import perf_counter, process_time
from typing import Any

import touchfield as tf
from machine import Bar, Figures, at_least, at_most, bench, figure, leave_out
from touchfield.pipeline import native_decoder
from touchfield.pipeline.decoding import open_file
from touchfield.pipeline.stream import VoxelStream

ROOT = Path(__file__).resolve().parents[1]

SOURCES = {"terrain": "sample:terrain", "motorcycle": "sample:motorcycle"}
QUERIES = 1_000_000


def build_core(folder: Path) -> None:
    """Build `touchfield_core` into `folder` and put it first on the import path.

    Child processes inherit the path.
    """
    headers = Path(sysconfig.get_path("include"))
    if which("cc") is None or not (headers / "Python.h").is_file():
        leave_out("no C compiler (cc), or no headers of Python")
    options = [
        "-O3",
        "-std=c99",
        "-shared",
        "-fPIC",
        "-DPy_LIMITED_API=0x030b0000",
        f"-I{headers}",
        f"-I{ROOT / 'c'}",
    ]
    source = ROOT / "core" / "touchfield_core.c"
    subprocess.run(
        ["cc", *options, f"-I{ROOT / 'c'}", "-o", str(folder / "touchfield_core.abi3.so"), str(source)],
        check=True,
    )
    sys.path.insert(0, str(folder))
    os.environ["PYTHONPATH"] = os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")])


def frames_per_cpu_s(stream: Path, is_native: bool, runs: int) -> float:
    """Return frames decoded per processor second on one thread, the best of `runs`.

    Each run decodes the whole file.
    """
    best = 0.0
    for _ in range(runs):
        with open_file(stream) as opened:
            assert isinstance(opened, VoxelStream)
            segments, decoder = len(opened.reader.segments), opened.decoder
            core = native_decoder._core()
            began = process_time()
            if is_native:
                file = core.open(opened.reader.read_all())
                for n in range(segments):
                    frames = core.frames(file, n)
                    while core.next(frames) is not None:
                        pass
            else:
                for n, entry in enumerate(opened.reader.segments):
                    for _ in decoder.frames(opened.reader.read_segment(n), entry.frame_count):
                        pass
            best = max(best, opened.reader.head.frame_count / (process_time() - began))
    return best


def cold_s(stream: Path, folder: Path, is_native: bool, runs: int) -> float:
    """Return the median wall time of `touchfield decode` with an empty cache, s.

    The cache is that of compiled kernels. Without `is_native` the import of `touchfield_core` is blocked, so
    numba decodes.
    """
    hidden = [] if is_native else ["import sys; sys.modules['touchfield_core'] = None"]
    program = "; ".join([*hidden, "from touchfield.cli.main import run; run()"])
    times = []
    for n in range(runs):
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder / f"cache-{is_native}-{n}")}
        began = perf_counter()
        arguments = ["decode", str(stream), str(folder / "out.npz")]
        subprocess.run(
            [sys.executable, "-c", program, *arguments],
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
    figures: dict[str, Any] = {"decode": {}}
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        build_core(folder)
        for name, source in SOURCES.items():
            stream = folder / f"{name}.touch"
            tf.encode(source, stream)
            ours, numbas = (frames_per_cpu_s(stream, is_native, runs) for is_native in (True, False))
            figures["decode"][name] = {"c": ours, "numba": numbas, "times": ours / numbas}
        stream = folder / "terrain.touch"
        figures["query_p50_us"], figures["query_p999_us"] = query_us(stream, folder, runs)
        figures["cold_decode_s"] = cold_s(stream, folder, True, runs)
        figures["cold_decode_without_s"] = cold_s(stream, folder, False, 1)
    figures["decode_times_numba"] = min(row["times"] for row in figures["decode"].values())
    return figures


def bars(figures: Figures) -> list[Bar]:
    """Require numba's speed, queries within a tick, and a first decoding in 0.5 s."""
    return [
        at_least("frames a second over numba's", figure(figures, "decode_times_numba"), 1.0),
        at_most("a query, median", figure(figures, "query_p50_us"), 0.3, "us"),
        at_most("a query, p99.9", figure(figures, "query_p999_us"), 1.0, "us"),
        at_most("first decode, nothing compiled", figure(figures, "cold_decode_s"), 0.5, "s"),
    ]


if __name__ == "__main__":
    bench("c", __doc__, measure, bars, runs=(5, 1), reads=("c/*.h", "core/*.c", "core/setup.py", "bench/*.c"))
