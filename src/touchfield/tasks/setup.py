"""Checks the installation and suggests fixes (`touchfield doctor`), and compiles every inner loop before it
is needed (`touchfield warmup`)."""

from __future__ import annotations

import os
import platform
import shutil
import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

import numpy as np

from touchfield.codec.touch.spec import TouchSpec
from touchfield.compute.threads import Progress, silent, worker_count
from touchfield.devices.drivers.registry import Check, array_kinds, library_check, point_kinds
from touchfield.errors import InvalidArgument, MissingExtra
from touchfield.filters.limit import limit_forces
from touchfield.filters.registry import field_filters
from touchfield.filters.resample import resample
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.pipeline.comparison import compare
from touchfield.pipeline.encoding import encode
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.laws import ForceProfile
from touchfield.tasks.measure import MeasureSpec, measure_medium

_MIN_SHARED_BYTES: Final = 1 << 28
LIBRARIES: Final = (
    ("numpy", "numpy", "", "everything"),
    ("scipy", "scipy", "", "sources and measures"),
    ("numba", "numba", "sources", "sources, filters and measures"),
    ("matplotlib", "matplotlib", "report", "pictures, and sample:terrain"),
    ("scikit-image", "skimage", "motorcycle", "sample:motorcycle"),
    ("mujoco-core", "mujoco", "physics", "simulated bodies"),
    ("av", "av", "video", "depth video and video"),
    ("mcap", "mcap", "mcap", "recordings of robots"),
    ("mcap-ros2-support", "mcap_ros2", "mcap", "ROS 2 bags"),
    ("opencv-python-headless", "cv2", "camera", "cameras, and lens distortion"),
    ("openexr", "OpenEXR", "exr", "depth in EXR"),
    ("websockets", "websockets", "devices", "haply and bhaptics"),
    ("pyserial", "serial", "devices", "pin displays on a serial line"),
)
"""Distribution, module, extra ("" is the core), purpose."""


def examine(name: str | None = None) -> dict[str, list[Check]]:
    """Check the libraries, the machine, and each device; or only the device `name`.

    Raises InvalidArgument if there is no such device.
    """
    kinds = {kind.name: kind.checks for kind in point_kinds()} | {
        kind.name: kind.checks for kind in array_kinds()
    }
    if name is None:
        devices = {known: checks() for known, checks in kinds.items()}
        return {"libraries": library_checks(), "machine": host_checks(), **devices}
    kind_name = name.strip().partition(":")[0].lower()
    if kind_name not in kinds:
        raise InvalidArgument("device", repr(name[:80]), f"one of {', '.join(kinds)}")
    return {kind_name: kinds[kind_name]()}


def library_checks() -> list[Check]:
    """Check the libraries of touchfield and of its extras, without importing them."""
    python = Check(
        "python", sys.version_info >= (3, 11), platform.python_version(), "Install Python 3.11 or newer."
    )
    return [python] + [
        library_check(name, extra, module, purpose) for name, module, extra, purpose in LIBRARIES
    ]


def host_checks() -> list[Check]:
    """Check whether the machine is suitable for a loop of 1 kHz."""
    cores = worker_count()
    hint = "Allow the process a second core."
    checks = [Check("two cores, one of them for the servo", cores > 1, f"{cores}", hint), _realtime()]

    purpose, latency = "processors that stay awake while the servo runs", Path("/dev/cpu_dma_latency")
    is_allowed = os.access(latency, os.W_OK)
    found = "allowed" if is_allowed else "not allowed" if latency.exists() else f"no {latency}"
    hint = f"It works without; where it is there, let your user write to {latency} (a udev rule)."
    checks.append(Check(purpose, is_allowed, found, hint))

    purpose = "locked memory, so that no tick waits for a page"
    try:
        import resource
    except ImportError:
        found = f"{platform.system()} has no such limit to ask"
        checks.append(Check(purpose, False, found, "The servo runs without it."))
    else:
        soft, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
        is_endless = soft == resource.RLIM_INFINITY
        enough = is_endless or soft >= _MIN_SHARED_BYTES or os.geteuid() == 0
        found = "no limit" if is_endless else f"up to {soft / 2**20:.0f} MiB"
        checks.append(
            Check(purpose, enough, found, "Add '@realtime - memlock unlimited' to /etc/security/limits.conf.")
        )

    purpose, folder = "shared memory of 256 MiB for decoded frames", Path("/dev/shm")
    free = shutil.disk_usage(folder).free if folder.is_dir() else None
    found = "managed by the system" if free is None else f"{free / 2**20:.0f} MiB free"
    hint = "Free some of /dev/shm, or enlarge it (mount -o remount,size=1G /dev/shm)."
    checks.append(Check(purpose, free is None or free >= _MIN_SHARED_BYTES, found, hint))

    try:
        from touchfield.compute.jit import kernel_folder
    except MissingExtra:
        return checks  # nothing is compiled
    kernels, hint = kernel_folder(), "Set NUMBA_CACHE_DIR to a folder of yours."
    found = "not writeable" if kernels is None else f"{kernels}"
    return [*checks, Check("a folder for compiled kernels", kernels is not None, found, hint)]


def _realtime() -> Check:
    purpose = "SCHED_FIFO, the scheduling class that keeps the servo in time"
    if not hasattr(os, "sched_setscheduler"):
        return Check(purpose, False, f"{platform.system()} has none", "The servo runs at normal priority.")
    before, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    except OSError as error:
        hint = "Add '@realtime - rtprio 80' to /etc/security/limits.conf and yourself to that group"
        return Check(purpose, False, error.strerror or str(error), f"{hint}; it works without.")
    os.sched_setscheduler(0, before, parameters)
    return Check(purpose, True, "allowed")


def _solid() -> ForceField:
    """A solid with a wavy top, on a grid of three bricks along each axis."""
    x, y, z = np.indices((24, 24, 24), np.float32)
    depth = 18 + np.sin(x / 3) + np.cos(y / 4) - z
    steep = np.stack([-np.cos(x / 3) / 3, np.sin(y / 4) / 4, np.ones_like(z)], axis=-1)
    grid = Grid((24, 24, 24), (0.01,) * 3, (0.0,) * 3)
    return ForceField.from_dense(grid, np.clip(0.2 * depth, 0, 2)[..., None] * steep)


def _filters() -> None:
    for kind in field_filters().values():
        kind.parse(kind.example)(_solid())


def _measures() -> None:
    medium = HapticMedium.from_frames([_solid()] * 2, 30.0)
    measure_medium(medium, MeasureSpec(devices=("tshirt-32x32",)))


def _fusion() -> None:
    """What a depth sequence needs after its tangent planes, from a picture without any."""
    from touchfield.sources.depth.fused_scene import FusedVolume
    from touchfield.sources.depth.kernels.planes import SurfacePlanes

    grid = Grid((16, 16, 16), (0.01,) * 3, (0.0,) * 3)
    no_tiles = np.tile(np.array([0, 1e30], np.float32), (1, 1, 1))
    surface = SurfacePlanes((8, 8), np.ones(4, np.float32), np.zeros(4 * 65, np.float32), no_tiles)
    volume = FusedVolume(grid, ForceProfile(((-0.01, 0.0, 0.0, -100.0),)), 0.001)
    volume.add(np.argwhere(np.ones(grid.brick_shape)).astype(np.int32))
    volume.integrate(surface, np.eye(4))
    volume.field(volume.forces_n())
    limit_forces(resample(_solid(), grid), 1.0)


GROUPS: Final[Mapping[str, Callable[[], None]]] = {
    "filters": _filters,
    "measures": _measures,
    "fusion": _fusion,
}
"""Groups of kernels that are compiled together, each by a small run."""


def warm_up(report: Progress = silent) -> None:
    """Compile and cache every kernel by running the pipeline on tiny scenes."""
    from touchfield.sources.tiny_scenes import tiny_scenes

    scenes = tiny_scenes()
    jobs = [(scene, EncodeSpec(nw=3)) for scene in scenes]
    jobs += [(scenes[0], EncodeSpec(device="tshirt-32x32"))]
    jobs += [(scenes[-1], EncodeSpec(nw=3, representation="voxel", surface_damping_n_s_per_m=1.0))]
    jobs += [(scenes[1], EncodeSpec(nw=4, touch=touch)) for touch in (TouchSpec(), TouchSpec(mode="nmse"))]
    total = len(jobs) + len(GROUPS)
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "warm.touch"
        for i, (scene, spec) in enumerate(jobs):
            encode(scene, target, spec)
            compare(scene, target)
            report(i + 1, total)
    for i, group in enumerate(GROUPS.values()):
        group()
        report(len(jobs) + i + 1, total)
