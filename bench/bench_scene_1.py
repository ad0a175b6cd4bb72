"""Measures the encoding of scene 1 of the paper (seven falling bodies), as objects and as voxels: time,
bytes, memory.

    python bench/bench_scene_1.py [--quick] [--frames N]

The scene has 2000 frames (`--frames`) at 1 kHz. Each representation is simulated, built, encoded and written
by a separate process, so that the peak memory is its own; kernels are compiled beforehand. Voxels are encoded
for the first quarter of the frames and compared with the objects of the same frames.

Further figures are the bytes of fields and poses; the difference between the decoded objects and the voxel
representation of the scene (which has the device's low-pass and no objects); zlib and LZMA on the poses as
float32; and the cost of the error bound of the composed field, as the bytes of the fields beside those of
fields that each keep the mask on their own.
"""

from __future__ import annotations

import json
import lzma
import subprocess
import sys
import tempfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from machine import Bar, Figures, at_least, at_most, bench, figure
from touchfield.codec.registry import field_encoder

HERE = Path(__file__).parent
SCENE = "sample:falling-7"
LOOKED_AT = 8

JOB = """
import json, sys
from peak_memory import peak_bytes
from touchfield import EncodeSpec, encode
representation, frames, out = sys.argv[1:]
done = encode("{scene}", out, EncodeSpec(representation=representation, frames=(0, int(frames))))
print(json.dumps({{**done.summary(), "peak_mb": peak_bytes() / 2**20}}))
"""


def coded(representation: str, frames: int, out: Path) -> dict[str, Any]:
    """Return the summary of one encoding in a separate process."""
    code = [sys.executable, "-c", JOB.format(scene=SCENE), representation, str(frames), str(out)]
    output = subprocess.run(code, cwd=HERE, check=True, capture_output=True, text=True).stdout
    return dict(json.loads(output.splitlines()[-1]))


def difference(objects: Path, frames: int) -> dict[str, float]:
    """Compare the decoded objects with the voxel representation.

    The frames are evenly spaced. The result also has the bytes of fields and poses.
    """
    from touchfield.measure.fidelity import FidelityMeter
    from touchfield.pipeline import prepare
    from touchfield.pipeline.decoding import open_file
    from touchfield.pipeline.spec import EncodeSpec

    voxels = prepare(SCENE, EncodeSpec(representation="voxel", frames=(0, frames))).medium
    meter = FidelityMeter(0.1, 0.05)
    with open_file(objects) as stream:
        for i in np.linspace(0, frames - 1, LOOKED_AT).astype(int):
            meter.add(voxels[int(i)], stream.medium[int(i)])
        assert stream.scene is not None
        poses = np.concatenate(
            [np.hstack([o.track.quaternions, o.track.positions_m]) for o in stream.scene.objects]
        )
        bits = stream.bits
        summary = stream.summary()
    raw = poses.astype(np.float32).tobytes()
    spec = EncodeSpec(frames=(0, frames))
    scene = prepare(SCENE, spec).objects
    assert scene is not None
    alone = [
        field_encoder(segment.medium.grid, spec.touch).encode_segment([segment.field(0)])
        for segment in scene.objects
    ]
    return {
        "worst_mask_ratio": summary["worst_mask_ratio"],
        "place_tolerance_um": summary["place_tolerance_um"],
        "field_bytes_each_within_its_mask": sum(len(segment.body) for segment in alone),
        "nmse_to_voxels_db": float(meter.nmse_db or -np.inf),
        "pose_bytes": bits.poses / 8,
        "field_bytes": summary["bits_fields"] / 8,
        "raw_pose_bytes": len(raw),
        "zlib_pose_bytes": len(zlib.compress(raw, 9)),
        "lzma_pose_bytes": len(lzma.compress(raw)),
    }


def measure(frames: int) -> Figures:
    """Measure both representations."""
    figures: dict[str, Any] = {"frames": frames}
    with tempfile.TemporaryDirectory() as folder:
        for name, representation, count in (
            ("object", "object", frames),
            ("object, a quarter", "object", frames // 4),
            ("voxel, a quarter", "voxel", frames // 4),
        ):
            out = Path(folder) / f"{name}.touch"
            coded(representation, 2, out)  # compile the kernels
            summary = coded(representation, count, out)
            selected = {
                k: summary[k] for k in ("encode_s", "file_bytes", "peak_mb", "supported_voxels", "grid_shape")
            }
            figures[name] = selected
        figures["object"] |= difference(Path(folder) / "object.touch", frames)
    return figures


def bars(figures: Figures) -> list[Bar]:
    """Limit time, memory, bytes and error of objects; require short poses."""
    row = figures["object"]
    quarter, voxels = (figure(figures, f"{name}, a quarter", "file_bytes") for name in ("object", "voxel"))
    over = voxels / quarter if voxels and quarter else None
    packed = min(row["zlib_pose_bytes"], row["lzma_pose_bytes"])
    return [
        at_most("objects, time", row["encode_s"], 60.0, "s"),
        at_most("objects, memory", row["peak_mb"], 2048.0, "MB"),
        at_most("objects, file", row["file_bytes"], 300_000, "bytes"),
        at_least("bytes of voxels over those of objects, a quarter of the frames", over, 10.0),
        at_most("error of the composed field, in units of the mask", figure(row, "worst_mask_ratio"), 1.0),
        at_most("objects against voxels, NMSE", row["nmse_to_voxels_db"], -15.0, "dB"),
        at_least("bytes of the shorter of zlib and lzma over our poses", packed / row["pose_bytes"], 1.0),
    ]


if __name__ == "__main__":
    bench("scene_1", __doc__, measure, bars, frames=(2000, 40))
