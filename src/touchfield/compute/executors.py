"""Work spread over threads, or over the workers of an executor: processes, or the machines of a cluster.

Any `concurrent.futures.Executor` will do; what is retried, moved and kept where is its business alone.
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

_MOST_SUBMITTED: Final = (
    256  # tasks that an executor is given before the first of their results is waited for
)
_MOST_PROCESSES: Final = 1024
_PATIENCE_S: Final = 5  # for a scheduler that does not answer


@contextmanager
def executor_of(words: str | None) -> Iterator[Executor | None]:
    """The executor of ``--workers``: ``processes:N`` of this machine, ``dask:ADDRESS``, dask's scheduler, or
    None.

    InvalidArgument if the words are neither; SourceError if there is no scheduler at the address.
    """
    if words is None:
        yield None
        return
    kind, _, rest = words.partition(":")
    if kind == "processes" and rest.isdigit() and 0 < int(rest) <= _MOST_PROCESSES:
        each = max(1, worker_count() // int(rest))
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(int(rest), context, _use_threads, (each,)) as pool:
            yield pool
    elif kind == "dask" and rest:
        Client = import_extra("distributed", "--workers dask:ADDRESS", "distributed", "cluster").Client
        try:
            client = Client(rest, timeout=_PATIENCE_S, set_as_default=False)
        except (OSError, ValueError) as error:
            found = f"no scheduler that answers ({str(error) or type(error).__name__})"
            mend = "Start one: dask scheduler."
            raise SourceError(f"--workers {words}", found, "the address of one", mend) from None
        with client:
            yield client.get_executor(pure=False)
    else:
        raise InvalidArgument(
            "--workers", repr(words), "processes:N, or dask:ADDRESS such as dask:tcp://host:8786"
        )


def in_order(
    work: Callable[[Item], Result],
    items: Iterable[Item],
    weight: Callable[[Item], int] = lambda _: 0,
    most_weight: int = 0,
    executor: Executor | None = None,
) -> Iterator[Result]:
    """``work(item)`` of each item in threads or by an executor, the results in the order of the items.

    The items are drawn by the caller's thread, one at a time and only as there is room: at most one more than
    there are threads is under way, and no second one while their weights, for example their bytes, exceed
    `most_weight` (0: any). With one thread everything happens in the caller's. The first error, in the order
    of the items, ends it; what was not begun is left. In threads `work` gains where it releases the
    interpreter's lock. Work and items are sent to the workers of an `executor`, and weights are not looked
    at. SourceError if a worker is lost and its executor cannot go on without it.
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
        except Exception as error:  # of a worker that was killed, or cannot read its task
            if executor is None:
                raise
            found = f"that one ended before its work was done ({type(error).__name__}: {str(error)[:300]})"
            raise SourceError(
                "a worker", found, mend="The same command goes on from what is finished."
            ) from error

    pool = executor or ThreadPoolExecutor(workers, thread_name_prefix="touchfield-job")
    most = workers + 1 if executor is None else _MOST_SUBMITTED
    waiting: deque[tuple[Future[Result], int]] = deque()
    under_way = 0
    try:
        for item in items:
            own = weight(item) if executor is None else 0
            while waiting and (len(waiting) >= most or (most_weight and under_way + own > most_weight)):
                first, size = waiting.popleft()
                yield of_pool(first.result)
                under_way -= size
            waiting.append((of_pool(partial(pool.submit, work, item)), own))
            under_way += own
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
    """The threads of one process of several."""
    os.environ.setdefault("TOUCHFIELD_THREADS", str(count))
