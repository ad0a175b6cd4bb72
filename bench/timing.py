"""Measures the time of one call alone, or of several calls alternately."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter, process_time
from typing import Any


def timed(call: Callable[[], Any], runs: int = 9, warm: int = 1) -> dict[str, float]:
    """Return minimum and median milliseconds of `runs` calls, after `warm` calls."""
    for _ in range(warm):
        call()
    times = []
    for _ in range(runs):
        began = perf_counter()
        call()
        times.append(1e3 * (perf_counter() - began))
    times.sort()
    return {"min_ms": times[0], "median_ms": times[len(times) // 2]}


Clock = Callable[[], float]
"""A function that runs something and returns its processor milliseconds."""


def call_clock(call: Callable[[], Any]) -> Clock:
    """Return the clock of a whole call."""

    def run() -> float:
        start = process_time()
        call()
        return 1e3 * (process_time() - start)

    return run


def paired_cpu_ms(ours: Clock, reference: Clock, rounds: int) -> list[tuple[float, float]]:
    """Run two clocks alternately; return a pair of processor milliseconds per round.

    The time of the reference is the mean of the runs before and after, so that a change of processor speed or
    of load affects both.
    """
    pairs, before = [], reference()
    for _ in range(rounds):
        ours_ms = ours()
        after = reference()
        pairs.append((ours_ms, (before + after) / 2))
        before = after
    return pairs
