"""The device filter's speed: sparse bricks against scipy on the dense array.

    python bench/bench_filter.py [samples]

A shell of force, 5 samples thick, in a cube of 256 (or the given number of) samples is taken to half the
lattice, to 0.39 of it, and smoothed at its own rate. The peer is `scipy.ndimage.gaussian_filter` of the three
components with the Gaussian of the same cut-off, then every second sample. Times are the best of several.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from machine import keep
from touchfield.filters import limited, resample
from touchfield.medium import ForceField, Grid
from touchfield.parallel import worker_count


def best_ms(job: Callable[[], object], repeats: int) -> float:
    """Wall time of the fastest of several runs, milliseconds."""
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        job()
        times.append(time.perf_counter() - begin)
    return 1000 * min(times)


def shell(samples: int) -> ForceField:
    """A sphere's wall, 5 samples thick."""
    grid = cube(samples)
    axis = grid.axis_m(0)
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij", sparse=True)
    r = np.sqrt(x * x + y * y + z * z)
    held = np.argwhere((r < 0.37) & (r > 0.37 - 5 / samples))
    points = grid.to_m(held)
    return ForceField.from_support(grid, held, points / np.linalg.norm(points, axis=1)[:, None])


def cube(samples: int) -> Grid:
    """A unit cube of so many samples along each edge."""
    return Grid.over_box((-0.5,) * 3, (0.5,) * 3, (samples,) * 3)


def scipy_half(dense: NDArray[np.float32]) -> NDArray[np.float32]:
    """The same cut-off with a Gaussian in scipy, then every second sample."""
    sigma = 2 * 0.3748
    parts = [ndimage.gaussian_filter(dense[..., c], sigma, mode="constant", truncate=4.0) for c in range(3)]
    return np.stack([p[::2, ::2, ::2] for p in parts], axis=-1)


def main() -> None:
    """Print the table."""
    samples = int(sys.argv[1]) if len(sys.argv) > 1 else 256
    field = shell(samples)
    print(f"{samples}^3, {len(field.bricks)} bricks, {worker_count()} threads")
    rows: dict[str, float] = {}
    for count in (samples // 2, samples * 100 // 256, samples):
        for kernel in ("spline", "gaussian", "sinc"):
            rows[f"resample to {count}^3, {kernel}, ms"] = best_ms(
                lambda grid=cube(count), k=kernel: resample(field, grid, k), 9
            )
    half = resample(field, cube(samples // 2))
    rows["clip and floor, ms"] = best_ms(lambda: limited(half, 0.5, 0.005), 9)
    dense = field.to_dense()
    rows["scipy gaussian_filter, sliced, dense, ms"] = best_ms(lambda: scipy_half(dense), 2)
    for name, ms in rows.items():
        print(f"  {name:44s} {ms:8.1f}")
    keep("filter", {"samples": samples, "bricks": len(field.bricks), "rows": rows})


if __name__ == "__main__":
    main()
