"""Perona-Malik diffusion and force shading: dense against numpy and medpy, and sparse bricks.

    python bench/bench_diffusion.py [samples]

Ten steps on a dense cube of 128 (or the given number of) samples with three components, and on a sphere's wall that
fills 5 % of the same cube. The peers: the same equation in vectorised numpy, and, where it is installed,
`medpy.filter.smoothing.anisotropic_diffusion` on each component (a conductance for each component apart: less work
than one of the vector). Each row is the best of several runs, all in one process.
"""

from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from machine import keep, timed
from touchfield.filters.shading import DiffusionFilter, ShadingFilter, perona_malik
from touchfield.medium import ForceField, Grid
from touchfield.parallel import worker_count

STEPS, KAPPA_N, LAM = 10, 0.3, 1 / 7

Floats = NDArray[np.float32]


def in_numpy(values: Floats) -> Floats:
    """The equation of `touchfield.filters.shading`, float32, in whole arrays."""
    u = values.copy()
    for _ in range(STEPS):
        change = np.zeros_like(u)
        for axis in range(3):
            d = np.diff(u, axis=axis)
            d *= LAM * np.exp(-(d**2).sum(axis=-1, keepdims=True) / KAPPA_N**2)
            low, high = (tuple(slice(*s) if a == axis else slice(None) for a in range(3)) for s in ((-1,), (1, None)))
            change[low] += d
            change[high] -= d
        u += change
    return u


def medpy_row(dense: Floats) -> Callable[[], object] | None:
    """A call of medpy, if it is installed."""
    try:
        from medpy.filter.smoothing import anisotropic_diffusion
    except ImportError:
        return None
    parts = [np.ascontiguousarray(dense[..., c]) for c in range(3)]
    return lambda: [anisotropic_diffusion(p, niter=STEPS, kappa=KAPPA_N, gamma=LAM, option=1) for p in parts]


def wall(samples: int) -> ForceField:
    """A sphere's wall that fills 5 % of a cube, its forces outward."""
    grid = Grid.over_box((-0.5,) * 3, (0.5,) * 3, (samples,) * 3)
    axis = grid.axis_m(0)
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij", sparse=True)
    r = np.sqrt(x * x + y * y + z * z)
    held = np.argwhere((r < 0.4) & (r > 0.3735))
    points = grid.to_m(held)
    return ForceField.from_support(grid, held, points / np.linalg.norm(points, axis=1)[:, None])


def main() -> None:
    """Print the table."""
    samples = int(sys.argv[1]) if len(sys.argv) > 1 else 128
    dense = np.random.default_rng(0).normal(size=(samples, samples, samples, 3)).astype(np.float32) / 5
    field = wall(samples)
    jobs: dict[str, Callable[[], object] | None] = {
        f"perona_malik, dense {samples}^3 x 3, exponential": lambda: perona_malik(
            dense, steps=STEPS, kappa_n=KAPPA_N, lam=LAM
        ),
        f"perona_malik, dense {samples}^3 x 3, rational": lambda: perona_malik(
            dense, steps=STEPS, kappa_n=KAPPA_N, lam=LAM, conductance="rational"
        ),
        "peer: numpy, the same equation": lambda: in_numpy(dense),
        "peer: medpy, each component apart": medpy_row(dense),
        "perona-malik, wall, region=support": lambda: DiffusionFilter(KAPPA_N, STEPS)(field),
        "perona-malik, wall, region=all": lambda: DiffusionFilter(KAPPA_N, STEPS, region="all")(field),
        "shading, wall, sigma 2 samples": lambda: ShadingFilter(2 / samples)(field),
        "shading, wall, sigma 4 samples": lambda: ShadingFilter(4 / samples)(field),
    }
    share = field.support_count / field.grid.voxel_count
    print(f"{samples}^3, wall of {len(field.bricks)} bricks, {100 * share:.1f} %, {worker_count()} threads")
    error = np.abs(perona_malik(dense, steps=STEPS, kappa_n=KAPPA_N, lam=LAM) - in_numpy(dense)).max()
    print(f"  greatest difference to numpy: {error:.1e} N")
    rows = {}
    for name, job in jobs.items():
        if job is None:
            print(f"  {name:52s} not installed")
            continue
        rows[name] = timed(job, runs=3 if name.startswith("peer") else 9)
        print(f"  {name:52s} {rows[name]['min_ms']:8.1f} ms, median {rows[name]['median_ms']:8.1f}")
    keep("diffusion", {"samples": samples, "steps": STEPS, "bricks": len(field.bricks), "rows": rows})


if __name__ == "__main__":
    main()
