"""Frames fused a second beside other people's fusion, and what a fused volume takes; of `bench_fusion`."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from touchfield.job import EncodeSpec, prepare
from touchfield.medium import ForceField, Grid
from touchfield.sources.depth_scene import DepthScene
from touchfield.sources.fused_scene import FusedVolume
from touchfield.sources.options import SourceOptions
from touchfield.sources.profile import ForceProfile
from touchfield.sources.registry import open_source

LEAST_PER_S = 30.0
ROUNDS = 9

Row = dict[str, Any]
MET: list[bool] = []


def bar(value: float, most: float) -> str:
    """The verdict on a figure that is to be at most so much (negative: at least), kept for the count."""
    MET.append(bool(value <= most))
    word = "at least" if most < 0 else "at most"
    return f"({word} {abs(most):g}: {'met' if MET[-1] else 'not met'})"


def spec_of(world: str, **more: Any) -> EncodeSpec:
    """The default, with that world, as voxels."""
    return EncodeSpec(source=SourceOptions(world=world), representation="voxel", **more)


def asked_of(scene: DepthScene, spec: EncodeSpec) -> tuple[Grid, ForceProfile]:
    """The lattice and the law, scene metres, that the device filter asks a scene for."""
    asked: list[tuple[Grid, ForceProfile]] = []

    def noted(frame: int, grid: Grid, profile: ForceProfile) -> ForceField:
        asked.append((grid, profile))
        return ForceField.empty(grid)

    own, scene.field = scene.field, noted  # type: ignore[method-assign]
    prepare(scene, spec).medium[0]
    scene.field = own  # type: ignore[method-assign]
    return asked[0]


def speed(name: str, folder: Path) -> Row:
    """Frames fused a second at n_w 7, from pictures and from memory; peers from memory; the volume's bytes."""
    scene: Any = open_source(str(folder), SourceOptions())
    fine, law = asked_of(scene, spec_of("fused"))
    count, sequence = scene.frame_count, scene.sequence
    depths = [np.asarray(sequence.depth_m(i)) for i in range(count)]
    read = sequence.depth_m

    def fused() -> tuple[float, FusedVolume, NDArray[np.float64]]:
        fresh, at = DepthScene(sequence), [time.perf_counter()]
        volume = FusedVolume(fine, law, fresh._noise_step_per_m())
        for i in range(count):
            at.append(time.perf_counter())
            surface, pose = fresh.planes(i), fresh.pose(i)
            at.append(time.perf_counter())
            volume.cover(surface, pose)
            at.append(time.perf_counter())
            volume.integrate(surface, pose)
        at.append(time.perf_counter())
        parts = np.diff(at)[1:].reshape(count, 3).mean(axis=0)
        return count / (at[-1] - at[0]), volume, 1e3 * parts

    fused()
    rate, volume, parts_ms = max((fused() for _ in range(ROUNDS)), key=lambda found: found[0])
    sequence.depth_m = lambda i: depths[i]
    in_memory = max(fused()[0] for _ in range(ROUNDS))
    sequence.depth_m = read
    k = sequence.intrinsics
    given: dict[str, Any] = {"depths_m": np.stack(depths), "poses": np.stack([scene.pose(i) for i in range(count)])}
    given |= {"intrinsics": np.array([k.fx, k.fy, k.cx, k.cy]), "voxel_m": np.array(np.mean(fine.spacing_m))}
    with tempfile.TemporaryDirectory() as out:
        np.savez(Path(out) / "depths.npz", **given)
        command = [os.environ.get("TOUCHFIELD_PEERS", sys.executable), str(Path(__file__).parent / "fusion_peers.py")]
        told = subprocess.run([*command, f"{out}/depths.npz"], check=True, capture_output=True, text=True).stdout
    peers: dict[str, Row] = json.loads(told.splitlines()[-1])
    fastest = max([p.get("frames_per_s", 0.0) for p in peers.values()])
    size = sum(array.nbytes for array in volume.samples)
    load, wall = os.getloadavg()[0], -law.low_m / float(np.mean(fine.spacing_m))
    row: Row = {
        "sequence": name,
        "load": load,
        "wall_samples": wall,
        "samples": fine.shape,
        "voxel_mm": 1e3 * float(np.mean(fine.spacing_m)),
    }
    row |= {"frames_per_s": rate, "in_memory_per_s": in_memory, "peers": peers, "volume_bytes": size}
    row |= {"bricks": len(volume.bricks), "bytes_per_brick": size / len(volume.bricks)}
    row |= dict(zip(("planes_ms", "cover_ms", "integrate_ms"), parts_ms, strict=True))
    row["share_of_box"] = len(volume.bricks) / float(np.prod(fine.brick_shape))
    print(f"{name}: {fine.shape} samples of {row['voxel_mm']:.1f} mm, {count} frames of 640 x 480; load {load:.1f}")
    print(f"    read and fused {rate:.1f} frames/s, without reading {in_memory:.1f}", bar(-rate, -LEAST_PER_S))
    print("    ms a frame: read and planes {:.1f}, cover {:.1f}, integrate {:.1f}".format(*parts_ms))
    for peer, found in peers.items():
        print(f"    {peer}: {found.get('absent') or format(found['frames_per_s'], '.1f') + ' frames/s, no reading'}")
    print("    ours less the fastest peer", bar(fastest - in_memory, 0.0))
    per_brick, share = size / len(volume.bricks), 100 * row["share_of_box"]
    print(f"    volume {size / 1e6:.0f} MB, {per_brick:.0f} a brick, {share:.1f} % of the box")
    return row
