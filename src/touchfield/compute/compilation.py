"""Reports when numba compiles a kernel, to whoever makes a person wait for it.

This module does not import numba; `touchfield.compute.numba_internals` calls it if numba is ever used.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

_callbacks: list[tuple[Callable[[], None], Callable[[], None]]] = []


@contextmanager
def compilation_events(on_start: Callable[[], None], on_end: Callable[[], None]) -> Iterator[None]:
    """Call `on_start` and `on_end` around each compilation within the block.

    Nested compilations count, too. With an unknown version of numba nothing is called.
    """
    pair = on_start, on_end
    _callbacks.append(pair)
    try:
        yield
    finally:
        _callbacks.remove(pair)


def compilation_started() -> None:
    """Call the functions of all blocks for the start of a compilation."""
    for on_start, _ in tuple(_callbacks):
        on_start()


def compilation_ended() -> None:
    """Call the functions of all blocks for the end of a compilation."""
    for _, on_end in tuple(_callbacks):
        on_end()
