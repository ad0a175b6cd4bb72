"""Chunks on threads: the whole range in order, propagated errors, and nested calls."""

from __future__ import annotations

import time

import numpy as np
import pytest

from touchfield.compute import threads


@pytest.mark.parametrize("count_text", ["1", "2", "5"])
def test_chunks_cover_the_range_once_and_in_order(monkeypatch: pytest.MonkeyPatch, count_text: str) -> None:
    monkeypatch.setenv("TOUCHFIELD_THREADS", count_text)
    for count in (0, 1, 7, 1000):
        visits = np.zeros(count, int)

        def kernel(start: int, stop: int, out: np.ndarray) -> tuple[int, int]:
            out[start:stop] += 1
            return start, stop

        pieces = threads.for_chunks(kernel, count, visits)
        assert (visits == 1).all()
        assert [p[0] for p in pieces[1:]] == [p[1] for p in pieces[:-1]]
        assert len(threads.for_chunks(kernel, count, visits, chunk=600)) == 1, "too little for two threads"


def test_invalid_thread_counts_mean_all_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("TOUCHFIELD_THREADS", raising=False)
    default_count = threads.worker_count()
    for text in ("0", "", "-2", "many"):
        monkeypatch.setenv("TOUCHFIELD_THREADS", text)
        assert threads.worker_count() == default_count > 0


def test_errors_propagate(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TOUCHFIELD_THREADS", "3")

    def kernel(start: int, stop: int) -> None:
        if start <= 50 < stop:
            raise ValueError("in the middle")

    with pytest.raises(ValueError, match="in the middle"):
        threads.for_chunks(kernel, 100)


def test_nested_calls_terminate(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TOUCHFIELD_THREADS", "2")

    def inner(start: int, stop: int) -> int:
        time.sleep(0.001)
        return stop - start

    def outer(start: int, stop: int) -> int:
        return sum(threads.for_chunks(inner, stop - start))

    assert sum(threads.for_chunks(outer, 64)) == 64
