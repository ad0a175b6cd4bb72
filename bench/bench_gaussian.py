"""Measures Gaussian smoothing of fields (sigma 2 samples, radius 8), against SciPy and OpenCV.

    python bench/bench_gaussian.py [--quick] [--samples N]

The inputs are a dense field of 256^3 (or `--samples`^3) random vectors, and two sparse fields that support 2
% of the lattice: the wall of a sphere and a ball. The peers smooth the dense float32 array:

* `scipy.ndimage.gaussian_filter`.
* `scipy.fft` on all cores, periodic and without padding, which favours it.
* OpenCV, each plane first and then across planes, with one thread per core.

Each peer is checked against touchfield with the peer's boundary condition. Peers and touchfield run
alternately, and the fastest run of each counts.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import repeat

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from bench_filter import shell
from machine import Bar, Figures, at_least, at_most, bench
from touchfield.compute.threads import worker_count
from touchfield.filters.smoothing import GaussianFilter, gaussian, gaussian_taps
from touchfield.medium import ForceField

SIGMA = 2.0
ROUNDS = 9

Dense = NDArray[np.float32]


def by_ndimage(dense: Dense) -> Dense:
    """Smooth with `scipy.ndimage`, reflecting boundary."""
    return np.asarray(ndimage.gaussian_filter(dense, (SIGMA, SIGMA, SIGMA, 0), mode="reflect"))


def by_fft(dense: Dense) -> Dense:
    """Smooth periodically by one product in the frequency domain.

    The spectrum of the kernel is computed from its taps.
    """
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


def by_opencv(pool: ThreadPoolExecutor) -> Callable[[Dense], Dense]:
    """Return a call of `cv2.sepFilter2D`, which is faster than `GaussianBlur`.

    It smooths each plane of y and z first, then along x over blocks of columns.
    """
    import cv2

    taps, identity_tap = gaussian_taps(SIGMA).astype(np.float32), np.ones(1, np.float32)

    def smoothed(source: Dense, target: Dense, across: Dense) -> None:
        cv2.sepFilter2D(source, -1, across, taps, dst=target, borderType=cv2.BORDER_REFLECT)

    def smooth(dense: Dense) -> Dense:
        between, out = np.empty_like(dense), np.empty_like(dense)
        list(pool.map(smoothed, dense, between, repeat(taps)))
        flat, target = between.reshape(len(dense), -1), out.reshape(len(dense), -1)
        width = flat.shape[1] // 16
        blocks = [slice(i * width, (i + 1) * width if i < 15 else None) for i in range(16)]
        list(
            pool.map(
                smoothed, [flat[:, b] for b in blocks], [target[:, b] for b in blocks], repeat(identity_tap)
            )
        )
        return out

    return smooth


def sparse_fields(samples: int) -> dict[str, ForceField]:
    """Return a sphere's wall, 5 samples thick, and a ball, each 2 % of the lattice."""
    middle, half = np.sqrt(0.02 * samples / (4 * np.pi * 5)), 2.5 / samples
    return {
        "wall": shell(samples, middle - half, middle + half),
        "ball": shell(samples, -1.0, np.cbrt(0.02 * 0.75 / np.pi)),
    }


def best_ms(jobs: dict[str, Callable[[], object]], rounds: int) -> dict[str, float]:
    """Run the jobs alternately; return the milliseconds of the fastest run of each."""
    best = dict.fromkeys(jobs, np.inf)
    for _ in range(rounds):
        for name, job in jobs.items():
            began = time.perf_counter()
            job()
            best[name] = min(best[name], 1e3 * (time.perf_counter() - began))
    return best


def measure(samples: int) -> Figures:
    """Check peers and touchfield against each other, and time them alternately."""
    dense = np.random.default_rng(0).normal(size=(samples, samples, samples, 3)).astype(np.float32)
    pool = ThreadPoolExecutor(worker_count())
    peers: dict[str, tuple[Callable[[Dense], Dense], str]] = {
        "scipy.ndimage": (by_ndimage, "reflect"),
        "scipy.fft": (by_fft, "wrap"),
    }
    absent = []
    try:
        peers["OpenCV sepFilter2D"] = (by_opencv(pool), "reflect")
    except ImportError:
        absent.append("OpenCV")
    differences = [
        float(np.abs(peer(dense) - gaussian(dense, SIGMA, boundary=boundary)).max())
        for peer, boundary in peers.values()
    ]
    fields = sparse_fields(samples)
    smooth = GaussianFilter(SIGMA / samples)
    for field in fields.values():
        differences.append(float(np.abs(smooth(field).to_dense() - gaussian(field.to_dense(), SIGMA)).max()))

    jobs: dict[str, Callable[[], object]] = {name: partial(peer, dense) for name, (peer, _) in peers.items()}
    jobs["touchfield, dense, zero"] = lambda: gaussian(dense, SIGMA)
    jobs["touchfield, dense, reflect"] = lambda: gaussian(dense, SIGMA, boundary="reflect")
    for name, field in fields.items():
        jobs[f"touchfield, {name}"] = partial(smooth, field)
    rows = best_ms(jobs, ROUNDS)
    support = {name: field.support_count / samples**3 for name, field in fields.items()}
    settings = {
        "samples": samples,
        "threads": worker_count(),
        "support": support,
        "largest_difference": max(differences),
    }
    return {**settings, "rows_ms": rows, "absent": absent}


def bars(figures: Figures) -> list[Bar]:
    """Require the speed of the fastest peer (ten times if sparse), and equal values."""
    rows = figures["rows_ms"]
    fastest = min(ms for name, ms in rows.items() if not name.startswith("touchfield"))
    over = {name: fastest / ms for name, ms in rows.items()}
    return [
        at_least("time of the fastest peer over ours, dense", over["touchfield, dense, reflect"], 1.0),
        at_least("time of the fastest peer over a wall's", over["touchfield, wall"], 10.0),
        at_least("time of the fastest peer over a ball's", over["touchfield, ball"], 10.0),
        at_most("largest difference of a value", figures.get("largest_difference"), 2e-6),
    ]


if __name__ == "__main__":
    bench("gaussian", __doc__, measure, bars, samples=(256, 48))
