"""Work in threads, with ordered results and bounded memory."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import pytest

from touchfield.compute.executors import in_order


@pytest.mark.parametrize("threads", ["1", "3"])
def test_results_are_in_the_order_of_the_items(threads: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TOUCHFIELD_THREADS", threads)

    def slow_where_even(i: int) -> int:
        time.sleep(0.002 * (i % 2 == 0))
        return i * i

    assert list(in_order(slow_where_even, range(20))) == [i * i for i in range(20)]
    assert list(in_order(slow_where_even, [])) == []


def test_several_threads_work_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TOUCHFIELD_THREADS", "3")
    meet = threading.Barrier(3, timeout=30)
    assert list(in_order(lambda i: meet.wait() >= 0 and i, range(3))) == [0, 1, 2]


@pytest.mark.parametrize(("max_weight", "max_items"), [(0, 4), (5, 1), (10, 2)])
def test_items_in_flight_are_limited(
    max_weight: int, max_items: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TOUCHFIELD_THREADS", "3")
    drawn, given_back, peak = 0, 0, 0

    def items() -> Iterator[int]:
        nonlocal drawn
        for i in range(12):
            drawn += 1
            yield i

    for _ in in_order(lambda i: time.sleep(0.001), items(), lambda _: 5, max_weight):
        peak = max(peak, drawn - given_back)
        given_back += 1
    assert given_back == 12 and peak <= max_items + 1  # one more item is drawn while it waits for capacity


@pytest.mark.parametrize("threads", ["1", "3"])
def test_the_first_error_ends_the_iteration(threads: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TOUCHFIELD_THREADS", threads)
    begun: list[int] = []

    def work(i: int) -> int:
        begun.append(i)
        if i == 2:
            raise ZeroDivisionError(str(i))
        return i

    results = in_order(work, range(1000))
    assert [next(results), next(results)] == [0, 1]
    with pytest.raises(ZeroDivisionError, match="2"):
        next(results)
    assert len(begun) < 20
