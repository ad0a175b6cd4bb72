"""Gaussian smoothing, sigma 2 samples, radius 8: a dense field of 256^3 vectors, and sparse ones at 2 % support.

    python bench/bench_gaussian.py [samples]

The peers smooth the dense float32 array: `scipy.ndimage.gaussian_filter`; `scipy.fft` on all cores, periodic and
without padding, which flatters it; and OpenCV, plane by plane and then over planes, with one thread a core. Each is
checked against ours with its own boundary. Peers and ours take turns, and each keeps its fastest run.
Bars: dense at least as fast as the fastest peer, sparse at least ten times as fast.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from machine import keep
from touchfield.filters.smoothing import GaussianFilter, gaussian, gaussian_taps
from touchfield.medium import ForceField, Grid
from touchfield.parallel import worker_count

SIGMA = 2.0
ROUNDS = 9

Dense = NDArray[np.float32]


def by_ndimage(dense: Dense) -> Dense:
    return np.asarray(ndimage.gaussian_filter(dense, (SIGMA, SIGMA, SIGMA, 0), mode="reflect"))


def by_fft(dense: Dense) -> Dense:
    """Periodic: one product in the frequency domain, the kernel's spectrum being known."""
    taps, shape = gaussian_taps(SIGMA), dense.shape[:3]
    gains = []
    for count in shape:
        row = np.zeros(count)
        row[: len(taps)] = taps
        gains.append(fft.fft(np.roll(row, -(len(taps) // 2))).real.astype(np.float32))
    half = shape[2] // 2 + 1
    gain = gains[0][:, None, None, None] * gains[1][:, None, None] * gains[2][:half, None]
    spectrum = fft.rfftn(dense, axes=(0, 1, 2), workers=worker_count())
    spectrum *= gain
    return np.asarray(fft.irfftn(spectrum, s=shape, axes=(0, 1, 2), workers=worker_count()))


def by_opencv(pool: ThreadPoolExecutor, whole: bool) -> Callable[[Dense], Dense]:
    """`whole`: `GaussianBlur`; else `sepFilter2D`; each plane of y, z first, then along x over blocks of columns."""
    import cv2

    taps = gaussian_taps(SIGMA).astype(np.float32)
    size, edge, one = len(taps), cv2.BORDER_REFLECT, np.ones(1, np.float32)

    def plane(source: Dense, target: Dense) -> None:
        if whole:
            cv2.GaussianBlur(source, (size, size), SIGMA, dst=target, borderType=edge)
        else:
            cv2.sepFilter2D(source, -1, taps, taps, dst=target, borderType=edge)

    def columns(source: Dense, target: Dense) -> None:
        if whole:
            cv2.GaussianBlur(source, (1, size), SIGMA, dst=target, borderType=edge)
        else:
            cv2.sepFilter2D(source, -1, one, taps, dst=target, borderType=edge)

    def smooth(dense: Dense) -> Dense:
        between, out = np.empty_like(dense), np.empty_like(dense)
        list(pool.map(plane, dense, between))
        flat, target = between.reshape(len(dense), -1), out.reshape(len(dense), -1)
        width = flat.shape[1] // 16
        blocks = [slice(i * width, (i + 1) * width if i < 15 else None) for i in range(16)]
        list(pool.map(columns, [flat[:, b] for b in blocks], [target[:, b] for b in blocks]))
        return out

    return smooth


def sparse_fields(samples: int) -> dict[str, ForceField]:
    """A sphere's wall 5 samples thick and a ball, each 2 % of the lattice."""
    grid = Grid.over_box((-0.5,) * 3, (0.5,) * 3, (samples,) * 3)
    axis = grid.axis_m(0) * samples
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij", sparse=True)
    r = np.sqrt(x * x + y * y + z * z)
    count = 0.02 * samples**3
    middle = np.sqrt(count / (4 * np.pi * 5))
    found = {}
    for name, held in (("wall", np.abs(r - middle) < 2.5), ("ball", r < np.cbrt(count * 0.75 / np.pi))):
        places = np.argwhere(held)
        points = grid.to_m(places)
        forces = points / np.maximum(np.linalg.norm(points, axis=1), 1e-9)[:, None]
        found[name] = ForceField.from_support(grid, places, forces)
    return found


def best_ms(jobs: dict[str, Callable[[], object]], rounds: int) -> dict[str, float]:
    """The fastest run of each job, milliseconds, the jobs taking turns."""
    best = dict.fromkeys(jobs, np.inf)
    for _ in range(rounds):
        for name, job in jobs.items():
            began = time.perf_counter()
            job()
            best[name] = min(best[name], 1e3 * (time.perf_counter() - began))
    return best


def main() -> None:
    """Print the table and keep the figures."""
    samples = int(sys.argv[1]) if len(sys.argv) > 1 else 256
    dense = np.random.default_rng(0).normal(size=(samples, samples, samples, 3)).astype(np.float32)
    pool = ThreadPoolExecutor(worker_count())
    peers = {"scipy.ndimage": (by_ndimage, "reflect"), "scipy.fft": (by_fft, "wrap")}
    try:
        peers["OpenCV sepFilter2D"] = (by_opencv(pool, whole=False), "reflect")
        peers["OpenCV GaussianBlur"] = (by_opencv(pool, whole=True), "reflect")
    except ImportError:
        print("OpenCV is not installed: it is left out")
    for name, (peer, boundary) in peers.items():
        apart = float(np.abs(peer(dense) - gaussian(dense, SIGMA, boundary=boundary)).max())
        assert apart < 2e-6, f"{name} differs by {apart}"
    fields = sparse_fields(samples)
    smooth = GaussianFilter(SIGMA / samples)
    for name, field in fields.items():
        apart = float(np.abs(smooth(field).to_dense() - gaussian(field.to_dense(), SIGMA)).max())
        assert apart < 2e-6, f"{name} differs by {apart}"

    jobs: dict[str, Callable[[], object]] = {name: lambda p=peer: p(dense) for name, (peer, _) in peers.items()}
    jobs["touchfield, dense, zero"] = lambda: gaussian(dense, SIGMA)
    jobs["touchfield, dense, reflect"] = lambda: gaussian(dense, SIGMA, boundary="reflect")
    for name, field in fields.items():
        jobs[f"touchfield, {name}"] = lambda f=field: smooth(f)
    rows = best_ms(jobs, ROUNDS)
    fastest = min(rows[name] for name in peers)
    for name, ms in rows.items():
        print(f"  {name:28s} {ms:8.1f} ms   {fastest / ms:6.2f} times the fastest peer")
    support = {name: field.support_count / samples**3 for name, field in fields.items()}
    keep("gaussian", {"samples": samples, "threads": worker_count(), "support": support, "rows_ms": rows})


if __name__ == "__main__":
    main()
