"""Measures time and bytes from rigged models (rigid links, a robot, a smooth skin) to fields and to a file.

    python bench/bench_rig.py [--quick] [--frames N] [--fox FOX.glb]

All rigs have 40 joints, about 20,000 triangles and 200 frames (`--frames`). Each link of the rigid rig
follows one joint, so that links become objects. "kept" is the rate, in frames per second, from the open file
to all that a receiver needs: a field for each link, and a pose for each frame. The robot has legs whose links
overlap at their joints. It is encoded as objects, which is the default, and as fields, which was the default
before. The smooth rig is a tube whose vertices follow two joints each, so that every frame has a new field.
It is timed to the fields on the device's lattice of 128^3 samples, step by step, and to the file. All are
coded at the default effort; the smooth rig also without the base layer, whose fit takes most of its time.
Processor seconds are given besides wall seconds, which other work on the machine lengthens, and the
fraction of all cores' time that is used ("cores_busy"); other work on the machine lowers it.

The running fox of the Khronos samples, if it is there, is encoded with all its frames. Its bytes have a bar
of half of what they were on 29 November 2026.

"Deformed" asks whether a field at rest and moving control points (paper section 6.3) could replace fields.
The field of one frame is deformed by tracks of 8^3 control points to six frames on each side of it. Given
are the fraction of the samples above F_0 that exceed the error bound max(F_0, k |F|), and bytes per frame: of
the coded fields, of the tracks, and of the differences at the samples outside the bound, which would have to
be sent besides the tracks.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from bench_deformation import SIDE, model
from machine import SHARED, Bar, Figures, at_least, at_most, bench, figure
from touchfield.codec.touch.encoder import TouchEncoder
from touchfield.codec.touch.spec import TouchSpec
from touchfield.compute.threads import worker_count
from touchfield.medium import ForceField, HapticMedium
from touchfield.pipeline.encoding import encode
from touchfield.pipeline.preparation import prepare
from touchfield.pipeline.spec import EncodeSpec
from touchfield.render.sampler import FieldSampler
from touchfield.sources.animation.animated_mesh import AnimatedMeshScene
from touchfield.sources.mesh.mesh_scene import union_of
from touchfield.sources.options import SourceOptions

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
FIELDS, CODED = 16, 40
"""Frames of a rig that are measured, as fields and as a file."""
FOX = SHARED / "meshes" / "fox" / "Fox.glb"
FOX_BYTES = 1902.1
"""Bytes of a frame of the running fox on 29 November 2026."""


def clocked(call: Callable[[], Any], frames: int) -> dict[str, float]:
    """Return wall and processor seconds, frames per second by each, and how busy all cores are.

    The rate by processor time is that of all cores without other work, all of them busy.
    """
    began, spent = time.perf_counter(), time.process_time()
    call()
    spent, took = time.process_time() - spent, time.perf_counter() - began
    return {
        "s": took,
        "processor_s": spent,
        "frames_per_s": frames / took,
        "frames_per_s_undisturbed": frames * worker_count() / spent,
        "processor_ms_per_frame": 1e3 * spent / frames,
        "cores_busy": spent / (took * worker_count()),
    }


def parts_of_a_frame(path: Path) -> dict[str, float]:
    """Return processor milliseconds of a frame of the smooth rig, by step."""
    scene = AnimatedMeshScene(path)
    medium = prepare(scene, EncodeSpec()).medium
    frames = np.linspace(0, scene.frame_count - 1, FIELDS).astype(int).tolist()
    surfaces = [scene.surface(frame) for frame in frames]
    calls: dict[str, Callable[[int], Any]] = {
        "joints and skin": lambda i: scene.vertices_m(frames[i]),
        "surface on its vertices": lambda i: surfaces[0].with_vertices(surfaces[i].vertices_m),
        "search for overlaps": lambda i: union_of(surfaces[i]),
        "all, with distance, sign and device filter": lambda i: medium[frames[i]],
    }
    times_ms = {}

    def each_of(call: Callable[[int], Any]) -> None:
        for i in range(FIELDS):
            call(i)

    for name, call in calls.items():
        call(0)
        times_ms[name] = 1e3 * clocked(partial(each_of, call), FIELDS)["processor_s"] / FIELDS
    return times_ms


def deformed(path: Path, rest: int, folder: Path) -> Figures:
    """Deform the field of frame `rest` to the frames around it, and compare it with theirs."""
    frames, field, tracks, _ = model(path, rest, 7, folder)
    grid, spec = field.grid, TouchSpec()
    sampler = FieldSampler(HapticMedium.from_frames([field], tracks.rate_hz), deformation=tracks)
    counts, differences = list[tuple[int, int]](), list[ForceField]()
    for n, frame in enumerate(frames):
        indices = np.unique(np.concatenate([frame.positions(), field.positions()]), axis=0)
        at = grid.to_m(indices)
        rendered = sampler.force_n(np.full(len(at), n / tracks.rate_hz), at).astype(float)
        expected = frame.sample_n(at).astype(float)
        size = np.linalg.norm(expected, axis=1)
        is_outside = np.linalg.norm(rendered - expected, axis=1) > np.maximum(spec.f0_n, spec.k * size)
        is_perceptible = size > spec.f0_n
        counts.append((int((is_outside & is_perceptible).sum()), int(is_perceptible.sum())))
        dense = np.zeros((*grid.shape, 3), np.float32)
        dense[tuple(indices[is_outside].T)] = (expected - rendered)[is_outside]
        differences.append(ForceField.from_dense(grid, dense))
    tracks.write(folder / "tracks.npz")
    outside, perceptible = np.array(counts).T
    return {
        "outside_bound": float(outside.sum() / perceptible.sum()),
        "outside_bound_worst_frame": float((outside / np.maximum(perceptible, 1)).max()),
        "coded_bytes": len(TouchEncoder(grid, spec).encode_segment(frames).body) / len(frames),
        "track_bytes": (folder / "tracks.npz").stat().st_size / len(frames),
        "difference_bytes": len(TouchEncoder(grid, spec).encode_segment(differences).body) / len(frames),
    }


def rig_files(frames: int, folder: Path) -> dict[str, Path]:
    """Write the rigs, and encode small ones like them, which compiles the kernels."""
    makers = import_module("gltf_makers")
    rigs = {
        "rigid": (makers.chain_rig(5, 500, 4, rigid=True), makers.chain_rig(frames=frames, rigid=True)),
        "smooth": (makers.chain_rig(5, 500, 4), makers.chain_rig(frames=frames)),
        "robot": (makers.robot_rig(3, 2, 900, 4), makers.robot_rig(frames=frames)),
    }
    for name, (small, _) in rigs.items():
        encode(small.save(folder / f"small {name}.glb", "glb"), folder / "out.touch")
    return {name: rig.save(folder / f"{name}.glb", "glb") for name, (_, rig) in rigs.items()}


def measure(frames: int, fox: Path) -> Figures:
    """Measure the rigs and the fox, to fields and to files."""
    rows: dict[str, dict[str, float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        out, paths = Path(folder) / "out.touch", rig_files(frames, Path(folder)) | {"fox": fox}

        def coded(name: str, rig: str, count: int, touch: TouchSpec, **options: Any) -> None:
            spec = EncodeSpec(frames=(0, count), touch=touch, **options)
            rows[name] = clocked(lambda: encode(paths[rig], out, spec), count)
            rows[name]["bytes"] = out.stat().st_size
            rows[name]["bytes_per_frame"] = out.stat().st_size / count

        triangles = len(AnimatedMeshScene(paths["smooth"]).surface(0).triangles)
        rows["rigid, kept"] = clocked(lambda: prepare(paths["rigid"], EncodeSpec()), frames)
        coded("rigid, to the file", "rigid", frames, TouchSpec())
        medium = prepare(paths["smooth"], EncodeSpec()).medium
        rows["smooth, fields"] = clocked(
            lambda: [medium[i] for i in range(min(frames, FIELDS))], min(frames, FIELDS)
        )
        count = min(frames, CODED)
        coded("smooth, to the file", "smooth", count, TouchSpec())
        coded("smooth, without guess", "smooth", count, TouchSpec(guess="off"))
        coded("robot, to the file", "robot", frames, TouchSpec())
        coded("robot, as fields", "robot", count, TouchSpec(), representation="voxel")
        parts, sources = parts_of_a_frame(paths["smooth"]), {}
        if frames > 2 * SIDE:
            sources["smooth"] = paths["smooth"], SIDE
        if fox.is_file():
            run = SourceOptions(animation="Run", rate_hz=60, unit_m=0.01)
            coded(
                "fox, to the file", "fox", AnimatedMeshScene(fox, "Run").frame_count, TouchSpec(), source=run
            )
            sources["fox, about frame 60"] = fox, 60
        rests = {name: deformed(*source, Path(folder)) for name, source in sources.items()}
        voxels = medium[0].support_count
    fields_s, coded_s = (rows[name]["processor_s"] for name in ("smooth, fields", "smooth, to the file"))
    parts["coding at the default effort"] = 1e3 * (coded_s / count - fields_s / min(frames, FIELDS))
    settings = {"frames": frames, "triangles": triangles, "voxels": voxels, "threads": worker_count()}
    return {**settings, "rows": rows, "deformed": rests, "parts_ms": parts}


def bars(figures: Figures) -> list[Bar]:
    """Require 100 frames/s of rigid links to memory, 15 frames/s to a file, and half of the bytes before."""
    files = ("rigid, to the file", "robot, to the file", "smooth, to the file")
    limits = {"rigid, kept": 100.0, **dict.fromkeys(files, 15.0)}
    rates = [
        at_least(f"{name}{suffix}", figure(figures, "rows", name, f"frames_per_s{key}"), limit, "frames/s")
        for name, limit in limits.items()
        for key, suffix in (("", ""), ("_undisturbed", ", by the processor's time"))
    ]
    return [
        *rates,
        at_most(
            "robot, bytes over those as fields", _over(figures, "robot, to the file", "robot, as fields"), 0.5
        ),
        at_most("fox, bytes over those before", _over(figures, "fox, to the file", FOX_BYTES), 0.5),
    ]


def _over(figures: Figures, name: str, other: str | float) -> float | None:
    """Return the bytes of a frame of a row over those of another row, or over a number."""
    size = figure(figures, "rows", name, "bytes_per_frame")
    before = other if isinstance(other, float) else figure(figures, "rows", other, "bytes_per_frame")
    return size / before if size and before else None


if __name__ == "__main__":
    bench("rig", __doc__, measure, bars, frames=(200, 8), fox=(FOX, FOX))
