"""Entropy of 10^8 int16 symbols, beside reading them once and numpy.bincount.

    python bench/bench_information.py [--quick] [--count N]

"Read" is the sum of the memory as 64-bit words, once by one thread (numpy) and once by as many as the counting has;
"int16 sum" is numpy's own reading of the symbols as what they are. Times are the best of several.
"Adds" are the bare adds to 32-bit tables, on all threads: one for each symbol, or, where all symbols lie within 128,
one for each pair, in rows of 128, whose numbers are made beforehand; the best of 1, 2, 4 and 8 tables. They bound
from below only a counting that makes these very adds. Constant stretches are counted without any, symbols that lie
within 64 in smaller tables of pairs, and those spread evenly over 65 .. 128 one by one: all of these may be below it.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numba import njit
from numpy.typing import NDArray

from machine import Bar, Figures, at_least, at_most, bench, column, timed
from touchfield.measure.histogram import Histogram, JointHistogram
from touchfield.measure.information import entropy
from touchfield.parallel import for_chunks


def sources(count: int) -> Iterator[tuple[str, NDArray[np.int16]]]:
    """Arrays like a quantised field, like its symbols alone, and worse ones."""
    rng = np.random.default_rng(0)
    sparse = rng.integers(0, 64, count, dtype=np.int16)
    sparse[rng.random(count, dtype=np.float32) < 0.97] = 0
    yield "64 symbols, 97 % zeros", sparse
    runs = np.zeros(count, np.int16)
    for begin in range(0, count, 10_000):
        runs[begin : begin + 300] = sparse[begin : begin + 300] + 1
    yield "64 symbols, 97 % zeros in runs", runs
    yield "63 levels", rng.integers(-31, 32, count, dtype=np.int16)
    yield "normal, sigma 10", rng.normal(0, 10, count).astype(np.int16)
    yield "normal, sigma 300", rng.normal(0, 300, count).astype(np.int16)
    yield "all 65536 symbols", rng.integers(-32768, 32768, count, dtype=np.int16)


@njit(nogil=True)
def _adds(begin, end, words, table, stride, tables):
    """Four 16-bit places a word, two words a turn, into `tables` tables in turn, `stride` apart."""
    places, one = np.uint64(0xFFFF), np.uint32(1)
    s1, s2, s3 = np.uint64(stride * (1 % tables)), np.uint64(stride * (2 % tables)), np.uint64(stride * (3 % tables))
    s4, s5 = np.uint64(stride * (4 % tables)), np.uint64(stride * (5 % tables))
    s6, s7 = np.uint64(stride * (6 % tables)), np.uint64(stride * (7 % tables))
    for i in range(begin, end - 1, 2):
        v, w = words[i], words[i + 1]
        table[v & places] += one
        table[s1 + ((v >> np.uint64(16)) & places)] += one
        table[s2 + ((v >> np.uint64(32)) & places)] += one
        table[s3 + (v >> np.uint64(48))] += one
        table[s4 + (w & places)] += one
        table[s5 + ((w >> np.uint64(16)) & places)] += one
        table[s6 + ((w >> np.uint64(32)) & places)] += one
        table[s7 + (w >> np.uint64(48))] += one


def adds_ms(x: NDArray[np.int16]) -> float:
    """Milliseconds of the adds alone."""
    places = x.view(np.uint16)
    if int(x.max()) - int(x.min()) < 128:
        lanes = (x - x.min()).astype(np.uint16)
        places = lanes[::2] * np.uint16(128) + lanes[1::2]
    words, stride = places[: len(places) // 8 * 8].view(np.uint64), (1 << 16) + 16

    def piece(begin: int, end: int, tables: int) -> None:
        _adds(begin, end, words, np.zeros(tables * stride, np.uint32), stride, tables)

    return min(timed(lambda t=t: for_chunks(piece, len(words), t), runs=15)["min_ms"] for t in (1, 2, 4, 8))


def row(x: NDArray[np.int16]) -> dict[str, float]:
    """Milliseconds of one array."""
    words, unsigned = x.view(np.uint64), x.view(np.uint16)
    measured = timed(lambda: entropy(x, interval=False), runs=15)["min_ms"]
    read = timed(lambda: words.sum(), runs=15)["min_ms"]
    adds = adds_ms(x)
    return {
        "entropy_ms": measured,
        "adds_ms": adds,
        "adds_over_read": adds / read,
        "read_ms": read,
        "read_by_all_threads_ms": timed(lambda: for_chunks(lambda b, e: words[b:e].sum(), len(words)), 15)["min_ms"],
        "int16_sum_ms": timed(lambda: x.sum(), runs=3)["min_ms"],
        "bincount_ms": timed(lambda: np.bincount(unsigned), runs=3)["min_ms"],
        "over_read": measured / read,
        "with_interval_ms": timed(lambda: entropy(x), runs=3)["min_ms"],
    }


def others(count: int) -> dict[str, dict[str, float]]:
    """Other types and pairs, a tenth as many samples, beside numpy.unique."""
    rng = np.random.default_rng(1)
    small = rng.integers(0, 100, count // 10)
    wide = rng.integers(0, 2**40, count // 1000)[rng.integers(0, count // 1000, count // 10)]
    rows = {}
    for name, x in {"uint8": small.astype(np.uint8), "int32": small.astype(np.int32), "int64, wide": wide}.items():
        rows[f"{name}"] = {
            "histogram_ms": timed(lambda x=x: Histogram.of(x), runs=3)["min_ms"],
            "unique_ms": timed(lambda x=x: np.unique(x, return_counts=True), runs=1, warm=0)["min_ms"],
        }
    x, y = small.astype(np.int32), (small // 3).astype(np.int16)
    rows["pairs of int32 and int16"] = {
        "histogram_ms": timed(lambda: JointHistogram.of(x, y), runs=3)["min_ms"],
        "unique_ms": timed(lambda: np.unique(x * 100 + y, return_counts=True), runs=1, warm=0)["min_ms"],
    }
    return rows


def measure(count: int) -> Figures:
    """Entropies, and what else is counted."""
    rows = {name: row(x) for name, x in sources(count)}
    return {"symbols": count, "rows": rows | others(count)}


def bars(figures: Figures) -> list[Bar]:
    """Far ahead of numpy's counting, and not far from reading the symbols."""
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
