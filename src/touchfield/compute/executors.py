"""Distributes work over threads, or over the processes or machines that the option ``--workers`` names, and
returns the results in order.

Any `concurrent.futures.Executor` can be used; retries and the placement of data are up to it.
"""

from __future__ import annotations

import multiprocessing
import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from typing import Any, Final, TypeVar

from touchfield.compute.threads import worker_count
from touchfield.errors import InvalidArgument, SourceError, TouchfieldError, import_extra

Item = TypeVar("Item")
Result = TypeVar("Result")

_MAX_SUBMITTED: Final = 256  # maximum number of tasks submitted to an executor before waiting for a result
_MAX_PROCESSES: Final = 1024
_PATIENCE_S: Final = 5  # time to wait for a scheduler to answer


@contextmanager
def executor_of(text: str | None) -> Iterator[Executor | None]:
    """Yield the executor of ``--workers``: ``processes:N``, ``dask:ADDRESS``, or None.

    The address is that of a dask scheduler. Raises InvalidArgument for another text; SourceError if no
    scheduler answers at the address.
    """
    if text is None:
        yield None
        return
    kind, _, rest = text.partition(":")
    if kind == "processes" and rest.isdigit() and 0 < int(rest) <= _MAX_PROCESSES:
        threads_each = max(1, worker_count() // int(rest))
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(int(rest), context, _use_threads, (threads_each,)) as pool:
            yield pool
    elif kind == "dask" and rest:
        Client = import_extra("distributed", "--workers dask:ADDRESS", "distributed", "cluster").Client
        try:
            client = Client(rest, timeout=_PATIENCE_S, set_as_default=False)
        except (OSError, ValueError) as error:
            found = f"no scheduler that answers ({str(error) or type(error).__name__})"
            hint = "Start one: dask scheduler."
            raise SourceError(f"--workers {text}", found, "the address of one", hint) from None
        with client:
            yield client.get_executor(pure=False)
    else:
        raise InvalidArgument(
            "--workers", repr(text), "processes:N, or dask:ADDRESS such as dask:tcp://host:8786"
        )


def in_order(
    work: Callable[[Item], Result],
    items: Iterable[Item],
    weight: Callable[[Item], int] = lambda _: 0,
    max_weight: int = 0,
    executor: Executor | None = None,
) -> Iterator[Result]:
    """Run ``work(item)`` for each item; yield the results in the order of the items.

    The work runs in threads or in an executor. The caller's thread draws the items one at a time, and only as
    capacity allows: at most one more item than there are threads is in progress. No second item is started
    while the sum of the weights, for example bytes, exceeds `max_weight` (0: no limit). With one thread
    everything runs in the caller's thread. The first error, in the order of the items, stops the iteration,
    and items not yet started are dropped. Threads help only if `work` releases the GIL. With an `executor`,
    work and items are sent to its workers, and weights are ignored. Raises SourceError if a worker is lost
    and its executor cannot continue.
    """
    workers = worker_count()
    if executor is None and workers == 1:
        yield from map(work, items)
        return

    def of_pool(step: Callable[[], Any]) -> Any:
        try:
            return step()
        except (TouchfieldError, MemoryError):
            raise
        except Exception as error:  # the worker was killed, or could not read its task
            if executor is None:
                raise
            found = f"that one ended before its work was done ({type(error).__name__}: {str(error)[:300]})"
            raise SourceError(
                "a worker", found, hint="The same command goes on from what is finished."
            ) from error

    pool = executor or ThreadPoolExecutor(workers, thread_name_prefix="touchfield-job")
    max_waiting = workers + 1 if executor is None else _MAX_SUBMITTED
    waiting: deque[tuple[Future[Result], int]] = deque()
    under_way = 0
    try:
        for item in items:
            item_weight = weight(item) if executor is None else 0
            while waiting and (
                len(waiting) >= max_waiting or (max_weight and under_way + item_weight > max_weight)
            ):
                first, size = waiting.popleft()
                yield of_pool(first.result)
                under_way -= size
            waiting.append((of_pool(partial(pool.submit, work, item)), item_weight))
            under_way += item_weight
            del item
            while waiting and waiting[0][0].done():
                first, size = waiting.popleft()
                yield of_pool(first.result)
                under_way -= size
        while waiting:
            yield of_pool(waiting.popleft()[0].result)
    finally:
        for future, _ in waiting:
            future.cancel()
        if executor is None:
            pool.shutdown()


def _use_threads(count: int) -> None:
    """Set the number of threads of a worker process."""
    os.environ.setdefault("TOUCHFIELD_THREADS", str(count))
