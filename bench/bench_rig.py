"""Measures the time from rigged models (rigid links, and a smooth skin) to fields and to a file.

    python bench/bench_rig.py [--quick] [--frames N]

Both rigs have 40 joints, about 20,000 triangles and 200 frames (`--frames`). Each link of the rigid rig
follows one joint, so that links become objects. "kept" is the rate, in frames per second, from the open file
to all that a receiver needs: a field for each link, and a pose for each frame. The smooth rig is a tube whose
vertices follow two joints each, so that every frame has a new field. It is timed to the fields on the
device's lattice of 128^3 samples, step by step, and to the file. Both are coded at the default effort; the
smooth rig also without the base layer, whose fit takes most of its time. Processor seconds are given besides
wall seconds, which other work on the machine lengthens.
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

from machine import Bar, Figures, at_least, bench, figure
from touchfield.codec.touch.spec import TouchSpec
from touchfield.compute.threads import worker_count
from touchfield.pipeline.encoding import encode
from touchfield.pipeline.preparation import prepare
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.animation.animated_mesh import AnimatedMeshScene
from touchfield.sources.mesh.mesh_scene import union_of

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
FIELDS, CODED = 16, 40
"""Frames of the smooth rig that are measured, as fields and as a file."""


def clocked(call: Callable[[], Any], frames: int) -> dict[str, float]:
    """Return wall and processor seconds, and frames per second by each.

    The rate by processor time is that of all cores without other work.
    """
    began, spent = time.perf_counter(), time.process_time()
    call()
    spent, took = time.process_time() - spent, time.perf_counter() - began
    return {
        "s": took,
        "processor_s": spent,
        "frames_per_s": frames / took,
        "frames_per_s_undisturbed": frames * worker_count() / spent,
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
        "pseudo-normals": lambda i: surfaces[i].pseudo_normals(),
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


def measure(frames: int) -> Figures:
    """Measure both rigs, to fields and to files."""
    chain_rig = import_module("gltf_makers").chain_rig
    rows: dict[str, dict[str, float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out.touch"
        paths = {}
        for name in ("rigid", "smooth"):
            small = chain_rig(5, 500, 4, rigid=name == "rigid").save(
                Path(folder) / f"small {name}.glb", "glb"
            )
            encode(small, out)  # compile the kernels
            paths[name] = chain_rig(frames=frames, rigid=name == "rigid").save(
                Path(folder) / f"{name}.glb", "glb"
            )

        def coded(name: str, source: str, count: int, touch: TouchSpec) -> None:
            spec = EncodeSpec(frames=(0, count), touch=touch)
            rows[name] = clocked(lambda: encode(paths[source], out, spec), count)
            rows[name]["bytes"] = out.stat().st_size

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
        parts = parts_of_a_frame(paths["smooth"])
        voxels = medium[0].support_count
    fields_s, coded_s = (rows[name]["processor_s"] for name in ("smooth, fields", "smooth, to the file"))
    parts["coding at the default effort"] = 1e3 * (coded_s / count - fields_s / min(frames, FIELDS))
    settings = {"frames": frames, "triangles": triangles, "voxels": voxels, "threads": worker_count()}
    return {**settings, "rows": rows, "parts_ms": parts}


def bars(figures: Figures) -> list[Bar]:
    """Require 100 frames/s of rigid links to memory, and 15 frames/s to a file."""
    limits = {"rigid, kept": 100.0, "rigid, to the file": 15.0, "smooth, to the file": 15.0}
    return [
        at_least(f"{name}{suffix}", figure(figures, "rows", name, f"frames_per_s{key}"), limit, "frames/s")
        for name, limit in limits.items()
        for key, suffix in (("", ""), ("_undisturbed", ", by the processor's time"))
    ]


if __name__ == "__main__":
    bench("rig", __doc__, measure, bars, frames=(200, 8))
