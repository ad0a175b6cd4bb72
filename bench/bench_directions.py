"""Vectors and amplitudes quantised in a second: the look-up tables against brute force (paper section 5.2).

Run ``python bench/bench_directions.py``; prints a table and writes bench/results/directions.json. Each figure is
the best of several repetitions, after one that compiles and warms.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from touchfield.codec.ladders import WeberSpec
from touchfield.codec.lloyd_max import LloydMaxSpec

from machine import keep
from touchfield.codec.kernels import directions as kernels
from touchfield.codec.paper.directions import Codebook
from touchfield.perception.deadband import READINGS, gate, gate_in_time, held_values

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
        side = codebook._cells[0]
        found[name] = {
            "vertices": len(codebook),
            "random_m_per_s": rate_m(lambda c=codebook: c.nearest(random), len(random)),
            "smooth_m_per_s": rate_m(lambda c=codebook: c.nearest(smooth), len(smooth)),
            "brute_force_numpy_m_per_s": rate_m(lambda v=vertices, x=few: (x @ v.T).argmax(axis=1), len(few), 3),
            "table_ms": round(1e3 * best_s(lambda c=codebook, s=side: kernels.cells(c.vertices, s), 5), 2),
        }
    return found


def amplitudes(values: np.ndarray) -> dict[str, Any]:
    """Training, and level look-up against numpy's search."""
    found = {}
    specs = {f"lloyd-max nq={nq}": LloydMaxSpec(nq) for nq in (4, 6, 8, 12)}
    specs |= {"weber k=0.1": WeberSpec(0.1), "weber k=0.01": WeberSpec(0.01)}
    for name, spec in specs.items():
        table = spec.fit(values)
        few = values[:100_000]
        found[name] = {
            "levels": len(table.levels_n),
            "fit_100k_ms": round(1e3 * best_s(lambda s=spec, x=few: s.fit(x), 5), 2),
            "fit_all_ms": round(1e3 * best_s(lambda s=spec: s.fit(values), 3), 2),
            "encode_m_per_s": rate_m(lambda t=table: t.encode(values), len(values)),
            "searchsorted_m_per_s": rate_m(
                lambda t=table: np.searchsorted(t.thresholds_n, values, "right"), len(values), 3
            ),
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
