"""Depth map 640 x 480 -> sparse force field: touchfield beside vectorised numpy and NVIDIA Warp on the CPU.

Run as ``python bench/bench_depth.py``; prints a table and writes ``bench/results/depth.json``. Ours is timed as a
whole and uncached (noise step, normals, culling, forces); numpy and Warp are given the finished planes and fill
the dense lattice with the same formula, and their result is checked against ours. Times are wall time.
"""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from machine import keep
from touchfield.medium import ForceField, Grid
from touchfield.sources.camera import DepthSequence, Intrinsics
from touchfield.sources.depth_scene import RAY_LIMIT, DepthScene
from touchfield.sources.kernels.planes import SurfacePlanes
from touchfield.sources.profile import ForceProfile

SIZE_PX = (480, 640)
LOW_M, HIGH_M = (-1.0, -1.0, 0.6), (1.0, 1.0, 2.6)
BALLS = (((-0.3, 0.2, 1.6), 0.35), ((0.45, 0.3, 1.9), 0.3), ((0.1, -0.35, 1.4), 0.2))


class Room(DepthSequence):
    """A wall, a floor and three balls, with a sensor's noise and 2 % of holes; always the same."""

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
    """A penalty wall eight samples thick that saturates half way in."""
    thickness = 8 * max(grid.spacing_m)
    knee = thickness / 2
    return ForceProfile(((-thickness, -knee, 3.3, 0.0), (-knee, 0.0, 0.0, -3.3 / knee)))


def timed(call: Callable[[], Any], seconds: float, most: int) -> tuple[Any, dict[str, float]]:
    """The result, and the least and median wall time of as many calls as fit, milliseconds."""
    call()
    times: list[float] = []
    end = time.perf_counter() + seconds
    while len(times) < 3 or (len(times) < most and time.perf_counter() < end):
        start = time.perf_counter()
        result = call()
        times.append((time.perf_counter() - start) * 1e3)
    return result, {"min_ms": min(times), "median_ms": float(np.median(times)), "runs": len(times)}


def with_numpy(surface: SurfacePlanes, grid: Grid, profile: ForceProfile) -> np.ndarray:
    """The dense field, float32 [nx, ny, nz, 3], in camera coordinates."""
    height, width = surface.size_px
    fx, fy, cx, cy = surface.camera_px
    x, y, z = np.ix_(*(grid.axis_m(a).astype(np.float32) for a in range(3)))
    per_z = 1 / z
    u = np.broadcast_to(x * per_z * fx + (cx + np.float32(0.5)), grid.shape)
    v = np.broadcast_to(y * per_z * fy + (cy + np.float32(0.5)), grid.shape)
    inside = (u >= 0) & (v >= 0) & (u < width) & (v < height)
    pixel = np.where(inside, v.astype(np.int32) * width + u.astype(np.int32), height * width)
    plane = surface.planes[pixel]
    facing = x * plane[..., 0] + y * plane[..., 1] + z * plane[..., 2]
    phi = facing - plane[..., 3]
    limit = np.where(phi <= 0, np.float32(-RAY_LIMIT * profile.low_m), np.float32(RAY_LIMIT * max(profile.high_m, 0)))
    held = (facing < 0) & (z * np.abs(phi) <= -facing * limit)
    amplitude = np.zeros(grid.shape, np.float32)
    for low, high, intercept, slope in profile.table().astype(np.float32):
        amplitude = np.where(held & (phi > low) & (phi <= high), intercept + slope * phi, amplitude)
    return amplitude[..., None] * plane[..., :3]


def warp_caller(surface: SurfacePlanes, grid: Grid, profile: ForceProfile) -> Callable[[], np.ndarray]:
    """The same as one Warp kernel over the dense lattice, on the CPU; two pieces of profile."""
    import warp as wp

    wp.config.quiet = True
    wp.init()

    @wp.kernel
    def forces(
        planes: wp.array(dtype=wp.vec4),  # type: ignore[valid-type]
        camera: wp.vec4,
        size: wp.vec2i,
        origin: wp.vec3,
        spacing: wp.vec3,
        first: wp.vec4,
        second: wp.vec4,
        front: float,
        behind: float,
        out: wp.array(dtype=wp.vec3, ndim=3),  # type: ignore[valid-type]
    ):  # type: ignore[no-untyped-def]
        i, j, k = wp.tid()
        p = wp.vec3(
            origin[0] + spacing[0] * float(i), origin[1] + spacing[1] * float(j), origin[2] + spacing[2] * float(k)
        )
        force = wp.vec3(0.0, 0.0, 0.0)
        u = p[0] / p[2] * camera[0] + camera[2] + 0.5
        v = p[1] / p[2] * camera[1] + camera[3] + 0.5
        if p[2] > 0.0 and u >= 0.0 and v >= 0.0 and u < float(size[1]) and v < float(size[0]):
            plane = planes[int(v) * size[1] + int(u)]
            n = wp.vec3(plane[0], plane[1], plane[2])
            facing = wp.dot(n, p)
            phi = facing - plane[3]
            limit = front
            if phi <= 0.0:
                limit = behind
            if facing < 0.0 and p[2] * wp.abs(phi) <= -facing * limit:
                if phi > first[0] and phi <= first[1]:
                    force = n * (first[2] + first[3] * phi)
                if phi > second[0] and phi <= second[1]:
                    force = n * (second[2] + second[3] * phi)
        out[i, j, k] = force

    planes = wp.array(surface.planes, dtype=wp.vec4, device="cpu")
    out = wp.zeros(grid.shape, dtype=wp.vec3, device="cpu")
    pieces = [wp.vec4(*map(float, piece)) for piece in profile.table()]
    limits = RAY_LIMIT * max(profile.high_m, 0.0), -RAY_LIMIT * profile.low_m
    camera, size = wp.vec4(*map(float, surface.camera_px)), wp.vec2i(*surface.size_px)
    given = [planes, camera, size, wp.vec3(*grid.origin_m), wp.vec3(*grid.spacing_m), *pieces, *limits, out]

    def call() -> np.ndarray:
        wp.launch(forces, dim=grid.shape, inputs=given, device="cpu")
        return out.numpy()

    return call


def differing(field: ForceField, dense: np.ndarray) -> float:
    """Share of samples that differ by more than 0.01 N: roundings at pixel borders and at the wall's faces."""
    return float((np.abs(field.to_dense() - dense).max(-1) > 0.01).mean())


def large() -> dict[str, Any]:
    """1000^3 over the bounds of the scene; meant for a process of its own."""
    scene = DepthScene(Room())
    grid = Grid.over_box(*scene.bounds_m(), (1000, 1000, 1000))
    profile = wall(grid)
    scene.field(0, Grid.over_box(*scene.bounds_m(), (16, 16, 16)), profile)  # compiled code is loaded
    start = time.perf_counter()
    field = DepthScene(scene.sequence).field(0, grid, profile)
    elapsed_ms = (time.perf_counter() - start) * 1e3
    status = Path("/proc/self/status").read_text(encoding="ascii")
    peak_kb = int(status.split("VmHWM:")[1].split()[0])  # of this process alone, unlike getrusage after a fork
    return {"ms": elapsed_ms, "peak_mb": peak_kb / 1024, "bricks": len(field.bricks), "support": field.support_count}


def compare(sequence: Room, n: int) -> dict[str, Any]:
    """All contestants on an n^3 lattice."""
    grid = Grid.over_box(LOW_M, HIGH_M, (n, n, n))
    profile = wall(grid)
    quick = n <= 128
    figures: dict[str, Any] = {}
    field, figures["touchfield"] = timed(
        lambda: DepthScene(sequence).field(0, grid, profile), 8.0 if quick else 5.0, 800 if quick else 60
    )
    figures["touchfield"] |= {"bricks": len(field.bricks), "support": field.support_count}
    surface = DepthScene(sequence).planes(0)
    dense, figures["numpy"] = timed(lambda: with_numpy(surface, grid, profile), 4.0, 7)
    figures["numpy"]["differing"] = differing(field, dense)
    if importlib.util.find_spec("warp") is None:
        figures["warp"] = {"skipped": "the library warp is not installed (pip install warp-lang)"}
    else:
        dense, figures["warp"] = timed(warp_caller(surface, grid, profile), 4.0, 30)
        figures["warp"]["differing"] = differing(field, dense)
    for rival in ("numpy", "warp"):
        if figures[rival].get("differing", 0.0) > 1e-4:
            raise SystemExit(f"{rival} at {n}^3 computes another field: {figures[rival]['differing']:.2%} differ")
        if "min_ms" in figures[rival]:
            figures[rival]["ratio"] = figures[rival]["min_ms"] / figures["touchfield"]["min_ms"]
    return figures


def verdict(value: float, bar: float, at_least: bool) -> str:
    """The bar, and whether it is met."""
    met = value >= bar if at_least else value <= bar
    return f"(bar {'>=' if at_least else '<='} {bar:g}: {'met' if met else 'MISSED'})"


def show(results: dict[str, Any]) -> None:
    """Print the table."""
    print(f"load of the machine before and after: {results['load']}")
    print(f"{'lattice':8} {'method':11} {'min ms':>9} {'median ms':>10}  ratio to touchfield")
    for n in (128, 256):
        for name, row in results[f"{n}^3"].items():
            if "skipped" in row:
                print(f"{n}^3".ljust(8), f"{name:11} skipped: {row['skipped']}")
                continue
            note = ""
            if n == 128:
                bar = {"touchfield": (row["min_ms"], 6, False), "numpy": (row.get("ratio"), 20, True)}
                bar["warp"] = (row.get("ratio"), 3, True)
                note = verdict(*bar[name])
            ratio = f"{row['ratio']:.1f}x " if "ratio" in row else ""
            print(f"{n}^3".ljust(8), f"{name:11} {row['min_ms']:9.2f} {row['median_ms']:10.2f}  {ratio}{note}")
    row = results["1000^3"]
    note = verdict(row["peak_mb"], 2048, False)
    print(f"1000^3   touchfield  {row['ms']:9.1f}  {row['bricks']} bricks, peak {row['peak_mb']:.0f} MB {note}")


def main() -> None:
    """Measure, print, write."""
    sequence = Room()
    before = round(os.getloadavg()[0], 2)
    results: dict[str, Any] = {}
    for n in (128, 256):
        results[f"{n}^3"] = compare(sequence, n)
    child = subprocess.run([sys.executable, __file__, "--large"], check=True, capture_output=True, text=True)
    results["1000^3"] = json.loads(child.stdout)
    results["load"] = [before, round(os.getloadavg()[0], 2)]  # other work on the machine slows all of it
    keep("depth", results)
    show(results)


if __name__ == "__main__":
    if "--large" in sys.argv:
        print(json.dumps(large()))
    else:
        main()
