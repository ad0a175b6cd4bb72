"""Write the conformance files. Run on purpose only: a change in them is a change of the format."""

from __future__ import annotations

import argparse
import json
import struct
import zlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from touchfield.codec.objects import ObjectsEncoder
from touchfield.codec.paper_spec import PaperSpec
from touchfield.codec.touch.body import BodyReader, write_body
from touchfield.codec.touch.encoder import TouchEncoder
from touchfield.codec.touch.exceptions import Exceptions
from touchfield.codec.touch.spec import TouchSpec
from touchfield.codec.varint import write_varint
from touchfield.codec.vibration import encode_vibration
from touchfield.container import Head, TouchReader, TouchWriter
from touchfield.errors import FormatError
from touchfield.job import EncodeSpec, encode, open_stream, write_field
from touchfield.job.object_stream import ObjectStream, write_objects
from touchfield.medium import ForceField, Grid, HapticMedium, HapticObject, HapticScene, PoseTrack
from touchfield.medium.vibration import VibrationFrame
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


def quarters(medium: HapticMedium) -> list[ForceField]:
    """Its frames with components of whole quarters of a newton."""
    return [ForceField.from_dense(f.grid, np.rint(f.to_dense() * 4) / np.float32(4)) for f in medium]


def block(grid: Grid, t: int) -> ForceField:
    """A block that pushes outward along x and up, and grows a little with t."""
    i, j, k = np.meshgrid(*(np.arange(n) for n in grid.shape), indexing="ij")
    inside = (abs(2 * i - 10) <= 7 + t) & (abs(2 * j - 8) <= 6) & (k >= 2) & (k <= 8)
    force = np.stack([i - 5, j - 4, np.full(grid.shape, 3)], axis=-1) * inside[..., None]
    return ForceField.from_dense(grid, (force * (8 + t) / 32).astype(np.float32))


def tumbling(frames: int, side: int) -> PoseTrack:
    """Quaternions and positions of whole numbers, made unit."""
    t = np.arange(frames)
    turns = np.stack([np.full(frames, 40), 3 * t, side * 2 * t - 1, -t], axis=1)
    turns = turns / np.sqrt((turns * turns).sum(axis=1, keepdims=True))
    return PoseTrack(turns, np.stack([side * (7 + t), t - 3, 16 - t * t // 4], axis=1) / 1024)


def scene_of(frames: int, rate_hz: float, deforming: bool, surface_damping: float) -> HapticScene:
    """Bodies that meet at their edges; one stays where it is."""
    own = Grid((11, 9, 10), (0.00125, 0.001, 0.0015), (-0.00625, -0.004, -0.007))
    world = Grid((20, 17, 18), (0.0025, 0.0025, 0.002), (-0.024, -0.02, -0.004))
    rigid = HapticMedium.from_frames([block(own, 0)], rate_hz)
    other = HapticMedium.from_frames([block(own, t) for t in range(frames)], rate_hz) if deforming else rigid
    ground = Grid((20, 17, 6), (0.0025, 0.0025, 0.002), (-0.024, -0.02, -0.004))
    i, j, k = np.meshgrid(*(np.arange(n) for n in ground.shape), indexing="ij")
    slope = np.stack([i % 3 - 1, j % 5 - 2, np.full(ground.shape, 8)], axis=-1) * (6 - k)[..., None] / 64
    floor = ForceField.from_dense(ground, slope.astype(np.float32))
    objects = (
        HapticObject("first block", rigid, tumbling(frames, 1)),
        HapticObject("floor", HapticMedium.from_frames([floor], rate_hz), PoseTrack.still(frames)),
        HapticObject("second block", other, tumbling(frames, -1)),
    )
    return HapticScene(world, rate_hz, objects, 1.25, surface_damping, "x east, y north, z up", 0.25, 0.5)


SCENES = {
    "objects-rigid": (scene_of(9, 1000.0, False, 0.125), PaperSpec()),
    "objects-deforming": (scene_of(5, 60.0, True, 0.0), PaperSpec(k=0.2, directions="ico3", segment_frames=3)),
}


def write_scene(stream: Path, scene: HapticScene, paper: PaperSpec) -> None:
    """A file of objects, made without the device filter."""
    encoder = ObjectsEncoder(scene, paper, 1 / 64)
    head = Head(
        grid_shape=scene.grid.shape, spacing_m=scene.grid.spacing_m, origin_m=scene.grid.origin_m,
        rate_hz=scene.rate_hz, frame_count=len(scene), axes=scene.axes, device_name="none", device_type=1,
        force_max_n=scene.force_max_n, mapping_scale=1.0, mapping_offset_m=(0.0, 0.0, 0.0), weber_fraction=paper.k,
        force_threshold_n=1 / 64, friction=scene.friction, damping_n_s_per_m=scene.damping_n_s_per_m,
        tags=scene.tags, coder=encoder.name, coder_parameters=encoder.parameters,
    )  # fmt: skip
    with TouchWriter(stream) as writer:
        writer.write_head(head, {"source": "made up"})
        write_objects(writer, encoder, len(scene))


def height(grid: Grid, t: int) -> ForceField:
    """All that is behind a surface with a step, saturated deep inside."""
    i, j, k = np.meshgrid(*(np.arange(n) for n in grid.shape), indexing="ij")
    depth = 4 * k - 15 - (i * i + 2 * t) % 7 - 12 * (j > 9)
    slope = np.stack([i % 4, np.ones(grid.shape), np.full(grid.shape, -12)], axis=-1)
    return ForceField.from_dense(grid, (np.clip(depth, 0, 16)[..., None] * slope / 64).astype(np.float32))


TOUCH_GRID = Grid((20, 17, 19), (0.00125, 0.001, 0.0005), (-0.01, -0.008, -0.004))
WAVES = list(waves(4, TOUCH_GRID.shape))
HEIGHTS = [height(TOUCH_GRID, t) for t in range(3)]
STRIPS = [ForceField.from_dense(f.grid, f.to_dense() * (np.arange(20) < 7)[:, None, None, None]) for f in WAVES[:3]]
FALLING = [block(TOUCH_GRID, t) for t in range(3)] + [ForceField.empty(TOUCH_GRID), block(TOUCH_GRID, 1)]

TOUCH = {
    "touch_mask": (WAVES, TouchSpec(segment_frames=3)),
    "touch_direction": (WAVES[:3], TouchSpec(mode="mask-direction", support="exact", f0_n=0.02)),
    "touch_nmse": (WAVES[:3], TouchSpec(mode="nmse", step_n=0.1)),
    "touch_fast": (WAVES, TouchSpec(effort="fast", k=0.05, segment_frames=2, interframe="on")),
    "touch_max": (STRIPS, TouchSpec(effort="max", segment_frames=2)),
    "touch_lossless": (quarters(HapticMedium.from_frames(WAVES, 30.0)), TouchSpec(mode="lossless")),
    "touch_surface": (HEIGHTS, TouchSpec(surface="on", motion="off", k=0.2)),
    "touch_motion": (FALLING, TouchSpec(motion="on", f0_n=0.01)),
    "touch_exceptions": (WAVES[:2], TouchSpec(k=0.25)),
    "touch_empty": ([ForceField.empty(TOUCH_GRID)] * 2, TouchSpec()),
}
"""Fields of coder `touch`, and what is asked of it."""


def hum(grid: Grid, t: int) -> VibrationFrame:
    """A pattern that vibrates within a box, not two samples alike; another in every frame, and nothing in frame 4."""
    i, j, k = np.meshgrid(*(np.arange(n) for n in grid.shape), indexing="ij")
    held = ((i + 2 * j + 3 * k + t // 2) % 3 == 0) & (i < 14) & (j > 3) & (k > 6 + t) & (t != 4)
    amplitudes = ((1 + (3 * i + 5 * j + k + t) % 61) / 64)[held]
    frequencies = (40 + 10 * (k + t) + (i * j) % 7)[held]
    places = np.argwhere(held).astype(np.int32)
    return VibrationFrame(grid, places, amplitudes.astype(np.float32), frequencies.astype(np.float32))


VIBRATING = {"vibration": ([block(TOUCH_GRID, t % 3) for t in range(6)], TouchSpec(segment_frames=2))}
"""Fields that vibrate, but for the second segment."""


def write_vibrating(stream: Path, frames: list[ForceField], spec: TouchSpec) -> None:
    """A file of coder `touch` with VIBR before its first and its third segment."""
    segments = touch_segments(frames, spec)
    bodies = [encode_vibration([hum(TOUCH_GRID, t), hum(TOUCH_GRID, t + 1)]) for t in (0, 4)]
    write_touch(stream, spec, segments, [bodies[0], None, bodies[1]])


def write_hum(stream: Path) -> None:
    """What vibrates in a file, as dense arrays."""
    with open_stream(stream) as opened:
        band = opened.medium.vibration
        assert band is not None
        amplitudes_n = np.zeros((len(band), *opened.grid.shape), np.float32)
        frequencies_hz = np.zeros_like(amplitudes_n)
        for i in range(len(band)):
            frame = band[i]
            amplitudes_n[(i, *frame.positions.T)] = frame.amplitudes_n
            frequencies_hz[(i, *frame.positions.T)] = frame.frequencies_hz
    np.savez_compressed(
        stream.with_suffix(".vibration.npz"), amplitudes_n=amplitudes_n, frequencies_hz=frequencies_hz
    )


def touch_segments(frames: list[ForceField], spec: TouchSpec) -> list[tuple[int, bytes]]:
    """Frame count and body of each segment."""
    encoder, per = TouchEncoder(frames[0].grid, spec), spec.segment_frames or 8
    parts = [frames[i : i + per] for i in range(0, len(frames), per)]
    return [(len(part), encoder.encode_segment(part).body) for part in parts]


def with_exceptions(body: bytes, frame: ForceField) -> bytes:
    """A segment that sends a force apart, one of zero, and one in a brick of its own, in its last frame."""
    reader = BodyReader(body, frame.grid, lossless=False)
    records = list(reader.records(2))
    told = Exceptions.of(frame, np.array([0, 3, 3]), np.array([0, 200, 511]))
    forces = told.forces_n.copy()
    forces[0], forces[1] = (0.5, -0.25, 1), (0, 0, 0)
    records[-1] = replace(records[-1], exceptions=Exceptions(told.keys, told.places, forces).to_bytes())
    return write_body(reader.lattice, records, reader.worst)


def write_segments(
    stream: Path,
    head: Head,
    segments: Sequence[tuple[int, bytes]],
    source: str,
    vibrations: Sequence[bytes | None] = (),
) -> None:
    """A file of bodies that are there already; each with its number of frames, and some with what vibrates."""
    first = 0
    with TouchWriter(stream) as writer:
        writer.write_head(head, {"source": source}, has_vibration=any(v is not None for v in vibrations))
        for i, (count, body) in enumerate(segments):
            vibration = vibrations[i] if vibrations else None
            if vibration is not None:
                writer.write_vibration(first, count, vibration)
            writer.write_segment(first, count, body)
            first += count


def write_touch(
    stream: Path, spec: TouchSpec, segments: list[tuple[int, bytes]], vibrations: Sequence[bytes | None] = ()
) -> None:
    """A file of bodies of coder `touch`, made without the device filter."""
    grid = TOUCH_GRID
    head = Head(
        grid_shape=grid.shape, spacing_m=grid.spacing_m, origin_m=grid.origin_m, rate_hz=30.0,
        frame_count=sum(count for count, _ in segments), axes="x right, y down, z forward", device_name="none",
        device_type=1, force_max_n=8.0, mapping_scale=1.0, mapping_offset_m=(0.0, 0.0, 0.0),
        weber_fraction=spec.k, force_threshold_n=spec.f0_n, friction=0.0, damping_n_s_per_m=0.0, tags=(),
        coder="touch", coder_parameters=TouchEncoder(grid, spec).parameters,
    )  # fmt: skip
    write_segments(stream, head, segments, "made up", vibrations)


def faulty_vibration(folder: Path) -> dict[str, str]:
    """Bodies of VIBR that are damaged where the CRC-32 does not tell, and the errors they raise."""
    frames, spec = VIBRATING["vibration"]
    [segment, *_] = touch_segments(frames, spec)
    body = encode_vibration([hum(TOUCH_GRID, 0), hum(TOUCH_GRID, 1)])
    flipped = bytearray(body)
    flipped[2] ^= 255  # in the first support
    bodies = {
        "vibration_cut": body[: len(body) // 2],
        "vibration_flipped": bytes(flipped),
        "vibration_long": body + b"\0",
        "vibration_one_frame": encode_vibration([hum(TOUCH_GRID, 0)]),
    }
    errors = {}
    for name, damaged in bodies.items():
        path = folder / f"{name}.touch"
        write_touch(path, spec, [segment], [damaged])
        try:
            with open_stream(path) as opened:
                band = opened.medium.vibration
                assert band is not None
                band[0]
        except FormatError as error:
            errors[name] = type(error).__name__
    if errors.keys() != bodies.keys():
        raise AssertionError(f"decoded without an error: {sorted(bodies.keys() - errors.keys())}")
    return errors


def faulty_touch(folder: Path) -> dict[str, str]:
    """Bodies of coder `touch` that are damaged where the CRC-32 does not tell, and the errors they raise."""
    frames, spec = WAVES[:2], TouchSpec()
    [(count, body)] = touch_segments(frames, spec)
    reader = BodyReader(body, TOUCH_GRID, lossless=False)
    first, *others = reader.records(count)
    flipped = bytearray(first.payload)
    flipped[2] ^= 255  # in the list of bricks
    size = write_varint(1 << 20)
    payloads = {
        "touch_cut": first.payload[: len(first.payload) // 2],
        "touch_flipped": bytes(flipped),
        "touch_long": first.payload + bytes(range(1, 10)),
        "touch_many_bricks": write_varint(len(size)) + size + first.payload[10:],
    }
    bodies = {
        name: write_body(reader.lattice, [replace(first, payload=payload), *others], None)
        for name, payload in payloads.items()
    }
    far = replace(others[-1], exceptions=write_varint(1 << 40) + bytes([1]))
    bodies["touch_far_exception"] = write_body(reader.lattice, [first, far], None)
    bodies["touch_chunk_beyond"] = body[: len(body) - len(others[-1].payload) // 2]
    errors = {}
    for name, damaged in bodies.items():
        path = folder / f"{name}.touch"
        write_touch(path, spec, [(count, damaged)])
        try:
            with open_stream(path) as opened:
                list(opened.medium)
        except FormatError as error:
            errors[name] = type(error).__name__
    if errors.keys() != bodies.keys():
        raise AssertionError(f"decoded without an error: {sorted(bodies.keys() - errors.keys())}")
    return errors


def write_parts(stream: Path) -> None:
    """What a file of objects decodes to, object by object: poses, and dense fields in newtons."""
    with TouchReader(stream) as reader:
        objects = ObjectStream(reader).scene.objects
        parts = {
            "quaternions": np.stack([one.track.quaternions for one in objects]),
            "positions_m": np.stack([one.track.positions_m for one in objects]),
        }
        for i, one in enumerate(objects):
            parts[f"forces_n_{i}"] = np.stack([field.to_dense() for field in one.medium])
    np.savez_compressed(stream.with_suffix(".objects.npz"), **parts)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "names", nargs="*", metavar="NAME", help="streams to write (default: all); faulty ones follow"
    )
    names = parser.parse_args().names
    valid, faulty = HERE / "v0", HERE / "faulty"
    for folder in (valid, faulty):
        folder.mkdir(exist_ok=True)
    for name in names or (*STREAMS, *SCENES, *TOUCH, *VIBRATING):
        stream = valid / f"{name}.touch"
        if name in SCENES:
            write_scene(stream, *SCENES[name])
            write_parts(stream)
        elif name in VIBRATING:
            write_vibrating(stream, *VIBRATING[name])
            write_hum(stream)
        elif name in TOUCH:
            touched, spec = TOUCH[name]
            segments = touch_segments(touched, spec)
            if name == "touch_exceptions":
                segments = [(count, with_exceptions(body, touched[-1])) for count, body in segments]
            write_touch(stream, spec, segments)
        else:
            frames, shape, paper = STREAMS[name]
            scene = StoredScene(waves(frames, shape))
            encode(scene, stream, replace(EncodeSpec(), nw=4, mapping="crop", coder="paper", paper=paper))
        with open_stream(stream) as opened:
            write_field(valid / f"{name}.npz", opened.medium)
    _write_faulty(faulty, (valid / "one-frame.touch").read_bytes(), (valid / "objects-rigid.touch").read_bytes())


def _write_faulty(folder: Path, good: bytes, objects: bytes) -> None:
    flipped = bytearray(good)
    flipped[len(good) // 2] ^= 4
    newer = bytearray(good)
    newer[10] = 9  # the major version follows the ten bytes of the magic
    files = {
        "vibration-late": (_with_late_vibration(good), "CorruptFile"),
        "cut-in-head": (good[:40], "TruncatedFile"),
        "cut-before-index": (good[: len(good) - 90], "TruncatedFile"),
        "bit-flipped": (bytes(flipped), "CorruptFile"),
        "newer-major": (bytes(newer), "UnsupportedVersion"),
        "text-mode": (good.replace(b"\r\n", b"\n"), "CorruptFile"),
        "foreign": (b"\x89PNG\r\n\x1a\n" + bytes(64), "ForeignFile"),
        "nothing": (b"", "ForeignFile"),
        **_faulty_objects(objects),
    }
    for name, (data, _) in files.items():
        (folder / f"{name}.touch").write_bytes(data)
    errors = {name: error for name, (_, error) in files.items()} | faulty_touch(folder) | faulty_vibration(folder)
    (folder / "errors.json").write_text(json.dumps(errors, indent=1) + "\n")


def _with_late_vibration(good: bytes) -> bytes:
    """A VIBR between the segments and the index, where none belongs; the CRC-32 of each record holds."""
    place, end = good.rindex(b"INDX"), good.rindex(b"TEND")
    late = b"VIBR" + struct.pack("<HHQIH", 0, 2, 6, 0, 1)
    late += struct.pack("<I", zlib.crc32(late))
    _, _, chain = struct.unpack("<QQI", good[end + 16 : end + 36])
    closing = b"TEND" + struct.pack("<HHQQQI", 1, 0, 20, place + len(late), len(good) + len(late), chain)
    closing += struct.pack("<I", zlib.crc32(closing))
    return good[:place] + late + good[place:end] + closing


def _faulty_objects(good: bytes) -> dict[str, tuple[bytes, str]]:
    """Objects in another order, and one that a later version brought; the CRC-32 of each record holds."""
    begin = good.index(b"OBJT")
    first_end = good.index(b"OBJT", begin + 4)
    second_end = good.index(b"OBJT", first_end + 4)
    first, second = good[begin:first_end], good[first_end:second_end]
    newer = first[:6] + struct.pack("<H", 9) + first[8:-4]
    newer += struct.pack("<I", zlib.crc32(newer))
    return {
        "objects-swapped": (good[:begin] + second + first + good[second_end:], "CorruptFile"),
        "objects-newer": (good[:begin] + newer + good[first_end:], "UnsupportedVersion"),
    }


if __name__ == "__main__":
    main()
