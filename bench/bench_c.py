"""`c/touch.h`: a frame decoded by one thread beside numba's, a query, and `touchfield decode` with nothing compiled.

make core && python bench/bench_c.py [--quick]
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median
from time import perf_counter, process_time
from typing import Any

import touchfield as tf
from machine import Bar, Figures, at_least, at_most, bench, figure
from touchfield.stream import native
from touchfield.stream.opened import open_stream

SOURCES = {"terrain": "sample:terrain", "motorcycle": "sample:motorcycle"}
QUERIES = 1_000_000


def frames_per_cpu_s(stream: Path, is_native: bool, runs: int) -> float:
    """Frames a second of one thread's processor time, the best of some runs over the whole file."""
    best = 0.0
    for _ in range(runs):
        with open_stream(stream) as own:
            segments, decoder = len(own.reader.segments), own.decoder
            core = native._core()
            began = process_time()
            if is_native:
                file = core.open(own.reader.read_all())
                for n in range(segments):
                    frames = core.frames(file, n)
                    while core.next(frames) is not None:
                        pass
            else:
                for n, entry in enumerate(own.reader.segments):
                    for _ in decoder.frames(own.reader.read_segment(n), entry.frame_count):
                        pass
            best = max(best, own.reader.head.frame_count / (process_time() - began))
    return best


def cold_s(stream: Path, folder: Path, is_native: bool, runs: int) -> float:
    """Wall seconds of `touchfield decode` with an empty cache of kernels, the median of some runs."""
    hidden = [] if is_native else ["import sys; sys.modules['touchfield_core'] = None"]
    program = "; ".join([*hidden, "from touchfield.cli.main import run; run()"])
    times = []
    for n in range(runs):
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder / f"cache-{is_native}-{n}")}
        began = perf_counter()
        words = ["decode", str(stream), str(folder / "out.npz")]
        subprocess.run(
            [sys.executable, "-c", program, *words], check=True, env=environment, stdout=subprocess.DEVNULL
        )
        times.append(perf_counter() - began)
    return median(times)


def query_us(stream: Path, folder: Path, runs: int) -> tuple[float, float]:
    """Median and 99.9th percentile of one query, the best of some runs."""
    here = Path(__file__).parent
    program = folder / "c_query"
    options = ["-O2", "-std=gnu99", f"-I{here.parent / 'c'}"]
    subprocess.run(["cc", *options, "-o", str(program), str(here / "c_query.c"), "-lm"], check=True)
    told = []
    for _ in range(runs):
        line = subprocess.run([program, stream, str(QUERIES)], check=True, capture_output=True, text=True).stdout
        told.append(tuple(float(n) / 1e3 for n in line.split()[:2]))
    return min(told)


def measure(runs: int) -> Figures:
    """Decoding, queries and the first decode of a fresh machine."""
    figures: dict[str, Any] = {"decode": {}}
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for name, source in SOURCES.items():
            stream = folder / f"{name}.touch"
            tf.encode(source, stream)
            ours, numbas = (frames_per_cpu_s(stream, own, runs) for own in (True, False))
            figures["decode"][name] = {"c": ours, "numba": numbas, "times": ours / numbas}
        stream = folder / "terrain.touch"
        figures["query_p50_us"], figures["query_p999_us"] = query_us(stream, folder, runs)
        figures["cold_decode_s"] = cold_s(stream, folder, True, runs)
        figures["cold_decode_without_s"] = cold_s(stream, folder, False, 1)
    figures["decode_times_numba"] = min(one["times"] for one in figures["decode"].values())
    return figures


def bars(figures: Figures) -> list[Bar]:
    """As fast as the compiled Python, in time for a tick, and nothing to wait for."""
    return [
        at_least("frames a second over numba's", figure(figures, "decode_times_numba"), 1.0),
        at_most("a query, median", figure(figures, "query_p50_us"), 0.3, "us"),
        at_most("a query, p99.9", figure(figures, "query_p999_us"), 1.0, "us"),
        at_most("first decode, nothing compiled", figure(figures, "cold_decode_s"), 0.5, "s"),
    ]


if __name__ == "__main__":
    bench("c", __doc__, measure, bars, runs=(5, 1))
