"""Measures the device filter on sparse fields, against SciPy on the dense array.

    python bench/bench_filter.py [--quick] [--samples N]

The input is a shell of force, 5 samples thick, in a cube of 256^3 (or `--samples`^3) samples. It is resampled
to half the number of samples along each axis, to 0.39 of it, and to the same number, which only smooths it.
The peer is `scipy.ndimage.gaussian_filter` of the three components with a Gaussian of the same cut-off,
followed by every second sample. Times are the best of several runs.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from machine import Bar, Figures, at_least, at_most, bench, figure, timed
from touchfield.compute.threads import worker_count
from touchfield.filters import limit_forces, resample
from touchfield.medium import ForceField, Grid

PEER = "scipy gaussian_filter, sliced, dense"


def cube(samples: int) -> Grid:
    """Return a unit cube with `samples` samples along each edge."""
    return Grid.over_box((-0.5,) * 3, (0.5,) * 3, (samples,) * 3)


def shell(samples: int, low: float, high: float) -> ForceField:
    """Return the wall of a sphere between two radii, with outward forces."""
    grid = cube(samples)
    x, y, z = np.meshgrid(*(grid.axis_m(n) for n in range(3)), indexing="ij", sparse=True)
    r = np.sqrt(x * x + y * y + z * z)
    indices = np.argwhere((r < high) & (r > low))
    points = grid.to_m(indices)
    return ForceField.from_support(
        grid, indices, points / np.maximum(np.linalg.norm(points, axis=1), 1e-9)[:, None]
    )


def scipy_half(dense: NDArray[np.float32]) -> NDArray[np.float32]:
    """Smooth with a Gaussian of the same cut-off, and take every second sample."""
    sigma = 2 * 0.3748
    parts = [ndimage.gaussian_filter(dense[..., c], sigma, mode="constant", truncate=4.0) for c in range(3)]
    return np.stack([p[::2, ::2, ::2] for p in parts], axis=-1)


def measure(samples: int) -> Figures:
    """Time each kernel to three lattices, the force limits, and SciPy."""
    field = shell(samples, 0.37 - 5 / samples, 0.37)
    half = resample(field, cube(samples // 2))
    dense = field.to_dense()
    jobs: dict[str, Callable[[], object]] = {
        f"resample to {count}^3, {kernel}": partial(resample, field, cube(count), kernel)
        for count in (samples // 2, samples * 100 // 256, samples)
        for kernel in ("spline", "sinc")
    }
    jobs["clip and floor"] = lambda: limit_forces(half, 0.5, 0.005)
    jobs[PEER] = lambda: scipy_half(dense)
    rows = {f"{name}, ms": timed(job, 2 if name == PEER else 9)["min_ms"] for name, job in jobs.items()}
    return {"samples": samples, "bricks": len(field.bricks), "threads": worker_count(), "rows": rows}


def bars(figures: Figures) -> list[Bar]:
    """Require 30 frames/s with the default kernel, and more speed than SciPy."""
    samples, rows = figures["samples"], figures["rows"]
    half = figure(rows, f"resample to {samples // 2}^3, spline, ms")
    limits, peer = (figure(rows, f"{name}, ms") for name in ("clip and floor", PEER))
    return [
        at_least("device filter to half the lattice, limits too", 1e3 / (half + limits), 30.0, "frames/s"),
        at_least("time of scipy over ours, the same cut-off", peer / half, 10.0),
        at_most("clip and floor", limits, 5.0, "ms"),
    ]


if __name__ == "__main__":
    bench("filter", __doc__, measure, bars, samples=(256, 64))
