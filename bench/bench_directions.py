"""Vectors and amplitudes quantised in a second: the look-up tables against brute force (paper section 5.2).

Run ``python bench/bench_directions.py``; prints a table and writes bench/results/directions.json. Each figure is
the best of several repetitions, after one that compiles and warms.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from machine import keep
from touchfield.codec.paper.directions import Codebook
from touchfield.codec.paper.quantisers import AmplitudeLevels, lloyd_max_levels, weber_ladder, weber_levels
from touchfield.perception.weber import READINGS, gate, gate_in_time, held_values

COUNT = 2_000_000
REPETITIONS = 15


def best_s(job: Callable[[], Any], repetitions: int = REPETITIONS) -> float:
    """Seconds of the fastest run, after a warming one."""
    job()
    times = []
    for _ in range(repetitions):
        began = time.perf_counter()
        job()
        times.append(time.perf_counter() - began)
    return min(times)


def rate_m(job: Callable[[], Any], count: int, repetitions: int = REPETITIONS) -> float:
    """Millions of items a second."""
    return round(count / best_s(job, repetitions) / 1e6, 1)


def directions(random: np.ndarray, smooth: np.ndarray) -> dict[str, Any]:
    """Nearest vertex: exact table, and brute force in numpy."""
    found = {}
    for name in ("ico3", "ico5", "octa3", "ico8", "ico20"):
        codebook = Codebook.get(name)
        vertices, few = codebook.vertices_float32, random[: 20_000_000 // len(codebook)]
        found[name] = {
            "vertices": len(codebook),
            "random_m_per_s": rate_m(lambda c=codebook: c.nearest(random), len(random)),
            "smooth_m_per_s": rate_m(lambda c=codebook: c.nearest(smooth), len(smooth)),
            "brute_force_numpy_m_per_s": rate_m(lambda v=vertices, x=few: (x @ v.T).argmax(axis=1), len(few), 3),
        }
    return found


def amplitudes(values: np.ndarray) -> dict[str, Any]:
    """Training, and quantising."""
    found = {}
    makers: dict[str, Callable[[np.ndarray], AmplitudeLevels]] = {
        f"lloyd-max nq={nq}": lambda x, nq=nq: lloyd_max_levels(x, nq) for nq in (4, 6, 8, 12)
    }
    makers |= {f"weber k={k}": lambda x, k=k: weber_levels(weber_ladder(k, float(x.max()))) for k in (0.1, 0.01)}
    for name, fitted in makers.items():
        table, few = fitted(values), values[:100_000]
        found[name] = {
            "levels": len(table),
            "fit_100k_ms": round(1e3 * best_s(lambda f=fitted, x=few: f(x), 5), 2),
            "fit_all_ms": round(1e3 * best_s(lambda f=fitted: f(values), 3), 2),
            "encode_m_per_s": rate_m(lambda t=table: t.encode(values), len(values)),
        }
    return found


def deadbands(smooth: np.ndarray) -> dict[str, Any]:
    """Gates along a scan that sends about four samples in ten, the hardest to foresee."""
    rng = np.random.default_rng(2)
    scan = (smooth * (1 + 0.08 * rng.normal(size=(len(smooth), 1)))).astype(np.float32)
    found = {}
    for reading in READINGS:
        sent = gate(scan, 0.1, reading)
        found[reading] = {
            "sent": round(float(sent.mean()), 3),
            "m_per_s": rate_m(lambda r=reading: gate(scan, 0.1, r), len(scan)),
        }
    found["in time"] = {"m_per_s": rate_m(lambda: gate_in_time(scan, smooth, 0.1), len(scan))}
    found["held values"] = {"m_per_s": rate_m(lambda: held_values(sent, scan), len(scan))}
    return found


def main() -> None:
    """Measure, print, write."""
    rng = np.random.default_rng(0)
    random = rng.normal(size=(COUNT, 3)).astype(np.float32)
    at = np.linspace(0, 20, COUNT)
    smooth = np.stack([np.sin(at), np.cos(1.3 * at), np.sin(0.7 * at) + 0.2], axis=1).astype(np.float32)
    values = np.minimum(rng.gamma(2.0, 0.6, 1_300_000), 3.3).astype(np.float32)
    result = {
        "directions": directions(random, smooth),
        "amplitudes": amplitudes(values),
        "deadband": deadbands(smooth),
    }
    for part in ("directions", "amplitudes", "deadband"):
        print(part)
        for name, figures in result[part].items():
            print(f"  {name:18s}", "  ".join(f"{k} {v}" for k, v in figures.items()))
    keep("directions", result)


if __name__ == "__main__":
    main()
