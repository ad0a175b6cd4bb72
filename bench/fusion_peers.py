"""Measures frames per second of Open3D and VDBFusion on the depth maps of `bench_fusion`.

    PYTHON fusion_peers.py DEPTHS.npz

`bench_fusion` runs this file in the interpreter that has the peers installed; it needs NumPy besides. The
input has depths_m float32 [n, h, w], poses float64 [n, 4, 4] (world from camera), intrinsics float64 [4] (fx,
fy, cx, cy) and voxel_m. The output is JSON: for each peer the frames per second of the best of nine runs, or
why it was not measured. The truncation distance is Open3D's default of eight voxels.
"""

from __future__ import annotations

import json
import sys
import time
from importlib import import_module
from typing import Any

import numpy as np

TRUNCATION_VOXELS = 8.0


def open3d_rate(data: Any) -> float:
    """Return frames per second of `VoxelBlockGrid` on the CPU."""
    o3d: Any = import_module("open3d")
    core, device = o3d.core, o3d.core.Device("CPU:0")
    fx, fy, cx, cy = data["intrinsics"]
    intrinsic = core.Tensor([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], core.float64)
    depths = [o3d.t.geometry.Image(core.Tensor(d, core.float32, device)) for d in data["depths_m"]]
    extrinsics = [core.Tensor(np.linalg.inv(pose), core.float64) for pose in data["poses"]]
    max_depth_m = float(data["depths_m"].max())

    def run() -> None:
        grid = o3d.t.geometry.VoxelBlockGrid(
            ("tsdf", "weight"),
            (core.float32, core.float32),
            ((1), (1)),
            float(data["voxel_m"]),
            16,
            20000,
            device,
        )
        for depth, extrinsic in zip(depths, extrinsics):
            blocks = grid.compute_unique_block_coordinates(
                depth, intrinsic, extrinsic, 1.0, max_depth_m, TRUNCATION_VOXELS
            )
            grid.integrate(blocks, depth, intrinsic, extrinsic, 1.0, max_depth_m, TRUNCATION_VOXELS)

    return _best(run, len(depths))


def vdbfusion_rate(data: Any) -> float:
    """Return frames per second of VDBFusion, including the conversion to points."""
    vdbfusion: Any = import_module("vdbfusion")

    fx, fy, cx, cy = data["intrinsics"]
    voxel_m, depths, poses = float(data["voxel_m"]), data["depths_m"], data["poses"]
    v, u = np.mgrid[: depths.shape[1], : depths.shape[2]]
    rays = np.stack([(u - cx) / fx, (v - cy) / fy, np.ones(u.shape)], -1)

    def run() -> None:
        volume = vdbfusion.VDBVolume(voxel_m, TRUNCATION_VOXELS * voxel_m, False)
        for depth, pose in zip(depths, poses):
            points = (rays * depth[..., None])[depth > 0] @ pose[:3, :3].T + pose[:3, 3]
            volume.integrate(points, pose)

    return _best(run, len(depths))


def _best(run: Any, frames: int) -> float:
    times = []
    for _ in range(9):
        began = time.perf_counter()
        run()
        times.append(time.perf_counter() - began)
    return frames / min(times)


def main() -> None:
    """Print the frames per second of each peer as JSON."""
    found: dict[str, Any] = {}
    data = dict(np.load(sys.argv[1]))
    for name, rate in (("Open3D VoxelBlockGrid", open3d_rate), ("VDBFusion", vdbfusion_rate)):
        try:
            found[name] = {"frames_per_s": rate(data)}
        except ImportError as error:
            found[name] = {"absent": f"cannot be imported ({error})"}
    print(json.dumps(found))


if __name__ == "__main__":
    main()
