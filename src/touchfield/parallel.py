"""Compiled kernels over all cores: a kernel without the interpreter's lock, a range, and threads.

Why not numba's own parallel loops: they take about two seconds each to compile, against 0.3 s for a scalar
kernel, and its default threading layer must not be entered twice at once (docs/decisions/0002).
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any

__all__ = ["for_chunks", "worker_count"]


def worker_count() -> int:
    """Threads to use: ``TOUCHFIELD_THREADS``, or the cores this process may run on."""
    asked = os.environ.get("TOUCHFIELD_THREADS", "")
    if asked.isdigit() and int(asked) > 0:
        return int(asked)
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@cache
def _pool(workers: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(workers, thread_name_prefix="touchfield")


def for_chunks(kernel: Callable[..., Any], count: int, *arguments: Any, chunk: int = 1) -> list[Any]:
    """Call ``kernel(begin, end, *arguments)`` over 0..count in pieces on all cores; results in order.

    `kernel` must release the lock (``nogil=True``) and write only what belongs to its range. `chunk` is the
    smallest piece worth a thread. The first error is raised after all pieces have ended.
    """
    workers = worker_count()
    pieces = min(workers * 4, max(1, count // max(1, chunk)))
    if workers == 1 or pieces == 1:
        return [kernel(0, count, *arguments)]
    edges = [count * i // pieces for i in range(pieces + 1)]
    pool = _pool(workers)
    futures = [pool.submit(kernel, a, b, *arguments) for a, b in zip(edges, edges[1:], strict=False)]
    errors = [e for f in futures if (e := f.exception()) is not None]
    if errors:
        raise errors[0]
    return [f.result() for f in futures]
