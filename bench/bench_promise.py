"""Tests the error bound of coder `touch`, max(F_0, k |F|), on every available input.

    python bench/bench_promise.py [--quick] [--frames N] [--nw N]

The inputs are all scenes of the optional folder ../shared/data and the samples of the package, at n_w 6
(`--nw`) for a Phantom Omni. Coder `touch` encodes 3 frames (`--frames`) of each with k = 0.05, 0.1 and 0.25,
F_0 = 0.05 N, and efforts fast and default. The decoded frames are compared with the original fields by
`touchfield.perception.violations`, independently of the coder's own check. The exit status is 1 if a voxel
exceeds the bound.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator

from machine import SHARED, Bar, Figures, at_least, at_most, bench, column, text
from touchfield.codec.touch.decoder import TouchDecoder
from touchfield.codec.touch.encoder import TouchEncoder
from touchfield.codec.touch.spec import TouchSpec
from touchfield.medium import ForceField, Grid
from touchfield.perception import violations
from touchfield.pipeline.preparation import prepare
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.options import SourceOptions

MESHES = (
    "fox/Fox.glb",
    "morph_stress_test/MorphStressTest.gltf",
    "spot/spot_triangulated.obj",
    "featuretype/featuretype.STL",
    "parasaurolophus_scan/parasaurolophus_6700.ply",
)
F0_N = 0.05


def sources(nw: int) -> Iterator[tuple[str, str, EncodeSpec]]:
    """Yield name, source and spec of every input."""
    for name in ("terrain", "motorcycle", "falling-7"):
        yield name, f"sample:{name}", EncodeSpec(nw=nw, representation="voxel")
    for name in ("rgbd_tum_fr1_rpy", "rgbd_iclnuim_livingroom1"):
        if (SHARED / name).is_dir():
            for reading in ("camera", "height"):
                spec = EncodeSpec(nw=nw, source=SourceOptions(reading=reading, world="frames"))
                yield f"{name}, {reading}", str(SHARED / name), spec
    for mesh in MESHES:
        if (SHARED / "meshes" / mesh).is_file():
            yield mesh, str(SHARED / "meshes" / mesh), EncodeSpec(nw=nw)


def row_of(name: str, grid: Grid, frames: list[ForceField], spec: TouchSpec) -> Figures:
    """Code a segment; return its bytes and its largest error relative to the bound."""
    encoder = TouchEncoder(grid, spec)
    body = encoder.encode_segment(frames).body
    decoded = TouchDecoder(grid, encoder.parameters).frames(body, len(frames))
    counts = [
        violations(before.to_dense().reshape(-1, 3), after.to_dense().reshape(-1, 3), spec.k, spec.f0_n)
        for before, after in zip(frames, decoded, strict=True)
    ]
    row = {"source": name, "k": spec.k, "effort": spec.effort, "bytes": len(body)}
    row |= {
        "worst": max(count.worst_ratio or 0.0 for count in counts),
        "beyond": sum(count.count for count in counts),
    }
    print(", ".join(f"{key} {text(value)}" for key, value in row.items()), flush=True)
    return row


def measure(frames: int, nw: int) -> Figures:
    """Measure every input at every k and effort."""
    rows = []
    for name, source, spec in sources(nw):
        medium = prepare(source, spec).medium
        start = max(0, min(len(medium) // 4, len(medium) - frames))
        some = [medium[i] for i in range(start, min(start + frames, len(medium)))]
        for k in (0.05, 0.1, 0.25):
            for effort in ("fast", "default"):
                rows.append(row_of(name, medium.grid, some, TouchSpec(k=k, f0_n=F0_N, effort=effort)))
    return {"frames": frames, "nw": nw, "rows": rows, "beyond": sum(column(rows, "beyond"))}


def bars(figures: Figures) -> list[Bar]:
    """Allow no voxel beyond its mask on any input."""
    return [
        at_most("voxels beyond max(F_0, k |F|)", figures["beyond"], 0),
        at_most("largest error, in units of the mask", max(column(figures["rows"], "worst")), 1.0),
        at_least("inputs", len(set(column(figures["rows"], "source"))), 12),
    ]


if __name__ == "__main__":
    verdicts = bench("promise", __doc__, measure, bars, frames=(3, 1), nw=(6, 4))
    sys.exit(verdicts[0]["met"] is False)
