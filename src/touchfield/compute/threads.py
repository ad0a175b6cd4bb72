"""Runs a compiled kernel on all cores: cuts the range of its loop into pieces and gives them to threads.

numba's own parallel loops are not used: they take about two seconds each to compile, compared with 0.3 s for
a scalar kernel, and its default threading layer must not be entered by two threads at once
(docs/decisions/0002).
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from functools import cache
from typing import Any

Progress = Callable[[int, int], None]
"""``report(done, total)``: progress of a long job."""


def silent(done: int, total: int) -> None:
    """A `Progress` that does nothing."""


def worker_count() -> int:
    """Return the number of threads.

    ``TOUCHFIELD_THREADS`` if it is set, else the number of cores that this process may use.
    """
    setting = os.environ.get("TOUCHFIELD_THREADS", "")
    if setting.isdigit() and int(setting) > 0:
        return int(setting)
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@cache
def _pool(workers: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(workers, thread_name_prefix="touchfield")


def for_chunks(kernel: Callable[..., Any], count: int, *arguments: Any, chunk: int = 1) -> list[Any]:
    """Call a kernel over the range 0..count in pieces on all cores.

    The call is ``kernel(start, stop, *arguments)``; results are returned in the order of the pieces. `kernel`
    must release the GIL (``nogil=True``) and write only to what belongs to its range. `chunk` is the smallest
    piece worth a thread. The caller's thread works too, so that a single core needs no other thread and
    nested calls cannot deadlock. The first error is raised after all started pieces have ended.
    """
    workers = worker_count()
    pieces = min(workers * 4, max(1, count // max(1, chunk)))
    if workers == 1 or pieces == 1:
        return [kernel(0, count, *arguments)]
    edges = [count * i // pieces for i in range(pieces + 1)]
    results: list[Any] = [None] * pieces
    errors: list[BaseException] = []
    turns = itertools.count()  # next() on it is atomic

    def work() -> None:
        while not errors and (i := next(turns)) < pieces:
            try:
                results[i] = kernel(edges[i], edges[i + 1], *arguments)
            except BaseException as error:  # of any kind; raised again below
                errors.append(error)

    others = [_pool(workers - 1).submit(work) for _ in range(min(workers, pieces) - 1)]
    work()
    wait([future for future in others if not future.cancel()])
    if errors:
        raise errors[0]
    return results
