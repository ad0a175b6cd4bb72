"""Write the conformance files. Run on purpose only: a change in them is a change of the format."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from touchfield.codec.paper_spec import PaperSpec
from touchfield.job import EncodeSpec, encode, open_stream, write_field
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.sources.stored import StoredScene

HERE = Path(__file__).parent


def waves(frames: int, shape: tuple[int, int, int]) -> HapticMedium:
    """A wall that moves a little, made of whole-number arithmetic so that it is the same everywhere."""
    grid = Grid(shape, (0.00125, 0.001, 0.0005), (-0.01, -0.008, -0.004))
    i, j, k = np.meshgrid(*(np.arange(n) for n in shape), indexing="ij")
    made = []
    for t in range(frames):
        depth = 8 * k - 40 - ((3 * i + 2 * t) % 17) - ((5 * j) % 11)
        amplitude = np.where((depth > 0) & (depth < 40), depth, 0) / 16
        slope = np.stack([(i * 7 + t) % 5 - 2, (j * 3) % 5 - 2, np.full(shape, -8)], axis=-1) / 8
        made.append(ForceField.from_dense(grid, (amplitude[..., None] * slope).astype(np.float32)))
    return HapticMedium.from_frames(made, 30.0, "x right, y down, z forward")


STREAMS = {
    "one-frame": (1, (16, 16, 16), PaperSpec()),
    "closed-loop": (5, (20, 17, 19), PaperSpec(k=0.05, segment_frames=3)),
    "literal": (3, (20, 17, 19), PaperSpec.literal()),
    "weber-ico3": (2, (16, 16, 16), PaperSpec(amplitude="weber", directions="ico3", interframe="none")),
    "empty": (1, (16, 16, 3), PaperSpec()),
}


def main() -> None:
    valid, faulty = HERE / "v0", HERE / "faulty"
    for folder in (valid, faulty):
        folder.mkdir(exist_ok=True)
    for name, (frames, shape, paper) in STREAMS.items():
        stream = valid / f"{name}.touch"
        medium = waves(frames, shape)
        scene = StoredScene(medium)
        encode(scene, stream, replace(EncodeSpec(), nw=4, mapping="crop", paper=paper))
        with open_stream(stream) as opened:
            write_field(valid / f"{name}.npz", opened.medium)
    _write_faulty(faulty, (valid / "one-frame.touch").read_bytes())


def _write_faulty(folder: Path, good: bytes) -> None:
    flipped = bytearray(good)
    flipped[len(good) // 2] ^= 4
    newer = bytearray(good)
    newer[10] = 9  # the major version follows the ten bytes of the magic
    files = {
        "cut-in-head": (good[:40], "TruncatedFile"),
        "cut-before-index": (good[: len(good) - 90], "TruncatedFile"),
        "bit-flipped": (bytes(flipped), "CorruptFile"),
        "newer-major": (bytes(newer), "UnsupportedVersion"),
        "text-mode": (good.replace(b"\r\n", b"\n"), "CorruptFile"),
        "foreign": (b"\x89PNG\r\n\x1a\n" + bytes(64), "ForeignFile"),
        "nothing": (b"", "ForeignFile"),
    }
    for name, (data, _) in files.items():
        (folder / f"{name}.touch").write_bytes(data)
    errors = {name: error for name, (_, error) in files.items()}
    (folder / "errors.json").write_text(json.dumps(errors, indent=1) + "\n")


if __name__ == "__main__":
    main()
