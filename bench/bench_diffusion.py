"""Measures the time of Perona-Malik diffusion and force shading of fields, against NumPy and MedPy.

    python bench/bench_diffusion.py [--quick] [--samples N]

Perona-Malik diffusion takes ten steps on a dense cube of `--samples`^3 samples (128^3) with three components,
and on the wall of a sphere that fills 5 % of the same cube. Force shading is timed on the wall.

The peers filter the dense cube: the same equation in vectorised NumPy and, if it is installed,
`medpy.filter.smoothing.anisotropic_diffusion` on each component. MedPy computes one conductance for each
component, which is less work than one conductance for the vector. Each row is the best of several runs in one
process.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from bench_filter import shell
from machine import Bar, Figures, at_least, at_most, bench, figure, timed
from touchfield.compute.threads import worker_count
from touchfield.filters.shading import DiffusionFilter, ShadingFilter, perona_malik

STEPS, KAPPA_N, LAM = 10, 0.3, 1 / 7

Floats = NDArray[np.float32]


def in_numpy(values: Floats) -> Floats:
    """Apply the equation of `touchfield.filters.shading` to whole arrays, float32."""
    u = values.copy()
    for _ in range(STEPS):
        change = np.zeros_like(u)
        for axis in range(3):
            d = np.diff(u, axis=axis)
            d *= LAM * np.exp(-(d**2).sum(axis=-1, keepdims=True) / KAPPA_N**2)
            before = (slice(None),) * axis
            change[(*before, slice(-1))] += d
            change[(*before, slice(1, None))] -= d
        u += change
    return u


def medpy_row(dense: Floats) -> Callable[[], object] | None:
    """Return a call of MedPy; None if it is not installed."""
    try:
        from medpy.filter.smoothing import anisotropic_diffusion
    except ImportError:
        return None
    parts = [np.ascontiguousarray(dense[..., c]) for c in range(3)]
    return lambda: [anisotropic_diffusion(p, niter=STEPS, kappa=KAPPA_N, gamma=LAM, option=1) for p in parts]


def measure(samples: int) -> Figures:
    """Time all filters and the installed peers."""
    normal = np.random.default_rng(0).normal(size=(samples, samples, samples, 3))
    dense = normal.astype(np.float32) / np.float32(5)
    field = shell(samples, 0.3735, 0.4)
    jobs: dict[str, Callable[[], object] | None] = {
        f"perona_malik, dense {samples}^3 x 3": lambda: perona_malik(dense, steps=STEPS, kappa_n=KAPPA_N),
        "peer: numpy, the same equation": lambda: in_numpy(dense),
        "peer: medpy, each component apart": medpy_row(dense),
        "perona-malik, wall": lambda: DiffusionFilter(KAPPA_N, STEPS)(field),
        "shading, wall, sigma 2 samples": lambda: ShadingFilter(2 / samples)(field),
        "shading, wall, sigma 4 samples": lambda: ShadingFilter(4 / samples)(field),
    }
    error = float(np.abs(perona_malik(dense, steps=STEPS, kappa_n=KAPPA_N) - in_numpy(dense)).max())
    rows = {name: timed(job, runs=3 if name.startswith("peer") else 9) for name, job in jobs.items() if job}
    support_fraction = field.support_count / field.grid.voxel_count
    settings = {
        "bricks": len(field.bricks),
        "support_share": support_fraction,
        "threads": worker_count(),
        "differ_n": error,
    }
    return {"samples": samples, "steps": STEPS, **settings, "rows": rows}


def bars(figures: Figures) -> list[Bar]:
    """Require more speed than the peers, equal values, and the wall at 30 frames/s."""
    rows = figures["rows"]
    ours = figure(rows, f"perona_malik, dense {figures['samples']}^3 x 3", "min_ms")
    peers = [row["min_ms"] for name, row in rows.items() if name.startswith("peer")]
    wall_ms = figure(rows, "perona-malik, wall", "min_ms")
    return [
        at_least("time of the fastest peer over ours, dense", min(peers) / ours if peers else None, 1.0),
        at_least("time of our dense one over the sparse wall's", wall_ms and ours / wall_ms, 1.0),
        at_most("ten steps on the wall", wall_ms, 1e3 / 30, "ms"),
        at_most("largest difference to numpy", figure(figures, "differ_n"), 1e-5, "N"),
    ]


if __name__ == "__main__":
    bench("diffusion", __doc__, measure, bars, samples=(128, 48))
