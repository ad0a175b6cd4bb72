"""Measures compiled loops on a GPU against the CPU: forces of a depth frame on 1000^3 samples, and force
queries.

    python bench/bench_cuda.py [--quick] [--points N]

The depth frame is the motorcycle stereo picture. The tangent planes of its pixels are fitted on the CPU and
copied to the GPU before the timer starts. "gpu" times the search for the bricks that have forces and the
computation of these forces, which stay on the GPU. "gpu_and_back" includes the copies of planes, bricks and
forces in both directions, as `encode` needs them. "floor" is the least that the GPU could take: the time of a
copy, on the GPU, in which as many bytes are read and written as the frame reads (planes) and writes (forces).

The queries are forces at `--points` points of a field of 128^3 samples, at random positions and along the
path of a wandering hand. If CuPy is installed, its `map_coordinates` on the dense field is the peer. Without
a GPU only the CPU is measured, the verdict of the bars is "not measured", and small fields and queries of the
same kernels are compared on numba's simulator ("simulated").
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from bench_query import SIDE, SPACING_M, field, path
from machine import Bar, Figures, at_least, at_most, bench, figure, timed
from touchfield.compute import cuda
from touchfield.medium import Grid, HapticMedium
from touchfield.render.sampler import DeviceSampler, FieldSampler
from touchfield.sources.depth.depth_scene import DepthScene, force_bricks, query_of
from touchfield.sources.depth.kernels import field as depth
from touchfield.sources.laws import LawSpec, penalty
from touchfield.sources.samples import sample

NOMINAL = 1000
"""Samples along each axis; the paper's smallest nominal workspace has as many."""


def gpu() -> str | None:
    """Return the name of the GPU that numba finds; None if there is none."""
    with cuda.computing("auto"):
        if not cuda.uses_gpu():
            return None
    library: Any = import_module("numba.cuda")

    name = library.get_current_device().name
    return name.decode() if isinstance(name, bytes) else str(name)


def synchronized(call: Callable[[], Any]) -> Callable[[], Any]:
    """Wrap a call so that it waits until the GPU has finished."""
    library: Any = import_module("numba.cuda")

    def both() -> Any:
        out = call()
        library.synchronize()
        return out

    return both


def floor_of(moved_bytes: int, runs: int) -> Figures:
    """Time a copy on the GPU that reads and writes so many bytes together."""
    source, target = (cuda.empty(max(moved_bytes // 2, 1), np.uint8) for _ in range(2))
    return timed(synchronized(lambda: target.copy_to_device(source)), runs) | {"bytes": moved_bytes}


def array_bytes(item: Any) -> int:
    """Return the bytes of an array, or of all arrays in a tuple."""
    if isinstance(item, tuple):
        return sum(map(array_bytes, item))
    return int(getattr(item, "nbytes", 0))


def simulated() -> Figures:
    """Return the largest differences between the CPU and numba's simulator of a GPU, newtons."""
    script = Path(__file__).resolve().parents[1] / "tests" / "simulated_gpu.py"
    run = subprocess.run(
        [sys.executable, "-W", "ignore", str(script)],
        env={**os.environ, "NUMBA_ENABLE_CUDASIM": "1"},
        capture_output=True,
        text=True,
        check=True,
    )
    return {name: row["difference_n"] for name, row in json.loads(run.stdout).items()}


def of_depth(has_gpu: bool, runs: int) -> Figures:
    """Time one depth frame on 1000^3 samples."""
    sequence = sample("motorcycle").sequence  # type: ignore[attr-defined]
    scene = DepthScene(sequence)
    low_m, high_m = scene.bounds_m()
    grid = Grid.over_box(low_m, high_m, (NOMINAL, NOMINAL, NOMINAL))
    query = query_of(scene.planes(0), np.eye(4), grid, penalty(LawSpec(), 4 * max(grid.spacing_m)))
    expected = depth.brick_forces(force_bricks(query, grid), query)
    took = {
        "bricks": len(expected),
        "processor": timed(lambda: depth.brick_forces(force_bricks(query, grid), query), runs),
    }
    if has_gpu:
        with cuda.computing("cuda"):
            device_query = cuda.on_device(query)
            frame = synchronized(
                lambda: depth.forces_on_device(force_bricks(device_query, grid), device_query)
            )
            took["gpu"] = timed(frame, runs)
            took["floor"] = floor_of(array_bytes(query) + expected.nbytes, runs)
            took["gpu_and_back"] = timed(lambda: depth.brick_forces(force_bricks(query, grid), query), runs)
            other = cuda.on_host(frame()).reshape(expected.shape)
            took["difference_n"] = float(np.abs(expected - other).max())
    return took


def of_queries(has_gpu: bool, points: int, runs: int) -> Figures:
    """Return points queried per second, at random and along a path."""
    rng = np.random.default_rng(1)
    medium = HapticMedium.from_frames([field()], 1000.0)
    position_sets = {"random": rng.uniform(0, (SIDE - 1) * SPACING_M, (points, 3)), "path": path(points, rng)}
    out: Figures = {}
    for name, positions_m in position_sets.items():
        sampler = FieldSampler(medium)
        expected = sampler.force_n(0.0, positions_m)
        began = perf_counter()
        sampler.force_n(0.0, positions_m)
        row: Figures = {"processor_per_s": points / (perf_counter() - began)}
        if has_gpu:
            device = DeviceSampler(medium)
            at = cuda.on_device(positions_m)
            took = timed(synchronized(partial(device.force_n, 0.0, at)), runs)
            row["gpu_per_s"] = 1e3 * points / took["median_ms"]
            row["difference_n"] = float(np.abs(expected - cuda.on_host(device.force_n(0.0, at))).max())
            row["cupy_per_s"] = cupy_per_s(positions_m, runs)
        out[name] = row
    return out


def cupy_per_s(positions_m: np.ndarray[Any, Any], runs: int) -> float | None:
    """Return points per second of CuPy, for three components; None without CuPy."""
    try:
        import cupy
        from cupyx.scipy.ndimage import map_coordinates
    except ImportError:
        return None
    dense = [cupy.asarray(c) for c in np.moveaxis(field().to_dense(), 3, 0)]
    at = cupy.asarray((positions_m / SPACING_M).T.astype(np.float32))
    took = timed(
        synchronized(lambda: [map_coordinates(c, at, order=1, prefilter=False) for c in dense]), runs
    )
    return 1e3 * len(positions_m) / took["median_ms"]


def measure(points: int, runs: int) -> Figures:
    """Measure the depth frame and the queries, with the name of the GPU."""
    name = gpu()
    has_gpu = name is not None
    figures = {"gpu": name, "depth": of_depth(has_gpu, runs), "queries": of_queries(has_gpu, points, runs)}
    return figures if has_gpu else figures | {"simulated": simulated()}


def bars(figures: Figures) -> list[Bar]:
    """Set limits for one NVIDIA H200; "not measured" without a GPU."""
    differences = [figure(figures, *where, "difference_n") for where in (("depth",), ("queries", "random"))]
    simulated_n = figure(figures, "simulated")
    worst = None if None in differences else max(d for d in differences if d is not None)
    return [
        at_most("a depth frame on 10^9 samples", figure(figures, "depth", "gpu", "median_ms"), 5.0, "ms"),
        at_least("random queries a second", figure(figures, "queries", "random", "gpu_per_s"), 1e9),
        at_least("queries a second along a path", figure(figures, "queries", "path", "gpu_per_s"), 5e9),
        at_most("difference to the processor", worst, 2e-6, "N"),
        at_most(
            "difference of the simulator to the processor",
            max(simulated_n.values()) if simulated_n else None,
            2e-6,
            "N",
        ),
    ]


if __name__ == "__main__":
    bench("cuda", __doc__, measure, bars, points=(10_000_000, 100_000), runs=(9, 2))
