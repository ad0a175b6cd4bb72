"""A rig of 40 joints, 20 thousand triangles and 200 frames, to fields and to a file: rigid links, and a smooth skin.

    python bench/bench_rig.py [frames]

Of the rigid rig each link goes with one joint: its links become objects. "Kept" is how many frames a second come from
the open file to all that a receiver needs of them, a field for each link and a pose for each frame. The smooth rig is
a tube whose vertices go with two joints each, a field of its own in every frame: timed to the fields on the device's
lattice of 128^3, part by part, and to the file. Both are coded at the default effort; the smooth one also without the
coder's guess of the field, whose fit takes most of its time. Beside the seconds by the clock stand those of the
processor, as other work on the machine lengthens the first.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from machine import keep
from touchfield.codec.touch.spec import TouchSpec
from touchfield.job import EncodeSpec
from touchfield.job.encode import encode
from touchfield.job.prepare import prepare
from touchfield.parallel import worker_count
from touchfield.sources.animated_mesh import AnimatedMeshScene
from touchfield.sources.mesh_scene import union_of

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
KEPT_PER_S, ENCODED_PER_S = 100.0, 15.0
FIELDS, CODED = 16, 40
"""Frames of the smooth rig that are measured, as fields and as a file."""


def clocked(call: Callable[[], Any], frames: int) -> dict[str, float]:
    """Seconds by the clock and of the processor, and frames a second by each (of the processor: on all its cores)."""
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
    """Processor milliseconds of a frame of the smooth rig, by what is done."""
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
    told = {}
    for name, call in calls.items():
        call(0)
        told[name] = 1e3 * clocked(lambda call=call: [call(i) for i in range(FIELDS)], FIELDS)["processor_s"] / FIELDS
    return told


def main() -> None:
    """Print the table and keep the figures."""
    chain_rig = import_module("gltf_makers").chain_rig
    frames = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    rows: dict[str, dict[str, float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out.touch"
        paths = {}
        for name in ("rigid", "smooth"):
            small = chain_rig(5, 500, 4, rigid=name == "rigid").save(Path(folder) / f"small {name}.glb", "glb")
            encode(small, out)  # compiles
            paths[name] = chain_rig(frames=frames, rigid=name == "rigid").save(Path(folder) / f"{name}.glb", "glb")
        triangles = len(AnimatedMeshScene(paths["smooth"]).surface(0).triangles)
        rows["rigid, kept"] = clocked(lambda: prepare(paths["rigid"], EncodeSpec()), frames)
        rows["rigid, to the file"] = clocked(lambda: encode(paths["rigid"], out), frames)
        rows["rigid, to the file"]["bytes"] = out.stat().st_size
        medium = prepare(paths["smooth"], EncodeSpec()).medium
        rows["smooth, fields"] = clocked(lambda: [medium[i] for i in range(FIELDS)], FIELDS)
        coded = min(frames, CODED)
        some = EncodeSpec(frames=(0, coded))
        rows["smooth, to the file"] = clocked(lambda: encode(paths["smooth"], out, some), coded)
        rows["smooth, to the file"]["bytes"] = out.stat().st_size
        bare = EncodeSpec(frames=(0, coded), touch=TouchSpec(guess="off"))
        rows["smooth, without guess"] = clocked(lambda: encode(paths["smooth"], out, bare), coded)
        rows["smooth, without guess"]["bytes"] = out.stat().st_size
        parts = parts_of_a_frame(paths["smooth"])
        voxels = medium[0].support_count
    print(
        f"{triangles} triangles, 40 joints, {frames} frames, {medium.grid.shape}, {voxels} voxels with a force,",
        end=" ",
    )
    print(f"{worker_count()} threads")
    for name, row in rows.items():
        print(
            f"  {name:22} {row['frames_per_s']:8.1f} frames/s, {row['frames_per_s_undisturbed']:8.1f} undisturbed",
            end="",
        )
        print(f", {row['bytes']:,} bytes" if "bytes" in row else "")
    print("processor milliseconds of a frame of the smooth rig:")
    for name, ms in parts.items():
        print(f"  {name:44} {ms:7.1f}")
    made, coded_s = (rows[name]["processor_s"] for name in ("smooth, fields", "smooth, to the file"))
    parts["coding at the default effort"] = 1e3 * (coded_s / coded - made / FIELDS)
    print(f"  {'coding at the default effort':44} {parts['coding at the default effort']:7.1f}")
    bars = {
        "rigid, kept": KEPT_PER_S,
        "rigid, to the file": ENCODED_PER_S,
        "smooth, to the file": ENCODED_PER_S,
    }
    verdicts = {
        name: {
            "bar_frames_per_s": bar,
            "is_kept": rows[name]["frames_per_s"] >= bar,
            "is_kept_undisturbed": rows[name]["frames_per_s_undisturbed"] >= bar,
        }
        for name, bar in bars.items()
    }
    for name, told in verdicts.items():
        words = ["kept" if told[key] else "NOT KEPT" for key in ("is_kept", "is_kept_undisturbed")]
        print(f"bar {name}, at least {told['bar_frames_per_s']:g} frames/s: {words[0]} ({words[1]} undisturbed)")
    figures = {"frames": frames, "triangles": triangles, "voxels": voxels, "rows": rows, "parts_ms": parts}
    keep("rig", {**figures, "bars": verdicts})


if __name__ == "__main__":
    main()
