"""Reports the progress of an experiment whose parts each report their own."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

__all__ = ["Steps"]

Progress = Callable[[int, int], None]

_PARTS: Final = 100


class Steps:
    """As many parts as are known beforehand, each as long as any other.

    Parameters
    ----------
    report : callable
        ``report(done, total)`` of the whole.
    total : int
        Parts.
    """

    def __init__(self, report: Progress, total: int) -> None:
        self._report, self._total, self._done = report, total, 0

    @contextmanager
    def step(self) -> Iterator[Progress]:
        """One part; gives its own ``report(done, total)``."""
        begin, whole = self._done * _PARTS, self._total * _PARTS

        def report(done: int, total: int) -> None:
            self._report(begin + _PARTS * done // max(1, total), whole)

        yield report
        self._done += 1
        self._report(self._done * _PARTS, whole)
