"""Guards against slower code: measures the processor time of each kernel (compiled inner loop), relative to a
stored loop that never changes.

    python bench/bench_guard.py [--quick] [--only NAME,NAME] [--store]

A kernel and its frozen loop (`reference.kernels`) run alternately on one thread. The processor time of each
run of the kernel is divided by the mean of the frozen loop's runs before and after it. The median of these
ratios depends little on other processes or on the speed of the machine.

A ratio above `MARGIN` times the stored one is measured for up to `TRIES` times as long, and then in up to
`PROCESSES` other processes, which removes noise. If it is still above the limit, the benchmark fails with
exit status 1. In a quick run, which has fewer rounds and may share its machine, the limit is `QUICK_MARGIN`.

`--only` selects groups of kernels. `--store` stores the ratios of this run as the new reference, after a
kernel has become faster, or slower on purpose. Ratios are stored for each processor model, because they
differ between models. On a model without stored ratios they are shown and not judged; `--store` adds the
model.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from math import inf
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

os.environ["TOUCHFIELD_THREADS"] = os.environ["NUMBA_NUM_THREADS"] = "1"

import numpy as np

import provenance
from bench_depth import HIGH_M, LOW_M, IndoorSequence, wall
from bench_filter import shell
from bench_mesh import BAND, bumpy
from bench_objects import scene
from bench_query import SIDE, SPACING_M, field, path
from machine import Bar, Figures, arguments, at_most, keep, machine, show, stored
from reference import kernels as frozen
from timing import Clock, call_clock, paired_cpu_ms
from touchfield.codec.touch.decoder import TouchDecoder
from touchfield.codec.touch.encoder import TouchEncoder
from touchfield.codec.touch.spec import TouchSpec
from touchfield.filters.smoothing import GaussianFilter, gaussian, gaussian_taps
from touchfield.medium import Grid, HapticMedium
from touchfield.render.sampler import FieldSampler
from touchfield.sources.depth.depth_scene import DepthScene, force_bricks, query_of
from touchfield.sources.depth.kernels.field import (
    _fill as fill_bricks,
    brick_forces,
    holds_force,
    may_hold_force,
)
from touchfield.sources.laws import ForceProfile
from touchfield.sources.mesh.mesh_scene import MeshScene
from touchfield.sources.scene import find_bricks_by_block

MARGIN = 1.15
"""Largest allowed ratio over the stored one.

A kernel that is a third slower has 1.33; noise is a few hundredths.
"""
QUICK_MARGIN = 1.25
TRIES, PROCESSES = 4, 3
ROUNDS = {True: 15, False: 60}
"""Runs of each of a pair, in quick runs (True) and otherwise."""
SIGMA = 2.0


class Pair(NamedTuple):
    """A kernel and its frozen reference loop."""

    ours: Clock
    reference: Clock

    @classmethod
    def of(cls, ours: Callable[[], Any], reference: Callable[[], Any]) -> Pair:
        """Return the pair of clocks of two whole calls."""
        return cls(call_clock(ours), call_clock(reference))


def depth_pairs() -> dict[str, Pair]:
    """Pairs for a depth image: tangent planes, search for bricks, and forces."""
    sequence, grid = IndoorSequence(), Grid.over_box(LOW_M, HIGH_M, (128, 128, 128))
    prepared_scene, image = DepthScene(sequence), sequence.depth_m(0)
    step_per_m = prepared_scene._noise_step_per_m()
    query = query_of(prepared_scene.planes(0), np.eye(4), grid, wall(grid))
    bricks = force_bricks(query, grid)
    out = brick_forces(bricks, query).reshape(-1)
    candidates = find_bricks_by_block(lambda blocks, size: may_hold_force(blocks, size, query), grid)
    planes, dense = np.zeros((*image.shape, 4), np.float32), np.zeros((64, 64, 64, 3), np.float32)
    frozen.image_planes(image, planes)
    small = np.ascontiguousarray(
        planes[::2, ::2]
    )  # fits in the cache; shared memory bandwidth would add noise

    def reference() -> None:
        frozen.projected_forces(small, dense)

    return {
        "depth, planes": Pair.of(
            lambda: DepthScene(sequence, step_per_m=step_per_m).planes(0),
            lambda: frozen.image_planes(image, planes),
        ),
        "depth, bricks": Pair.of(lambda: holds_force(candidates, query), reference),
        "depth, forces": Pair.of(lambda: fill_bricks(0, len(bricks), bricks, query, out), reference),
    }


def mesh_pairs() -> dict[str, Pair]:
    """Pairs for the band of a mesh, with and without building the tree."""
    vertices, faces = bumpy(4)
    grid = Grid.over_box((-1.0,) * 3, (1.0,) * 3, (128, 128, 128))
    width = BAND * grid.spacing_m[0]
    law = ForceProfile(((-width, width, 2.0, 1 / width),))
    built_scene, corners = MeshScene(vertices, faces), vertices[faces[::16]].astype(np.float64)
    points = np.random.default_rng(0).uniform(-1, 1, (4000, 3))
    out = np.zeros(len(points))

    def reference() -> None:
        frozen.triangle_distances(points, corners, out)

    return {
        "mesh, tree and band": Pair.of(lambda: MeshScene(vertices, faces).field(0, grid, law), reference),
        "mesh, band": Pair.of(lambda: built_scene.field(0, grid, law), reference),
    }


def gaussian_pairs() -> dict[str, Pair]:
    """Pairs for a dense field, and for a wall of 2 % of its samples."""
    side = 96
    dense = np.random.default_rng(0).normal(size=(side, side, side, 3)).astype(np.float32)
    taps = gaussian_taps(SIGMA).astype(np.float32)
    between, out = np.zeros((side, side, 3 * side), np.float32), np.zeros((side, side, 3 * side), np.float32)
    thin, smooth = shell(128, 0.37 - 5 / 128, 0.37), GaussianFilter(SIGMA / 128)

    def reference() -> None:
        frozen.smoothed(dense, taps, between, out)

    return {
        "gaussian, dense": Pair.of(lambda: gaussian(dense, SIGMA), reference),
        "gaussian, wall": Pair.of(lambda: smooth(thin), reference),
    }


def query_pairs() -> dict[str, Pair]:
    """Pairs for forces at many points.

    Of one frame, between two frames, of seven objects, and their gradients.
    """
    rng, first = np.random.default_rng(1), field()
    sampler = FieldSampler(HapticMedium.from_frames([first, first.scaled(0.5)], 1000.0))
    objects, dense = FieldSampler(scene()), first.to_dense()
    anywhere, along = rng.uniform(0, (SIDE - 1) * SPACING_M, (100_000, 3)), path(100_000, rng)
    out = np.zeros(anywhere.shape, np.float32)

    def reference(points: Any) -> Callable[[], Any]:
        inside = np.minimum(points / SPACING_M, SIDE - 1.001)
        return lambda: frozen.interpolated(dense, inside, out)

    return {
        "query, random": Pair.of(lambda: sampler.force_n(0.0, anywhere), reference(anywhere)),
        "query, path": Pair.of(lambda: sampler.force_n(0.0, along), reference(along)),
        "query, between frames": Pair.of(lambda: sampler.force_n(0.0004, along), reference(along)),
        "query, objects": Pair.of(lambda: objects.force_n(0.0004, along[:60_000]), reference(along)),
        "query, slopes": Pair.of(lambda: sampler.gradient_n_per_m(0.0, along[:60_000]), reference(along)),
    }


def coder_pairs() -> dict[str, Pair]:
    """Pairs for encoding and decoding two depth frames."""
    grid = Grid.over_box(LOW_M, HIGH_M, (48, 48, 48))
    frames = [DepthScene(IndoorSequence()).field(0, grid, wall(grid))] * 2
    symbols = (np.abs(np.random.default_rng(0).normal(0, 6, (40, 40, 40))) % 32).astype(np.uint8)
    logits = np.arange(-2048, 2048)
    squash = np.clip(np.rint(4096 / (1 + np.exp(-logits / 256))), 1, 4095).astype(np.int32)
    probabilities = (np.arange(4096) + 0.5) / 4096
    stretch = np.clip(np.rint(256 * np.log(probabilities / (1 - probabilities))), -2047, 2047).astype(
        np.int32
    )
    out = np.zeros(1 << 16, np.uint8)
    encoder = TouchEncoder(grid, TouchSpec())
    body, decoder = encoder.encode_segment(frames).body, TouchDecoder(grid, encoder.parameters)

    def encode() -> None:
        encoder.encode_segment(frames)

    def decode() -> None:
        list(decoder.frames(body, len(frames)))

    def reference() -> None:
        frozen.coded_bits(symbols, squash, stretch, out)

    return {"encode": Pair.of(encode, reference), "decode": Pair.of(decode, reference)}


GROUPS = {
    "depth": depth_pairs,
    "mesh": mesh_pairs,
    "gaussian": gaussian_pairs,
    "query": query_pairs,
    "coder": coder_pairs,
}


def ratio_of(pair: Pair, rounds: int, limit: float) -> dict[str, float]:
    """Return the milliseconds of both, and the median of their ratios.

    Measures `rounds` pairs, and up to `TRIES` times as many while the ratio exceeds `limit`.
    """
    pair.ours()
    pair.reference()
    pairs: list[tuple[float, float]] = []
    for _ in range(TRIES):
        pairs += paired_cpu_ms(*pair, rounds)
        ratio = median(ours / reference for ours, reference in pairs)
        if ratio <= limit:
            break
    ours, reference = (min(values) for values in zip(*pairs))
    return {"ours_ms": ours, "reference_ms": reference, "ratio": ratio}


def stored_ratios() -> dict[str, dict[str, float]]:
    """Return the stored ratio of each kernel, by processor model."""
    ratios: dict[str, dict[str, float]] = stored("guard").get("stored_ratios", {})
    return ratios


def measure(only: str, store: bool, rounds: int) -> Figures:
    """Measure the ratio of each kernel, with the one stored for this processor model."""
    processor, ratios = machine()["processor"], stored_ratios()
    before = ratios.get(processor, {})
    rows: dict[str, Figures] = {}
    for group in only.split(",") if only else GROUPS:
        for name, pair in GROUPS[group]().items():
            limit = None if store else before.get(name)
            row = ratio_of(pair, rounds, inf if limit is None else MARGIN * limit)
            over = None if limit is None else row["ratio"] / limit
            rows[name] = {**row, "stored_ratio": limit, "over_stored": over, "group": group}
    if store:
        new = {name: row["ratio"] for name, row in rows.items()}
        ratios = {**ratios, processor: {**before, **new}}
    return {"rows": rows, "stored_ratios": ratios}


def measured_again(figures: Figures, rounds: int) -> Figures:
    """Measure kernels that look too slow again in new processes.

    The placement of arrays in memory makes a difference.
    """
    rows = dict(figures["rows"])
    for _ in range(PROCESSES):
        slow = {row["group"] for row in rows.values() if (row["over_stored"] or 0.0) > MARGIN}
        if not slow:
            break
        program = (
            f"import json, bench_guard as g; print(json.dumps(g.measure({','.join(slow)!r}, False, "
            f"{rounds})))"
        )
        command, folder = [sys.executable, "-c", program], Path(__file__).parent
        done = subprocess.run(command, check=True, capture_output=True, text=True, cwd=folder)
        for name, row in json.loads(done.stdout.splitlines()[-1])["rows"].items():
            rows[name] = min(row, rows[name], key=lambda candidate: candidate["over_stored"])
    return {**figures, "rows": rows}


def bars(figures: Figures, margin: float = MARGIN) -> list[Bar]:
    """Require every ratio to be at most `margin` times the stored one."""
    return [
        at_most(f"{name}, over the stored ratio", row["over_stored"], margin)
        for name, row in figures["rows"].items()
    ]


def main() -> None:
    options, is_quick = arguments(__doc__, {"only": ("", ""), "store": (False, False)})
    trace, run = provenance.Trace(), provenance.Run()
    rounds = ROUNDS[is_quick and not options["store"]]
    figures = measured_again(measure(options["only"], options["store"], rounds), rounds)
    show(figures)
    verdicts = bars(figures, QUICK_MARGIN if is_quick else MARGIN)
    is_stored = options["store"] or not (is_quick or options["only"])
    keep("guard", figures, verdicts, not is_stored, run.summary(), provenance.code_of(trace.files()))
    if any(bar["met"] is False for bar in verdicts):
        sys.exit(
            "slower than the stored ratio: see above; on purpose? store it: bench/bench_guard.py --store"
        )
    if machine()["processor"] not in figures["stored_ratios"]:
        processors = ", ".join(figures["stored_ratios"]) or "no processor"
        print(f"not judged: ratios are stored for {processors}; --store adds {machine()['processor']}")


if __name__ == "__main__":
    main()
