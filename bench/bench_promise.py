"""The promise on every input there is: voxels beyond max(F_0, k |F|), which must be none.

    python bench/bench_promise.py [FRAMES]

Every scene of the optional folder ../shared/data, and the samples of the package, at n_w 6 for a Phantom Omni, at
k = 0.05, 0.1 and 0.25 and F_0 = 0.05 N, efforts fast, default and max, FRAMES frames of each (3). The decoded frames
are compared with the fields before coding by `touchfield.perception.mask`, apart from the coder's own check. Exits
with 1 where a voxel is beyond.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from machine import keep
from touchfield.codec.touch.decoder import TouchDecoder
from touchfield.codec.touch.encoder import TouchEncoder
from touchfield.codec.touch.spec import TouchSpec
from touchfield.job import EncodeSpec
from touchfield.job.prepare import prepare
from touchfield.perception import violations
from touchfield.sources.options import SourceOptions

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"
MESHES = (
    "fox/Fox.glb",
    "morph_stress_test/MorphStressTest.gltf",
    "spot/spot_triangulated.obj",
    "featuretype/featuretype.STL",
    "parasaurolophus_scan/parasaurolophus_6700.ply",
)
F0_N = 0.05
NW = 6


def sources() -> Iterator[tuple[str, str, EncodeSpec]]:
    """Name, source and spec of every input."""
    for name in ("terrain", "motorcycle", "falling-7"):
        yield name, f"sample:{name}", EncodeSpec(nw=NW, representation="voxel")
    for name in ("rgbd_tum_fr1_rpy", "rgbd_iclnuim_livingroom1"):
        if (SHARED / name).is_dir():
            for reading in ("camera", "height"):
                spec = EncodeSpec(nw=NW, source=SourceOptions(reading=reading, world="frames"))
                yield f"{name}, {reading}", str(SHARED / name), spec
    for mesh in MESHES:
        if (SHARED / "meshes" / mesh).is_file():
            yield mesh, str(SHARED / "meshes" / mesh), EncodeSpec(nw=NW)


def main() -> None:
    """Print and keep the counts."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 3
    rows, beyond = [], 0
    for name, source, spec in sources():
        medium = prepare(source, spec).medium
        start = max(0, min(len(medium) // 4, len(medium) - count))
        frames = [medium[i] for i in range(start, min(start + count, len(medium)))]
        for k in (0.05, 0.1, 0.25):
            for effort in ("fast", "default", "max"):
                encoder = TouchEncoder(medium.grid, TouchSpec(k=k, f0_n=F0_N, effort=effort))
                body = encoder.encode_segment(frames).body
                worst, bad = 0.0, 0
                for x, y in zip(
                    frames, TouchDecoder(medium.grid, encoder.parameters).frames(body, len(frames)), strict=True
                ):
                    a, b = (np.ascontiguousarray(f.to_dense().reshape(-1, 3)) for f in (x, y))
                    found = violations(a, b, k, F0_N)
                    worst, bad = max(worst, found.worst_ratio or 0.0), bad + found.count
                rows.append(
                    {"source": name, "k": k, "effort": effort, "bytes": len(body), "worst": worst, "beyond": bad}
                )
                beyond += bad
                print(
                    f"{name:34} k {k:4} {effort:8} {len(body):8,} bytes  worst {worst:.6f}  beyond {bad}", flush=True
                )
    keep("promise", {"frames": count, "rows": rows, "beyond": beyond})
    print(f"{beyond} voxels beyond the mask in {len(rows)} streams")
    sys.exit(beyond > 0)


if __name__ == "__main__":
    main()
