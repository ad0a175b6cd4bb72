"""Pairs of frames that `FieldSampler.at` looks between: while one is asked for, the next is made in the background.

Two stores take turns, each with what one instant needs: what is asked for is never written to meanwhile. Cells of a
frame are made once and copied into both.
"""

from __future__ import annotations

import os
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from functools import cache
from typing import TYPE_CHECKING

from touchfield.render.frame_store import FrameStore

if TYPE_CHECKING:
    from touchfield.medium.cells import CellPool
    from touchfield.render.frame_parts import FieldName, FrameParts
    from touchfield.render.memory import Memory

__all__ = ["PairsAhead"]

Place = tuple["Memory", int, int]
"""Block of a pair, and where its two frames lie in it."""


class PairsAhead:
    """Pairs (a, b) of frames in the order of play, ready before they are needed.

    Asked by one thread. Frames are made by one thread at a time, the caller's or a background one.

    Parameters
    ----------
    parts : FrameParts
    memory_bytes : int
        For each store.
    """

    def __init__(self, parts: FrameParts, memory_bytes: int) -> None:
        self._count = parts.frame_count
        self._parts = parts
        self._cells: dict[FieldName, CellPool] = {}  # of the pair made last
        self._stores = [FrameStore(parts, memory_bytes, self._cells_of) for _ in range(2)]
        self._used = 0
        self._coming: tuple[tuple[int, int], Future[Place]] | None = None

    def take(self, a: int, b: int) -> Place:
        """The pair, valid until the next call; the one that follows is begun.

        Raises
        ------
        Exception
            What the frames of this pair raised; an error of the pair that follows comes in its turn.
        """
        coming, self._coming = self._coming, None
        self._used = 1 - self._used
        if coming is not None and coming[0] == (a, b):
            place = coming[1].result()
        else:
            if coming is not None and not coming[1].cancel():
                coming[1].exception()  # both would make frames at once
            place = self._make(self._used, a, b)
        after = (b, b + 1) if b > a else (a, a + 1)
        if after[1] < self._count:
            self._coming = after, _pool().submit(self._make, 1 - self._used, *after)
        return place

    def _make(self, which: int, a: int, b: int) -> Place:
        store = self._stores[which]
        first, second = store.places(a, b)
        names = {name for frame in (a, b) for name in self._parts.names(frame)}
        self._cells = {name: cells for name, cells in self._cells.items() if name in names}
        return store.memory, first, second

    def _cells_of(self, name: FieldName) -> CellPool:
        if name not in self._cells:
            self._cells[name] = self._parts.cells(name)
        return self._cells[name]

    def settle(self) -> None:
        """Wait until nothing is made in the background."""
        if self._coming is not None:
            self._coming[1].exception()


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(1, thread_name_prefix="touchfield-pairs", initializer=_stand_back)


def _stand_back() -> None:
    """Let this thread, when it is woken, not take the processor from the one that asks (4 ms of it, else)."""
    if hasattr(os, "SCHED_BATCH"):
        with suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
