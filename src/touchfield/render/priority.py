"""Before the others: the scheduling class and the memory of the servo's process, as far as the user may."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import struct
import sys
from typing import Final

__all__ = ["prefer"]

FIFO_PRIORITY: Final = 50
"""In the middle: above all ordinary processes, below what the kernel itself runs there."""

_LATENCY: Final = "/dev/cpu_dma_latency"
"""Linux: while it is open, no processor takes longer to wake than what was written, microseconds."""

_MCL_CURRENT, _MCL_ONFAULT = 1, 4
_PR_SET_TIMERSLACK: Final = 29


def prefer(is_realtime: bool = True) -> dict[str, str]:
    """Make this process punctual; what was had is told, and what was not is no error.

    The collector is switched off, wake-ups are not put together with others, and with `is_realtime` the process is
    scheduled under SCHED_FIFO, its memory stays where it is, and until it ends processors do not fall asleep: one
    that sleeps wakes late, and in a virtual machine only when the host finds a place for it (milliseconds where
    others want the host, too).

    Returns
    -------
    dict
        ``priority``: "SCHED_FIFO 50", or "normal" and why; ``memory``: "locked", or "not locked" and why;
        ``processors``: "kept awake", or "may sleep" and why.
    """
    gc.collect()
    gc.disable()
    gc.freeze()
    if sys.platform.startswith("linux"):
        with contextlib.suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)
    if not is_realtime:
        asked = "not asked for"
        return {
            "priority": "normal: asked for",
            "memory": f"not locked: {asked}",
            "processors": f"may sleep: {asked}",
        }
    return {"priority": _fifo(), "memory": _locked(), "processors": _awake()}


def _fifo() -> str:
    if not hasattr(os, "sched_setscheduler"):
        return "normal: this system has no SCHED_FIFO"
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(FIFO_PRIORITY))
    except OSError as error:
        return f"normal: SCHED_FIFO is not allowed ({error.strerror})"
    return f"SCHED_FIFO {FIFO_PRIORITY}"


def _locked() -> str:
    if not sys.platform.startswith("linux"):
        return "not locked: not on this system"
    try:  # what is locked is what was and will be touched of the block: it need not be there as a whole
        library = ctypes.CDLL(None, use_errno=True)
        if library.mlockall(_MCL_CURRENT | _MCL_ONFAULT) == 0:
            return "locked"
        return f"not locked: {os.strerror(ctypes.get_errno())}"
    except (OSError, AttributeError) as error:
        return f"not locked: {error}"


def _awake() -> str:
    try:
        held = os.open(_LATENCY, os.O_WRONLY)  # to the end of the process
    except OSError as error:
        return f"may sleep: {error.strerror}"
    try:
        os.write(held, struct.pack("i", 0))
    except OSError as error:
        os.close(held)
        return f"may sleep: {error.strerror}"
    return "kept awake"
