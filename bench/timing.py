"""Measuring time: one call alone, or several calls in turn."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from time import perf_counter, process_time
from typing import Any


def timed(call: Callable[[], Any], runs: int = 9, warm: int = 1) -> dict[str, float]:
    """Minimum and median milliseconds of `runs` calls after `warm` ones."""
    for _ in range(warm):
        call()
    times = []
    for _ in range(runs):
        began = perf_counter()
        call()
        times.append(1e3 * (perf_counter() - began))
    times.sort()
    return {"min_ms": times[0], "median_ms": times[len(times) // 2]}


def interleaved_cpu_ms(calls: Mapping[str, Callable[[], Any]], rounds: int) -> dict[str, float]:
    """Minimum processor milliseconds of each call, the calls taking turns after one round without a clock.

    Other processes then slow all calls alike, and the minimum is free of most of what they take.
    """
    for call in calls.values():
        call()
    best = dict.fromkeys(calls, float("inf"))
    for _ in range(rounds):
        for name, call in calls.items():
            start = process_time()
            call()
            best[name] = min(best[name], 1e3 * (process_time() - start))
    return best
