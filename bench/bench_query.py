"""Measures force queries at points of a field of 128^3 samples and of moving objects, against SciPy.

    python bench/bench_query.py [--quick] [--points N]

Batches of `--points` points are at random in the box, at random in the supported region, and along the path
of a hand that wanders through the box. The field is queried at one frame and between two frames; the seven
objects are those of `bench_objects`. The peers interpolate the same dense field: SciPy's `map_coordinates`
(order 1, one call for each component), `RegularGridInterpolator`, and a compiled trilinear loop on all
threads. Forces are compared.

A single query is timed within C by the processor's counter (`query_times.c`), and from Python. README quotes
its 99.9th percentile at random points with a force, where each query finds other memory, and along the path.
"""

from __future__ import annotations

import ctypes
import subprocess
import sys
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from time import perf_counter_ns
from typing import Any

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator
from scipy.ndimage import map_coordinates

from bench_objects import scene
from machine import Bar, Figures, at_least, at_most, bench, column, timed
from touchfield.compute.threads import worker_count
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.render.sampler import FieldSampler
from touchfield.sources.laws import LawSpec, penalty
from touchfield.sources.shapes.analytic_scene import AnalyticScene
from touchfield.sources.shapes.shapes import Box, Sphere

Floats = NDArray[np.float64]
SIDE, SPACING_M, RATE_HZ = 128, 0.001, 1000.0
PEER_POINTS, QUERIES = 10**5, 200_000
BETWEEN_S = 0.4 / RATE_HZ


def field() -> ForceField:
    """Return a ball and a box with the default wall."""
    shapes = [Sphere((0.045, 0.045, 0.05), 0.03), Box((0.09, 0.08, 0.085), (0.02, 0.025, 0.03))]
    grid = Grid((SIDE,) * 3, (SPACING_M,) * 3, (0.0,) * 3)
    return AnalyticScene(shapes).field(0, grid, penalty(LawSpec(), LawSpec().saturation_m))


def path(count: int, rng: np.random.Generator) -> Floats:
    """Return the path of a randomly pushed hand, reflected at the walls.

    A step is some hundredths of a sample.
    """
    velocity = np.cumsum(rng.normal(0, 0.02, (count, 3)), axis=0)
    distance = np.cumsum(0.02 * velocity, axis=0) / (SIDE - 2)
    return (np.abs(distance % 2 - 1) * (SIDE - 2) + 0.5) * SPACING_M


class Peers:
    """The same field by SciPy."""

    def __init__(self, of: ForceField) -> None:
        dense = of.to_dense()
        self.components = [np.ascontiguousarray(c) for c in np.moveaxis(dense, 3, 0)]
        axes = [of.grid.axis_m(a) for a in range(3)]
        self.dense = dense
        self.interpolator = RegularGridInterpolator(axes, dense, bounds_error=False, fill_value=0.0)

    def map_coordinates(self, points_m: Floats) -> Floats:
        """Return newtons at points [n, 3]."""
        at = np.ascontiguousarray((points_m / SPACING_M).T)
        return np.stack(
            [map_coordinates(c, at, np.float32, order=1, prefilter=False) for c in self.components], 1
        )

    def regular_grid(self, points_m: Floats) -> Floats:
        """Return newtons at points [n, 3]."""
        forces: Floats = self.interpolator(points_m)
        return forces

    def compiled_dense(self, points_m: Floats) -> Floats:
        """Return newtons at points [n, 3] by a compiled loop over the dense field."""
        out = np.empty_like(points_m)
        trilinear(self.dense, np.minimum(points_m / SPACING_M, SIDE - 1.001), out)
        return out


@njit(nogil=True, parallel=True, fastmath=True)
def trilinear(dense, at, out):  # type: ignore[no-untyped-def]
    """Interpolate a dense field [n, n, n, 3] at points [m, 3], in samples."""
    for p in prange(at.shape[0]):
        i, j, k = int(at[p, 0]), int(at[p, 1]), int(at[p, 2])
        u, v, w = at[p, 0] - i, at[p, 1] - j, at[p, 2] - k
        for n in range(3):
            lower = (dense[i, j, k, n] * (1 - w) + dense[i, j, k + 1, n] * w) * (1 - v)
            lower += (dense[i, j + 1, k, n] * (1 - w) + dense[i, j + 1, k + 1, n] * w) * v
            upper = (dense[i + 1, j, k, n] * (1 - w) + dense[i + 1, j, k + 1, n] * w) * (1 - v)
            upper += (dense[i + 1, j + 1, k, n] * (1 - w) + dense[i + 1, j + 1, k + 1, n] * w) * v
            out[p, n] = lower * (1 - u) + upper * u


@cache
def timer() -> ctypes.CDLL:
    """Return `query_times.c`, compiled as the package's module is."""
    folder = Path(__file__).resolve().parent
    sys.path.insert(0, str(folder.parent / "build_backend"))
    import compiler  # type: ignore[import-not-found]

    library = Path(tempfile.mkdtemp()) / "query_times.so"
    command = [*compiler.find_compiler(), *compiler.OPTIONS, "-o", str(library)]
    subprocess.run([*command, str(folder / "query_times.c"), "-lm"], check=True)
    loaded = ctypes.CDLL(str(library))
    loaded.count_now.restype = ctypes.c_int64
    return loaded


def counter_ns() -> float:
    """Return nanoseconds per count."""
    count_now = timer().count_now
    began_ns, began = perf_counter_ns(), count_now()
    while perf_counter_ns() - began_ns < 50e6:
        pass
    ended_ns, ended = perf_counter_ns(), count_now()
    return float((ended_ns - began_ns) / (ended - began))


def percentiles(us: Floats) -> dict[str, float]:
    """Return percentiles of the microseconds of many calls."""
    return {f"p{q:g}_us": float(np.percentile(us, q)) for q in (50, 99, 99.9)} | {"worst_us": float(us.max())}


def compiled(sampler: FieldSampler, time_s: float, points_m: Floats) -> dict[str, float]:
    """Time single queries in C, less the time to read the counter."""
    first, second, blend = sampler._instant(time_s)
    pair = sampler._pair(first, second)
    counts, forces = np.zeros((len(points_m), 2), np.int64), np.zeros(points_m.shape)
    points, number = np.ascontiguousarray(points_m), ctypes.c_int64
    addresses = [ctypes.c_void_p(a.ctypes.data) for a in (pair.memory.bytes, points, counts, forces)]
    memory, *arrays = addresses
    instant = number(pair.first), number(pair.second), ctypes.c_double(blend)
    for _ in range(2):
        timer().time_queries(memory, *instant, arrays[0], number(len(points)), *arrays[1:])
    expected = sampler.force_n(np.full(len(points), time_s), points)
    assert np.array_equal(forces.astype(np.float32), expected)
    return percentiles((counts[:, 0] - np.median(counts[:, 1])) * counter_ns() / 1e3)


def from_python(call: Callable[[float, float, float], Any], points_m: Floats) -> dict[str, float]:
    """Time single calls from Python."""
    call(*points_m[0].tolist())
    times_us = np.empty(len(points_m))
    for n, (x, y, z) in enumerate(points_m.tolist()):
        began = perf_counter_ns()
        call(x, y, z)
        times_us[n] = (perf_counter_ns() - began) / 1e3
    return percentiles(times_us)


def rate(call: Callable[[Floats], Any], points_m: Floats, runs: int) -> float:
    """Return millions of points per second."""
    return len(points_m) / timed(lambda: call(points_m), runs)["min_ms"] / 1e3


def batch(sampler: FieldSampler, objects: FieldSampler, peers: Peers, points: Floats) -> dict[str, float]:
    """Return millions of points per second, differences, and the supported fraction.

    The supported fraction is that of the points with a force.
    """
    few = points[:PEER_POINTS]
    found = sampler.force_n(0.0, few)
    row = {
        "frame": rate(lambda p: sampler.force_n(0.0, p), points, 15),
        "between": rate(lambda p: sampler.force_n(BETWEEN_S, p), points, 9),
        "map_coordinates": rate(peers.map_coordinates, few, 5),
        "regular_grid": rate(peers.regular_grid, few, 5),
        "compiled_dense": rate(peers.compiled_dense, points, 9),
        "objects": rate(lambda p: objects.force_n(0.0, p), points, 5),
        "objects_between": rate(lambda p: objects.force_n(BETWEEN_S, p), points, 5),
        "share": float(found.any(axis=1).mean()),
    }
    row["times_dense"] = row["frame"] / row["compiled_dense"]
    row["times"] = row["frame"] / max(row["map_coordinates"], row["regular_grid"])
    row["differ_n"] = max(
        float(np.abs(found - call(few)).max())
        for call in (peers.map_coordinates, peers.regular_grid, peers.compiled_dense)
    )
    return row


def queries(
    sampler: FieldSampler, objects: FieldSampler, peers: Peers, point_sets: dict[str, Floats]
) -> dict[str, dict[str, float]]:
    """Time one query at a time."""
    some = {name: points[:QUERIES] for name, points in point_sets.items()}
    along = some["path"]
    return {
        **{f"compiled, {name}": compiled(sampler, 0.0, points) for name, points in some.items()},
        "compiled, path, between frames": compiled(sampler, BETWEEN_S, along),
        "compiled, 7 objects": compiled(objects, 0.0, along),
        "compiled, 7 objects, between": compiled(objects, BETWEEN_S, along),
        "Python": from_python(lambda *p: sampler.at(0.0, *p), along),
        "Python, map_coordinates": from_python(lambda *p: peers.map_coordinates(np.array([p])), along[:5000]),
        "Python, RegularGridInterpolator": from_python(
            lambda *p: peers.regular_grid(np.array([p])), along[:2000]
        ),
    }


def measure(points: int) -> Figures:
    """Measure many points at once, and one query at a time."""
    rng, first = np.random.default_rng(1), field()
    sampler = FieldSampler(HapticMedium.from_frames([first, first.scaled(0.5)], RATE_HZ))
    objects, peers = FieldSampler(scene()), Peers(first)
    in_force = first.positions()[rng.integers(0, first.support_count, points)] + rng.uniform(
        -0.5, 0.5, (points, 3)
    )
    point_sets = {
        "random": rng.uniform(0, (SIDE - 1) * SPACING_M, (points, 3)),
        "in force": np.clip(in_force, 0, SIDE - 1.001) * SPACING_M,
        "path": path(points, rng),
    }
    return {
        "support_share": first.support_count / SIDE**3,
        "threads": worker_count(),
        "batches": {name: batch(sampler, objects, peers, some) for name, some in point_sets.items()},
        "single": queries(sampler, objects, peers, point_sets),
    }


def bars(figures: Figures) -> list[Bar]:
    """Require more speed than the peers, fast single queries, and equal forces."""
    batches, single = figures["batches"], figures["single"]
    alone = [single[f"compiled, {name}"] for name in ("random", "in force", "path")]
    return [
        at_least("points, random", batches["random"]["frame"], 30.0, "M/s"),
        at_least("points over scipy's faster, random", batches["random"]["times"], 20.0),
        at_least("points, path", batches["path"]["frame"], 100.0, "M/s"),
        at_least("points over scipy's faster, path", batches["path"]["times"], 20.0),
        at_least("points over a compiled dense loop, worst", min(column(batches, "times_dense")), 1.0),
        at_least("one query in compiled code, median", min(column(alone, "p50_us")), 0.005, "us"),
        at_most("one query in compiled code, median", max(column(alone, "p50_us")), 0.6, "us"),
        at_most("one query in compiled code, p99.9", max(column(alone, "p99.9_us")), 3.0, "us"),
        at_most("one query from Python, p99.9", single["Python"]["p99.9_us"], 1000.0, "us"),
        at_most("largest difference to a peer", max(column(batches, "differ_n")), 1e-5, "N"),
    ]


if __name__ == "__main__":
    bench("query", __doc__, measure, bars, points=(10**6, 10**5), reads=("bench/query_times.c",))
