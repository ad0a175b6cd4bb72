"""`touchfield doctor`: what is installed, what is missing, and one line each on how to mend it."""

from __future__ import annotations

import os
import platform
import shutil
import sys
import time
from pathlib import Path
from typing import Final

from touchfield.adapters.array_registry import array_kinds
from touchfield.adapters.check import Check, library_check
from touchfield.adapters.point_registry import point_kinds
from touchfield.errors import InvalidArgument
from touchfield.parallel import worker_count

__all__ = ["examine", "host_checks", "library_checks", "sleep_lateness_us"]

LIBRARIES: Final = (
    ("numpy", "numpy", "", "everything"),
    ("scipy", "scipy", "", "sources and measures"),
    ("numba", "numba", "", "compiled kernels"),
    ("matplotlib", "matplotlib", "report", "pictures, and sample:terrain"),
    ("scikit-image", "skimage", "motorcycle", "sample:motorcycle"),
    ("mujoco-core", "mujoco", "physics", "simulated bodies"),
    ("av", "av", "video", "depth video and video"),
    ("mcap", "mcap", "mcap", "recordings of robots"),
    ("websockets", "websockets", "devices", "haply and bhaptics"),
    ("pyserial", "serial", "devices", "pin displays on a serial line"),
)
"""Distribution, module, extra (none: the core), what it is for."""

_LEAST_SHARED_BYTES: Final = 1 << 28
_SLEEPS: Final = 200
_TICK_S: Final = 1e-3


def examine(name: str | None = None) -> dict[str, list[Check]]:
    """What is there, by what it is for: the libraries, the machine, and each device; or one device alone.

    Raises
    ------
    InvalidArgument
        If there is no such device.
    """
    kinds = {kind.name: kind.checks for kind in point_kinds()} | {kind.name: kind.checks for kind in array_kinds()}
    if name is None:
        devices = {known: checks() for known, checks in kinds.items()}
        return {"libraries": library_checks(), "machine": host_checks(), **devices}
    wanted = name.strip().partition(":")[0].lower()
    if wanted not in kinds:
        raise InvalidArgument("--device", repr(name[:80]), f"one of {', '.join(kinds)}")
    return {wanted: kinds[wanted]()}


def library_checks() -> list[Check]:
    """The libraries that touchfield needs, and those of its extras; none is imported."""
    found = [Check("python", sys.version_info >= (3, 11), platform.python_version(), "Install Python 3.11 or newer.")]
    return found + [library_check(name, extra, module, purpose) for name, module, extra, purpose in LIBRARIES]


def host_checks() -> list[Check]:
    """What the machine gives a loop of 1 kHz; takes a quarter of a second."""
    cores = worker_count()
    checks = [
        Check("two cores, one of them for the servo", cores > 1, f"{cores}", "Allow the process a second core.")
    ]
    checks += [_realtime(), _awake(), _locked_memory(), _shared_memory(), _kernel_cache()]
    late = sleep_lateness_us()
    mend = "Close other programs, or take a machine that is not shared; see also SCHED_FIFO above."
    what = "sleeps at normal priority end in time (99 % within 0.5 ms)"
    checks.append(Check(what, late <= 500, f"{late:.0f} us late", mend))
    return checks


def sleep_lateness_us() -> float:
    """By how much the worst but 1 % of 200 sleeps of 1 ms end late, microseconds."""
    late = []
    for _ in range(_SLEEPS):
        began = time.perf_counter()
        time.sleep(_TICK_S)
        late.append(time.perf_counter() - began - _TICK_S)
    return 1e6 * sorted(late)[int(0.99 * _SLEEPS)]


def _realtime() -> Check:
    what = "SCHED_FIFO, the scheduling class that keeps the servo in time"
    if not hasattr(os, "sched_setscheduler"):
        return Check(what, False, f"{platform.system()} has none", "The servo runs at normal priority.")
    before, beside = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    except OSError as error:
        mend = (
            "Add '@realtime - rtprio 80' to /etc/security/limits.conf and yourself to that group; it works without."
        )
        return Check(what, False, error.strerror or str(error), mend)
    os.sched_setscheduler(0, before, beside)
    return Check(what, True, "allowed")


def _awake() -> Check:
    what = "processors that stay awake while the servo runs"
    latency = Path("/dev/cpu_dma_latency")
    if not latency.exists():
        return Check(what, False, f"no {latency}", "The servo runs without it.")
    mend = f"It works without; to have it, let your user write to {latency} (a udev rule)."
    return Check(what, os.access(latency, os.W_OK), "allowed" if os.access(latency, os.W_OK) else "not allowed", mend)


def _locked_memory() -> Check:
    what = "locked memory, so that no tick waits for a page"
    try:
        import resource
    except ImportError:
        return Check(what, False, f"{platform.system()} has no such limit to ask", "The servo runs without it.")
    soft, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    enough = soft == resource.RLIM_INFINITY or soft >= _LEAST_SHARED_BYTES or os.geteuid() == 0
    told = "no limit" if soft == resource.RLIM_INFINITY else f"up to {soft / 2**20:.0f} MiB"
    return Check(what, enough, told, "Add '@realtime - memlock unlimited' to /etc/security/limits.conf.")


def _shared_memory() -> Check:
    what = "shared memory of 256 MiB for decoded frames"
    folder = Path("/dev/shm")
    if not folder.is_dir():
        return Check(what, True, "managed by the system")
    free = shutil.disk_usage(folder).free
    mend = "Free some of /dev/shm, or enlarge it (mount -o remount,size=1G /dev/shm)."
    return Check(what, free >= _LEAST_SHARED_BYTES, f"{free / 2**20:.0f} MiB free", mend)


def _kernel_cache() -> Check:
    what = "a folder in which compiled kernels are kept"
    named = os.environ.get("NUMBA_CACHE_DIR")
    folder = Path(named) if named else Path(__file__).parent
    is_kept = os.access(folder, os.W_OK)
    fallback = Path.home() / ".cache"
    if not is_kept and not named and os.access(fallback if fallback.exists() else Path.home(), os.W_OK):
        return Check(what, True, "in the user's cache folder")
    return Check(
        what, is_kept, "writeable" if is_kept else "not writeable", "Set NUMBA_CACHE_DIR to a folder of yours."
    )
