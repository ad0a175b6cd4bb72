"""The peak memory of a process of its own, for code that a benchmark runs in one."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path


def peak_bytes() -> int:
    """Return the largest resident memory of this program so far, bytes.

    Linux: ``VmHWM``, because ``ru_maxrss`` outlives `exec`: a child begins with the peak of its parent.
    Elsewhere ``ru_maxrss``.
    """
    status = Path("/proc/self/status")
    if status.exists():
        lines = (line.split() for line in status.read_text().splitlines())
        return next(1024 * int(words[1]) for words in lines if words[0] == "VmHWM:")
    resource = import_module("resource")
    unit = 1 if sys.platform == "darwin" else 1024
    return unit * int(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
