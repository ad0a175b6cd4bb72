"""Writes the golden files of the conformance tests. Run it on purpose only: a change in them is a change of
the format."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from golden_content import LARGE, apart, block, bodies, hum, nothing, quarters, solid, wave
from make_faulty import write_faulty

from touchfield.codec.objects.encoder import ObjectsEncoder
from touchfield.codec.paper.spec import STAGES, PaperSpec
from touchfield.codec.registry import field_encoder
from touchfield.codec.touch.spec import TouchSpec
from touchfield.codec.vibration import encode_vibration
from touchfield.container import Head, TouchWriter
from touchfield.medium import ForceField, Grid, HapticScene
from touchfield.pipeline.decoding import open_file, write_field
from touchfield.pipeline.encoding import write_objects

HERE = Path(__file__).parent
GOLDEN, FAULTY = HERE / "v1", HERE / "faulty"

FIELDS: dict[str, tuple[Callable[[int], ForceField], int, PaperSpec | TouchSpec]] = {
    "paper-one-frame": (wave, 1, PaperSpec()),
    "paper-closed-loop": (wave, 5, PaperSpec(k=0.05, segment_frames=3)),
    "paper-literal": (wave, 3, PaperSpec.literal()),
    "paper-weber-ico3": (block, 5, PaperSpec(amplitude="weber", directions="ico3", interframe="none")),
    "paper-empty": (nothing, 1, PaperSpec()),
    "paper-large": (apart, 2, PaperSpec(k=0.3)),
    **{f"paper-{stage}": (block, 2, PaperSpec(stage=stage, step_n=0.1)) for stage in STAGES[1:]},
    "touch-mask": (wave, 4, TouchSpec(segment_frames=3)),
    "touch-direction": (wave, 3, TouchSpec(mode="mask-direction", support="exact", f0_n=0.02)),
    "touch-masking": (wave, 3, TouchSpec(masking=0.1, masking_radius_m=0.002)),
    "touch-nmse": (wave, 3, TouchSpec(mode="nmse", step_n=0.1)),
    "touch-fast": (wave, 4, TouchSpec(effort="fast", k=0.05, segment_frames=2)),
    "touch-lossless": (quarters, 3, TouchSpec(mode="lossless")),
    "touch-solid": (solid, 3, TouchSpec(k=0.2)),
    "touch-block": (block, 5, TouchSpec(f0_n=0.01)),
    "touch-empty": (nothing, 2, TouchSpec()),
    "touch-large": (apart, 2, TouchSpec(k=0.3)),
    "vibration": (block, 6, PaperSpec(segment_frames=2)),
    "vibration-touch": (block, 6, TouchSpec(segment_frames=2)),
}
"""Per file: the field as a function of the frame number, the number of frames, and the coder's options."""

SCENES: dict[str, tuple[HapticScene, PaperSpec | TouchSpec]] = {
    "objects-rigid": (bodies(9, 1000.0, False, 0.125), PaperSpec()),
    "objects-deforming": (bodies(5, 60.0, True, 0.0), PaperSpec(k=0.2, directions="ico3", segment_frames=3)),
    "objects-touch": (bodies(9, 1000.0, False, 0.125), TouchSpec(segment_frames=4)),
    "objects-touch-deforming": (bodies(5, 60.0, True, 0.25), TouchSpec(k=0.2, segment_frames=3)),
}


def head_of(grid: Grid, rate_hz: float, frame_count: int, encoder: Any, **more: Any) -> Head:
    """The head of a file that no device filter has seen."""
    usual: dict[str, Any] = {"axes": "x right, y down, z forward", "force_max_n": 8.0, "tags": ()}
    return Head(
        grid_shape=grid.shape, spacing_m=grid.spacing_m, origin_m=grid.origin_m, rate_hz=rate_hz,
        frame_count=frame_count, device_name="none", device_type=1, mapping_scale=1.0,
        mapping_offset_m=(0.0, 0.0, 0.0), weber_fraction=0.1, force_threshold_n=0.0, coder=encoder.name,
        coder_parameters=encoder.parameters, **{**usual, "friction": 0.0, "damping_n_s_per_m": 0.0, **more},
    )  # fmt: skip


def write_frames(
    stream: Path, make: Callable[[int], ForceField], count: int, spec: PaperSpec | TouchSpec
) -> None:
    """A file of fields; of those of vibration, the second segment is the one in which nothing vibrates."""
    grid, per = make(0).grid, spec.segment_frames or count
    encoder = field_encoder(grid, spec)
    with TouchWriter(stream) as writer:
        writer.write_head(head_of(grid, 30.0, count, encoder), {"source": "made up, größer als nichts"})
        for first in range(0, count, per):
            frames = range(first, min(first + per, count))
            if stream.stem.startswith("vibration") and first != per:
                writer.write_vibration(first, len(frames), encode_vibration([hum(t) for t in frames]))
            writer.write_segment(first, len(frames), encoder.encode_segment([make(t) for t in frames]).body)


def write_scene(stream: Path, scene: HapticScene, spec: PaperSpec | TouchSpec) -> None:
    """A file of objects."""
    encoder = ObjectsEncoder(scene, spec, 1 / 64)
    names = "axes", "force_max_n", "friction", "damping_n_s_per_m", "tags"
    head = head_of(
        scene.grid, scene.rate_hz, len(scene), encoder, **{name: getattr(scene, name) for name in names}
    )
    with TouchWriter(stream) as writer:
        writer.write_head(head, {"source": "made up"})
        write_objects(writer, encoder, len(scene))


def write_expected(stream: Path) -> None:
    """What a file decodes to: dense, or of a large grid its bricks, with the frame of each; and what
    vibrates.
    """
    with open_file(stream) as opened:
        medium, band = opened.medium, opened.medium.vibration
        if opened.grid == LARGE:
            fields = list(medium)
            which = np.repeat(range(len(fields)), [len(f.bricks) for f in fields])
            bricks, forces_n = (
                np.concatenate([getattr(f, name) for f in fields]) for name in ("bricks", "forces_n")
            )
            np.savez_compressed(stream.with_suffix(".npz"), frames=which, bricks=bricks, forces_n=forces_n)
        else:
            write_field(stream.with_suffix(".npz"), medium)
        if band is not None:
            both = np.stack([band[i].as_field().to_dense() for i in range(len(band))])
            target = stream.with_suffix(".vibration.npz")
            np.savez_compressed(target, amplitudes_n=both[..., 0], frequencies_hz=both[..., 1])


def main() -> None:
    """Write all golden files, or some, and the faulty files that are made of them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="golden files to write; the default is all")
    GOLDEN.mkdir(exist_ok=True)
    for name in parser.parse_args().names or (*FIELDS, *SCENES):
        stream = GOLDEN / f"{name}.touch"
        if name in SCENES:
            write_scene(stream, *SCENES[name])
        else:
            write_frames(stream, *FIELDS[name])
        write_expected(stream)
    write_faulty(GOLDEN, FAULTY)


if __name__ == "__main__":
    main()
