"""Measures the time to compute the force fields of an animated mesh, against Open3D and libigl.

    python bench/bench_animation.py [--quick] [--path FOX.glb] [--samples N]

The input is the run cycle of Fox.glb (576 triangles, 24 joints): six frames on a cubic lattice of 128^3
samples. `--samples` sets the number of samples along each axis.

touchfield is timed from the animation to the force fields of all six frames: joints, skinning, surface, and
the signed distance and its direction at every sample within 4 voxels of the surface. A second row adds
damping against the moving surface.

Each installed peer builds its search tree from the triangles of a frame and returns signed distances. It is
timed twice: at all samples of the lattice, as if the position of the surface were unknown (one frame is timed
and counted six times), and only at the samples of touchfield's band and their neighbours.

Distances are compared outside the solid only. Inside, the peers also measure the distance to triangles hidden
within another part of the body, which touchfield leaves out; such samples are counted. The peers do not take
signs from the winding number either; signs that differ are counted.
"""

from __future__ import annotations

from functools import partial
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from bench_mesh import PEERS, missing
from machine import SHARED, Bar, Figures, at_least, at_most, bench, column, figure, leave_out, timed
from touchfield.compute.threads import worker_count
from touchfield.medium import Grid
from touchfield.sources.animation.animated_mesh import AnimatedMeshScene
from touchfield.sources.laws import ForceProfile

BAND = 4  # voxels
MAX_DIFFERENCE = 1e-3  # voxels
FRAMES = 6


def enclosing_cube(scene: AnimatedMeshScene, samples: int) -> Grid:
    """Return a cubic lattice that encloses the scene and its band."""
    low, high = scene.bounds_m()
    half = float((high - low).max()) / 2 * samples / (samples - 2 * BAND - 2)
    return Grid.over_box((low + high) / 2 - half, (low + high) / 2 + half, (samples,) * 3)


def with_neighbours(mask: np.ndarray) -> np.ndarray:
    """Return a mask [x, y, z] dilated by one sample along each axis."""
    wide = mask.copy()
    for axis in range(3):
        body, line = np.moveaxis(wide, axis, 0), np.moveaxis(mask, axis, 0)
        body[1:] |= line[:-1]
        body[:-1] |= line[1:]
    return wide


def in_bands(peer: Any, surfaces: list[Any], band: list[Any]) -> list[Any]:
    """Return a peer's distances for each frame, at the points of the frame's band."""
    return [peer(*surface, some) for surface, some in zip(surfaces, band, strict=True)]


def measure(path: Path, samples: int) -> Figures:
    """Measure times and differences of touchfield and the peers on the running fox."""
    if not path.is_file():
        leave_out("Fox.glb is not there; give its --path")
    scene = AnimatedMeshScene(path, "Run", unit_m=0.01)
    grid = enclosing_cube(scene, samples)
    voxel = grid.spacing_m[0]
    # |F| = 2 + phi / (BAND * voxel), so the field gives phi back
    law = ForceProfile(((-BAND * voxel, BAND * voxel, 2.0, 1 / (BAND * voxel)),))
    damped = ForceProfile(law.pieces, 1.0)
    frames = np.linspace(0, scene.frame_count - 1, FRAMES).astype(int).tolist()
    every = grid.to_m(np.argwhere(np.ones(grid.shape, bool)))

    band, surfaces, phis, indices = [], [], [], []
    for frame in frames:
        field = scene.field(frame, grid, law)
        mask = np.zeros(grid.shape, bool)
        indices.append(tuple(np.asarray(field.positions()).T))
        mask[indices[-1]] = True
        band.append(grid.to_m(np.argwhere(with_neighbours(mask))))
        phis.append((np.linalg.norm(field.vectors_n().astype(np.float64), axis=1) - 2) * BAND * voxel)
        surfaces.append((scene.surface(frame).vertices_m, scene.surface(frame).triangles))
    rows: dict[str, dict[str, Any]] = {
        "touchfield": timed(lambda: [scene.field(i, grid, law) for i in frames], runs=25, warm=2),
        "touchfield, with damping": timed(
            lambda: [scene.field(i, grid, damped) for i in frames], runs=25, warm=2
        ),
        "of it, the vertices": timed(lambda: [scene.vertices_m(i) for i in frames]),
    }
    absent = missing(("open3d", "libigl"))
    for name in {"open3d", "libigl"} - set(absent):
        peer = PEERS[name][1]
        difference, hidden, signs = 0.0, 0, 0
        for surface, phi, index in zip(surfaces, phis, indices, strict=True):
            values = peer(*surface, grid.to_m(np.stack(index, axis=1)))
            differences = np.abs(np.abs(values) - np.abs(phi)) / voxel
            difference = max(difference, float(differences[phi > 0].max()))
            hidden += int((differences[phi < 0] > MAX_DIFFERENCE).sum())
            signs += int(((values > 0) != (phi > 0)).sum())
        comparison = {
            "version": metadata.version(name),
            "largest_difference_voxels": difference,
            "nearer_to_hidden_triangles": hidden,
            "signs_that_differ": signs,
        }
        dense_times = timed(partial(peer, *surfaces[0], every), runs=1, warm=0)
        rows[f"{name}, all samples"] = comparison | {key: ms * len(frames) for key, ms in dense_times.items()}
        rows[f"{name}, the band and its neighbours"] = comparison | timed(
            partial(in_bands, peer, surfaces, band), runs=3, warm=0
        )
    for row in rows.values():
        row["frames_per_s"] = 1e3 * len(frames) / row["min_ms"]
        row["times_touchfield"] = row["min_ms"] / rows["touchfield"]["min_ms"]
    counts = [len(phi) for phi in phis]
    return {
        "samples": samples,
        "threads": worker_count(),
        "band_voxels": counts,
        "rows": rows,
        "absent": absent,
    }


def bars(figures: Figures) -> list[Bar]:
    """Require more speed than the peers, 30 frames/s with damping, equal distances."""
    rows = figures["rows"]
    peers = {name: row for name, row in rows.items() if "version" in row}
    open3d = min(
        column({n: r for n, r in peers.items() if n.startswith("open3d")}, "times_touchfield"), default=None
    )
    fastest = min(column(peers, "times_touchfield"), default=None)
    differ = max(column(rows, "largest_difference_voxels"), default=None)
    return [
        at_least("time that Open3D takes over ours", open3d, 5.0),
        at_least("time of the fastest peer over ours", fastest, 1.0),
        at_least(
            "frames of field, with damping",
            figure(rows, "touchfield, with damping", "frames_per_s"),
            30,
            "/s",
        ),
        at_most("largest difference of a distance to a peer's, outside", differ, MAX_DIFFERENCE, "voxels"),
    ]


if __name__ == "__main__":
    fox = SHARED / "meshes" / "fox" / "Fox.glb"
    peers = ("rows/libigl*", "rows/open3d*")  # installed or not, and in any version
    bench("animation", __doc__, measure, bars, without=peers, path=(fox, fox), samples=(128, 48))
