"""Fields of every source with a GPU kernel, on the CPU and on numba's GPU simulator, and their differences.

Run by `test_cuda` in a separate process: ``NUMBA_ENABLE_CUDASIM`` is read once. Prints one JSON object:
newtons.
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from touchfield.compute.cuda import computing, on_host
from touchfield.medium import ForceField, Grid, HapticMedium, HapticObject, HapticScene, PoseTrack
from touchfield.render.sampler import DeviceSampler, FieldSampler
from touchfield.sources.laws import LawSpec, penalty
from touchfield.sources.tiny_scenes import tiny_scenes


def grid_of(scene: Any, shape: tuple[int, int, int]) -> Grid:
    """A lattice over a scene with a margin of some samples."""
    low, high = scene.bounds_m()
    margin = 0.1 * max(high - low)
    return Grid.over_box(low - margin, high + margin, shape)


def difference(a: ForceField, b: ForceField) -> dict[str, float]:
    """Largest difference, and the compared values."""
    first, second = a.to_dense(), b.to_dense()
    return {
        "bricks": len(a.bricks),
        "same_bricks": bool(np.array_equal(a.bricks, b.bricks)),
        "force_n": float(np.abs(first).max()),
        "difference_n": float(np.abs(first - second).max()),
    }


def fields() -> dict[str, Any]:
    """The last frame of each tiny scene."""
    out = {}
    for n, scene in enumerate(tiny_scenes()):
        name = f"{type(scene).__name__} {n}"
        if not scene.has_gpu:
            continue
        grid = grid_of(scene, (13, 9, 7))
        law = penalty(LawSpec(), 3 * max(grid.spacing_m))
        frame = scene.frame_count - 1
        on_cpu = scene.field(frame, grid, law)
        with computing("cuda"):
            other = tiny_scenes()[n].field(frame, grid, law)
        out[name] = difference(on_cpu, other)
    return out


def queries() -> dict[str, Any]:
    """Between two frames and between two others, of voxels and of an object, at points inside and outside."""
    rng = np.random.default_rng(4)
    grid = Grid((20, 18, 16), (0.001, 0.002, 0.003), (0.0, 0.0, 0.0))
    fields = [
        ForceField.from_dense(grid, rng.normal(0, 1, (*grid.shape, 3)).astype(np.float32)) for _ in range(4)
    ]
    medium = HapticMedium.from_frames(fields, 30.0)
    track = PoseTrack(np.tile([1.0, 0.0, 0.0, 0.0], (4, 1)), rng.normal(0, 0.002, (4, 3)))
    points, out = rng.uniform(-0.002, 0.05, (100, 3)), {}
    scene = HapticScene(grid, 30.0, (HapticObject("body", medium, track),), 4.0)
    for name, kind in {"voxels": medium, "objects": scene}.items():
        sampler, device_sampler = FieldSampler(kind), DeviceSampler(kind)
        on_cpu = np.stack([sampler.force_n(time_s, points) for time_s in (0.0, 0.02, 0.09)])
        other = np.stack([on_host(device_sampler.force_n(time_s, points)) for time_s in (0.0, 0.02, 0.09)])
        out[name] = {
            "force_n": float(np.abs(on_cpu).max()),
            "difference_n": float(np.abs(on_cpu - other).max()),
        }
    return out


if __name__ == "__main__":
    print(json.dumps({**fields(), **queries()}))
