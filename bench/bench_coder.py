"""Measures speed, size and error of coder `paper`, the coder that the paper describes, on a real depth scene.

    python bench/bench_coder.py [--quick] [--source SOURCE] [--nw N]

The default source is the motorcycle stereo picture of scikit-image, on a lattice of 128^3 samples (n_w 7).
The depth map is read as a camera view and as a height map. Each is coded in one segment of up to four frames
with the default settings, and with finer amplitudes and directions.
"""

from __future__ import annotations

from machine import Bar, Figures, at_least, at_most, bench, column, timed
from touchfield.codec.paper.decoder import PaperDecoder
from touchfield.codec.paper.encoder import PaperEncoder
from touchfield.codec.paper.spec import PaperSpec
from touchfield.measure.fidelity import FidelityMeter
from touchfield.medium import ForceField, Grid
from touchfield.pipeline import prepare
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.options import SourceOptions


def row_of(grid: Grid, frames: list[ForceField], spec: PaperSpec) -> dict[str, float]:
    """Return size, error, milliseconds per frame and megavoxels per second."""
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


def measure(source: str, nw: int) -> Figures:
    """Measure both readings of the source with the default and with a finer coder."""
    rows = {}
    for reading in ("camera", "height"):
        prepared = prepare(source, EncodeSpec(nw=nw, source=SourceOptions(reading=reading)))
        frames = [prepared.medium[i] for i in range(min(4, len(prepared.medium)))]
        for name, spec in (
            ("default", PaperSpec()),
            ("k 0.01, octa3", PaperSpec(k=0.01, directions="octa3")),
        ):
            rows[f"{reading}, {name}"] = row_of(prepared.medium.grid, frames, spec)
    return {"source": source if source.startswith("sample:") else "a depth sequence", "nw": nw, "rows": rows}


def bars(figures: Figures) -> list[Bar]:
    """Require 30 frames/s of encoding and decoding, and an NMSE below -15 dB."""
    rows = figures["rows"]
    slowest = max(column(rows, "encode_ms"), default=None)
    return [
        at_least(
            "decoding at 128^3, slowest", min(column(rows, "decode_frames_s"), default=None), 30.0, "frames/s"
        ),
        at_least("encoding at 128^3, slowest", slowest and 1e3 / slowest, 30.0, "frames/s"),
        at_most("NMSE, worst", max(column(rows, "nmse_db"), default=None), -15.0, "dB"),
    ]


if __name__ == "__main__":
    bench("coder", __doc__, measure, bars, source=("sample:motorcycle", "sample:motorcycle"), nw=(7, 5))
