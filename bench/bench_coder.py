"""The paper's coder on a real depth scene: throughput of encoding and decoding, and what is kept.

    python bench/bench_coder.py [SOURCE]

SOURCE defaults to the motorcycle that scikit-image carries. Frames are on a 128^3 lattice.
"""

from __future__ import annotations

import sys

from machine import keep, timed
from touchfield.codec.paper.decoder import PaperDecoder
from touchfield.codec.paper.encoder import PaperEncoder
from touchfield.codec.paper.spec import PaperSpec
from touchfield.job import EncodeSpec, prepare
from touchfield.measure.fidelity import FidelityMeter
from touchfield.medium import ForceField, Grid
from touchfield.sources.options import SourceOptions


def measure(grid: Grid, frames: list[ForceField], spec: PaperSpec) -> dict[str, float]:
    """Milliseconds a frame and megavoxels a second, both ways."""
    encoder = PaperEncoder(grid, spec)
    body = encoder.encode_segment(frames).body
    decoder = PaperDecoder(grid, encoder.parameters)
    encode_ms = timed(lambda: encoder.encode_segment(frames), runs=5)["min_ms"] / len(frames)
    decode_ms = timed(lambda: list(decoder.frames(body, len(frames))), runs=5)["min_ms"] / len(frames)
    meter = FidelityMeter(spec.k, 0.05)
    for a, b in zip(frames, decoder.frames(body, len(frames)), strict=True):
        meter.add(a, b)
    supported = meter.supported_voxels / len(frames)
    return {
        "supported_voxels": supported,
        "bytes_a_frame": len(body) / len(frames),
        "bits_per_supported_voxel": 8 * len(body) / meter.supported_voxels,
        "nmse_db": meter.nmse_db or float("-inf"),
        "encode_ms": encode_ms,
        "decode_ms": decode_ms,
        "encode_mvoxel_s": grid.voxel_count / encode_ms / 1e3,
        "decode_mvoxel_s": grid.voxel_count / decode_ms / 1e3,
        "encode_supported_mvoxel_s": supported / encode_ms / 1e3,
        "decode_supported_mvoxel_s": supported / decode_ms / 1e3,
        "decode_frames_s": 1e3 / decode_ms,
    }


def main() -> None:
    source = sys.argv[1] if len(sys.argv) > 1 else "sample:motorcycle"
    results = {}
    for reading in ("camera", "height"):
        prepared = prepare(source, EncodeSpec(nw=7, source=SourceOptions(reading=reading)))
        frames = [prepared.medium[i] for i in range(min(4, len(prepared.medium)))]
        for name, spec in (("default", PaperSpec()), ("k 0.01, octa3", PaperSpec(k=0.01, directions="octa3"))):
            row = measure(prepared.medium.grid, frames, spec)
            results[f"{reading}, {name}"] = row
            print(f"{reading}, {name}: " + ", ".join(f"{key} {value:.4g}" for key, value in row.items()))
    print("bar: decoding at least 30 frames a second at 128^3")
    keep("coder", {"source": source if source.startswith("sample:") else "a depth sequence", "rows": results})


if __name__ == "__main__":
    main()
