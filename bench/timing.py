"""Measuring time: one call alone, or several calls in turn."""

from __future__ import annotations

from collections.abc import Callable
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


def paired_cpu_ms(ours: Callable[[], Any], reference: Callable[[], Any], rounds: int) -> list[tuple[float, float]]:
    """Processor milliseconds of ours and of the reference, which run in turn: one pair a round.

    The reference's is the mean of the runs before and after ours, so that a processor that changes its speed, and
    other processes that come and go, change both.
    """
    pairs, before = [], _cpu_ms(reference)
    for _ in range(rounds):
        own = _cpu_ms(ours)
        after = _cpu_ms(reference)
        pairs.append((own, (before + after) / 2))
        before = after
    return pairs


def _cpu_ms(call: Callable[[], Any]) -> float:
    start = process_time()
    call()
    return 1e3 * (process_time() - start)
