"""Measures fields of seven moving objects, against SciPy: a whole frame, one force query, many queries.
Measures how the encoding of bodies scales.

    python bench/bench_objects.py [--quick] [--queries N] [--seconds N]

Seven rigid bodies tumble through a cube of 128 mm. Each has its own lattice of 30^3 to 64^3 samples. Three
things are timed: the voxel representation of a frame on 128^3 samples, one force query, and `--queries`
(10^6) queries at once. The peer is SciPy's `map_coordinates` (order 1) on the same fields as dense arrays,
with one call for each object and component; for a frame it evaluates only the samples within the box of each
object's lattice. Forces are compared.

Scaling: balls that touch their neighbours and a floor, and all move, are encoded four times with twice the
frames, and four times with twice the balls. The exponent is the slope of a straight line through the
logarithms of the processor times. Bodies at rest: the same balls move for half of the frames and rest for the
other half; processor time and bytes of the second half, relative to the first. At last 100 simulated bodies
are encoded from a scene file for `--seconds` (60) at 1 kHz by a process of its own.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from time import process_time
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from scipy.spatial.transform import Rotation

from machine import Bar, Figures, at_least, at_most, bench, column, figure, timed
from touchfield.codec.objects.encoder import ObjectsEncoder
from touchfield.codec.objects.error_bound import ComposedRule, Moves, Pair
from touchfield.codec.touch.spec import TouchSpec
from touchfield.compute.threads import worker_count
from touchfield.medium import ForceField, Grid, HapticMedium, HapticObject, HapticScene, PoseTrack
from touchfield.sources.laws import LawSpec, penalty
from touchfield.sources.shapes.analytic_scene import AnalyticScene
from touchfield.sources.shapes.shapes import Box, Sphere, Superquadric

HERE = Path(__file__).parent
Floats = NDArray[np.float64]
SIDES = (30, 36, 42, 48, 54, 60, 64)
SPACING_M = 0.001
FRAMES = 5
DOUBLINGS = 4
FULL_SECONDS = 60
"""Duration for which time, bytes and memory of 100 bodies have bars."""
PITCH_M = 0.011
"""Distance of the balls of a floor, whose radius is 6 mm."""

JOB = """
import json, sys, time
from peak_memory import peak_bytes
from touchfield import EncodeSpec, encode
done = encode(sys.argv[1], sys.argv[2], EncodeSpec(representation="object"))
summary = {key: done.summary()[key] for key in ("file_bytes", "encode_s", "frames", "objects")}
print(json.dumps({**summary, "cpu_s": time.process_time(), "peak_mb": peak_bytes() / 2**20}))
"""


def scene() -> HapticScene:
    """Return balls, boxes and superquadrics that tumble through a cube of 128 mm.

    They have the default penalty wall.
    """
    rng = np.random.default_rng(0)
    law, origin = penalty(LawSpec(), LawSpec().saturation_m), (0.0, 0.0, 0.0)
    objects = []
    for n, side in enumerate(SIDES):
        half = (side - 6) * SPACING_M / 2
        shapes = (
            Sphere(origin, half),
            Box(origin, (half, 0.8 * half, 0.6 * half)),
            Superquadric(origin, (half,) * 3, (0.5, 1.0)),
        )
        grid = Grid((side,) * 3, (SPACING_M,) * 3, (-(side - 1) * SPACING_M / 2,) * 3)
        field = AnalyticScene([shapes[n % 3]]).field(0, grid, law)
        track = PoseTrack(
            Rotation.random(FRAMES, random_state=n).as_quat(), rng.uniform(0.03, 0.098, (FRAMES, 3))
        )
        objects.append(HapticObject(f"object {n}", HapticMedium.from_frames([field], 1000.0), track))
    return HapticScene(Grid((128,) * 3, (SPACING_M,) * 3, (0.0,) * 3), 1000.0, tuple(objects), 3.3)


class Scipy:
    """The same scene by `map_coordinates`."""

    def __init__(self, of: HapticScene) -> None:
        self.scene = of
        self.components = [np.moveaxis(body.field(0).to_dense(), 3, 0).copy() for body in of.objects]

    def forces_n(self, frame: int, points_m: Floats) -> Floats:
        """Return newtons at points [n, 3].

        Each object is evaluated only where a point may lie within its lattice.
        """
        total = np.zeros(points_m.shape)
        for body, components in zip(self.scene.objects, self.components):
            grid: Grid = body.medium.grid
            index = grid.to_index(body.track.to_body(points_m, frame))
            is_inside = ((index > -1) & (index < grid.shape)).all(axis=1)
            where = index[is_inside].T
            forces = [
                map_coordinates(c, where, np.float64, order=1, mode="grid-constant") for c in components
            ]
            total[is_inside] += np.stack(forces, axis=1) @ body.track.rotation(frame).T
        length = np.linalg.norm(total, axis=1, keepdims=True)
        limited: Floats = total * np.minimum(1.0, self.scene.force_max_n / np.maximum(length, 1e-300))
        return limited

    def frame(self, frame: int) -> ForceField:
        """Return the voxelised frame."""
        grid = self.scene.grid
        points = grid.to_m(np.moveaxis(np.indices(grid.shape), 0, -1)).reshape(-1, 3)
        return ForceField.from_dense(grid, self.forces_n(frame, points).reshape(*grid.shape, 3))


def kernel_us(medium: HapticScene, point: Floats) -> float:
    """Return the microseconds of a query without the interpreter, on one thread.

    One point is repeated in a batch.
    """
    many = np.repeat(point[None], 2000, axis=0)  # too few for a second thread
    return timed(lambda: medium.sample_n(0, many), runs=200)["min_ms"] / len(many) * 1e3


# -- scaling -----------------------------------------------------------------------------------------------


class Coded(NamedTuple):
    """Processor seconds and bytes of an encoding."""

    cpu_s: float
    size_bytes: int


def touching(count: int, frames: int, moving: int) -> HapticScene:
    """Return balls in rows on a floor, which touch it and their neighbours.

    They slide and turn in the first `moving` frames, then they rest. The floor grows with their number.
    """
    law, origin, rng = penalty(LawSpec(), LawSpec().saturation_m), (0.0, 0.0, 0.0), np.random.default_rng(0)
    columns = 2 ** (count.bit_length() // 2)
    size = np.array([columns, -(-count // columns)]) * PITCH_M
    nx, ny = (int(length / SPACING_M) + 12 for length in size)
    world = Grid((nx, ny, 24), (SPACING_M,) * 3, (-0.011, -0.011, -0.008))
    ball = AnalyticScene([Sphere(origin, 0.006)]).field(
        0, Grid((18,) * 3, (SPACING_M,) * 3, (-0.0085,) * 3), law
    )
    half = (0.5 * nx * SPACING_M, 0.5 * ny * SPACING_M, 0.004)
    slab = Box((half[0] - 0.011, half[1] - 0.011, -0.004), half)
    floor = AnalyticScene([slab]).field(0, world, law)
    bodies = [HapticObject("floor", HapticMedium.from_frames([floor], 1000.0), PoseTrack.constant(frames))]
    t = np.minimum(np.arange(frames), moving)[:, None] / 1000
    for n in range(count):
        phase, turn_rad_s = rng.uniform(0, 2 * np.pi, 3), rng.normal(0, 3, 3)
        place = np.array([n % columns * PITCH_M, n // columns * PITCH_M, 0.005])
        track = PoseTrack(
            Rotation.from_rotvec(t * turn_rad_s).as_quat(scalar_first=True),
            place + 0.0005 * np.sin(20 * t + phase),
        )
        bodies.append(HapticObject(f"ball {n}", HapticMedium.from_frames([ball], 1000.0), track))
    return HapticScene(world, 1000.0, tuple(bodies), 3.3)


def coded(count: int, frames: int, moving: int | None = None) -> Coded:
    """Encode touching balls."""
    bodies = touching(count, frames, frames if moving is None else moving)
    start_s = process_time()
    encoder = ObjectsEncoder(bodies, TouchSpec(k=0.1, f0_n=0.05, effort="fast"), 0.05)
    size_bytes = sum(len(body.field) for body in encoder.objects())
    size_bytes += sum(len(body) for _, _, body in encoder.segments())
    return Coded(process_time() - start_s, size_bytes)


def exponent(counts: Iterable[int], seconds: Iterable[float]) -> float:
    """Return the slope of the logarithm of the seconds over that of the counts."""
    return float(np.polyfit(np.log(list(counts)), np.log(list(seconds)), 1)[0])


def scaling(frames: int, balls: int = 4) -> Figures:
    """Measure the exponents, from `frames` frames of `balls` balls, and from `balls` in half the frames."""
    factors = [2**n for n in range(DOUBLINGS + 1)]
    coded(1, 2)  # compile the kernels
    by_frames = [coded(balls, frames * factor) for factor in factors]
    by_balls = [coded(balls * factor, frames // 2) for factor in factors]
    half, whole = by_frames[-2], coded(balls, frames * factors[-1], frames * factors[-2])
    return {
        "frames_cpu_s": {str(frames * n): run.cpu_s for n, run in zip(factors, by_frames, strict=True)},
        "balls_cpu_s": {str(balls * n): run.cpu_s for n, run in zip(factors, by_balls, strict=True)},
        "exponent_frames": exponent(factors, [run.cpu_s for run in by_frames]),
        "exponent_balls": exponent(factors, [run.cpu_s for run in by_balls]),
        "rest_time": whole.cpu_s / half.cpu_s - 1,
        "rest_size": whole.size_bytes / half.size_bytes - 1,
    }


def hundred_bodies(path: Path, seconds: int) -> None:
    """Write a scene of 100 bodies that fall on a floor and nearly come to rest, apart from each other."""
    rng = np.random.default_rng(1)
    shapes = (
        'kind = "box"\nhalf_extents_m = [0.03, 0.02, 0.025]',
        'kind = "sphere"\nradius_m = 0.03',
        'kind = "capsule"\nradius_m = 0.02\nhalf_length_m = 0.02',
        'kind = "cylinder"\nradius_m = 0.025\nhalf_length_m = 0.025',
    )
    lines = [f"[physics]\nseconds = {seconds}\nrolling_friction_m = 0.003\ntorsional_friction_m = 0.003"]
    lines.append("[floor]\ntouchable = false")
    for n in range(100):
        x, y, z = 0.13 * (n % 10), 0.13 * (n // 10), 0.1 + 0.05 * rng.random()
        lines.append(f'[[body]]\n{shapes[n % 4]}\nname = "b{n}"\nposition_m = [{x:.3f}, {y:.3f}, {z:.6f}]')
        keys = {"rotation_deg": 100.0, "velocity_m_s": 0.05, "spin_deg_s": 60.0}
        for key, size in keys.items():
            lines.append(f"{key} = {rng.normal(0, size, 3).round(6).tolist()}")
    path.write_text("\n".join(lines) + "\n")


def encoded_bodies(seconds: int) -> Figures | None:
    """Encode 100 bodies in a process of its own; None without MuJoCo."""
    if find_spec("mujoco") is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bodies.toml"
        hundred_bodies(path, seconds)
        code = [sys.executable, "-c", JOB, str(path), str(path.with_suffix(".touch"))]
        output = subprocess.run(code, cwd=HERE, check=True, capture_output=True, text=True).stdout
    return dict(json.loads(output.splitlines()[-1]))


def measure(queries: int, seconds: int) -> Figures:
    """Measure frames and queries by touchfield and by SciPy, and the encoding of many bodies."""
    bodies = encoded_bodies(seconds)  # first, as a process inherits the peak memory of the one that starts it
    composed = scene()
    peer, frames = Scipy(composed), composed.voxelise()
    points = np.random.default_rng(1).uniform(0, 0.128, (queries, 3))
    middle = composed.objects[0].track.to_scene((0.011, 0.0, 0.0), 0)
    turn = iter(range(10**9))

    differ = {
        "frame": float(np.abs(frames[1].to_dense() - peer.frame(1).to_dense()).max()),
        "queries": float(np.abs(composed.sample_n(1, points) - peer.forces_n(1, points)).max()),
    }
    jobs: dict[str, tuple[Any, int, Any, int]] = {
        "voxelised frame": (lambda n: frames[n], 41, peer.frame, 3),
        "one query": (
            lambda n: composed.sample_n(0, middle), 2001, lambda n: peer.forces_n(0, middle[None]), 201,
        ),
        "one query, next frame": (
            lambda n: composed.sample_n(n, middle), 2001, lambda n: peer.forces_n(n, middle[None]), 201,
        ),
        "10^6 queries": (lambda n: composed.sample_n(1, points), 9, lambda n: peer.forces_n(1, points), 3),
    }  # fmt: skip
    rows: dict[str, dict[str, float]] = {}

    def next_frame(job: Callable[[int], Any]) -> Any:
        return job(next(turn) % FRAMES)

    for name, (our_job, runs, peer_job, fewer) in jobs.items():
        rows[name] = timed(partial(next_frame, our_job), runs, warm=5)
        rows[name]["scipy_ms"] = timed(partial(next_frame, peer_job), fewer)["min_ms"]
        rows[name]["times"] = rows[name]["scipy_ms"] / rows[name]["min_ms"]
    pairs = [Pair(o.field(0), o.field(0).scaled(1.05)) for o in composed.objects]
    rule, moves = ComposedRule(composed, 0.1, 0.05), Moves.of(composed, [o.track for o in composed.objects])
    check = timed(lambda: rule.check(pairs, moves, range(FRAMES)))["min_ms"] / FRAMES
    settings = {
        "queries": queries,
        "support": frames[1].support_count,
        "threads": worker_count(),
        "rows": rows,
    }
    return settings | {
        "kernel_us": kernel_us(composed, middle),
        "check_ms_a_frame": check,
        "largest_difference_n": differ,
        "scaling": scaling(128 if seconds >= FULL_SECONDS else 32),
        "seconds": seconds,
        "bodies": bodies,
    }


def bars(figures: Figures) -> list[Bar]:
    """Limit times and the growth of the encoding; require more speed than SciPy, and equal forces."""
    rows, scales = figures["rows"], figures["scaling"]
    full = figures["bodies"] if figures["seconds"] >= FULL_SECONDS else None
    return [
        at_most("a voxelised frame; the prototype took 24 ms", rows["voxelised frame"]["min_ms"], 24.0, "ms"),
        at_most("a query, kernel alone", figures["kernel_us"], 2.0, "us"),
        at_least("time of scipy over ours, worst of all", min(column(rows, "times")), 10.0),
        at_most(
            "check of the composed promise, a frame", figure(figures, "check_ms_a_frame"), 1e3 / 30, "ms"
        ),
        at_most("largest difference to scipy", max(figures["largest_difference_n"].values()), 1e-5, "N"),
        at_most("exponent of the encoding's processor time in frames", scales["exponent_frames"], 1.1),
        at_most("the same in touching balls", scales["exponent_balls"], 1.1),
        at_most("time that as many frames at rest add", scales["rest_time"], 0.1),
        at_most("bytes that they add", scales["rest_size"], 0.05),
        at_most("100 bodies for 60 s at 1 kHz", figure(full, "encode_s"), 60.0, "s"),
        at_most("their processor time", figure(full, "cpu_s"), 120.0, "s"),
        at_most("their file", figure(full, "file_bytes"), 4e5, "bytes"),
        at_most("peak memory", figure(full, "peak_mb"), 600.0, "MB"),
    ]


if __name__ == "__main__":
    bench("objects", __doc__, measure, bars, queries=(10**6, 10**4), seconds=(FULL_SECONDS, 1))
