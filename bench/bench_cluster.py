"""Measures how much faster two worker processes encode than one, and encodes a workspace of 8 x 10^9 samples.

    python bench/bench_cluster.py [--quick]

The first part encodes falling bodies as voxels, 2000 frames at 1 kHz, with one worker and with two. Each
worker has one thread, and kernels are compiled before the timed run. The bytes are compared with those of an
encoding without workers.

The second part encodes a real stereo picture on the nominal lattice of the Phantom Omni (2909 x 2182 x 1273
samples) as a zarr store of tiles, with two workers. The memory is that of the largest process. A quick run
takes 512 frames, and 2^8 samples along each axis.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from time import perf_counter

from machine import Bar, Figures, at_least, at_most, bench, figure, need_module
from touchfield import EncodeSpec, device, encode
from touchfield.codec import TouchSpec
from touchfield.compute.executor_kinds import TaskExecutor
from touchfield.compute.executors import executor_of
from touchfield.pipeline.tiles import encode_tiles

SOURCE = "sample:falling-7"
TILED = "sample:motorcycle"


def seconds(out: Path, spec: EncodeSpec, workers: TaskExecutor | None) -> float:
    """Return the wall seconds of one encoding."""
    began = perf_counter()
    encode(SOURCE, out, spec, executor=workers)
    return perf_counter() - began


def spread(frames: int, rounds: int) -> Figures:
    """Encode without workers, with one and with two; return times and efficiency."""
    spec = EncodeSpec(nw=6, representation="voxel", frames=(0, frames))
    figures: Figures = {"frames": frames}
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "a.touch"
        seconds(out, spec, None)
        alone = out.read_bytes()
        figures["bytes"] = len(alone)
        same = True
        for count in (1, 2) * rounds:
            with executor_of(f"processes:{count}") as workers:
                seconds(out, replace(spec, frames=(0, 256 * count)), workers)
                took = seconds(out, spec, workers)
            figures[f"workers_{count}_s"] = min(took, figures.get(f"workers_{count}_s", took))
            same &= out.read_bytes() == alone
        figures["same_bytes"] = same
    figures["efficiency"] = figures["workers_1_s"] / (2 * figures["workers_2_s"])
    return figures


def huge(nw: int | None) -> Figures:
    """Encode a workspace in tiles; return sizes and times.

    `nw` is the n_w of the lattice; None takes the nominal lattice of the device.
    """
    spec = EncodeSpec(nw=nw, touch=TouchSpec(effort="fast"))
    with tempfile.TemporaryDirectory() as folder, executor_of("processes:2") as workers:
        done = encode_tiles(TILED, Path(folder) / "a.zarr", spec, executor=workers)
    samples = done.prepared.medium.grid.voxel_count
    return {
        "samples": samples,
        "tiles": done.tiles,
        "supported_voxels": done.supported_voxels,
        "file_bytes": done.file_bytes,
        "seconds": done.encode_s,
        "core_seconds_a_tile": 2 * done.encode_s / done.tiles,
        "samples_a_second_and_core": samples / done.encode_s / 2,
    }


def in_a_process(nw: int | None) -> Figures:
    """Run `huge` in a separate process, so that only the memory of its workers counts."""
    import json

    code = "import json, sys, bench_cluster; print(json.dumps(bench_cluster.huge(json.loads(sys.argv[1]))))"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])}
    done = subprocess.run(
        [sys.executable, "-c", code, json.dumps(nw)],
        env=environment,
        check=True,
        capture_output=True,
        text=True,
    )
    max_bytes = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024
    return {**json.loads(done.stdout), "most_bytes": max_bytes}


def measure(frames: int, is_huge: int, rounds: int) -> Figures:
    """Measure the speed-up by a second worker, and the tiled workspace."""
    need_module("zarr")
    os.environ["TOUCHFIELD_THREADS"] = "1"
    shape = device("phantom-omni").lattice
    return {
        "nominal": list(shape),
        "tiles": in_a_process(None if is_huge else 8),
        "spread": spread(frames, rounds),
    }


def bars(figures: Figures) -> list[Bar]:
    """Limit memory, and require efficiency and equal bytes."""
    return [
        at_least("efficiency of two processes", figure(figures, "spread", "efficiency"), 0.85),
        at_least("same bytes with none, one and two workers", float(figures["spread"]["same_bytes"]), 1.0),
        at_least("samples of the workspace", figure(figures, "tiles", "samples"), 8e9),
        at_most("memory of the largest process", figure(figures, "tiles", "most_bytes"), 2e9, "bytes"),
    ]


if __name__ == "__main__":
    bench("cluster", __doc__, measure, bars, frames=(2000, 512), is_huge=(1, 0), rounds=(2, 1))
