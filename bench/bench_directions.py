"""Measures the time to quantise directions and amplitudes of forces (paper 5.2), against NumPy.

    python bench/bench_directions.py [--quick] [--count N]

The nearest direction of a codebook is found by an exact table and, as the peer, by the largest dot product
over all vertices. Amplitudes are quantised by a table and, as the peer, by `numpy.searchsorted`. The deadband
gates are timed alone. The inputs are `--count` random forces, a smooth path of forces, and two thirds as many
random amplitudes. Each figure is the best of several repetitions, after one that compiles.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from machine import Bar, Figures, at_least, bench, column, figure, timed
from touchfield.codec.paper.directions import Codebook
from touchfield.codec.paper.quantisers import AmplitudeLevels, lloyd_max_levels, weber_ladder, weber_levels
from touchfield.perception.weber import READINGS, gate, gate_in_time


def best_ms(job: Callable[[], Any], runs: int) -> float:
    """Return the milliseconds of the fastest run."""
    return timed(job, runs)["min_ms"]


def rate_m(job: Callable[[], Any], count: int, runs: int = 15) -> float:
    """Return millions of items per second."""
    return count / timed(job, runs)["min_ms"] / 1e3


def brute_force(vertices: np.ndarray, forces: np.ndarray) -> Any:
    """Find the nearest vertex by the largest dot product, in NumPy."""
    return (forces @ vertices.T).argmax(axis=1)


def by_weber(k: float, values: np.ndarray) -> AmplitudeLevels:
    """Return the levels of a Weber ladder up to the largest value."""
    return weber_levels(weber_ladder(k, float(values.max())))


def directions(random: np.ndarray, smooth: np.ndarray) -> dict[str, Any]:
    """Time the nearest vertex by the exact table and by brute force in NumPy."""
    found = {}
    for name in ("ico3", "ico5", "octa3", "ico8", "ico20"):
        codebook = Codebook.get(name)
        vertices, few = codebook.vertices_float32, random[: 20_000_000 // len(codebook)]
        found[name] = {
            "vertices": len(codebook),
            "random_m_per_s": rate_m(partial(codebook.nearest, random), len(random)),
            "smooth_m_per_s": rate_m(partial(codebook.nearest, smooth), len(smooth)),
            "brute_force_numpy_m_per_s": rate_m(partial(brute_force, vertices, few), len(few), 3),
        }
    return found


def amplitudes(values: np.ndarray) -> dict[str, Any]:
    """Time fitting and quantising of each amplitude quantiser."""
    found = {}
    makers: dict[str, Callable[[np.ndarray], AmplitudeLevels]] = {
        f"lloyd-max nq={nq}": partial(lloyd_max_levels, nq=nq) for nq in (4, 6, 8, 12)
    }
    makers |= {f"weber k={k}": partial(by_weber, k) for k in (0.1, 0.01)}
    for name, fitted in makers.items():
        table, few = fitted(values), values[:100_000]
        found[name] = {
            "levels": len(table),
            "fit_100k_ms": best_ms(partial(fitted, few), 5),
            "fit_all_ms": best_ms(partial(fitted, values), 3),
            "encode_m_per_s": rate_m(partial(table.encode, values), len(values)),
            "searchsorted_m_per_s": rate_m(
                partial(np.searchsorted, table.thresholds_n, values, "right"), len(values), 3
            ),
        }
    return found


def deadbands(smooth: np.ndarray) -> dict[str, Any]:
    """Time the deadband gates along a scan.

    About 40 % of the samples are sent, the worst case for branch prediction.
    """
    rng = np.random.default_rng(2)
    scan = (smooth * (1 + 0.08 * rng.normal(size=(len(smooth), 1)))).astype(np.float32)
    found = {}
    for reading in READINGS:
        sent = gate(scan, 0.1, reading)
        found[reading] = {
            "sent": float(sent.mean()),
            "m_per_s": rate_m(partial(gate, scan, 0.1, reading), len(scan)),
        }
    found["in time"] = {"m_per_s": rate_m(lambda: gate_in_time(scan, smooth, 0.1), len(scan))}
    return found


def measure(count: int) -> Figures:
    """Measure directions, amplitudes and gates."""
    rng = np.random.default_rng(0)
    random = rng.normal(size=(count, 3)).astype(np.float32)
    at = np.linspace(0, 20, count)
    smooth = np.stack([np.sin(at), np.cos(1.3 * at), np.sin(0.7 * at) + 0.2], axis=1).astype(np.float32)
    values = np.minimum(rng.gamma(2.0, 0.6, count * 2 // 3), 3.3).astype(np.float32)
    return {
        "directions": directions(random, smooth),
        "amplitudes": amplitudes(values),
        "deadband": deadbands(smooth),
    }


def bars(figures: Figures) -> list[Bar]:
    """Require more speed than NumPy, and each step on a dense 128^3 frame in 1/30 s."""
    rows, levels = figures["directions"], figures["amplitudes"].values()
    brute = min(row["random_m_per_s"] / row["brute_force_numpy_m_per_s"] for row in rows.values())
    search = [
        row["encode_m_per_s"] / row["searchsorted_m_per_s"] for row in levels if "searchsorted_m_per_s" in row
    ]
    gates, frames = column(figures["deadband"], "m_per_s"), 30 * 128**3 / 1e6
    return [
        at_least("directions over numpy's brute force", brute, 10.0),
        at_least("amplitudes over numpy's searchsorted", min(search, default=None), 1.0),
        at_least("nearest of 258 directions", figure(rows, "octa3", "random_m_per_s"), frames, "M/s"),
        at_least("amplitudes, slowest", min(column(levels, "encode_m_per_s")), frames, "M/s"),
        at_least("gates, slowest", min(gates), frames, "M/s"),
    ]


if __name__ == "__main__":
    bench("directions", __doc__, measure, bars, count=(2_000_000, 50_000))
