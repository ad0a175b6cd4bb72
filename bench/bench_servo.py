"""Measures the servo loop, which renders forces at 1 kHz or more: rate, jitter, lateness and missing frames,
by scheduling and load.

    python bench/bench_servo.py [--quick] [--seconds 150] [--others 45] [--deaths 10]

A turning body of 64^3 voxels at 30 frames per second is decoded ahead from a file (effort fast) and looped.
The device is simulated: it reports positions on a circle through the body. Each row is a separate run with a
scheduling class (SCHED_FIFO or normal), a tick rate, and a load: "loaded" runs as many busy processes as
cores. `--seconds` is the duration of the first row, `--others` that of the other rows.

The jitter is |dT - 1/rate|. The lateness is the delay from the absolute deadline of a tick to its start. A
tick whose deadline is missed by a period or more is left out ("missed"), and lowers the mean rate. "empty_"
are the figures of a loop in another process that only sleeps until its deadlines, at the same time, at the
same rate and in the same scheduling class: the share of the system, which the bars do not count. With
SCHED_FIFO both run on one processor, because a hypervisor halts processors one by one.
"stolen" is the fraction of processor time withheld from a virtual machine. "seeks" are the times from a seek
to the first force when nothing is decoded ahead, to each frame of the segments once: those that the servo
waits, and the processor time of decoding and writing the frames. "deaths" are the times from a signal that
kills or stops the servo until its standby has set zero force on a device that still has the servo's.
"""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from machine import Bar, Figures, at_most, bench, figure
from touchfield.codec.touch.spec import TouchSpec
from touchfield.compute.threads import worker_count
from touchfield.devices import device
from touchfield.errors import DeviceError
from touchfield.medium import HapticMedium, PoseTrack
from touchfield.pipeline import encode
from touchfield.pipeline.decoding import open_file
from touchfield.pipeline.spec import EncodeSpec
from touchfield.render.feeder import FrameSource
from touchfield.render.offline import run_offline
from touchfield.render.player import Player
from touchfield.render.point_device import Point, PointDevice
from touchfield.render.spec import RenderSpec
from touchfield.sources.mesh.mesh_scene import MeshScene
from touchfield.sources.physics.body_scene import BodyScene
from touchfield.sources.scene import Body

FRAMES, FRAME_RATE_HZ = 60, 30.0
STRIDE = 37
"""From the frame of a seek to that of the next: prime to the number of frames, and into another segment."""

MAX_START_S = 60.0
"""Time for the processes to start, s: the log holds so much more than the time of the empty loop."""

MAX_BEYOND_EMPTY_US = 100.0
"""Of the lateness beyond that of an empty loop: a tenth of a tick."""

PROFILE = device("phantom-omni")

ROWS = (
    ("SCHED_FIFO, idle", 1000.0, True, False),
    ("SCHED_FIFO, loaded", 1000.0, True, True),
    ("normal, idle", 1000.0, False, False),
    ("normal, loaded", 1000.0, False, True),
    ("SCHED_FIFO, idle, 5 kHz", 5000.0, True, False),
)


DEATHS = (
    ("death", "SIGKILL", False),
    ("death, loaded", "SIGKILL", True),
    ("hang", "SIGSTOP", False),
)


EMPTY = """
import array, ctypes, gc, os, sys, time
seconds, period_ns, is_realtime = float(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
try:
    ctypes.CDLL(None).prctl(29, 1, 0, 0, 0)
    if is_realtime:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(50))
except (AttributeError, OSError):
    pass
gc.disable()
now = time.perf_counter_ns
began = now()
times, deadline, ticks = array.array("q", bytes(8 * int(1e9 * seconds / period_ns + 2))), began + period_ns, 1
times[0] = began
while deadline - began < 1e9 * seconds:
    at = now()
    while at < deadline:
        time.sleep(1e-9 * (deadline - at))
        at = now()
    times[ticks] = at
    ticks += 1
    deadline += period_ns * max(1, -(-(at - deadline) // period_ns))
sys.stdout.buffer.write(times[:ticks].tobytes())
"""

PERCENTILES = {"p50": 50.0, "p99": 99.0, "p99_9": 99.9, "worst": 100.0}


class Circle(PointDevice):
    """A device that moves on a circle, whatever the force."""

    def __init__(self) -> None:
        self._angle = 0.0

    def open(self) -> None:
        pass

    def position_m(self) -> Point:
        self._angle += 0.006
        return 0.03 * math.cos(self._angle), 0.03 * math.sin(self._angle), 0.0

    def put_force_n(self, x: float, y: float, z: float) -> None:
        pass

    def close(self) -> None:
        pass


class RecordedCircle(Circle):
    """The same circle; it writes the time and size of each force into a file, and stays at its force."""

    has_force_at_open = True

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._file = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT)

    def put_force_n(self, x: float, y: float, z: float) -> None:
        os.write(self._file, b"%d %.17g\n" % (time.perf_counter_ns(), math.hypot(x, y, z)))


class SimulatedCircle(Circle):
    """The same circle for an offline run, driven by its ticks."""

    def advance(self, dt_s: float) -> None:
        pass


def write_medium(path: Path) -> None:
    """Write a tetrahedron that turns once in 2 s, as voxels."""
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], float)
    faces = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])
    turns = Rotation.from_euler("xyz", np.outer(np.arange(FRAMES), [2 * math.pi / FRAMES, 0, 0]))
    track = PoseTrack(turns.as_quat()[:, [3, 0, 1, 2]], np.zeros((FRAMES, 3)))
    scene = BodyScene((Body("tetrahedron", MeshScene(corners, faces), track),), FRAME_RATE_HZ)
    encode(scene, path, EncodeSpec(nw=6, representation="voxel", touch=TouchSpec(effort="fast")))


def cpu_s(pid: int | None) -> float:
    """Return the processor seconds of a process so far.

    NaN where the system does not report them.
    """
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError, IndexError):
        return math.nan


def keep_busy(stack: ExitStack) -> None:
    """Run as many busy processes as cores until the end of a context."""
    for _ in range(worker_count()):
        busy = stack.enter_context(subprocess.Popen([sys.executable, "-c", "while True: pass"]))
        stack.callback(busy.kill)


def run(
    medium: HapticMedium, seconds: float, rate_hz: float, is_realtime: bool, is_loaded: bool
) -> dict[str, Any]:
    """Return the statistics of one run, the servo's fraction of a core, and the times of an empty loop."""
    with ExitStack() as stack:
        if is_loaded:
            keep_busy(stack)
        spec, rows = RenderSpec(rate_hz=rate_hz), round((seconds + MAX_START_S) * rate_hz)
        player = stack.enter_context(
            Player(medium, PROFILE, Circle, spec, loop=True, log_rows=rows, is_realtime=is_realtime)
        )
        player.play()
        empty = stack.enter_context(empty_loop(seconds, rate_hz, is_realtime))
        if is_realtime and player.servo_pid is not None:
            share_processor(player.servo_pid, empty.pid)
        began, cpu = time.monotonic(), cpu_s(player.servo_pid)
        player.wait(seconds)
        core_fraction = (cpu_s(player.servo_pid) - cpu) / (time.monotonic() - began)
        empty_ns = np.frombuffer(empty.communicate()[0], np.int64)
        first_ns = time.perf_counter_ns() - round(1e9 * player.statistics()["seconds"])  # within a tick
        statistics, ticks_ns = player.statistics(), np.rint(1e9 * player.log()["time_s"]).astype(np.int64)
    beside = punctuality(empty_ns - empty_ns[0], (0, empty_ns[-1] - empty_ns[0]), rate_hz)
    return {
        **statistics,
        **punctuality(ticks_ns, (empty_ns[0] - first_ns, empty_ns[-1] - first_ns), rate_hz),
        **{f"empty_{key}": value for key, value in beside.items()},
        "servo_core_share": core_fraction,
    }


def share_processor(*processes: int) -> None:
    """Bind processes to one of the processors, where the system can."""
    if hasattr(os, "sched_setaffinity"):
        for process in processes:
            os.sched_setaffinity(process, {min(os.sched_getaffinity(0))})


def punctuality(elapsed_ns: NDArray[np.int64], span_ns: tuple[int, int], rate_hz: float) -> dict[str, float]:
    """Return lateness, missed ticks and mean rate of a loop between two times since its first tick.

    `elapsed_ns` are the times of the ticks since the first one. The deadlines are multiples of the period:
    that of a tick is the first one after the tick before.
    """
    period_ns = round(1e9 / rate_hz)
    before_ns, ticks_ns = elapsed_ns[:-1], elapsed_ns[1:]
    late_us = 1e-3 * (ticks_ns - period_ns * (before_ns // period_ns + 1))
    is_inside = (ticks_ns >= span_ns[0]) & (ticks_ns <= span_ns[1])
    late_us, inside_ns = late_us[is_inside], ticks_ns[is_inside]
    duration_ns = int(inside_ns[-1] - inside_ns[0])
    return {
        **{f"lateness_{name}_us": float(np.percentile(late_us, q)) for name, q in PERCENTILES.items()},
        "missed_ticks": round(duration_ns / period_ns) + 1 - len(inside_ns),
        "mean_rate_hz": 1e9 * (len(inside_ns) - 1) / duration_ns,
    }


def stolen_s() -> float:
    """Return the steal time of a virtual machine so far, s; 0 if it is not reported."""
    try:
        return int(Path("/proc/stat").read_text().split("\n", 1)[0].split()[8]) / os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError, IndexError):
        return 0.0


def empty_loop(seconds: float, rate_hz: float, is_realtime: bool) -> subprocess.Popen[bytes]:
    """Start an empty loop in a process of its own, which prints the times of its ticks, int64 ns."""
    arguments = (str(seconds), str(round(1e9 / rate_hz)), str(int(is_realtime)))
    return subprocess.Popen([sys.executable, "-c", EMPTY, *arguments], stdout=subprocess.PIPE)


def seeks(medium: HapticMedium, count: int) -> dict[str, float]:
    """Return milliseconds from a seek to the first force, with nothing decoded ahead."""
    waited_ms = []
    frames = [STRIDE * n % FRAMES for n in range(count)]
    with Player(medium, PROFILE, Circle, loop=True, log_rows=0) as player:
        player.play()
        player.wait(0.2)
        before = player.statistics()["waiting_ticks"]
        for frame in frames:
            player.seek((frame + 0.1) / FRAME_RATE_HZ)
            player.wait(0.4)
            after = player.statistics()["waiting_ticks"]
            waited_ms.append(float(after - before))
            before = after
    processor_ms = [seek_processor_ms(medium, frame) for frame in frames]
    return {
        **dict(zip(("median_ms", "p99_ms", "worst_ms"), np.percentile(waited_ms, (50, 99, 100)).tolist())),
        "min_ms": min(waited_ms),
        "processor_median_ms": float(np.median(processor_ms)),
        "processor_worst_ms": max(processor_ms),
    }


def seek_processor_ms(medium: HapticMedium, frame: int) -> float:
    """Return the processor time of the two frames that a seek needs, ms."""
    source = FrameSource(medium)
    source.prepare((frame + FRAMES // 2) % FRAMES)  # in another segment
    began_s = time.thread_time()
    source.forget()
    for needed in (frame, (frame + 1) % FRAMES):
        source.prepare(needed)
    return 1e3 * (time.thread_time() - began_s)


def death_ms(medium: HapticMedium, name: str, is_loaded: bool, folder: Path) -> float:
    """Return milliseconds from a signal to the servo until its device has no force."""
    path = folder / f"forces-{time.perf_counter_ns()}"
    with ExitStack() as stack:
        player = stack.enter_context(Player(medium, PROFILE, partial(RecordedCircle, path), loop=True))
        player.play()
        servo = player._servo
        assert servo is not None
        while servo.standby is None or not servo.standby.is_ready:
            player.wait(0.01)
        if is_loaded:
            keep_busy(stack)
        player.wait(0.5)
        while not forces_of(path)[-1][1]:  # outside the body
            player.wait(0.01)
        assert player.servo_pid is not None
        signalled_ns = time.perf_counter_ns()
        os.kill(player.servo_pid, getattr(signal, name))
        with suppress(DeviceError):
            player.wait()
    ended_ns, force_n = forces_of(path)[-1]
    return math.nan if force_n else 1e-6 * (ended_ns - signalled_ns)


def forces_of(path: Path) -> list[tuple[int, float]]:
    """Return times, ns, and sizes, N, of the forces so far; a line that is being written is left out."""
    whole, _, _ = path.read_text().rpartition("\n")
    lines = (line.split() for line in whole.splitlines())
    return [(int(at_ns), float(force_n)) for at_ns, force_n in lines]


def measure_deaths(medium: HapticMedium, count: int, folder: Path) -> Figures:
    """Return the times from the servo's death, or hang, to zero force, ms."""
    figures: Figures = {}
    for row, name, is_loaded in DEATHS:
        times_ms = [death_ms(medium, name, is_loaded, folder) for _ in range(count)]
        figures[row] = {"median_ms": float(np.median(times_ms)), "worst_ms": float(np.max(times_ms))}
        print(f"{row} is measured", flush=True)
    return figures


def measure(seconds: float, others: float, offline: float, deaths: int, seek_count: int) -> Figures:
    """Measure the offline loop, every row beside an empty loop, seeks, and deaths."""
    figures: Figures = {"seconds": seconds, "others_seconds": others, "death_count": deaths}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "turning.touch"
        write_medium(path)
        with open_file(path) as stream:
            medium = stream.medium
            first_frame = medium.between(0, 1)
            run_offline(first_frame, PROFILE, SimulatedCircle, seconds=0.1)
            began = time.perf_counter()
            ticks = run_offline(first_frame, PROFILE, SimulatedCircle, seconds=offline).statistics["ticks"]
            figures["offline_us_per_tick"] = 1e6 * (time.perf_counter() - began) / ticks
            for name, rate_hz, is_realtime, is_loaded in ROWS:
                lasts_s, stolen = seconds if name == ROWS[0][0] else others, stolen_s()
                figures[name] = run(medium, lasts_s, rate_hz, is_realtime, is_loaded)
                figures[name]["stolen_share"] = (stolen_s() - stolen) / (lasts_s * worker_count())
                print(f"{name} is measured", flush=True)
            figures["seeks"] = seeks(medium, seek_count)
            figures["deaths"] = measure_deaths(medium, deaths, Path(folder))
    return figures


def beyond_empty_us(row: Figures, percentile: str) -> float | None:
    """Return the lateness of a row beyond that of the empty loop beside it, microseconds."""
    own, empty = row[f"lateness_{percentile}_us"], figure(row, f"empty_lateness_{percentile}_us")
    return None if empty is None else own - empty


def missing_beyond_empty(row: Figures) -> float | None:
    """Return the fraction of the ticks that a row lacks beyond that of the empty loop beside it."""
    empty_hz = figure(row, "empty_mean_rate_hz")
    return None if empty_hz is None else (empty_hz - row["mean_rate_hz"]) / row["rate_hz"]


def bars(figures: Figures) -> list[Bar]:
    """Require the requested rate, punctual ticks, no underruns, fast seeks, and a fast end of the force."""
    first = figures[ROWS[0][0]]
    idle = f"{ROWS[0][0]}: "
    underruns = sum(figures[name]["underruns"] for name, *_ in ROWS if name in figures)
    realtime = [name for name, _, is_realtime, _ in ROWS if is_realtime and name in figures]
    beyond = {name: beyond_empty_us(figures[name], "p99_9") for name in realtime}
    return [
        at_most(f"{idle}mean rate, below an empty loop's by", missing_beyond_empty(first), 1e-3),
        *(
            at_most(f"{name}: lateness, p99.9, beyond an empty loop's", late_us, MAX_BEYOND_EMPTY_US, "us")
            for name, late_us in beyond.items()
        ),
        at_most("underruns, all rows", underruns, 0),
        at_most("a tick without a clock", figures["offline_us_per_tick"], 1000.0, "us"),
        at_most("a seek to its first force, p99", figure(figures, "seeks", "p99_ms"), 50.0, "ms"),
        *(
            at_most(
                f"from the servo's {row} to zero force, worst",
                figure(figures, "deaths", row, "worst_ms"),
                100.0,
                "ms",
            )
            for row, *_ in DEATHS
        ),
    ]


if __name__ == "__main__":
    bench(
        "servo",
        __doc__,
        measure,
        bars,
        seconds=(150.0, 2.0),
        others=(45.0, 1.0),
        offline=(20.0, 2.0),
        deaths=(10, 1),
        seek_count=(FRAMES, 3),
    )
