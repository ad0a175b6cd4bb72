"""Three decoders report the same for mutants whose CRC-32s hold: the kind of error, or the values."""

from __future__ import annotations

import random
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mutants import by_reference, compare, mutant
from second import decoder, make_golden
from test_c import COMPILER, built

from touchfield.codec.registry import field_encoder
from touchfield.codec.touch.body import BodyReader, write_body
from touchfield.codec.touch.spec import TouchSpec
from touchfield.codec.varint import write_varint
from touchfield.codec.vibration import encode_vibration
from touchfield.container import TouchWriter
from touchfield.medium import ForceField, Grid, HapticMedium, HapticObject, HapticScene, PoseTrack
from touchfield.medium.medium import VibrationFrame

SEED = 45
MUTANTS = 1500
GRID = Grid((9, 8, 7), (0.01,) * 3, (0.0,) * 3)
# a spline of nodes every four samples; its code is arbitrary, and ends after 60 bytes
SPLINE = bytes([0, 2, 2, 2, 16, 1, 1, 1]) + bytes(range(40, 240, 20)) + random.Random(1).randbytes(50)
EMPTY = b"\0\0\0\0\x80"  # payload of a frame without bricks
OUTLIERS = b"".join(
    write_varint(gap) + write_varint(2 * sample) + struct.pack("<3f", 0.0, 1.5, -0.25)
    for gap, sample in ((0, 3), (0, 9), (1, 5))
)

pytestmark = pytest.mark.skipif(COMPILER is None, reason="there is no C compiler here")


def slope(t: int) -> ForceField:
    """A few samples along a slope, which move."""
    i, j, k = np.indices(GRID.shape)
    near = abs(2 * i + j - 3 * k + t) < 3
    return ForceField.from_dense(GRID, (near[..., None] * [0.25, 0, 1]).astype(np.float32))


def frames_stream(path: Path, spec: TouchSpec, **parts: bytes) -> bytes:
    """A file of three frames in one segment; the second one has other parts."""
    encoder = field_encoder(GRID, spec)
    body = encoder.encode_segment([slope(t) for t in range(3)]).body
    if parts:
        reader = BodyReader(body, GRID, exact=False)
        first, second, third = reader.records(3)
        body = write_body(reader.lattice, [first, replace(second, **parts), third], reader.max_error)
    with TouchWriter(path) as writer:
        writer.write_head(make_golden.head_of(GRID, 30.0, 3, encoder))
        if path.stem == "vibration":
            writer.write_vibration(0, 3, encode_vibration([vibrating(t) for t in range(3)]))
        writer.write_segment(0, 3, body)
    return path.read_bytes()


def vibrating(t: int) -> VibrationFrame:
    """Eight samples that vibrate."""
    positions = np.argwhere(np.ones((2, 2, 2))).astype(np.int32) + t
    numbers = np.arange(1, 9, dtype=np.float32)
    return VibrationFrame(GRID, positions, numbers / 8, 40 * numbers)


def scene() -> HapticScene:
    """A deforming body between two rigid ones."""
    rigid = HapticMedium.from_frames([slope(0)], 30.0)
    deforming = HapticMedium.from_frames([slope(t) for t in range(3)], 30.0)
    t = np.arange(3)
    turns = np.stack([np.full(3, 40), 3 * t, 2 * t, -t], axis=1)
    track = PoseTrack(turns / np.linalg.norm(turns, axis=1, keepdims=True), np.outer(t, [1, 2, 3]) / 1024)
    bodies = [HapticObject(name, medium, track) for name, medium in
              (("a", rigid), ("b", deforming), ("c", deforming), ("d", rigid))]  # fmt: skip
    return HapticScene(GRID, 30.0, tuple(bodies), 1.25, 0.125, "", 0.25, 0.5)


@pytest.fixture(scope="module")
def streams(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """Small files of all parts that the C code decodes: the second decoder takes milliseconds for each."""
    folder = tmp_path_factory.mktemp("streams")
    specs = {
        "mask": TouchSpec(), "masking": TouchSpec(masking=0.1, masking_radius_m=0.02),
        "direction": TouchSpec(mode="mask-direction"), "nmse": TouchSpec(mode="nmse", step_n=0.1),
        "lossless": TouchSpec(mode="lossless"), "vibration": TouchSpec(effort="fast"),
    }  # fmt: skip
    files = {name: frames_stream(folder / name, spec) for name, spec in specs.items()}
    files["outliers"] = frames_stream(folder / "outliers", TouchSpec(), outliers=OUTLIERS)
    independent = TouchSpec(interframe="off")
    files["spline"] = frames_stream(folder / "spline", independent, base_layer=SPLINE, payload=EMPTY)
    make_golden.write_scene(folder / "scene", scene(), TouchSpec())
    return files | {"scene": (folder / "scene").read_bytes()}


@pytest.mark.thorough
def test_decoders_report_the_same_for_mutants(streams: dict[str, bytes], tmp_path: Path) -> None:
    program = built(tmp_path, "touch_decode", "-O2")
    kinds, differences = compare(program, list(streams.values()), SEED, MUTANTS, tmp_path)
    assert not differences, "\n".join(differences)
    assert min(kinds[kind] for kind in ("", "TruncatedFile", "CorruptFile")) > MUTANTS // 20


def test_unchanged_files_are_valid(streams: dict[str, bytes]) -> None:
    for name, data in streams.items():
        assert by_reference(data).kind == "", name


def test_mutants_have_valid_records(streams: dict[str, bytes]) -> None:
    """Their faults lie within the payloads, so the decoders behind the container are compared."""
    rng = random.Random(SEED)
    for data in streams.values():
        changed = [mutant(data, rng) for _ in range(20)]
        assert len(set(changed)) > 10
        for other in changed:
            assert decoder.read_records(other)[-1].tag == "TEND"
