"""Sampled spheres and planes, and files of points."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from touchfield.sources.clouds.cloud import Cloud
from touchfield.sources.clouds.cloud_scene import CloudScene
from touchfield.sources.clouds.surfels import surface_of

RADIUS_M = 0.05
SIDE_M = 0.1
NOISE = 0.25  # of the spacing


def sphere(count: int, seed: int = 0, noise: float = NOISE) -> tuple[np.ndarray, np.ndarray, float]:
    """Points on a sphere with noise of some of the spacing, the outward normals, and the spacing."""
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    spacing_m = math.sqrt(4 * math.pi * RADIUS_M**2 / count)
    return normals * RADIUS_M + noise * spacing_m * rng.normal(size=(count, 3)), normals, spacing_m


def plane(count: int, seed: int = 0, noise: float = NOISE) -> tuple[np.ndarray, np.ndarray, float]:
    """Points on a square z = 0 with noise along z, upward normals, and the spacing."""
    rng = np.random.default_rng(seed)
    spacing_m = math.sqrt(SIDE_M**2 / count)
    points = np.append(
        rng.uniform(-SIDE_M / 2, SIDE_M / 2, (count, 2)),
        noise * spacing_m * rng.normal(size=(count, 1)),
        axis=1,
    )
    return points, np.tile([0.0, 0.0, 1.0], (count, 1)), spacing_m


def scene_of(points: np.ndarray, normals: np.ndarray | None = None, side: str = "auto") -> CloudScene:
    """The scene of points, with normals if there are any."""
    cloud = Cloud(np.array(points, np.float64))
    if normals is not None:
        cloud = Cloud(cloud.points, np.asarray(normals, np.float32))
    return CloudScene(surface_of(cloud, side, "cloud"), name="cloud")


def ply(path: Path, points: np.ndarray, normals: np.ndarray | None = None, form: str = "ascii") -> Path:
    """Write points as a PLY without faces: "ascii", "<" or ">"."""
    rows = np.asarray(points) if normals is None else np.concatenate([points, normals], axis=1)
    names = ("x", "y", "z", "nx", "ny", "nz")[: rows.shape[1]]
    word = {"ascii": "ascii", "<": "binary_little_endian", ">": "binary_big_endian"}[form]
    head = ["ply", f"format {word} 1.0", f"element vertex {len(rows)}"]
    head += [*(f"property double {name}" for name in names), "end_header", ""]
    body = text_of(rows) if form == "ascii" else rows.astype(f"{form}f8").tobytes()
    path.write_bytes("\n".join(head).encode() + body)
    return path


def text_of(rows: Iterable[Iterable[float]]) -> bytes:
    """Lines of numbers."""
    return "".join(" ".join(f"{value:.9g}" for value in row) + "\n" for row in rows).encode()


def pcd(
    path: Path,
    points: np.ndarray,
    form: str = "ascii",
    normals: np.ndarray | None = None,
    viewpoint: str = "0 0 0 1 0 0 0",
    height: int = 1,
) -> Path:
    """Write points as a PCD with a field of padding: "ascii", "binary" or "binary_compressed"."""
    rows = np.asarray(points) if normals is None else np.concatenate([points, normals], axis=1)
    names = ["x", "y", "z", *(["normal_x", "normal_y", "normal_z"] * (normals is not None)), "_", "intensity"]
    count = len(rows)
    head = [
        "# .PCD v0.7", "VERSION 0.7", f"FIELDS {' '.join(names)}", f"SIZE {'4 ' * (len(names) - 2)}1 8",
        f"TYPE {'F ' * (len(names) - 2)}U F", f"COUNT {'1 ' * (len(names) - 2)}4 1",
        f"WIDTH {count // height}",
        f"HEIGHT {height}", f"VIEWPOINT {viewpoint}", f"POINTS {count}", f"DATA {form}", "",
    ]  # fmt: skip
    if form == "ascii":
        body = text_of(np.concatenate([rows, np.zeros((count, 5))], axis=1))
    else:
        record = np.dtype([*((name, "<f4") for name in names[:-2]), ("_", "u1", 4), ("intensity", "<f8")])
        values = np.zeros(count, record)
        for name, column in zip(names, rows.T, strict=False):
            values[name] = column
        body = values.tobytes()
        if form == "binary_compressed":
            fields = b"".join(np.ascontiguousarray(values[name]).tobytes() for name in record.names or ())
            packed = lzf(fields)
            body = np.array([len(packed), len(fields)], "<u4").tobytes() + packed
    path.write_bytes("\n".join(head).encode() + body)
    return path


def lzf(data: bytes) -> bytes:
    """Compress by LZF: runs of equal bytes become copies at distance 1, which overlap their source."""
    out, at = bytearray(), 0
    while at < len(data):
        run = 1
        while at + run < len(data) and data[at + run] == data[at] and run < 264:
            run += 1
        if run >= 10:
            out += bytes([0, data[at]])
            length = run - 1 - 2
            out += bytes([7 << 5, length - 7, 0] if length >= 7 else [length << 5, 0])
        else:
            run = min(run, 32)
            out += bytes([run - 1]) + data[at : at + run]
        at += run
    return bytes(out)
