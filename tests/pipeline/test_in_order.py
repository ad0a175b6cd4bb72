"""Work in threads, results in order, memory bounded."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import pytest

from touchfield.compute.executors import in_order


@pytest.mark.parametrize("threads", ["1", "3"])
def test_results_come_in_the_order_of_the_items(threads: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TOUCHFIELD_THREADS", threads)

    def slow_where_even(i: int) -> int:
        time.sleep(0.002 * (i % 2 == 0))
        return i * i

    assert list(in_order(slow_where_even, range(20))) == [i * i for i in range(20)]
    assert list(in_order(slow_where_even, [])) == []


def test_it_is_done_by_several_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TOUCHFIELD_THREADS", "3")
    meet = threading.Barrier(3, timeout=30)
    assert list(in_order(lambda i: meet.wait() >= 0 and i, range(3))) == [0, 1, 2]


@pytest.mark.parametrize(("most_weight", "most"), [(0, 4), (5, 1), (10, 2)])
def test_no_more_is_under_way_than_asked(
    most_weight: int, most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TOUCHFIELD_THREADS", "3")
    drawn, given_back, seen = 0, 0, 0

    def items() -> Iterator[int]:
        nonlocal drawn
        for i in range(12):
            drawn += 1
            yield i

    for _ in in_order(lambda i: time.sleep(0.001), items(), lambda _: 5, most_weight):
        seen = max(seen, drawn - given_back)
        given_back += 1
    assert given_back == 12 and seen <= most + 1  # one more is drawn before there is room for it


@pytest.mark.parametrize("threads", ["1", "3"])
def test_the_first_error_ends_it(threads: str, monkeypatch: pytest.MonkeyPatch) -> None:
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
