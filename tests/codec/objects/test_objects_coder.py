"""Coder `objects`: haptic scenes survive a round trip, and faulty files are refused."""

from __future__ import annotations

import dataclasses
import io
import tracemalloc
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

from object_makers import F0_N, ball, head_of, moving_scene, tumbling
from touchfield.codec.objects.decoder import ObjectsDecoder
from touchfield.codec.objects.encoder import ObjectsEncoder, check_pose_count
from touchfield.codec.objects.layout import MAX_OBJECTS, ObjectPart, Parameters, SegmentParts
from touchfield.codec.paper.decoder import PaperDecoder
from touchfield.codec.paper.encoder import PaperEncoder
from touchfield.codec.paper.spec import PaperSpec
from touchfield.codec.registry import coder, field_decoder
from touchfield.codec.segment import MaxError
from touchfield.codec.varint import write_varint
from touchfield.container import TouchReader, TouchWriter
from touchfield.errors import CorruptFile, FormatError, InvalidArgument, UnsupportedVersion
from touchfield.medium import Grid, HapticMedium, HapticObject, HapticScene, PoseTrack
from touchfield.medium.pose_track import MAX_POSES
from touchfield.pipeline.decoded_objects import SceneStream
from touchfield.pipeline.encoding import record_of, write_objects

SPEC = PaperSpec(segment_frames=3)


def write_scene(path: Path, scene: HapticScene, spec: PaperSpec = SPEC) -> ObjectsEncoder:
    """Write a scene to a file; return its encoder."""
    encoder = ObjectsEncoder(scene, spec, F0_N)
    with TouchWriter(path) as writer:
        writer.write_head(head_of(scene, encoder, spec), {"source": "made up"})
        write_objects(writer, encoder, scene.frame_count)
    return encoder


@pytest.fixture(scope="module")
def stream_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("objects") / "moving.touch"
    write_scene(path, moving_scene())
    return path


# -- whole scenes ------------------------------------------------------------------------------------------


def test_scene_round_trip(stream_path: Path) -> None:
    scene = moving_scene()
    with TouchReader(stream_path) as reader:
        decoded = SceneStream(reader).scene
        for name in (
            "grid",
            "rate_hz",
            "force_max_n",
            "surface_damping_n_s_per_m",
            "axes",
            "friction",
            "tags",
        ):
            assert getattr(decoded, name) == getattr(scene, name)
        assert decoded.damping_n_s_per_m == scene.damping_n_s_per_m
        assert decoded.provenance == {"source": "made up"}
        for restored, original in zip(decoded.objects, scene.objects, strict=True):
            assert (restored.name, restored.is_rigid, restored.medium.grid) == (
                original.name,
                original.is_rigid,
                original.medium.grid,
            )
            assert len(restored.track) == 7


@pytest.mark.parametrize("damping", [0.02, 0.5, 10.0])
def test_the_damping_of_a_moving_surface_is_within_the_mask(tmp_path: Path, damping: float) -> None:
    """Compared where both motions have a force; the surface is displaced by less than a voxel."""
    scene = moving_scene(deforming=False, surface_damping=damping)
    scene = dataclasses.replace(scene, objects=scene.objects[:1], force_max_n=100.0)
    write_scene(tmp_path / "a.touch", scene)
    index = np.moveaxis(np.indices((41, 41, 41)), 0, -1) / 40 - 0.5
    with TouchReader(tmp_path / "a.touch") as reader:
        decoded = SceneStream(reader).scene
        body = decoded.objects[0]
        exact = dataclasses.replace(
            decoded, objects=(dataclasses.replace(body, track=scene.objects[0].track),)
        )
        undamped = dataclasses.replace(exact, surface_damping_n_s_per_m=0.0)
        for frame in (0, 3, 6):
            points = scene.objects[0].track.to_scene(0.009 * index, frame)
            both = (np.abs(undamped.sample_n(frame, points)) > 1e-3).any(axis=-1)
            error = exact.sample_n(frame, points) - decoded.sample_n(frame, points)
            assert both.sum() > 1000
            assert np.sqrt((error[both] ** 2).sum(axis=-1)).max() <= F0_N / 2 + 1e-5


def test_fields_are_those_of_the_paper_coder(stream_path: Path) -> None:
    scene = moving_scene()
    with TouchReader(stream_path) as reader:
        stream = SceneStream(reader)
        coders = [PaperEncoder(item.medium.grid, SPEC) for item in scene.objects]
        for i in (0, 1):
            body = coders[i].encode_segment([scene.objects[i].field(0)]).body
            (expected,) = PaperDecoder(scene.objects[i].medium.grid, coders[i].parameters).frames(body, 1)
            assert stream.scene.objects[i].field(5) == expected
        decoder = PaperDecoder(scene.objects[2].medium.grid, coders[2].parameters)
        expected_frames = []
        for start in (0, 3, 6):
            frames = [scene.objects[2].field(f) for f in range(start, min(start + 3, 7))]
            expected_frames += decoder.frames(coders[2].encode_segment(frames).body, len(frames))
        for frame in (0, 1, 6, 2, 2, 5, 4, 3):  # in any order
            assert stream.scene.objects[2].field(frame) == expected_frames[frame]


def test_both_representations_agree_after_decoding(stream_path: Path) -> None:
    with TouchReader(stream_path) as reader:
        decoded = SceneStream(reader).scene
        voxels = decoded.voxelise()
        grid = decoded.grid
        points = grid.to_m(np.moveaxis(np.indices(grid.shape), 0, -1))
        assert len(voxels) == 7
        for frame in (0, 6):
            np.testing.assert_allclose(voxels[frame].to_dense(), decoded.sample_n(frame, points), atol=1e-6)
            assert voxels[frame].support_count > 100


def test_surface_damping_round_trip(tmp_path: Path) -> None:
    write_scene(tmp_path / "a.touch", moving_scene(deforming=False, surface_damping=0.75))
    with TouchReader(tmp_path / "a.touch") as reader:
        stream = SceneStream(reader)
        assert stream.scene.surface_damping_n_s_per_m == 0.75
        assert stream.decoder.describe()["surface_damping_n_s_per_m"] == 0.75


def test_rigid_motion_costs_poses_and_one_field(tmp_path: Path) -> None:
    sizes = {}
    for frames in (2, 200):
        write_scene(tmp_path / f"{frames}.touch", moving_scene(frames, deforming=False))
        with TouchReader(tmp_path / f"{frames}.touch") as reader:
            sizes[frames] = SceneStream(reader).bits
            assert len(reader.segments) == 1
    assert sizes[200].support == sizes[2].support > 0
    # a raw pose of float64 has 56 bytes, and there are two
    assert sizes[2].poses < sizes[200].poses < 200 * 64 * 8


def test_bits_of_all_parts_sum_to_the_file(tmp_path: Path) -> None:
    encoder = write_scene(tmp_path / "a.touch", moving_scene())
    with TouchReader(tmp_path / "a.touch") as reader:
        stream = SceneStream(reader)
        bodies = [reader.read_segment(i) for i in range(len(reader.segments))]
        rigid = [body.field for body in stream.decoder.objects]
        bits = stream.bits
    assert bits.total == 8 * (sum(map(len, bodies)) + sum(map(len, rigid)))
    assert min(bits.poses, bits.support, bits.amplitude, bits.direction, bits.side) > 0
    support_counts = [f.support_count for body in moving_scene().objects for f in body.medium]
    assert encoder.supported == sum(support_counts)


def test_the_same_scene_has_the_same_bytes(stream_path: Path, tmp_path: Path) -> None:
    write_scene(tmp_path / "again.touch", moving_scene())
    assert (tmp_path / "again.touch").read_bytes() == stream_path.read_bytes()


def test_segments_may_be_encoded_before_the_objects() -> None:
    scene = moving_scene()
    encoder, other_encoder = (ObjectsEncoder(scene, SPEC, F0_N) for _ in range(2))
    objects = list(encoder.objects())
    assert list(encoder.segments()) == list(other_encoder.segments())
    assert objects == list(other_encoder.objects())


def test_empty_objects_and_a_single_frame(tmp_path: Path) -> None:
    grid = Grid((5, 4, 3), (0.001,) * 3, (0.0,) * 3)
    nothing = HapticMedium.from_frames([ball(grid, 1e-9)], 30.0)
    assert nothing[0].support_count == 0
    scene = HapticScene(grid, 30.0, (HapticObject("", nothing, tumbling(1, 0.1, 0.3)),), 3.0)
    write_scene(tmp_path / "a.touch", scene)
    with TouchReader(tmp_path / "a.touch") as reader:
        decoded = SceneStream(reader).scene
        assert decoded.voxelise()[0].support_count == 0
        assert len(decoded.objects[0].track) == 1


# -- what is refused ---------------------------------------------------------------------------------------


def test_other_coders_are_refused_by_name() -> None:
    assert coder("paper").decoder_class is PaperDecoder and coder("objects").decoder_class is ObjectsDecoder
    with pytest.raises(
        UnsupportedVersion, match=r"^HEAD.coder: found 'x'; expected 'touch' or 'paper' or 'objects'"
    ):
        coder("x")
    grid = Grid((5, 4, 3), (0.001,) * 3, (0.0,) * 3)
    with pytest.raises(
        UnsupportedVersion, match=r"OBJT 3 field_coder: found 'objects'; expected 'touch' or 'paper'"
    ):
        field_decoder("objects", grid, b"", "OBJT 3")  # objects of objects
    with pytest.raises(CorruptFile, match="codebook"):
        field_decoder("paper", grid, b"cube")


@pytest.mark.parametrize(
    ("data", "match"),
    [
        (b"", "0 bytes"),
        (Parameters(1, 0.0, 0.0).to_bytes() + b"\0", "21 bytes"),
        (Parameters(0, 0.0, 0.0).to_bytes(), "0 objects"),
        (Parameters(MAX_OBJECTS + 1, 0.0, 0.0).to_bytes(), "4097 objects"),
        (Parameters(1, -0.5, 0.0).to_bytes(), "damping of -0.5"),
        (Parameters(1, float("nan"), 0.0).to_bytes(), "damping of nan"),
        (Parameters(1, 0.0, float("inf")).to_bytes(), "place of inf"),
        (Parameters(1, 0.0, -1.0).to_bytes(), "place of -1"),
    ],
)
def test_parameters_out_of_bounds(data: bytes, match: str) -> None:
    with pytest.raises(CorruptFile, match=f"HEAD.coder_parameters: found .*{match}"):
        Parameters.from_bytes(data)


def test_objects_that_contradict_themselves(stream_path: Path) -> None:
    with TouchReader(stream_path) as reader:
        objects = SceneStream(reader).decoder.objects
        parameters = reader.head.coder_parameters

    def decoder(**changes: object) -> ObjectsDecoder:
        return ObjectsDecoder(parameters, (*objects[:2], dataclasses.replace(objects[2], **changes)))  # type: ignore[arg-type]

    with pytest.raises(CorruptFile, match=r"OBJT records: found 2; expected 3"):
        ObjectsDecoder(parameters, objects[:2])
    with pytest.raises(CorruptFile, match=r"OBJT 2 field: found 1 bytes; expected none"):
        decoder(field=b"x")
    with pytest.raises(FormatError):
        decoder(pose_steps=b"")
    with pytest.raises(UnsupportedVersion, match=r"OBJT 2 field_coder: found 'newer'"):
        decoder(field_coder="newer")
    with pytest.raises(CorruptFile, match="codebook"):
        decoder(field_parameters=b"cube7")
    with pytest.raises(FormatError):
        ObjectsDecoder(parameters, [dataclasses.replace(o, is_deforming=False) for o in objects]).rigid_field(
            2
        )


def test_too_many_objects_or_poses() -> None:
    check_pose_count(MAX_OBJECTS, MAX_POSES // MAX_OBJECTS)
    with pytest.raises(InvalidArgument, match="4097 objects; expected at most 4096"):
        check_pose_count(MAX_OBJECTS + 1, 1)
    with pytest.raises(InvalidArgument, match="8388609 frames of 2 objects"):
        check_pose_count(2, MAX_POSES // 2 + 1)


def test_declared_poses_allocate_no_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Empty segments whose poses would take 100 GB are refused before anything is allocated."""
    scene = moving_scene(1, deforming=False)
    encoder = ObjectsEncoder(scene, SPEC, F0_N)

    def file_with_frames(frames: int) -> io.BytesIO:
        with TouchWriter(tmp_path / "a.touch") as writer:
            writer.write_head(dataclasses.replace(head_of(scene, encoder), frame_count=frames))
            for body in encoder.objects():
                writer.write_object(record_of(body))
            for first in range(0, frames, 65535):
                writer.write_segment(first, min(65535, frames - first), b"")
        return io.BytesIO((tmp_path / "a.touch").read_bytes())

    with (
        TouchReader(file_with_frames(MAX_POSES // 2 + 1)) as reader,
        pytest.raises(CorruptFile, match="16777216 poses"),
    ):
        SceneStream(reader)
    monkeypatch.setenv("TOUCHFIELD_MEMORY_GIB", "0.1")
    with (
        TouchReader(file_with_frames(1 << 20)) as reader,
        pytest.raises(InvalidArgument, match="GiB of poses"),
    ):
        SceneStream(reader)
    monkeypatch.setenv("TOUCHFIELD_MEMORY_GIB", "1")
    with TouchReader(file_with_frames(1 << 20)) as reader:
        tracemalloc.start()
        try:
            with pytest.raises(FormatError):
                _ = SceneStream(reader).tracks
            assert tracemalloc.get_traced_memory()[1] < 2_000_000
        finally:
            tracemalloc.stop()


# -- the body of a segment ---------------------------------------------------------------------------------


voxels = st.tuples(*[st.integers(0, (1 << 20) - 1)] * 3)
max_errors = st.none() | st.builds(
    lambda n, f, v: MaxError(n / 65535, f, v), st.integers(0, 65535), st.integers(0, 65534), voxels
)


@given(
    max_errors,
    st.lists(st.tuples(st.binary(max_size=300), st.none() | st.binary(max_size=300)), max_size=6),
    st.data(),
)
def test_segment_parts_round_trip(
    max_error: MaxError | None, contents: list[tuple[bytes, bytes | None]], data: st.DataObject
) -> None:
    parts = SegmentParts(max_error, [ObjectPart(poses, fields) for poses, fields in contents])
    body = parts.to_bytes()
    kinds = [fields is not None for _, fields in contents]
    assert SegmentParts.from_bytes(body, kinds) == parts
    with pytest.raises(CorruptFile, match="1 bytes after the last object"):
        SegmentParts.from_bytes(body + b"\0", kinds)
    with pytest.raises(FormatError):
        SegmentParts.from_bytes(body[: data.draw(st.integers(0, len(body) - 1))], kinds)


@pytest.mark.parametrize("ratio", [0.0, 1e-9, 0.5, 0.99999, 1.0])
def test_max_error_is_not_rounded_down(ratio: float) -> None:
    read = SegmentParts.from_bytes(SegmentParts(MaxError(ratio, 0, (0, 0, 0)), []).to_bytes(), []).max_error
    assert read is not None and ratio <= read.ratio <= ratio + 1 / 65535


def test_a_length_beyond_the_body_allocates_nothing() -> None:
    huge = b"\0" + b"\xff" * 7 + b"\x7f"
    with pytest.raises(FormatError, match=r"poses of object 0: found 0 bytes; expected \d{17} bytes"):
        SegmentParts.from_bytes(huge, [False])


def test_max_error_voxel_out_of_bounds(decoding: tuple[ObjectsDecoder, list[bytes]]) -> None:
    decoder, bodies = decoding
    parts = decoder.parts(bodies[0])
    late = parts._replace(max_error=MaxError(0.5, 3, (0, 0, 0)))
    with pytest.raises(CorruptFile, match=r"SEGM.body worst frame: found 3 at offset 3; expected .* below 3"):
        decoder.tracks(late.to_bytes(), 3)
    for bad in (
        write_varint(65537),
        write_varint(1) + write_varint(1 << 16),
        write_varint(1) * 2 + write_varint(1 << 20),
    ):
        with pytest.raises(CorruptFile, match=r"SEGM.body worst"):
            decoder.parts(bad + bytes(9))


@given(st.data())
def test_changed_bodies_are_refused_or_read(
    decoding: tuple[ObjectsDecoder, list[bytes]], data: st.DataObject
) -> None:
    """Past the CRC-32 any bytes may reach the decoder: it raises only the named errors."""
    decoder, bodies = decoding
    body = bytearray(data.draw(st.sampled_from(bodies)))
    for _ in range(data.draw(st.integers(1, 4))):
        start = data.draw(st.integers(0, len(body)))
        body[start : start + data.draw(st.integers(0, 4))] = data.draw(st.binary(max_size=4))
    with suppress(FormatError):
        assert all(len(track) == 3 for track in decoder.tracks(bytes(body), 3))
        assert len(list(decoder.fields(bytes(body), 2, 3))) == 3
        assert decoder.cost(bytes(body), 3).total == 8 * len(body)


@given(st.data())
def test_changed_objects_are_refused_or_read(
    decoding: tuple[ObjectsDecoder, list[bytes]], data: st.DataObject
) -> None:
    decoder, bodies = decoding
    index = data.draw(st.integers(0, 2))
    name = data.draw(st.sampled_from(["field", "pose_steps", "field_parameters"]))
    value = bytearray(getattr(decoder.objects[index], name))
    for _ in range(data.draw(st.integers(1, 3))):
        start = data.draw(st.integers(0, len(value)))
        value[start : start + data.draw(st.integers(0, 3))] = data.draw(st.binary(max_size=3))
    objects = list(decoder.objects)
    objects[index] = dataclasses.replace(objects[index], **{name: bytes(value)})
    with suppress(FormatError):
        changed = ObjectsDecoder(Parameters(3, 0.0, 0.0).to_bytes(), objects)
        assert len(changed.tracks(bodies[0], 3)) == 3
        assert changed.rigid_field(0).grid == objects[0].grid
        assert changed.object_cost(1).total == 8 * len(objects[1].field)


def test_bytes_after_the_last_field_of_a_segment_are_noticed(stream_path: Path) -> None:
    """Also where frames are read one at a time."""
    with TouchReader(stream_path) as reader:
        stream = SceneStream(reader)
        medium = stream.scene.objects[2].medium
        parts = stream.decoder.parts(reader.read_segment(0))
        poses, fields = [part.poses for part in parts.objects], parts.objects[2].fields
        assert fields is not None
        longer = [ObjectPart(p, None) for p in poses[:2]] + [ObjectPart(poses[2], fields + b"\0")]
        body = SegmentParts(None, longer).to_bytes()
        stream._body = lambda segment: body  # type: ignore[assignment]
        medium[0], medium[1]
        with pytest.raises(CorruptFile, match="1 bytes after the last frame"):
            medium[2]


@pytest.fixture(scope="module")
def decoding(stream_path: Path) -> tuple[ObjectsDecoder, list[bytes]]:
    with TouchReader(stream_path) as reader:
        return SceneStream(reader).decoder, [reader.read_segment(i) for i in (0, 1)]


def test_fields_are_of_objects_that_deform(decoding: tuple[ObjectsDecoder, list[bytes]]) -> None:
    decoder, bodies = decoding
    with pytest.raises(InvalidArgument, match="object: found 0, which is rigid"):
        decoder.fields(bodies[0], 0, 3)
    assert decoder.object_cost(2).total == 0
    assert decoder.describe()["objects"] == 3 and decoder.describe()["deforming_objects"] == 1


def test_the_parts_of_a_segment_are_read_once_for_all_objects(
    stream_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Thousands of objects read the same body: parsing it for each would be quadratic in their number."""
    calls = []
    read = SegmentParts.from_bytes
    monkeypatch.setattr(SegmentParts, "from_bytes", lambda *a: calls.append(a) or read(*a))
    with TouchReader(stream_path) as reader:
        stream = SceneStream(reader)
        assert stream.tracks and len(calls) == len(reader.segments)
        calls.clear()
        body = reader.read_segment(0)
        for _ in range(5):
            stream.decoder.fields(body, 2, 3)
    assert len(calls) == 1


def test_errors_name_the_record_and_the_object(decoding: tuple[ObjectsDecoder, list[bytes]]) -> None:
    decoder, bodies = decoding
    for change, message in (
        ({"pose_steps": b"\0"}, "OBJT 1 pose_steps: found 1 bytes"),
        ({"field_parameters": b"cube"}, "OBJT 1 field_parameters: found b'cube'"),
        ({"field_coder": "x"}, "OBJT 1 field_coder: found 'x'"),
    ):
        first, second, third = decoder.objects
        with pytest.raises(FormatError, match=message):
            ObjectsDecoder(
                Parameters(3, 0.0, 0.0).to_bytes(), [first, dataclasses.replace(second, **change), third]
            )
    parts = decoder.parts(bodies[0]).objects
    cut = [parts[0], parts[1]._replace(poses=parts[1].poses[:-1]), parts[2]]
    with pytest.raises(FormatError, match=r"SEGM.body poses of object 1"):
        decoder.tracks(SegmentParts(None, cut).to_bytes(), 3)


def test_damping_that_needs_too_fine_poses_is_refused(tmp_path: Path) -> None:
    scene = moving_scene(3, deforming=False, surface_damping=1e9)
    with pytest.raises(
        InvalidArgument, match=r"a damping of 1e\+09 N s/m at 1000 Hz.*smaller surface damping"
    ):
        write_scene(tmp_path / "x.touch", scene)
    assert not list(tmp_path.iterdir())


def test_objects_at_rest_are_exact(decoding: tuple[ObjectsDecoder, list[bytes]]) -> None:
    decoder, bodies = decoding
    assert decoder.tracks(bodies[0], 3)[1] == PoseTrack.constant(3)


def write_scene_on_grid(path: Path, scene: HapticScene, world: Grid) -> int:
    """Write a scene whose header declares another grid; return the file's size in bytes."""
    encoder = ObjectsEncoder(scene, SPEC, F0_N)
    head = head_of(scene, encoder, SPEC)
    with TouchWriter(path) as writer:
        grid_fields = {"grid_shape": world.shape, "spacing_m": world.spacing_m, "origin_m": world.origin_m}
        writer.write_head(dataclasses.replace(head, **grid_fields), {})
        write_objects(writer, encoder, scene.frame_count)
    return path.stat().st_size


@pytest.mark.parametrize("spacing_m", [1e-9, 1e-5, 5e-5])
def test_small_file_cannot_fill_a_huge_grid(tmp_path: Path, spacing_m: float) -> None:
    """Each brick of a body would cover thousands of the grid's bricks, up to all 134 million."""
    world = Grid((4096,) * 3, (spacing_m,) * 3, (-2048 * spacing_m,) * 3)
    size = write_scene_on_grid(tmp_path / "a.touch", moving_scene(3), world)
    with TouchReader(tmp_path / "a.touch") as reader:
        scene = SceneStream(reader).scene
        scene.sample_n(0, [0.0, 0.0, 0.0])
        tracemalloc.start()
        try:
            with pytest.raises(
                CorruptFile, match=rf"frame 1: .*than {4096 + 32 * size} bricks.* of {size} bytes"
            ):
                scene.voxelise()[1]
            peak = tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()
        assert peak < (700 << 20)  # an index entry per brick of the grid; its pages are never touched
        small_grid = Grid((8, 8, 8), (0.001,) * 3, (0.0,) * 3)
        assert scene.voxelise(small_grid)[1].grid == small_grid  # a requested grid is not limited


def test_huge_grid_around_a_small_scene_is_accepted(tmp_path: Path) -> None:
    scene = moving_scene(3)
    h, origin = scene.grid.spacing_m, scene.grid.origin_m
    wide_grid = Grid(
        (4096,) * 3, h, (origin[0] - 1024 * h[0], origin[1] - 1024 * h[1], origin[2] - 1024 * h[2])
    )
    write_scene_on_grid(tmp_path / "a.touch", scene, wide_grid)
    write_scene(tmp_path / "b.touch", scene)
    with TouchReader(tmp_path / "a.touch") as reader, TouchReader(tmp_path / "b.touch") as plain_reader:
        found, expected = (SceneStream(r).scene.voxelise()[2] for r in (reader, plain_reader))
        shifted = found.bricks - 128
        is_inside = ((shifted >= 0) & (shifted < scene.grid.brick_shape)).all(axis=1)
        assert np.array_equal(shifted[is_inside], expected.bricks)
