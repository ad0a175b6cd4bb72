"""Measures point clouds: time and memory of a field of 10^7 points, and the error of contact.

    python bench/bench_clouds.py [--quick] [--points N] [--samples N]

"speed": clouds of 10^5 points to `--points` on a sphere with bumps, in a binary PLY in random order, are read
and become a force field on `--samples`^3 samples. A process of its own reads each one after a small cloud,
whose run compiles. "bytes_per_point" is the growth of its greatest memory over that small cloud, divided by
the points; pages of the file count.

"contact": 20,000 points on a sphere and on a square, with noise of a quarter and of half the point spacing.
The error is the distance to the surface that is found at points of the true one, in spacings. The trivial
peers are the nearest point, and the plane of the nearest point with its true normal; Open3D makes a mesh of
points and true normals, by Poisson and by ball pivoting (a fifth of the points of the square lies near its
rim, which is left out for all).
"""

from __future__ import annotations

import json
import math
import subprocess
import sys
import tempfile
import time
from importlib import import_module, metadata
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machine import Bar, Figures, at_most, bench, figure
from peak_memory import peak_bytes
from touchfield.compute.threads import worker_count
from touchfield.medium import Grid
from touchfield.sources.clouds.cloud import Cloud
from touchfield.sources.clouds.cloud_files import KIND
from touchfield.sources.clouds.cloud_scene import CloudScene
from touchfield.sources.clouds.surfels import surface_of
from touchfield.sources.laws import ForceProfile, LawSpec, profile_of
from touchfield.sources.options import SourceOptions

Floats = NDArray[np.floating[Any]]
HERE = Path(__file__).parent
SMALLEST, CONTACT_POINTS, PROBES = 100_000, 20_000, 2_000
RADIUS_M = 0.05
NOISES = (0.25, 0.5)  # of the spacing
MAX_SECONDS, MAX_SPACINGS, MAX_BYTES_PER_POINT = 20.0, 0.5, 200.0
POISSON_DEPTH = 8


# -- speed and memory --------------------------------------------------------------------------------------


def write_bumpy(path: Path, count: int) -> None:
    """Write points of a sphere with bumps, with noise of a quarter of the spacing, a part at a time."""
    rng = np.random.default_rng(0)
    names = "".join(f"property float {axis}\n" for axis in "xyz")
    spacing_m = math.sqrt(4 * math.pi * RADIUS_M**2 / count)
    with path.open("wb") as file:
        file.write(
            f"ply\nformat binary_little_endian 1.0\nelement vertex {count}\n{names}end_header\n".encode()
        )
        for first in range(0, count, 1 << 20):
            directions = unit(rng.normal(size=(min(1 << 20, count - first), 3)))
            x, y, z = directions.T
            radius = RADIUS_M * (1 + 0.1 * np.sin(7 * x) * np.sin(6 * y) * np.sin(8 * z))
            points = directions * radius[:, None] + 0.25 * spacing_m * rng.normal(size=(len(x), 3))
            file.write(points.astype("<f4").tobytes())


def unit(vectors: Floats) -> Floats:
    """Return vectors of length 1."""
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1)[:, None])


def field_of(path: str, samples: int) -> tuple[CloudScene, int]:
    """Read a file and compute its field; return the scene and the bricks with a force."""
    scene = KIND.open(Path(path), SourceOptions())
    assert isinstance(scene, CloudScene)
    grid = Grid.over_box((-1.2 * RADIUS_M,) * 3, (1.2 * RADIUS_M,) * 3, (samples,) * 3)
    law = LawSpec()
    return scene, len(scene.field(0, grid, profile_of(law, law.saturation_m)).bricks)


def one(path: str, small: str, samples: int) -> None:
    """Print the figures of a cloud; called in a process of its own."""
    field_of(small, samples)
    before, began, used = peak_bytes(), time.perf_counter(), time.process_time()
    scene, bricks = field_of(path, samples)
    seconds, processor_s = time.perf_counter() - began, time.process_time() - used
    surface = scene.surface
    figures = {"seconds": seconds, "processor_s": processor_s, "peak_mb": peak_bytes() / 1e6}
    figures |= {
        "grown_bytes_s": peak_bytes() - before,
        "discs": len(surface.surfels.weights),
        "bricks": bricks,
    }
    print(json.dumps(figures))


def measure_speed(points: int, samples: int) -> dict[str, Figures]:
    """Time clouds of growing size, each in a process of its own."""
    rows: dict[str, Figures] = {}
    count = SMALLEST
    with tempfile.TemporaryDirectory() as folder:
        small, path = Path(folder) / "small.ply", Path(folder) / "cloud.ply"
        write_bumpy(small, SMALLEST // 2)
        while count <= points:
            write_bumpy(path, count)
            code = f"import bench_clouds; bench_clouds.one({str(path)!r}, {str(small)!r}, {samples})"
            done = subprocess.run(
                [sys.executable, "-c", code], cwd=HERE, check=True, stdout=subprocess.PIPE, text=True
            )
            row = json.loads(done.stdout)
            row["bytes_per_point_s"] = row.pop("grown_bytes_s") / count
            rows[f"10^{round(math.log10(count))} points"] = row
            count *= 10
    return rows


# -- contact -----------------------------------------------------------------------------------------------


def sphere(rng: np.random.Generator, noise: float) -> tuple[Floats, Floats, float]:
    """Return noisy points, their normals and their spacing."""
    normals = unit(rng.normal(size=(CONTACT_POINTS, 3)))
    spacing_m = math.sqrt(4 * math.pi * RADIUS_M**2 / CONTACT_POINTS)
    return RADIUS_M * normals + noise * spacing_m * rng.normal(size=normals.shape), normals, spacing_m


def square(rng: np.random.Generator, noise: float) -> tuple[Floats, Floats, float]:
    """Return noisy points of a square of twice the radius, their normals and their spacing."""
    points = rng.uniform(-RADIUS_M, RADIUS_M, (CONTACT_POINTS, 3))
    spacing_m = 2 * RADIUS_M / math.sqrt(CONTACT_POINTS)
    points[:, 2] = 0
    normals = np.tile([0.0, 0.0, 1.0], (CONTACT_POINTS, 1))
    return points + noise * spacing_m * rng.normal(size=points.shape), normals, spacing_m


def probes(shape: str, rng: np.random.Generator) -> Floats:
    """Return points of the true surface, away from a rim."""
    if shape == "sphere":
        return RADIUS_M * unit(rng.normal(size=(PROBES, 3)))
    return np.asarray(rng.uniform(-0.9 * RADIUS_M, 0.9 * RADIUS_M, (PROBES, 3)) * [1, 1, 0])


def surface_errors(points: Floats, normals: Floats | None, at: Floats) -> Floats:
    """Return the distances of true surface points to the surface that is found, NaN where there is none."""
    cloud = Cloud(np.array(points))
    if normals is not None:
        cloud = Cloud(cloud.points, normals.astype(np.float32))
    scene = CloudScene(surface_of(cloud, "auto", "bench"))
    law = ForceProfile(((-0.02, 0.02, 1.0, 10.0),))  # |F| gives the distance back
    found = np.full(len(at), np.nan)
    for index, point in enumerate(at):
        forces = scene.field(0, Grid((1, 1, 1), (1e-4,) * 3, tuple(point.tolist())), law).vectors_n()
        if len(forces):
            found[index] = abs(float(np.linalg.norm(forces[0])) - 1) / 10
    return found


def peer_errors(points: Floats, normals: Floats, at: Floats) -> dict[str, Floats]:
    """Return the errors of the trivial peers, and of those of Open3D if it is installed."""
    from scipy.spatial import cKDTree

    distances, nearest = cKDTree(points).query(at)
    plane = np.abs(((at - points[nearest]) * normals[nearest]).sum(axis=1))
    found = {"peer: nearest point": distances, "peer: plane of the nearest point": plane}
    try:
        open3d = import_module("open3d")
    except (ImportError, OSError):
        return found
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    cloud.normals = open3d.utility.Vector3dVector(normals)
    mesh, _ = open3d.geometry.TriangleMesh.create_from_point_cloud_poisson(cloud, depth=POISSON_DEPTH)
    spacing_m = float(np.median(cKDTree(points).query(points, 2)[0][:, 1])) * 2
    radii = open3d.utility.DoubleVector([spacing_m, 2 * spacing_m, 4 * spacing_m])
    balls = open3d.geometry.TriangleMesh.create_from_point_cloud_ball_pivoting(cloud, radii)
    name = f"open3d {metadata.version('open3d')}"
    for method, result in (("Poisson", mesh), ("ball pivoting", balls)):
        scene = open3d.t.geometry.RaycastingScene()
        scene.add_triangles(open3d.t.geometry.TriangleMesh.from_legacy(result))
        errors = scene.compute_distance(open3d.core.Tensor(at.astype(np.float32))).numpy()
        found[f"peer: {method}, {name}"] = errors
    return found


def measure_contact() -> dict[str, Figures]:
    """Measure the error of contact by shape and noise, in spacings."""
    rows: dict[str, Figures] = {}
    for shape, make in (("sphere", sphere), ("plane", square)):
        for noise in NOISES:
            points, normals, spacing_m = make(np.random.default_rng(1), noise)
            at = probes(shape, np.random.default_rng(2))
            found = {
                "given normals": surface_errors(points, normals, at),
                "estimated normals": surface_errors(points, None, at),
                **peer_errors(points, normals, at),
            }
            for method, errors in found.items():
                spacings = errors / spacing_m
                rows[f"{shape}, noise {noise:g}, {method}"] = {
                    "rms": float(np.sqrt(np.mean(spacings**2))),
                    "p99": float(np.quantile(spacings, 0.99)),
                    "largest": float(spacings.max()),
                }
    return rows


def measure(points: int, samples: int) -> Figures:
    """Measure speed, memory and contact."""
    return {
        "threads": worker_count(),
        "samples": samples,
        "speed": measure_speed(points, samples),
        "contact": measure_contact(),
    }


def bars(figures: Figures) -> list[Bar]:
    """Require 20 s for 10^7 points, a bounded memory by points, and contact within half a spacing."""
    speed, contact = figures["speed"], figures["contact"]
    own = {name: row for name, row in contact.items() if "peer" not in name and "noise 0.25" in name}
    largest = "10^7 points"
    return [
        at_most("seconds for 10^7 points", figure(speed, largest, "seconds"), MAX_SECONDS, "s"),
        at_most(
            "memory by points",
            figure(speed, largest, "bytes_per_point_s"),
            MAX_BYTES_PER_POINT,
            "bytes a point",
        ),
        at_most(
            "largest error of contact", max(row["largest"] for row in own.values()), MAX_SPACINGS, "spacings"
        ),
    ]


if __name__ == "__main__":
    bench("clouds", __doc__, measure, bars, points=(10_000_000, 100_000), samples=(128, 48))
