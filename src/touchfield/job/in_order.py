"""Work on all cores whose results come in order, with no more of it under way than memory allows."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

from touchfield.parallel import worker_count

__all__ = ["in_order"]

Item = TypeVar("Item")
Result = TypeVar("Result")


def in_order(
    work: Callable[[Item], Result],
    items: Iterable[Item],
    weight: Callable[[Item], int] = lambda _: 0,
    most_weight: int = 0,
) -> Iterator[Result]:
    """``work(item)`` of each item in threads, the results in the order of the items.

    The items are drawn by the caller's thread, one at a time and only as there is room: at most one more than there
    are workers is under way, and no second one while their weights exceed `most_weight`. With one worker everything
    happens in the caller's thread. The first error, in the order of the items, ends it; what was not begun is left.

    Parameters
    ----------
    work : callable
        Must release the interpreter's lock to gain anything, and be safe to call from several threads.
    items : iterable
    weight : callable
        Of an item, for example its bytes.
    most_weight : int
        Of all items under way; 0 means any.
    """
    workers = worker_count()
    if workers == 1:
        for item in items:
            yield work(item)
        return
    pool = ThreadPoolExecutor(workers, thread_name_prefix="touchfield-job")
    waiting: deque[tuple[Future[Result], int]] = deque()
    held = 0
    try:
        for item in items:
            own = weight(item)
            while waiting and (len(waiting) > workers or (most_weight and held + own > most_weight)):
                first, size = waiting.popleft()
                yield first.result()
                held -= size
            waiting.append((pool.submit(work, item), own))
            held += own
            del item
            while waiting and waiting[0][0].done():
                first, size = waiting.popleft()
                yield first.result()
                held -= size
        while waiting:
            yield waiting.popleft()[0].result()
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
