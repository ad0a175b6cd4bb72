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
from touchfield.devices import device
from touchfield.devices.drivers.registry import (
    Check,
    DeviceKind,
    array_kinds,
    library_check,
    point_device,
    point_kinds,
    require_device,
)
from touchfield.errors import DeviceError, InvalidArgument, MissingExtra
from touchfield.filters.limit import limit_forces
from touchfield.filters.registry import field_filters
from touchfield.filters.resample import resample
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.pipeline.comparison import compare
from touchfield.pipeline.encoding import encode
from touchfield.pipeline.spec import EncodeSpec
from touchfield.render.player import Player
from touchfield.render.readiness import Readiness
from touchfield.render.spec import delay_s_of
from touchfield.sources.laws import ForceProfile
from touchfield.tasks.measure import MeasureSpec, measure_medium

_MIN_SHARED_BYTES: Final = 1 << 28
_DELAY_S: Final = 5.0
_DELAY_POLL_S: Final = 0.05
LIBRARIES: Final = (
    ("numpy", "numpy", "", "everything"),
    ("scipy", "scipy", "", "sources and measures"),
    ("aiohttp", "aiohttp", "", "serve, live and play --bridge"),
    ("numba", "numba", "sources", "sources, filters and measures"),
    ("matplotlib", "matplotlib", "report", "pictures, and sample:terrain"),
    ("scikit-image", "skimage", "motorcycle", "sample:motorcycle"),
    ("mujoco-core", "mujoco", "physics", "simulated bodies"),
    ("pycollada", "collada", "meshes", "meshes in COLLADA"),
    ("lib3mf", "lib3mf", "meshes", "meshes in 3MF"),
    ("av", "av", "video", "depth video and video"),
    ("mcap", "mcap", "mcap", "recordings of robots, and logs for Foxglove"),
    ("rerun-sdk", "rerun", "rerun", "view --rerun"),
    ("raptorq", "raptorq", "broadcast", "live by UDP"),
    ("mcap-ros2-support", "mcap_ros2", "mcap", "ROS 2 bags"),
    ("rosbags", "rosbags", "ros1", "ROS 1 bags, also of RealSense"),
    ("opencv-python-headless", "cv2", "camera", "cameras, and lens distortion"),
    ("openexr", "OpenEXR", "exr", "depth in EXR"),
    ("websockets", "websockets", "devices", "haply and bhaptics"),
    ("pyserial", "serial", "devices", "pin displays on a serial line"),
)
"""Distribution, module, extra ("" is the core), purpose."""


def examine(name: str | None = None, measures_delay: bool = False) -> dict[str, list[Check]]:
    """Check the libraries, the machine, and each device; or only the device `name`.

    `name` may name a unit, such as "haply:HOST:PORT/ID". With `measures_delay` it is opened, and the delay of
    its loop is measured without a force. Raises InvalidArgument if there is no such device, or its delay
    cannot be measured.
    """
    if measures_delay and name is None:
        raise InvalidArgument("--delay", "no --device", "the device whose delay is to be measured")
    kinds = {kind.name: kind for kind in (*point_kinds(), *array_kinds())}
    if name is None:
        devices = {known: device_checks(kind) for known, kind in kinds.items()}
        return {"libraries": library_checks(), "machine": host_checks(), **devices}
    kind_name, _, rest = name.strip().partition(":")
    kind = kinds.get(kind_name.lower())
    if kind is None:
        raise InvalidArgument("device", repr(name[:80]), f"one of {', '.join(kinds)}")
    if rest:
        require_device(name)
    checks = device_checks(kind, rest)
    if measures_delay:
        checks.append(delay_check(name.strip(), kind))
    return {kind.name: checks}


def device_checks(kind: DeviceKind, rest: str = "") -> list[Check]:
    """Check the requirements of a kind of device and the state of its units.

    Units are looked for at `rest`, or at the default address if all requirements are met.
    """
    checks = kind.checks()
    if kind.settings:
        settings = ", ".join(f"{setting.name}={setting.form}" for setting in kind.settings)
        checks.append(Check("settings (play --settings)", True, settings))
    if kind.find_units is None or not (rest or all(check.is_there for check in checks)):
        return checks
    try:
        units = kind.find_units(rest)
    except (DeviceError, MissingExtra) as error:
        return [*checks, Check("units", False, error.found, error.hint)]
    if not units:
        return [*checks, Check("units", False, "none connected", "Plug one in.")]
    return [
        *checks,
        *(Check(f"unit {unit.unit}".strip(), unit.is_ready, unit.details, unit.hint) for unit in units),
    ]


def delay_check(device_text: str, kind: DeviceKind) -> Check:
    """Open a point device, measure the delay of its loop without a force, and compare it with the profile.

    Raises InvalidArgument for an array and a simulated hand, which have none.
    """
    if kind.is_array or kind.is_simulated or kind.profile is None:
        raise InvalidArgument("--delay", kind.name, "a device with a position and a force of its own")
    profile, subject = device(kind.profile), "delay from position to force"
    stated = "no delay, 1 ms is assumed" if profile.delay_ms is None else f"{profile.delay_ms:g} ms"
    choice, seconds = point_device(device_text), 0.0
    try:
        medium = HapticMedium.from_frames([_solid()], 1.0)
        with Player(medium, profile, choice.opener, wait_s=_DELAY_S) as player:
            while player.statistics()["delay_p90_us"] is None and not player.wait(_DELAY_POLL_S):
                seconds += _DELAY_POLL_S
                if seconds > _DELAY_S:
                    raise DeviceError(kind.name, f"no tick for {_DELAY_S:g} s", "a loop that runs")
            figures = player.statistics()
    except (DeviceError, MissingExtra) as error:
        return Check(subject, False, error.found, error.hint)
    slow_ms, median_ms = (1e-3 * figures[f"delay_{name}_us"] for name in ("p90", "p50"))
    found = f"{slow_ms:.3g} ms in nine of ten ticks, {median_ms:.3g} ms in the median; {profile.name} states"
    is_enough = 1e-3 * figures["delay_used_us"] <= 1e3 * delay_s_of(profile) * 1.02
    hint = "Stability is chosen for the measured delay. Close other programs, or state it in the profile."
    return Check(subject, is_enough, f"{found} {stated}", hint)


def connected_units() -> dict[str, list[Readiness]]:
    """Return the state of the units that are connected, by the name of their kind of device.

    A kind whose library or service is not there has none.
    """
    found: dict[str, list[Readiness]] = {}
    for kind in (*point_kinds(), *array_kinds()):
        if kind.find_units is None:
            continue
        try:
            found[kind.name] = kind.find_units("")
        except (DeviceError, MissingExtra):
            found[kind.name] = []
    return found


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
