"""Depth sequences as one world that stands still: what trembles, what it costs, how true it is; bars beside figures.

    python bench/bench_fusion.py

"then" are the figures of the first run, each frame alone, by the coder and filter of that time. A voxel changes if it
differs from frame to frame by more than max(0.05 N, 0.1 |F|); of those held in both frames. Newly seen, and apart: a
sample of the oversampled lattice within the low-pass's reach is held that was not in the frame before. Peers are run
by TOUCHFIELD_PEERS, the path of a Python interpreter that has them (default: this one). Keeps results/fusion.json
and fusion.png; exits with 0 whether bars are met or not.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_picture import draw
from fusion_speed import MET, Row, asked_of, bar, spec_of, speed
from fusion_truth import contact_errors_mm
from machine import RESULTS, keep
from touchfield.adapters.sim import SimHand
from touchfield.devices import device
from touchfield.filters.resample import low_pass, nyquist_per_m
from touchfield.job import EncodeSpec, encode, open_stream, prepare
from touchfield.medium import ForceField, Grid
from touchfield.medium.trace import Trace
from touchfield.perception.slides import MARGIN_S, in_band, points_on_surface
from touchfield.render.offline import run_offline
from touchfield.sources.options import SourceOptions
from touchfield.sources.registry import open_source

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"
TUM, ICL = "TUM fr1_rpy", "ICL living room"
FOLDERS = {TUM: SHARED / "rgbd_tum_fr1_rpy", ICL: SHARED / "rgbd_iclnuim_livingroom1"}
THEN = {
    TUM: {"share": 0.72, "change_n": 0.295, "bytes": 43_617},
    ICL: {"share": 0.22, "change_n": 0.080, "bytes": 59_890},
}
MOST_SHARE = {"fused": 0.01, "causal": 0.05}
MOST_BYTES = {"fused": 0.25, "causal": 0.45}
MOST_ERROR_RATIO, MOST_CONTACT_MM, MOST_AT_REST_MN = 0.5, 1.0, 5.0
FRAMES = 10
REST_S, RAMP_S, POINTS = 3.0, 0.2, 6
STEP_M, FLOOR_N, LEVEL_N = 1e-4, 0.034, 1.0


def spread(new: NDArray[np.bool_], fine: Grid, grid: Grid, reach_m: float) -> NDArray[np.bool_]:
    """Samples of `grid` within whose reach one of `fine`, bool, is true; both in the same metres."""
    for axis in range(3):
        at = (grid.axis_m(axis) - fine.origin_m[axis]) / fine.spacing_m[axis]
        reach, size = reach_m / fine.spacing_m[axis], new.shape[axis]
        low, high = (np.clip(x.astype(int), 0, size) for x in (np.ceil(at - reach), np.floor(at + reach) + 1))
        sums = np.insert(np.cumsum(new, axis), 0, 0, axis)
        new = np.take(sums, high, axis) > np.take(sums, low, axis)
    return new


def standing(name: str, world: str, frames_bytes: int | None) -> Row:
    """What changes from frame to frame of ten, and the bytes."""
    spec = spec_of(world, nw=6, frames=(0, FRAMES))
    with tempfile.TemporaryDirectory() as folder:
        done = encode(str(FOLDERS[name]), Path(folder) / "it.touch", spec)
    medium, placement = done.prepared.medium, done.prepared.placement
    scene = open_source(str(FOLDERS[name]), spec.source)
    scene.take(0, FRAMES)
    fine, law = asked_of(scene, spec)  # type: ignore[arg-type]
    grid = placement.to_scene(medium.grid)
    reach_m = low_pass("spline").half_width / nyquist_per_m(grid)[0]
    counts, changes = np.zeros((2, 2)), []
    before, raw_before = medium[0].to_dense(), scene.field(0, fine, law).to_dense().any(-1)
    for i in range(1, FRAMES):
        now = medium[i].to_dense()
        raw = scene.field(i, fine, law).to_dense().any(-1) if world == "causal" else raw_before
        seen = ~spread(np.asarray(raw & ~raw_before), fine, grid, reach_m)
        both = before.any(-1) & now.any(-1)
        change = np.linalg.norm(now - before, axis=-1)
        beyond = both & (change > np.maximum(0.05, 0.1 * np.linalg.norm(before, axis=-1)))
        counts += [[beyond.sum(), both.sum()], [(beyond & seen).sum(), (both & seen).sum()]]
        changes.append(change[both])
        before, raw_before = now, raw
    share, share_seen = (counts[:, 0] / counts[:, 1]).tolist()
    row: Row = {"sequence": name, "world": world, "share": share, "change_n": float(np.concatenate(changes).mean())}
    row |= {"bytes": done.file_bytes, "of_then": done.file_bytes / THEN[name]["bytes"], "then": THEN[name]}
    row["of_frames"] = done.file_bytes / (frames_bytes or done.file_bytes)
    if world == "causal":
        row |= {"share_newly_seen_apart": share_seen, "apart": 1 - counts[1, 1] / counts[0, 1]}
    told = f"{name:16} {world:7} {100 * share:6.2f} % (then {100 * THEN[name]['share']:.0f} %)"
    told += f" {row['change_n']:6.3f} N (then {THEN[name]['change_n']:.3f}) {row['bytes']:7,} bytes,"
    print(f"{told} {row['of_then']:.2f} of then, {row['of_frames']:.2f} of frames", flush=True)
    if world != "frames":
        held = row.get("share_newly_seen_apart", share)
        apart = f", {100 * row['apart']:.0f} % newly seen apart" if "apart" in row else ""
        verdicts = bar(held, MOST_SHARE[world]), bar(row["of_then"], MOST_BYTES[world])
        print(f"{'':24} changing {100 * held:.2f} %{apart} {verdicts[0]}; bytes of then {verdicts[1]}", flush=True)
    return row


def first_contact() -> Row:
    """Where rays of frame 0 of ICL first meet the filtered fused field, against the rendered depth; hand mm."""
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
    ends = start_m + rays * true_m[:, None]
    seen = (true_m > 0) & ((ends > low) & (ends < high)).all(axis=1)
    rays, true_m = rays[seen], true_m[seen]
    row: Row = {"rays": len(rays), "spacing_mm": 1e3 * field.grid.spacing_m[0]}
    for key, level_n in (("first", FLOOR_N), ("at_1_n", LEVEL_N)):
        error = _met_m(field, start_m, rays, level_n, float(true_m.max()) + 0.02) - true_m
        missed, found = float(np.isnan(error).mean()), 1e3 * np.abs(error[~np.isnan(error)])
        row[key] = {"median_mm": np.median(found), "p95_mm": np.percentile(found, 95), "missed": missed}
        row[key]["signed_median_mm"] = 1e3 * np.nanmedian(error)
        print(
            f"first contact at {level_n:g} N, less |F|/K: " + ", ".join(f"{n} {x:.3f}" for n, x in row[key].items())
        )
    print("    median of the first contact, hand mm", bar(row["first"]["median_mm"], MOST_CONTACT_MM))
    return row


def _met_m(
    field: ForceField, start_m: NDArray[Any], rays: NDArray[Any], level_n: float, far_m: float
) -> NDArray[np.float64]:
    """Metres along each ray to the surface that the first |F| of that level tells of, NaN where there is none."""
    found, open_ = np.full(len(rays), np.nan), np.arange(len(rays))
    for way_m in np.arange(0.0, far_m, STEP_M):
        forces = field.sample_n(start_m + way_m * rays[open_]).astype(np.float64)
        size = np.linalg.norm(forces, axis=1)
        hit = size >= level_n
        met, at = rays[open_[hit]], forces[hit] / size[hit, None]
        facing = np.maximum(-(at * met).sum(axis=1), 0.1)  # grazing planes tell of a place far along the ray
        found[open_[hit]] = way_m - size[hit] / EncodeSpec().stiffness_n_per_m / facing
        open_ = open_[~hit]
    return found


def at_rest(name: str) -> tuple[Row, dict[str, ForceField]]:
    """A hand held for 3 s at points of the surface, the stream played over and over; a frame of each world."""
    row: Row = {"sequence": name, "points": POINTS, "seconds": REST_S}
    frames: dict[str, ForceField] = {}
    points = None
    for world in ("fused", "frames"):
        powers, once, held = [], [], []
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "it.touch"
            done = encode(str(FOLDERS[name]), path, spec_of(world, nw=6))
            frames[world] = done.prepared.medium[len(done.prepared.medium) // 2]
            points = (
                points_on_surface(frames["fused"], POINTS, np.random.default_rng(0)) if points is None else points
            )
            with open_stream(path) as stream:
                profile = replace(device("phantom-omni"), axes=stream.medium.axes)
                length_s = len(stream.medium) / stream.medium.rate_hz
                for point in points:
                    opener = partial(SimHand, Trace(np.array([0.0, REST_S]), np.stack([point, point])))
                    log = run_offline(stream.medium, profile, opener, seconds=REST_S, loop=True).log
                    log = log[log["time_s"] >= RAMP_S]
                    felt = (in_band(log["field_force_n"], 1000.0) ** 2).sum(axis=1)
                    powers.append(felt.mean())
                    held.append(np.linalg.norm(log["field_force_n"], axis=1).mean())
                    margin = round(1000 * MARGIN_S)
                    once.append(felt[: max(1, round(1000 * (length_s - RAMP_S)) - 2 * margin)].mean())
        row[world] = {"mn": 1e3 * np.sqrt(np.mean(powers)), "worst_mn": 1e3 * np.sqrt(np.max(powers))}
        row[world] |= {
            "first_pass_mn": 1e3 * np.sqrt(np.mean(once)),
            "force_n": np.mean(held),
            "bytes": done.file_bytes,
        }
        assert np.mean(held) > 0.1, "a hand that touches nothing tells nothing"
        print(
            f"hand at rest, {name}, {world}: " + ", ".join(f"{n} {x:.2f}" for n, x in row[world].items()), flush=True
        )
    print("    40 to 400 Hz of fused, mN rms", bar(row["fused"]["mn"], MOST_AT_REST_MN))
    return row, frames


def main() -> None:
    """Print and keep the figures; draw the picture."""
    here = [name for name, folder in FOLDERS.items() if folder.is_dir()]
    for name in FOLDERS:
        print("" if name in here else f"{name}: not here, skipped\n", end="")
    rows: list[Row] = []
    for name in here:
        frames_bytes = None
        for world in ("frames", "causal", "fused"):
            rows.append(standing(name, world, frames_bytes))
            frames_bytes = frames_bytes or rows[-1]["bytes"]
    figures: Row = {
        "standing": rows,
        "speed": [speed(name, FOLDERS[name]) for name in here],
        "truth": contact_errors_mm(),
    }
    truth = figures["truth"]
    told = f"truth: a frame {truth['single_mm']:.2f} mm, fused {truth['fused_mm']:.2f} mm, ratio {truth['ratio']:.2f}"
    print(told, bar(truth["ratio"], MOST_ERROR_RATIO))
    if ICL in here:
        figures["first_contact"] = first_contact()
    if TUM in here:
        figures["at_rest"], worlds = at_rest(TUM)
        draw(RESULTS / "fusion.png", "TUM fr1_rpy, n_w 6, frame 12 of 24: alone, and the world fused of all", worlds)
    print(f"{sum(MET)} of {len(MET)} bars met")
    keep("fusion", {"met": sum(MET), "bars": len(MET), **figures})


if __name__ == "__main__":
    main()
