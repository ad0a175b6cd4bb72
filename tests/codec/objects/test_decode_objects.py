"""The decoder written from docs/format/objects.md alone agrees on poses, fields and forces."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from bit_writer import coded_numbers
from object_makers import F0_N, head_of, moving_scene, tumbling
from touchfield.codec.objects.decoder import PoseSteps, decode_poses
from touchfield.codec.objects.encoder import ObjectsEncoder, encode_poses
from touchfield.codec.paper.spec import PaperSpec
from touchfield.container import TouchReader, TouchWriter
from touchfield.errors import CorruptFile
from touchfield.medium import PoseTrack
from touchfield.pipeline.decoded_objects import SceneStream
from touchfield.pipeline.encoding import write_objects

CONFORMANCE = Path(__file__).resolve().parents[3] / "conformance"
SAMPLE_ATOL_N = 2e-6
"""Tolerance for float32 sums of a few newtons in another order."""


@pytest.fixture(scope="module")
def reference_decoder() -> Iterator[Any]:
    """The decoder in `conformance/`, whose scripts import each other."""
    sys.path.insert(0, str(CONFORMANCE))
    try:
        yield importlib.import_module("decode_objects")  # which imports more when it needs it
    finally:
        sys.path.remove(str(CONFORMANCE))


@pytest.mark.parametrize("deforming", [False, True])
@pytest.mark.parametrize("surface_damping", [0.0, 0.75])
def test_scenes_of_the_encoder(
    reference_decoder: Any, tmp_path: Path, deforming: bool, surface_damping: float
) -> None:
    """The coded integers of poses and fields are equal; poses and forces agree to rounding."""
    spec, scene = PaperSpec(segment_frames=3, directions="ico3"), moving_scene(5, deforming, surface_damping)
    encoder = ObjectsEncoder(scene, spec, F0_N)
    with TouchWriter(tmp_path / "a.touch") as writer:
        writer.write_head(head_of(scene, encoder, spec))
        write_objects(writer, encoder, len(scene))
    with TouchReader(tmp_path / "a.touch") as reader:
        stream = SceneStream(reader)
        file = SimpleNamespace(
            head=asdict(reader.head),
            objects=[asdict(reader.read_object(i)) for i in range(reader.object_count)],
            segments=[
                SimpleNamespace(frame_count=entry.frame_count, body=reader.read_segment(i))
                for i, entry in enumerate(reader.segments)
            ],
        )
        decoded = reference_decoder.decode_scene(file.head, file.objects, file.segments)
        scene = stream.scene
        assert decoded.surface_damping == scene.surface_damping_n_s_per_m
        assert decoded.place_tolerance_m == stream.decoder.place_tolerance_m and set(decoded.max_errors) == {
            None
        }
        for body, original in zip(decoded.bodies, scene.objects, strict=True):
            np.testing.assert_array_equal(body.positions_m, original.track.positions_m)
            alignments = np.abs((body.quaternions * original.track.quaternions).sum(axis=1))  # of either sign
            np.testing.assert_allclose(alignments, 1.0, atol=1e-15, rtol=0)
            assert len(body.forces_n) == len(original.medium)
            for forces_n, field in zip(body.forces_n, original.medium, strict=True):
                np.testing.assert_array_equal(forces_n, field.to_dense())
        for frame, dense_n in enumerate(reference_decoder.decode_forces(file)):
            np.testing.assert_allclose(
                dense_n, scene.voxelise()[frame].to_dense(), atol=SAMPLE_ATOL_N, rtol=0
            )


def test_max_error_is_read(reference_decoder: Any) -> None:
    from touchfield.codec.objects.layout import SegmentParts
    from touchfield.codec.segment import MaxError

    max_error = MaxError(13 / 65535, 2, (3, 700, 5))
    assert reference_decoder.max_error_of(
        reference_decoder.Cursor(SegmentParts(max_error, []).to_bytes()), 3
    ) == tuple(max_error)
    with pytest.raises(ValueError, match="a number of 2"):
        reference_decoder.max_error_of(reference_decoder.Cursor(SegmentParts(max_error, []).to_bytes()), 2)


@pytest.mark.parametrize("seed", range(4))
def test_poses_of_any_kind(reference_decoder: Any, seed: int) -> None:
    """Large jumps, long stretches of nothing, smooth and rough motion."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 40))
    position = np.cumsum(rng.normal(size=(count, 3)) * 10.0 ** rng.integers(-5, 6, size=(count, 1)), axis=0)
    position[:, seed % 3] = position[0, seed % 3]
    quaternions = rng.normal(size=(count, 4)) if seed % 2 else tumbling(count, 0.0, 0.1).quaternions
    track = PoseTrack(quaternions / np.sqrt((quaternions * quaternions).sum(axis=1, keepdims=True)), position)
    steps = PoseSteps(2.0**-12, 2.0**-9)
    data = encode_poses(track, steps)
    numbers = reference_decoder.pose_numbers(data, count, 512)
    decoded = decode_poses(data, count, steps)
    np.testing.assert_array_equal(numbers[:, :3] * steps.position_m, decoded.positions_m)
    units = numbers[:, 3:] / np.sqrt((numbers[:, 3:] ** 2).sum(axis=1, keepdims=True))
    np.testing.assert_allclose(np.abs((units * decoded.quaternions).sum(axis=1)), 1.0, atol=1e-15, rtol=0)


def test_faulty_poses_are_refused(reference_decoder: Any) -> None:
    data = encode_poses(tumbling(9, 0.01, 0.1), PoseSteps(2.0**-12, 2.0**-9))
    for wrong, unit in ((data + bytes(8), 512), (data[:-8], 512), (b"", 512), (data, 256)):
        with pytest.raises(ValueError, match=r"predictor|quaternion|limit|end|behind"):
            reference_decoder.pose_numbers(wrong, 9, unit)
    for order, turn, message in (
        (4, 512, "predictor"),
        (0, 500, "not unit"),
        (0, 600, "limit"),
        (0, 512, ""),
    ):
        crafted = coded_numbers([order, *[0] * 9, turn, 0, 0, 0])
        if message:
            with pytest.raises(ValueError, match=message):
                reference_decoder.pose_numbers(crafted, 1, 512)
            with pytest.raises(CorruptFile):
                decode_poses(crafted, 1, PoseSteps(2.0**-12, 2.0**-9))
        else:
            assert reference_decoder.pose_numbers(crafted, 1, 512).tolist() == [[0, 0, 0, 512, 0, 0, 0]]
