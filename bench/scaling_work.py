"""Runs one operation on media of growing size for `bench_scaling`, and prints a line of JSON for each.

    python bench/scaling_work.py OPERATION AXIS FOLDER SIZE...

Processor time is that of all threads; the operation runs once beforehand, so that kernels are compiled and
loaded. That of `play` is the time of a number of ticks, without opening the medium.
Memory is the largest resident memory during a run, less that before it. Files that an operation reads are
made in FOLDER where they are missing; making them is not measured.
"""

from __future__ import annotations

import ctypes
import gc
import json
import os
import re
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bench_library import KINDS, fill_folder
from machine import Figures
from scaling_media import SETTINGS
from touchfield.devices import device
from touchfield.medium import ForceField
from touchfield.pipeline.comparison import compare
from touchfield.pipeline.encoding import encode
from touchfield.pipeline.preparation import prepare
from touchfield.pipeline.source import decode
from touchfield.render.offline import run_offline
from touchfield.render.point_device import Point, PointDevice
from touchfield.render.spec import RenderSpec
from touchfield.tasks.library import index_folder, search
from touchfield.tasks.measure import measure_medium

Run = Callable[[], Figures]
"""An operation with its input; returns what describes the medium."""

TICKS, TICKS_OF_FRAMES, FIRST_TICK = 40_000, 4000, 100
"""Ticks that are measured on a medium of one frame and on others, and the number of the first of them."""
NEAR_M, STOPS, STEP_M = 0.02, 32, 1e-4
"""A hand goes to so many places with a force, this near to the middle, in steps of `STEP_M`."""
SHORT_S, REPEATS = 1.0, 4
"""A run that takes less processor time is repeated so often."""
MEDIA: Final = 640
SEARCHES: Final = 4


# -- operations --------------------------------------------------------------------------------------------


def encoding(axis: str, size: float, folder: Path) -> Run:
    """Encode the medium, which the scene makes."""
    setting = SETTINGS[axis](size)
    scene, spec = setting.scene(), setting.spec(folder)

    def run() -> Figures:
        done = encode(scene, _file(axis, size, folder), spec)
        return {"supported_voxels": done.supported_voxels, "file_bytes": done.file_bytes}

    return run


def decoding(axis: str, size: float, folder: Path) -> Run:
    """Decode every frame."""
    path = encoded(axis, size, folder)
    return lambda: {"supported_voxels": sum(frame.support_count for frame in decode(path))}


def comparing(axis: str, size: float, folder: Path) -> Run:
    """Compare the file with its scene."""
    path, scene = encoded(axis, size, folder), SETTINGS[axis](size).scene()
    return lambda: {"supported_voxels": compare(scene, path).summary()["supported_voxels"]}


def measuring(axis: str, size: float, folder: Path) -> Run:
    """Measure entropies, coding limits and passivity."""
    path = encoded(axis, size, folder)
    return lambda: {"supported_voxels": measure_medium(path).supported_voxels}


def indexing(axis: str, size: float, folder: Path) -> Run:
    """Describe the files of a folder: many, or one with the medium."""
    index = folder / "new.index.npz"
    index.unlink(missing_ok=True)
    if axis == "media":
        files, figures = media_folder(round(size), folder), {}
    else:
        path, files = encoded(axis, size, folder), folder / f"only {axis} {size:g}"
        figures = {"supported_voxels": decode(path)[0].support_count}
        if not files.exists():
            files.mkdir()
            (files / path.name).hardlink_to(path)
    return lambda: {"media": index_folder(files, index).figures["described"], **figures}


def searching(axis: str, size: float, folder: Path) -> Run:
    """Search a folder for media like one of its files, a few times."""
    files = library_folder(round(size), folder)
    like = files / "kind00-0.touch"

    def run() -> Figures:
        for _ in range(SEARCHES):
            found = search(files, like)
        return {"media": found.figures["media"]}

    return run


def fusing(axis: str, size: float, folder: Path) -> Run:
    """Fuse all pictures of a depth camera into one field."""
    setting = SETTINGS[axis](size)
    scene, spec = setting.scene(), setting.spec(folder)
    return lambda: {"supported_voxels": prepare(scene, spec).medium[0].support_count}


def composing(axis: str, size: float, folder: Path) -> Run:
    """Encode bodies as objects, and make the voxels of every frame from the file."""
    encode_objects, path = encoding(axis, size, folder), _file(axis, size, folder)

    def run() -> Figures:
        encode_objects()
        return {"supported_voxels": sum(frame.support_count for frame in decode(path))}

    return run


def playing(axis: str, size: float, folder: Path) -> Run:
    """Play the file in a loop to a simulated device that moves through the forces.

    The figures have the processor seconds from one tick to a later one, in place of those of the whole run.
    """
    medium = decode(encoded(axis, size, folder))
    first_frame = medium[0]
    path_m, voxels = hand_path_m(first_frame), first_frame.support_count
    ticks = TICKS_OF_FRAMES if len(medium) > 1 else TICKS

    def run() -> Figures:
        moved = MovedDevice(path_m)
        run_offline(
            medium, device("phantom-omni"), lambda: moved, RenderSpec(up="lattice"),
            seconds=1e-3 * (FIRST_TICK + ticks + 1), loop=True,
        )  # fmt: skip
        seconds = moved.times_s[FIRST_TICK + ticks] - moved.times_s[FIRST_TICK]
        return {"cpu_s": seconds, "supported_voxels": voxels}

    return run


OPERATIONS: Final[dict[str, Callable[..., Run]]] = {
    "encode": encoding, "decode": decoding, "compare": comparing, "measure": measuring, "index": indexing,
    "search": searching, "fuse": fusing, "objects": composing, "play": playing,
}  # fmt: skip


class MovedDevice(PointDevice):
    """A device that moves along a closed path, float64 [n, 3], metres, whatever the force.

    `times_s` are the processor seconds at each tick.
    """

    def __init__(self, path_m: NDArray[np.float64]) -> None:
        self._path: list[Point] = [(x, y, z) for x, y, z in path_m.tolist()]
        self.times_s: list[float] = []

    def open(self) -> None:
        pass

    def position_m(self) -> Point:
        self.times_s.append(time.process_time())
        return self._path[len(self.times_s) % len(self._path)]

    def put_force_n(self, x: float, y: float, z: float) -> None:
        pass

    def close(self) -> None:
        pass

    def advance(self, dt_s: float) -> None:
        """Take notice of a tick of an offline run."""


def hand_path_m(field: ForceField) -> NDArray[np.float64]:
    """Return a closed path through places with a force near the middle, float64 [n, 3], metres."""
    points = np.asarray(field.grid.to_m(field.positions()))
    points = points[np.linalg.norm(points, axis=1) < NEAR_M]
    stops = points[np.random.default_rng(0).choice(len(points), STOPS)]
    stops = stops[np.argsort(np.arctan2(stops[:, 1], stops[:, 0]))]
    legs = []
    for start, stop in zip(stops, np.roll(stops, -1, axis=0), strict=True):
        steps = max(1, round(float(np.linalg.norm(stop - start)) / STEP_M))
        legs.append(start + (stop - start) * np.linspace(0, 1, steps, endpoint=False)[:, None])
    return np.concatenate(legs)


# -- files that operations read ----------------------------------------------------------------------------


def _file(axis: str, size: float, folder: Path) -> Path:
    return folder / f"{axis} {size:g}.touch"


def encoded(axis: str, size: float, folder: Path) -> Path:
    """Return the file of a medium; it is made if it is missing."""
    path = _file(axis, size, folder)
    if not path.exists():
        encoding(axis, size, folder)()
    return path


def media_folder(count: int, folder: Path) -> Path:
    """Return a folder of `count` different small files, links to the first of `MEDIA`."""
    every, files = folder / "media", folder / f"media {count}"
    if not every.exists():
        every.mkdir()
        fill_folder(every, MEDIA)
    if not files.exists():
        files.mkdir()
        for path in sorted(every.rglob("*.touch"), key=lambda path: path.name.rpartition("-")[2])[:count]:
            (files / path.name).hardlink_to(path)
    return files


def library_folder(count: int, folder: Path) -> Path:
    """Return an indexed folder of `count` files, which are links to those of `KINDS` media.

    An index takes the descriptor of a file with the same bytes, so that the media are described once.
    """
    files = folder / f"library {count}"
    if files.exists():
        return files
    files.mkdir()
    originals = sorted(media_folder(KINDS, folder).rglob("*.touch"))
    for copy in range(count // KINDS):
        for kind, original in enumerate(originals):
            (files / f"kind{kind:02}-{copy}.touch").hardlink_to(original)
        if copy == 0:
            index_folder(files)
    index_folder(files)
    return files


# -- measuring ---------------------------------------------------------------------------------------------


def resident_mb(name: str) -> float:
    """Return a figure of this process's memory, "VmRSS" or its peak "VmHWM"; NaN without /proc."""
    status = Path("/proc/self/status")
    found = re.search(rf"{name}:\s*(\d+) kB", status.read_text()) if status.exists() else None
    return 1024 * int(found[1]) / 1e6 if found else float("nan")


def settled_mb() -> float:
    """Return the resident memory once what was freed is back with the system, megabytes."""
    gc.collect()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # of glibc
    if trim is not None:
        trim(0)
    return resident_mb("VmRSS")


def measure(operation: str, axis: str, folder: Path, sizes: list[float]) -> None:
    """Print a line for each size: processor seconds, megabytes, and figures of the medium.

    The first size runs once more beforehand, so that kernels are compiled and loaded. A short run is repeated
    and the shortest time counts, because other programs disturb it.
    """
    make = OPERATIONS[operation]
    make(axis, sizes[0], folder)()
    for size in sizes:
        measured = measured_run(make(axis, size, folder))
        for _ in range(REPEATS if measured["cpu_s"] < SHORT_S else 0):
            again = measured_run(make(axis, size, folder))
            measured["cpu_s"] = min(measured["cpu_s"], again["cpu_s"])
        print(json.dumps({"size": size, **measured}), flush=True)


def measured_run(run: Run) -> Figures:
    """Return processor seconds, the megabytes of the peak above those before the run, and its figures."""
    before_mb = settled_mb()
    if os.access("/proc/self/clear_refs", os.W_OK):
        Path("/proc/self/clear_refs").write_text("5")  # the peak is that of the run alone
    start_s = time.process_time()
    figures = run()
    seconds = time.process_time() - start_s
    return {"cpu_s": seconds, "peak_mb": resident_mb("VmHWM") - before_mb, **figures}


def main() -> None:
    operation, axis, folder, *sizes = sys.argv[1:]
    measure(operation, axis, Path(folder), list(map(float, sizes)))


if __name__ == "__main__":
    main()
