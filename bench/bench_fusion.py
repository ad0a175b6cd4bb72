"""Measures the fusion of depth sequences into one static world: changes between frames, bytes, accuracy,
speed.

    python bench/bench_fusion.py [--quick] [--frames N] [--rounds N]

The inputs are TUM fr1_rpy (a moving Kinect) and the ICL living room, as far as the optional folder of inputs
has them. Each is encoded with every frame on its own ("frames"), fused from the frames so far ("causal"), and
fused from all frames ("fused"):

* standing: a voxel changes if its force differs between frames by more than max(0.05 N, 0.1 |F|). Voxels
  supported in both frames are counted. Voxels that the camera sees for the first time are counted separately:
  those within the reach of the low-pass of a sample of the oversampled lattice that became supported in this
  frame. "then" holds the figures of the first run, with each frame on its own and the coder and filter of
  that version.
* speed: frames fused per second. The peers, Open3D and VDBFusion, run in the Python interpreter of the
  environment variable TOUCHFIELD_PEERS (default: this one).
* truth: error on a synthetic sequence whose surface is known (`fusion_truth`).
* first_contact: error of the first contact along the rays of a frame.
* at_rest: vibration of a hand that rests on the surface.

`--frames` is the number of frames of the first test, `--rounds` the number of repetitions of the speed test.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_truth import contact_errors_mm
from machine import SHARED, Bar, Figures as Row, at_least, at_most, bench, column, figure
from touchfield.devices import device
from touchfield.devices.drivers.simulated import SimHand
from touchfield.filters.resample import low_pass
from touchfield.medium import ForceField, Grid
from touchfield.medium.trace import Trace
from touchfield.medium.updates import FieldUpdate
from touchfield.perception.hand_motion import MARGIN_S, in_band, points_on_surface
from touchfield.pipeline import encode, prepare
from touchfield.pipeline.decoding import open_file
from touchfield.pipeline.spec import EncodeSpec
from touchfield.render.offline import run_offline
from touchfield.sources.depth.depth_scene import DepthScene
from touchfield.sources.depth.fused_scene import FusedVolume
from touchfield.sources.laws import ForceProfile
from touchfield.sources.options import SourceOptions
from touchfield.sources.registry import open_source

TUM, ICL = "TUM fr1_rpy", "ICL living room"
FOLDERS = {TUM: SHARED / "rgbd_tum_fr1_rpy", ICL: SHARED / "rgbd_iclnuim_livingroom1"}
FIRST_RUN = {
    TUM: {"share": 0.72, "change_n": 0.295, "bytes": 43_617},
    ICL: {"share": 0.22, "change_n": 0.080, "bytes": 59_890},
}
REST_S, RAMP_S, POINTS = 3.0, 0.2, 6
STEP_M, FLOOR_N, LEVEL_N = 1e-4, 0.034, 1.0


def spec_of(world: str, **more: Any) -> EncodeSpec:
    """Return the default spec with this `world`, as voxels."""
    return EncodeSpec(source=SourceOptions(world=world), representation="voxel", **more)


def requested_lattice(scene: DepthScene, spec: EncodeSpec) -> tuple[Grid, ForceProfile]:
    """Return the lattice and force profile that the device filter requests of a scene.

    Both are in scene metres.
    """
    requests: list[tuple[Grid, ForceProfile]] = []

    def record_request(frame: int, grid: Grid, profile: ForceProfile) -> FieldUpdate:
        requests.append((grid, profile))
        return FieldUpdate(ForceField.empty(grid), np.empty((0, 3), np.int32), ForceField.empty(grid))

    update_method, scene.field_update = scene.field_update, record_request  # type: ignore[method-assign]
    prepare(scene, spec).medium[0]
    scene.field_update = update_method  # type: ignore[method-assign]
    return requests[0]


def spread(new: NDArray[np.bool_], fine: Grid, grid: Grid, reach_m: float) -> NDArray[np.bool_]:
    """Return the samples of `grid` with a true sample of `fine` within `reach_m`.

    Both lattices are in the same metres.
    """
    for axis in range(3):
        at = (grid.axis_m(axis) - fine.origin_m[axis]) / fine.spacing_m[axis]
        reach, size = reach_m / fine.spacing_m[axis], new.shape[axis]
        low, high = (np.clip(x.astype(int), 0, size) for x in (np.ceil(at - reach), np.floor(at + reach) + 1))
        sums = np.insert(np.cumsum(new, axis), 0, 0, axis)
        new = np.take(sums, high, axis) > np.take(sums, low, axis)
    return new


def standing(name: str, world: str, frames_bytes: int | None, count: int) -> Row:
    """Return the changes between the first `count` frames, and the bytes."""
    spec = spec_of(world, nw=6, frames=(0, count))
    with tempfile.TemporaryDirectory() as folder:
        done = encode(str(FOLDERS[name]), Path(folder) / "it.touch", spec)
    medium, placement = done.prepared.medium, done.prepared.placement
    scene = open_source(str(FOLDERS[name]), spec.source)
    scene.restrict_frames(0, count)
    fine, law = requested_lattice(scene, spec)  # type: ignore[arg-type]
    grid = placement.to_scene(medium.grid)
    reach_m = low_pass("spline").half_width * 2 * grid.spacing_m[0]
    counts, changes = np.zeros((2, 2)), []
    before, raw_before = medium[0].to_dense(), scene.field(0, fine, law).to_dense().any(-1)
    for i in range(1, count):
        now = medium[i].to_dense()
        raw = scene.field(i, fine, law).to_dense().any(-1) if world == "causal" else raw_before
        is_known = ~spread(np.asarray(raw & ~raw_before), fine, grid, reach_m)
        both = before.any(-1) & now.any(-1)
        change = np.linalg.norm(now - before, axis=-1)
        beyond = both & (change > np.maximum(0.05, 0.1 * np.linalg.norm(before, axis=-1)))
        counts += [[beyond.sum(), both.sum()], [(beyond & is_known).sum(), (both & is_known).sum()]]
        changes.append(change[both])
        before, raw_before = now, raw
    changed_fraction, changed_fraction_known = (counts[:, 0] / counts[:, 1]).tolist()
    row: Row = {
        "sequence": name,
        "world": world,
        "share": changed_fraction,
        "change_n": float(np.concatenate(changes).mean()),
    }
    row |= {
        "bytes": done.file_bytes,
        "of_then": done.file_bytes / FIRST_RUN[name]["bytes"],
        "then": FIRST_RUN[name],
    }
    row["of_frames"] = done.file_bytes / (frames_bytes or done.file_bytes)
    if world == "causal":
        row |= {"share_newly_seen_apart": changed_fraction_known, "apart": 1 - counts[1, 1] / counts[0, 1]}
    return row


def first_contact() -> Row:
    """Return the error of the first contact along rays of ICL frame 0, hand mm.

    The field is fused and filtered. The contact is moved back by |F| / K and compared with the depth.
    """
    prepared = prepare(str(FOLDERS[ICL]), spec_of("fused"))
    field, placement = prepared.medium[0], prepared.placement
    sequence = open_source(str(FOLDERS[ICL]), SourceOptions()).sequence  # type: ignore[attr-defined]
    k, depth = sequence.intrinsics, np.asarray(sequence.depth_m(0), np.float64)
    v, u = np.mgrid[4 : depth.shape[0] : 8, 4 : depth.shape[1] : 8].reshape(2, -1)
    rays = np.stack([(u - k.cx) / k.fx, (v - k.cy) / k.fy, np.ones(len(u))], -1)
    true_m = placement.scale * depth[v, u] * np.linalg.norm(rays, axis=1)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    start_m = -placement.scale * np.asarray(placement.offset_m)
    low, high = field.grid.box_m
    end_points = start_m + rays * true_m[:, None]
    is_visible = (true_m > 0) & ((end_points > low) & (end_points < high)).all(axis=1)
    rays, true_m = rays[is_visible], true_m[is_visible]
    row: Row = {"rays": len(rays), "spacing_mm": 1e3 * field.grid.spacing_m[0]}
    for key, level_n in (("first", FLOOR_N), ("at_1_n", LEVEL_N)):
        error = _first_hit_m(field, start_m, rays, level_n, float(true_m.max()) + 0.02) - true_m
        missed, found = float(np.isnan(error).mean()), 1e3 * np.abs(error[~np.isnan(error)])
        row[key] = {"median_mm": np.median(found), "p95_mm": np.percentile(found, 95), "missed": missed}
        row[key]["signed_median_mm"] = 1e3 * np.nanmedian(error)
    return row


def _first_hit_m(
    field: ForceField, start_m: NDArray[Any], rays: NDArray[Any], level_n: float, max_distance_m: float
) -> NDArray[np.float64]:
    """Return metres along each ray to the surface, from the first |F| of `level_n`.

    NaN where a ray meets no such force.
    """
    found, open_ = np.full(len(rays), np.nan), np.arange(len(rays))
    for way_m in np.arange(0.0, max_distance_m, STEP_M):
        forces = field.sample_n(start_m + way_m * rays[open_]).astype(np.float64)
        size = np.linalg.norm(forces, axis=1)
        hit = size >= level_n
        hit_rays, at = rays[open_[hit]], forces[hit] / size[hit, None]
        facing = np.maximum(-(at * hit_rays).sum(axis=1), 0.1)  # limits the correction on grazing planes
        found[open_[hit]] = way_m - size[hit] / EncodeSpec().stiffness_n_per_m / facing
        open_ = open_[~hit]
    return found


def at_rest(name: str) -> Row:
    """Return the vibration of a hand at rest while the stream loops, mN rms.

    The hand rests on the surface; the band is 40 to 400 Hz.
    """
    row: Row = {"sequence": name, "points": POINTS, "seconds": REST_S}
    points = None
    for world in ("fused", "frames"):
        powers, once, forces_n = [], [], []
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "it.touch"
            done = encode(str(FOLDERS[name]), path, spec_of(world, nw=6))
            if points is None:
                middle = done.prepared.medium[len(done.prepared.medium) // 2]
                points = points_on_surface(middle, POINTS, np.random.default_rng(0))
            with open_file(path) as stream:
                profile = replace(device("phantom-omni"), axes=stream.medium.axes)
                length_s = len(stream.medium) / stream.medium.rate_hz
                for point in points:
                    opener = partial(SimHand, Trace(np.array([0.0, REST_S]), np.stack([point, point])))
                    log = run_offline(stream.medium, profile, opener, seconds=REST_S, loop=True).log
                    log = log[log["time_s"] >= RAMP_S]
                    vibration_n2 = (in_band(log["field_force_n"], 1000.0) ** 2).sum(axis=1)
                    powers.append(vibration_n2.mean())
                    forces_n.append(np.linalg.norm(log["field_force_n"], axis=1).mean())
                    margin = round(1000 * MARGIN_S)
                    once.append(vibration_n2[: max(1, round(1000 * (length_s - RAMP_S)) - 2 * margin)].mean())
        row[world] = {"mn": 1e3 * np.sqrt(np.mean(powers)), "worst_mn": 1e3 * np.sqrt(np.max(powers))}
        row[world] |= {
            "first_pass_mn": 1e3 * np.sqrt(np.mean(once)),
            "force_n": np.mean(forces_n),
            "bytes": done.file_bytes,
        }
        assert np.mean(forces_n) > 0.1, "a hand that touches nothing tells nothing"
    return row


def speed(name: str, rounds: int) -> Row:
    """Return frames fused per second at n_w 7, and the bytes of the volume.

    Frames are read from files and from memory; the peers read from memory.
    """
    scene: Any = open_source(str(FOLDERS[name]), SourceOptions())
    fine, law = requested_lattice(scene, spec_of("fused"))
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
    rate, volume, parts_ms = max((fused() for _ in range(rounds)), key=lambda found: found[0])
    sequence.depth_m = lambda i: depths[i]
    in_memory = max(fused()[0] for _ in range(rounds))
    sequence.depth_m = read
    k = sequence.intrinsics
    inputs: dict[str, Any] = {
        "depths_m": np.stack(depths),
        "poses": np.stack([scene.pose(i) for i in range(count)]),
    }
    inputs |= {"intrinsics": np.array([k.fx, k.fy, k.cx, k.cy]), "voxel_m": np.array(np.mean(fine.spacing_m))}
    with tempfile.TemporaryDirectory() as out:
        np.savez(Path(out) / "depths.npz", **inputs)
        command = [
            os.environ.get("TOUCHFIELD_PEERS", sys.executable),
            str(Path(__file__).parent / "fusion_peers.py"),
        ]
        output = subprocess.run(
            [*command, f"{out}/depths.npz"], check=True, capture_output=True, text=True
        ).stdout
    peers: dict[str, Row] = json.loads(output.splitlines()[-1])
    size = sum(array.nbytes for array in volume.samples)
    return {
        "sequence": name,
        "load": os.getloadavg()[0],
        "frames": count,
        "samples": fine.shape,
        "voxel_mm": 1e3 * float(np.mean(fine.spacing_m)),
        "wall_samples": -law.low_m / float(np.mean(fine.spacing_m)),
        "frames_per_s": rate,
        "in_memory_per_s": in_memory,
        "peers": peers,
        **dict(zip(("planes_ms", "cover_ms", "integrate_ms"), parts_ms, strict=True)),
        "volume_bytes": size,
        "bricks": len(volume.bricks),
        "bytes_per_brick": size / len(volume.bricks),
        "share_of_box": len(volume.bricks) / float(np.prod(fine.brick_shape)),
    }


def measure(frames: int, rounds: int) -> Row:
    """Measure the available sequences."""
    present = [name for name, folder in FOLDERS.items() if folder.is_dir()]
    rows: list[Row] = []
    for name in present:
        frames_bytes = None
        for world in ("frames", "causal", "fused"):
            rows.append(standing(name, world, frames_bytes, frames))
            frames_bytes = frames_bytes or rows[-1]["bytes"]
    figures: Row = {
        "standing": rows,
        "speed": [speed(name, rounds) for name in present],
        "truth": contact_errors_mm(),
    }
    figures["absent"] = [name for name in FOLDERS if name not in present]
    if ICL in present:
        figures["first_contact"] = first_contact()
    if TUM in present:
        figures["at_rest"] = at_rest(TUM)
    return figures


def bars(figures: Row) -> list[Bar]:
    """Require a static world in a quarter of the bytes, accuracy, and speed."""
    found: list[Bar] = []
    for row in figures["standing"]:
        name, world = f"{row['sequence']}, {row['world']}", row["world"]
        if world != "frames":
            changed_fraction = row.get("share_newly_seen_apart", row["share"])
            found.append(
                at_most(f"{name}: samples that change", changed_fraction, 0.01 if world == "fused" else 0.05)
            )
            found.append(
                at_most(f"{name}: bytes of then", row["of_then"], 0.25 if world == "fused" else 0.45)
            )
    for row in figures["speed"]:
        fastest = max(column(row["peers"], "frames_per_s"), default=None)
        over = None if fastest is None else row["in_memory_per_s"] / fastest
        found.append(at_least(f"{row['sequence']}: read and fused", row["frames_per_s"], 30.0, "frames/s"))
        found.append(at_least(f"{row['sequence']}: frames a second over the fastest peer's", over, 1.0))
    contact, rest = (figure(figures, *keys) for keys in (("first_contact", "first"), ("at_rest", "fused")))
    return [
        *found,
        at_most("error of the fused surface over a frame's", figures["truth"]["ratio"], 0.5),
        at_most("first contact, median", figure(contact, "median_mm"), 1.0, "mm of the hand"),
        at_most("a hand at rest, 40 to 400 Hz", figure(rest, "mn"), 5.0, "mN rms"),
    ]


if __name__ == "__main__":
    bench("fusion", __doc__, measure, bars, frames=(10, 3), rounds=(9, 1))
