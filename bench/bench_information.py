"""Measures the time to compute the entropy of 10^8 int16 symbols, against one read of them and
`numpy.bincount`.

    python bench/bench_information.py [--quick] [--count N]

The symbols have six distributions, from 97 % zeros to all 65,536 symbols. For comparison the same memory is
read once: "read" sums it as 64-bit words on one thread with NumPy, "read by all threads" on as many threads
as the counting uses, and "int16 sum" with NumPy as int16. The peer is `numpy.bincount`. Histograms of other
types and of pairs, with a tenth as many samples, are compared with `numpy.unique`. Times are the best of
several runs.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machine import Bar, Figures, at_least, at_most, bench, column, timed
from touchfield.compute.threads import for_chunks
from touchfield.measure.counts import Counts
from touchfield.measure.information import entropy


def sources(count: int) -> Iterator[tuple[str, NDArray[np.int16]]]:
    """Yield arrays like a quantised field and its non-zero symbols, and harder cases."""
    rng = np.random.default_rng(0)
    sparse = rng.integers(0, 64, count, dtype=np.int16)
    sparse[rng.random(count, dtype=np.float32) < 0.97] = 0
    yield "64 symbols, 97 % zeros", sparse
    runs = np.zeros(count, np.int16)
    for start in range(0, count, 10_000):
        runs[start : start + 300] = sparse[start : start + 300] + 1
    yield "64 symbols, 97 % zeros in runs", runs
    yield "63 levels", rng.integers(-31, 32, count, dtype=np.int16)
    yield "normal, sigma 10", rng.normal(0, 10, count).astype(np.int16)
    yield "normal, sigma 300", rng.normal(0, 300, count).astype(np.int16)
    yield "all 65536 symbols", rng.integers(-32768, 32768, count, dtype=np.int16)


def row(x: NDArray[np.int16]) -> dict[str, float]:
    """Time the entropy of one array, and the comparisons, milliseconds."""
    wide, unsigned = x.view(np.uint64), x.view(np.uint16)
    measured = timed(lambda: entropy(x, interval=False), runs=15)["min_ms"]
    read = timed(lambda: wide.sum(), runs=15)["min_ms"]
    return {
        "entropy_ms": measured,
        "read_ms": read,
        "read_by_all_threads_ms": timed(lambda: for_chunks(lambda b, e: wide[b:e].sum(), len(wide)), 15)[
            "min_ms"
        ],
        "int16_sum_ms": timed(lambda: x.sum(), runs=3)["min_ms"],
        "bincount_ms": timed(lambda: np.bincount(unsigned), runs=3)["min_ms"],
        "over_read": measured / read,
        "with_interval_ms": timed(lambda: entropy(x), runs=3)["min_ms"],
    }


def others(count: int) -> dict[str, dict[str, float]]:
    """Time histograms of other types and of pairs, against `numpy.unique`."""
    rng = np.random.default_rng(1)
    small = rng.integers(0, 100, count // 10)
    wide = rng.integers(0, 2**40, count // 1000)[rng.integers(0, count // 1000, count // 10)]
    rows = {}
    types: dict[str, NDArray[Any]] = {
        "uint8": small.astype(np.uint8),
        "int32": small.astype(np.int32),
        "int64, wide": wide,
    }
    for name, x in types.items():
        rows[f"{name}"] = {
            "histogram_ms": timed(partial(Counts.of, x), runs=3)["min_ms"],
            "unique_ms": timed(partial(np.unique, x, return_counts=True), runs=1, warm=0)["min_ms"],
        }
    x, y = small.astype(np.int32), (small // 3).astype(np.int16)
    rows["pairs of int32 and int16"] = {
        "histogram_ms": timed(lambda: Counts.of(x, y), runs=3)["min_ms"],
        "unique_ms": timed(lambda: np.unique(x * 100 + y, return_counts=True), runs=1, warm=0)["min_ms"],
    }
    return rows


def measure(count: int) -> Figures:
    """Measure entropies, and histograms of other types."""
    rows = {name: row(x) for name, x in sources(count)}
    return {"symbols": count, "rows": rows | others(count)}


def bars(figures: Figures) -> list[Bar]:
    """Require more speed than NumPy's counting, and at most four times one read."""
    rows = figures["rows"].values()
    bincount = min(row["bincount_ms"] / row["entropy_ms"] for row in rows if "bincount_ms" in row)
    unique = min(row["unique_ms"] / row["histogram_ms"] for row in rows if "unique_ms" in row)
    return [
        at_least("time of numpy's bincount over ours, worst", bincount, 5.0),
        at_least("time of numpy's unique over ours, worst", unique, 1.0),
        at_most("time over one reading by one thread, worst", max(column(rows, "over_read")), 4.0),
    ]


if __name__ == "__main__":
    bench("information", __doc__, measure, bars, count=(10**8, 10**6))
