"""Measures the time from a depth map to a sparse force field, against NumPy and NVIDIA Warp on the CPU.

    python bench/bench_depth.py [--quick] [--large N]

The depth map (640 x 480 pixels) shows a synthetic room. touchfield is timed as a whole and without any cache:
noise step, normals, culling and forces. NumPy and Warp receive the finished tangent planes and fill the dense
lattice by the same formula, on 128^3 and 256^3 samples; their fields are compared with touchfield's. Times
are wall times.

A large lattice of `--large`^3 samples is measured for touchfield only, in a separate process, to record its
peak memory.
"""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from machine import Bar, Figures, at_least, at_most, bench, figure, timed
from touchfield.medium import ForceField, Grid
from touchfield.sources.camera import DepthSequence, Intrinsics
from touchfield.sources.depth.depth_scene import RAY_LIMIT, DepthScene
from touchfield.sources.depth.kernels.planes import SurfacePlanes
from touchfield.sources.laws import ForceProfile

SIZE_PX = (480, 640)
LOW_M, HIGH_M = (-1.0, -1.0, 0.6), (1.0, 1.0, 2.6)
BALLS = (((-0.3, 0.2, 1.6), 0.35), ((0.45, 0.3, 1.9), 0.3), ((0.1, -0.35, 1.4), 0.2))


class IndoorSequence(DepthSequence):
    """A wall, a floor and three balls, with sensor noise and 2 % of holes.

    The noise is seeded, so the map is the same in every run.
    """

    def __init__(self) -> None:
        self.name, self.rate_hz, self.frame_count = "room", 30.0, 1
        self.height, self.width = SIZE_PX
        self.intrinsics = Intrinsics(525.0, 525.0, (self.width - 1) / 2, (self.height - 1) / 2)
        v, u = np.mgrid[: self.height, : self.width]
        x, y = (u - self.intrinsics.cx) / 525.0, (v - self.intrinsics.cy) / 525.0
        z = np.minimum(2.3, np.where(y > 0, 0.7 / np.maximum(y, 1e-6), np.inf))
        square = x * x + y * y + 1
        for (cx, cy, cz), radius in BALLS:
            along = x * cx + y * cy + cz
            inside = along**2 - square * (cx**2 + cy**2 + cz**2 - radius**2)
            hit = np.where(inside > 0, (along - np.sqrt(np.maximum(inside, 0))) / square, np.inf)
            z = np.minimum(z, hit)
        rng = np.random.default_rng(0)
        z += rng.normal(0, 0.001, z.shape) * z**2
        z[rng.random(z.shape) < 0.02] = 0
        self._depth = z.astype(np.float32)

    def depth_m(self, frame: int) -> np.ndarray:
        return self._depth


def wall(grid: Grid) -> ForceProfile:
    """Return a penalty wall eight samples thick whose force saturates half way in."""
    thickness = 8 * max(grid.spacing_m)
    knee = thickness / 2
    return ForceProfile(((-thickness, -knee, 3.3, 0.0), (-knee, 0.0, 0.0, -3.3 / knee)))


def with_numpy(surface: SurfacePlanes, grid: Grid, profile: ForceProfile) -> np.ndarray:
    """Compute the dense field, float32 [nx, ny, nz, 3], in camera coordinates."""
    height, width = surface.size_px
    fx, fy, cx, cy = surface.camera_px
    x, y, z = np.ix_(*(grid.axis_m(a).astype(np.float32) for a in range(3)))
    per_z = 1 / z
    u = np.broadcast_to(x * per_z * fx + (cx + np.float32(0.5)), grid.shape)
    v = np.broadcast_to(y * per_z * fy + (cy + np.float32(0.5)), grid.shape)
    inside = (u >= 0) & (v >= 0) & (u < width) & (v < height)
    pixel = np.where(inside, v.astype(np.int32) * width + u.astype(np.int32), height * width)
    plane = surface.planes.reshape(-1, 4)[pixel]
    facing = x * plane[..., 0] + y * plane[..., 1] + z * plane[..., 2]
    phi = facing - plane[..., 3]
    limit = np.where(
        phi <= 0, np.float32(-RAY_LIMIT * profile.low_m), np.float32(RAY_LIMIT * max(profile.high_m, 0))
    )
    supported = (facing < 0) & (z * np.abs(phi) <= -facing * limit)
    amplitude = np.zeros(grid.shape, np.float32)
    for low, high, intercept, slope in profile.table().astype(np.float32):
        amplitude = np.where(supported & (phi > low) & (phi <= high), intercept + slope * phi, amplitude)
    return amplitude[..., None] * plane[..., :3]


def warp_caller(surface: SurfacePlanes, grid: Grid, profile: ForceProfile) -> Callable[[], np.ndarray]:
    """Return a call of one Warp kernel that fills the dense lattice on the CPU.

    The force profile has two pieces.
    """
    wp: Any = import_module("warp")
    wp.config.quiet = True
    wp.init()

    @wp.kernel  # type: ignore[untyped-decorator]
    def forces(  # type: ignore[no-untyped-def]
        planes: wp.array(dtype=wp.vec4),  # type: ignore[valid-type]
        camera: wp.vec4,
        size: wp.vec2i,
        origin: wp.vec3,
        spacing: wp.vec3,
        first: wp.vec4,
        second: wp.vec4,
        front_limit: float,
        back_limit: float,
        out: wp.array(dtype=wp.vec3, ndim=3),  # type: ignore[valid-type]
    ):
        i, j, k = wp.tid()
        p = wp.vec3(
            origin[0] + spacing[0] * float(i),
            origin[1] + spacing[1] * float(j),
            origin[2] + spacing[2] * float(k),
        )
        force = wp.vec3(0.0, 0.0, 0.0)
        u = p[0] / p[2] * camera[0] + camera[2] + 0.5
        v = p[1] / p[2] * camera[1] + camera[3] + 0.5
        if p[2] > 0.0 and u >= 0.0 and v >= 0.0 and u < float(size[1]) and v < float(size[0]):
            plane = planes[int(v) * size[1] + int(u)]
            n = wp.vec3(plane[0], plane[1], plane[2])
            facing = wp.dot(n, p)
            phi = facing - plane[3]
            limit = front_limit
            if phi <= 0.0:
                limit = back_limit
            if facing < 0.0 and p[2] * wp.abs(phi) <= -facing * limit:
                if phi > first[0] and phi <= first[1]:
                    force = n * (first[2] + first[3] * phi)
                if phi > second[0] and phi <= second[1]:
                    force = n * (second[2] + second[3] * phi)
        out[i, j, k] = force

    planes = wp.array(surface.planes.reshape(-1, 4), dtype=wp.vec4, device="cpu")
    out = wp.zeros(grid.shape, dtype=wp.vec3, device="cpu")
    pieces = [wp.vec4(*map(float, piece)) for piece in profile.table()]
    limits = RAY_LIMIT * max(profile.high_m, 0.0), -RAY_LIMIT * profile.low_m
    camera, size = wp.vec4(*map(float, surface.camera_px)), wp.vec2i(*surface.size_px)
    inputs = [planes, camera, size, wp.vec3(*grid.origin_m), wp.vec3(*grid.spacing_m), *pieces, *limits, out]

    def call() -> np.ndarray:
        wp.launch(forces, dim=grid.shape, inputs=inputs, device="cpu")
        return np.asarray(out.numpy())

    return call


def differing_fraction(field: ForceField, dense: np.ndarray) -> float:
    """Return the fraction of samples that differ by more than 0.01 N.

    They come from rounding at pixel borders and at the faces of the wall.
    """
    return float((np.abs(field.to_dense() - dense).max(-1) > 0.01).mean())


def by_itself(n: int) -> Figures:
    """Compute a field of n^3 samples over the bounds of the scene, and measure it.

    Run it in a separate process: the peak memory is that of the process.
    """
    scene = DepthScene(IndoorSequence())
    low_m, high_m = scene.bounds_m()
    grid = Grid.over_box(low_m, high_m, (n, n, n))
    profile = wall(grid)
    scene.field(0, Grid.over_box(low_m, high_m, (16, 16, 16)), profile)  # load the compiled code
    start = perf_counter()
    field = DepthScene(scene.sequence).field(0, grid, profile)
    elapsed_ms = (perf_counter() - start) * 1e3
    status = Path("/proc/self/status").read_text(encoding="ascii")
    peak_kb = int(
        status.split("VmHWM:")[1].split()[0]
    )  # of this process alone, unlike getrusage after a fork
    return {
        "ms": elapsed_ms,
        "peak_mb": peak_kb / 1024,
        "bricks": len(field.bricks),
        "support": field.support_count,
    }


def compare(sequence: IndoorSequence, n: int) -> Figures:
    """Time touchfield and the peers on an n^3 lattice, and compare their fields."""
    grid = Grid.over_box(LOW_M, HIGH_M, (n, n, n))
    profile = wall(grid)
    field = DepthScene(sequence).field(0, grid, profile)
    surface = DepthScene(sequence).planes(0)
    rows = {"touchfield": timed(lambda: DepthScene(sequence).field(0, grid, profile), 50_000 // n, 3)}
    rows["touchfield"] |= {"bricks": len(field.bricks), "support": field.support_count}
    jobs: dict[str, Callable[[], np.ndarray]] = {"numpy": lambda: with_numpy(surface, grid, profile)}
    if importlib.util.find_spec("warp") is not None:
        jobs["warp"] = warp_caller(surface, grid, profile)
    for name, job in jobs.items():
        rows[name] = {
            "differing": differing_fraction(field, job()),
            **timed(job, 7 if name == "numpy" else 25),
        }
        rows[name]["ratio"] = rows[name]["min_ms"] / rows["touchfield"]["min_ms"]
    return rows


def measure(large: int) -> Figures:
    """Measure both lattices, and the large one."""
    sequence = IndoorSequence()
    figures: dict[str, Any] = {f"{n}^3": compare(sequence, n) for n in (128, 256)}
    program = f"import json, bench_depth; print(json.dumps(bench_depth.by_itself({large})))"
    process = subprocess.run(
        [sys.executable, "-c", program], check=True, capture_output=True, cwd=Path(__file__).parent
    )
    figures[f"{large}^3"] = json.loads(process.stdout)
    return figures


def bars(figures: Figures) -> list[Bar]:
    """Require more speed than NumPy and Warp and equal fields; limit the memory."""
    rows = {
        f"{n}^3 {peer}": figure(figures, f"{n}^3", peer) for n in (128, 256) for peer in ("numpy", "warp")
    }
    differs = [row["differing"] for row in rows.values() if row and "differing" in row]
    return [
        at_most("a frame at 128^3", figure(figures, "128^3", "touchfield", "min_ms"), 6.0, "ms"),
        at_least("time of numpy over ours at 128^3", figure(rows, "128^3 numpy", "ratio"), 20.0),
        at_least("time of Warp over ours at 128^3", figure(rows, "128^3 warp", "ratio"), 6.0),
        at_least("time of Warp over ours at 256^3", figure(rows, "256^3 warp", "ratio"), 3.0),
        at_most("samples more than 0.01 N from a peer's, share", max(differs, default=None), 1e-4),
        at_most("memory of a frame at 1000^3", figure(figures, "1000^3", "peak_mb"), 2048, "MB"),
    ]


if __name__ == "__main__":
    bench("depth", __doc__, measure, bars, large=(1000, 400))
