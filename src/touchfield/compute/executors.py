"""Distributes work over threads, or over the processes or machines that the option ``--workers`` names, and
returns the results in order.

Any object with `submit`, as in `concurrent.futures`, or with `map` is an executor; retries and the placement
of data are up to it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from itertools import islice
from typing import Any, Final, TypeVar, cast

from touchfield.compute.executor_kinds import (
    MapExecutor,
    SubmitExecutor,
    TaskExecutor,
    TaskFuture,
    executor_kinds,
    require_executor,
)
from touchfield.compute.threads import worker_count
from touchfield.errors import InvalidArgument, SourceError, TouchfieldError

Item = TypeVar("Item")
Result = TypeVar("Result")

_MAX_SUBMITTED: Final = 256  # maximum number of tasks submitted to an executor before waiting for a result
_MAX_MAPPED: Final = 64  # tasks in one call of `map`: results may arrive only when all of them are there


@contextmanager
def executor_of(text: str | None) -> Iterator[TaskExecutor | None]:
    """Yield the executor of ``--workers``, such as ``processes:N`` or ``dask:ADDRESS``, or None.

    The kinds are those of `executor_kinds`. Raises InvalidArgument for another text; MissingExtra if a
    library is not installed; SourceError if no scheduler answers at the address.
    """
    if text is None:
        yield None
        return
    name, _, rest = text.partition(":")
    kinds = executor_kinds()
    if name not in kinds or not kinds[name].accepts(rest):
        forms = ", ".join(kind.forms for kind in kinds.values())
        raise InvalidArgument("--workers", repr(text), f"one of {forms}")
    with kinds[name].open(rest) as executor:
        yield executor


def in_order(
    work: Callable[[Item], Result],
    items: Iterable[Item],
    weight: Callable[[Item], int] = lambda _: 0,
    max_weight: int = 0,
    executor: TaskExecutor | None = None,
) -> Iterator[Result]:
    """Run ``work(item)`` for each item; yield the results in the order of the items.

    The work runs in threads or in an executor. The caller's thread draws the items one at a time, and only as
    capacity allows: at most one more item than there are threads is in progress. No second item is started
    while the sum of the weights, for example bytes, exceeds `max_weight` (0: no limit). With one thread
    everything runs in the caller's thread. The first error, in the order of the items, stops the iteration,
    and items not yet started are dropped. Threads help only if `work` releases the GIL. With an `executor`,
    work and items are sent to its workers, and weights are ignored; one with `map` alone gets 64 items at a
    time. Raises InvalidArgument for an object that is no executor; SourceError if a worker is lost and its
    executor cannot continue.
    """
    workers = worker_count()
    if executor is not None:
        yield from _results_of(executor, work, items)
    elif workers == 1:
        yield from map(work, items)
    else:
        pool = ThreadPoolExecutor(workers, thread_name_prefix="touchfield-job")
        try:
            yield from _submitted(pool, work, items, workers + 1, weight, max_weight)
        finally:
            pool.shutdown()


def _results_of(
    executor: TaskExecutor, work: Callable[[Item], Result], items: Iterable[Item]
) -> Iterator[Result]:
    """Run the work by an executor, one task at a time if it can `submit`."""
    require_executor(executor)
    if callable(getattr(executor, "submit", None)):
        return _submitted(cast("SubmitExecutor", executor), work, items, _MAX_SUBMITTED, step=_of_worker)
    return _mapped(cast("MapExecutor", executor), work, items)


def _submitted(
    executor: SubmitExecutor,
    work: Callable[[Item], Result],
    items: Iterable[Item],
    max_waiting: int,
    weight: Callable[[Item], int] = lambda _: 0,
    max_weight: int = 0,
    step: Callable[[Callable[[], Any]], Any] = lambda call: call(),
) -> Iterator[Result]:
    """Submit items while at most `max_waiting` wait; `step` runs each call of the executor."""
    waiting: deque[tuple[TaskFuture, int]] = deque()
    under_way = 0
    try:
        for item in items:
            item_weight = weight(item)
            while waiting and (
                len(waiting) >= max_waiting or (max_weight and under_way + item_weight > max_weight)
            ):
                first, size = waiting.popleft()
                yield step(first.result)
                under_way -= size
            waiting.append((step(partial(executor.submit, work, item)), item_weight))
            under_way += item_weight
            del item
            while waiting and waiting[0][0].done():
                first, size = waiting.popleft()
                yield step(first.result)
                under_way -= size
        while waiting:
            yield step(waiting.popleft()[0].result)
    finally:
        for future, _ in waiting:
            future.cancel()


def _mapped(executor: MapExecutor, work: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """Map items in lists: an executor may draw them in a thread of its own, and all of them at once."""
    remaining = iter(items)
    while batch := list(islice(remaining, _MAX_MAPPED)):
        results = _of_worker(lambda: iter(executor.map(work, batch)))
        for _ in batch:
            yield _of_worker(partial(next, results))


def _of_worker(step: Callable[[], Any]) -> Any:
    """Run a call of an executor; an error that is not of the work itself becomes a SourceError."""
    try:
        return step()
    except (TouchfieldError, MemoryError):
        raise
    except Exception as error:  # the worker was killed, or could not read its task
        about = ": ".join(filter(None, (type(error).__name__, str(error)[:300])))
        found = f"that it, or its scheduler, ended before its work was done ({about})"
        hint = "The same command goes on from what is finished."
        raise SourceError("a worker", found, hint=hint) from error
