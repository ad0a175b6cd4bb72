"""Starts helper processes in a first run, which compile the inner loops (*kernels*) that a command needs
later.

Meanwhile the job compiles those that it needs first, and finds the others in numba's cache. Run as a program,
this module is one helper: ``python -m touchfield.cli.compile_ahead GROUP...``.
"""

from __future__ import annotations

import gc
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Final

from touchfield.compute.threads import worker_count

_MAX_HELPERS: Final = 3
_NICE: Final = 5


@contextmanager
def helpers(groups: Sequence[str]) -> Iterator[Callable[[], None]]:
    """Yield a function that starts helpers on all cores but one; they end with the block or this process.

    `groups` are names in `touchfield.tasks.setup.GROUPS`, the longest first. ``TOUCHFIELD_HELPERS`` is the
    maximum number of helpers, 3 by default; 0 starts none.
    """
    started: list[subprocess.Popen[bytes]] = []

    def start() -> None:
        limit = os.environ.get("TOUCHFIELD_HELPERS", "")
        count = min(int(limit) if limit.isdigit() else _MAX_HELPERS, worker_count() - 1, len(groups))
        for n in range(count):
            code = [sys.executable, "-P", "-m", "touchfield.cli.compile_ahead", *groups[n::count]]
            with suppress(OSError):  # without helpers the job compiles everything itself
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
    """Exit when the parent does: nothing is written to standard input, so the read ends with the pipe."""
    os.read(0, 1)
    os._exit(0)


def _main(groups: list[str]) -> None:
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if hasattr(os, "nice"):
        os.nice(_NICE)
    gc.disable()
    from touchfield.tasks.setup import GROUPS

    for group in groups:
        GROUPS[group]()


if __name__ == "__main__":
    _main(sys.argv[1:])
