"""Helpers of a first run: processes that compile what a job needs later while it compiles what it needs
first.

They fill numba's cache, where the job finds the kernels when it comes to them. Run as a program, this file is
one of them: ``python -m touchfield.cli.ahead GROUP...``.
"""

from __future__ import annotations

import gc
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from typing import Final

from touchfield.compute.threads import worker_count

_MOST: Final = 3
_NICE: Final = 5


@contextmanager
def helpers(groups: Sequence[str]) -> Iterator[Callable[[], None]]:
    """Yields what starts them, one for each core but one; they end with the block, and with this process.

    `groups` are of `touchfield.tasks.setup.GROUPS`, what takes longest first. ``TOUCHFIELD_HELPERS`` gives
    the most helpers, 3 where it is not set; 0: none.
    """
    started: list[subprocess.Popen[bytes]] = []

    def start() -> None:
        asked = os.environ.get("TOUCHFIELD_HELPERS", "")
        count = min(int(asked) if asked.isdigit() else _MOST, worker_count() - 1, len(groups))
        for n in range(count):
            code = [sys.executable, "-P", "-m", "touchfield.cli.ahead", *groups[n::count]]
            with suppress(OSError):  # the job compiles by itself what nobody compiled for it
                quiet = subprocess.DEVNULL
                started.append(subprocess.Popen(code, stdin=subprocess.PIPE, stdout=quiet, stderr=quiet))

    try:
        yield start
    finally:
        for helper in started:
            helper.kill()
        for helper in started:
            helper.communicate()


def _end_with_parent() -> None:
    """Nothing is ever written to the pipe of standard input: it ends when the other end does."""
    os.read(0, 1)
    os._exit(0)


def _main(groups: list[str]) -> None:
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if hasattr(os, "nice"):
        os.nice(_NICE)
    gc.disable()
    from touchfield.codec.touch.warm import GROUPS

    every = GROUPS if set(groups) <= GROUPS.keys() else import_module("touchfield.tasks.setup").GROUPS
    for group in groups:
        every[group]()


if __name__ == "__main__":
    _main(sys.argv[1:])
