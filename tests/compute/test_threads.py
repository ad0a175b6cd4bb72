"""Pieces on threads: all of the range, in order, errors handed on, calls within calls."""

from __future__ import annotations

import time

import numpy as np
import pytest

from touchfield.compute import threads


@pytest.mark.parametrize("count_text", ["1", "2", "5"])
def test_the_whole_range_once_and_in_order(monkeypatch: pytest.MonkeyPatch, count_text: str) -> None:
    monkeypatch.setenv("TOUCHFIELD_THREADS", count_text)
    for count in (0, 1, 7, 1000):
        seen = np.zeros(count, int)

        def kernel(begin: int, end: int, out: np.ndarray) -> tuple[int, int]:
            out[begin:end] += 1
            return begin, end

        pieces = threads.for_chunks(kernel, count, seen)
        assert (seen == 1).all()
        assert [p[0] for p in pieces[1:]] == [p[1] for p in pieces[:-1]]
        assert len(threads.for_chunks(kernel, count, seen, chunk=600)) == 1, "too little for two threads"


def test_what_is_no_number_of_threads_is_all_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("TOUCHFIELD_THREADS", raising=False)
    usual = threads.worker_count()
    for words in ("0", "", "-2", "many"):
        monkeypatch.setenv("TOUCHFIELD_THREADS", words)
        assert threads.worker_count() == usual > 0


def test_an_error_is_handed_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TOUCHFIELD_THREADS", "3")

    def kernel(begin: int, end: int) -> None:
        if begin <= 50 < end:
            raise ValueError("in the middle")

    with pytest.raises(ValueError, match="in the middle"):
        threads.for_chunks(kernel, 100)


def test_a_call_within_a_call_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TOUCHFIELD_THREADS", "2")

    def inner(begin: int, end: int) -> int:
        time.sleep(0.001)
        return end - begin

    def outer(begin: int, end: int) -> int:
        return sum(threads.for_chunks(inner, end - begin))

    assert sum(threads.for_chunks(outer, 64)) == 64
