"""The pipeline from Python: equal fields by every path, random access, devices, mappings."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from touchfield.codec.paper.spec import PaperSpec
from touchfield.codec.touch.spec import TouchSpec
from touchfield.errors import CorruptFile, InvalidArgument
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.pipeline import compare, encode, prepare
from touchfield.pipeline.decoding import open_file, write_field
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.options import SourceOptions
from touchfield.sources.shapes.analytic_scene import AnalyticScene
from touchfield.sources.shapes.shapes import Sphere
from touchfield.sources.stored import StoredScene


def ball(radius_m: float = 0.04) -> AnalyticScene:
    return AnalyticScene((Sphere((0.0, 0.0, 0.0), radius_m),))


@cache
def moving(frames: int = 7) -> StoredScene:
    """A stored medium on the lattice of the device: a ball that grows and shrinks."""
    grid = prepare(ball(), EncodeSpec(nw=4)).medium.grid
    fields = [
        prepare(ball(0.02 + 0.004 * (t % 4)), EncodeSpec(nw=4, mapping="crop")).medium[0].on_grid(grid)
        for t in range(frames)
    ]
    return StoredScene(HapticMedium.from_frames(fields, 25.0, "x right, y up, z towards the viewer"))


def test_frames_decoded_without_a_force_are_noted(tmp_path: Path) -> None:
    """Forces below F_0 may be dropped within the guarantee; such a frame has no force, and a note says so."""
    grid = prepare(ball(), EncodeSpec(nw=3)).medium.grid
    weak, strong = (ForceField.from_dense(grid, np.full((8, 8, 8, 3), n / 3**0.5)) for n in (0.03, 1.0))
    empty = ForceField.empty(grid)
    alone = EncodeSpec(touch=TouchSpec(segment_frames=1))
    for frames, message in (
        ((strong, weak, empty), "1 of 3 frames are decoded without any force"),
        ((strong, empty, strong), ""),
        ((weak, strong, weak), "2 of 3 frames are decoded without any force"),
        ((weak, weak, strong), "2 of 3 frames are decoded without any force"),
    ):
        notes = encode(HapticMedium.from_frames(frames, 30.0), tmp_path / "out.touch", alone).notes
        assert [message in note and "--f0-n" in note for note in notes[1:]] == [True] * bool(message)


def test_pins_are_within_half_a_step_unless_another_bound_is_requested(tmp_path: Path) -> None:
    done = encode("sample:terrain", tmp_path / "map.touch", EncodeSpec(device="graphiti"))
    with open_file(tmp_path / "map.touch") as stream:
        off_n = np.linalg.norm(done.prepared.medium[0].to_dense() - stream.medium[0].to_dense(), axis=3)
    assert 0 < off_n.max() * 35 / 3.3 <= 0.5 + 1e-6
    assert any("within half a step of 36 heights" in note for note in done.notes)
    for requested in (
        EncodeSpec(device="graphiti", touch=TouchSpec(k=0.05)),
        EncodeSpec(device="tactsuit-x40"),
    ):
        prepared = prepare("sample:terrain", requested)
        assert prepared.spec == requested and not any("half a step" in note for note in prepared.notes)


def test_a_field_on_the_devices_lattice_is_encoded_untouched(tmp_path: Path) -> None:
    spec = EncodeSpec(nw=5, thickness_m=0.01)
    field = write_field(tmp_path / "field.npz", prepare(ball(), spec).medium)
    direct = encode(ball(), tmp_path / "direct.touch", spec)
    stored = encode(field, tmp_path / "stored.touch", spec)
    assert stored.supported_voxels == direct.supported_voxels
    with open_file(tmp_path / "direct.touch") as a, open_file(tmp_path / "stored.touch") as b:
        assert a.medium[0] == b.medium[0]


def test_frames_in_any_order_are_the_frames_in_sequence(tmp_path: Path) -> None:
    stream = tmp_path / "s.touch"
    encode(moving(), stream, EncodeSpec(nw=4, touch=TouchSpec(segment_frames=3)))
    with open_file(stream) as opened:
        assert [s.frame_count for s in opened.reader.segments] == [3, 3, 1]
        in_sequence = list(opened.medium)
        for i in (6, 0, 5, 4, 2, 3, 1, 1):
            assert opened.medium[i] == in_sequence[i]
        assert opened.medium.rate_hz == 25.0


def test_a_range_of_frames(tmp_path: Path) -> None:
    complete, part = tmp_path / "whole.touch", tmp_path / "part.touch"
    alone = TouchSpec(interframe="off", segment_frames=1)
    encode(moving(), complete, EncodeSpec(nw=4, touch=alone))
    encode(moving(), part, EncodeSpec(nw=4, frames=(2, 5), touch=alone))
    with open_file(complete) as a, open_file(part) as b:
        assert list(b.medium) == [a.medium[i] for i in (2, 3, 4)]
    summary = compare(moving(), part).summary()
    assert summary["frames"] == 3
    for frames in ({"frames": (5, 8)}, {"fit_frames": (0, 8)}, {"frames": (7, None)}):
        with pytest.raises(InvalidArgument, match=f"{next(iter(frames))}: .*within 0:7"):
            prepare(moving(), EncodeSpec(nw=4, **frames))  # type: ignore[arg-type]
    field = write_field(tmp_path / "field.npz", moving().stored)
    assert compare(field, part).summary()["nmse_db"] == summary["nmse_db"]


def test_compare_uses_the_requested_mask(tmp_path: Path) -> None:
    masked = TouchSpec(masking=0.3, masking_radius_m=0.02)
    encode(ball(), tmp_path / "s.touch", EncodeSpec(nw=4, touch=masked))
    meter = compare(ball(), tmp_path / "s.touch").meter
    assert meter.mask_violations == 0
    for mask in ({"k": meter.k}, {"f0_n": meter.f0_n}):
        assert compare(ball(), tmp_path / "s.touch", **mask).meter.mask_violations > 0, "without the masking"
    other = compare(ball(), tmp_path / "s.touch", k=0.5, f0_n=4.0).meter
    assert (other.k, other.f0_n) == (0.5, 4.0) and other.worst_mask_ratio < meter.worst_mask_ratio


def test_encoding_is_deterministic(tmp_path: Path) -> None:
    for name in ("a", "b"):
        encode(moving(), tmp_path / f"{name}.touch", EncodeSpec(nw=4))
    assert (tmp_path / "a.touch").read_bytes() == (tmp_path / "b.touch").read_bytes()


def test_mappings_preserve_the_stiffness_at_the_hand() -> None:
    fitted = prepare(ball(), EncodeSpec(nw=5))
    assert fitted.placement.scale == pytest.approx(
        0.9 * 0.070 / 0.080
    )  # the 80 mm of the ball fit into the Omni's 70 mm
    assert prepare(ball(), EncodeSpec(nw=5, mapping="fill")).placement.scale == pytest.approx(0.070 / 0.080)
    assert prepare(ball(), EncodeSpec(nw=5, mapping="crop")).placement.scale == 1
    assert prepare(ball(), EncodeSpec(nw=5, mapping="0.25")).placement.scale == 0.25
    with pytest.raises(InvalidArgument, match="mapping"):
        prepare(ball(), EncodeSpec(mapping="stretch"))
    # the stiffness at the hand is independent of the scale: 2 mm within the ball, 1 N at 500 N/m
    for mapping, radius_m in (("crop", 0.03), ("0.5", 0.06), ("2", 0.015)):
        medium = prepare(ball(radius_m), EncodeSpec(nw=6, mapping=mapping, oversample=1)).medium
        forces = medium[0].sample_n([[0.028, 0, 0], [0, -0.028, 0]])
        np.testing.assert_allclose(np.linalg.norm(forces, axis=1), 1.0, atol=0.25)
        assert forces[0, 0] > 0 > forces[1, 1]


def test_friction_is_that_of_the_source_or_as_requested() -> None:
    rubbed = StoredScene(replace(moving().stored, friction=0.4))
    frictions = [prepare(rubbed, EncodeSpec(nw=4, friction=mu)).medium.friction for mu in (None, 0.0, 0.2)]
    assert frictions == [0.4, 0.0, 0.2]


def test_a_lossless_field_must_fit_along_each_axis() -> None:
    grid = Grid((40, 4, 4), (0.01,) * 3, (-0.195, -0.015, -0.015))
    long = StoredScene(HapticMedium.from_frames([ForceField.from_dense(grid, np.ones((40, 4, 4, 3)))], 30.0))
    with pytest.raises(InvalidArgument, match="a stored field of 400 x 40 x 40 mm"):
        prepare(long, EncodeSpec(touch=TouchSpec(mode="lossless")))


def test_no_force_exceeds_the_device(tmp_path: Path) -> None:
    # for an array, a steeper law needs finer samples; 200 N/m are enough for its 3.3 N
    for name, stiffness in (("phantom-omni", 2e3), ("novint-falcon", 2e3), ("tshirt-32x32", 200.0)):
        prepared = prepare(ball(), EncodeSpec(device=name, nw=4, stiffness_n_per_m=stiffness))
        assert np.linalg.norm(prepared.medium[0].vectors_n(), axis=1).max() <= prepared.device.force_max_n * (
            1 + 1e-6
        )


def test_an_array_keeps_its_one_direction(tmp_path: Path) -> None:
    stream = tmp_path / "s.touch"
    spec = EncodeSpec(device="tshirt-32x32", thickness_m=math.inf, stiffness_n_per_m=100.0)
    encode(ball(), stream, spec)
    compared = compare(ball(), stream).summary()
    assert compared["grid_shape"] == [32, 32, 1]
    assert compared["mask_violations"] == 0
    with open_file(stream) as opened:
        vectors = opened.medium[0].vectors_n()
    np.testing.assert_array_equal(vectors[:, :2], 0)


def test_another_source_is_noticed(tmp_path: Path) -> None:
    stream = tmp_path / "s.touch"
    encode(ball(), stream, EncodeSpec(nw=4))
    with pytest.raises(InvalidArgument, match="elsewhere"):
        compare(ball(0.02), stream)
    encode(moving(3), tmp_path / "m.touch", EncodeSpec(nw=4))
    with pytest.raises(InvalidArgument, match="3 frames"):
        compare(moving(2), tmp_path / "m.touch")
    with pytest.raises(InvalidArgument, match="frame"):
        compare(ball(), stream, frame=1)


def test_the_spec_round_trips_through_the_provenance() -> None:
    spec = replace(
        EncodeSpec(), frames=(1, None), thickness_m=math.inf, coder="paper", paper=PaperSpec.literal(k=0.2)
    )
    assert EncodeSpec.from_json(spec.to_json()) == spec
    for text in (
        "",
        "{}",
        "[]",
        "null",
        '{"nw": 3}',
        spec.to_json().replace("literal", "x").replace('"k"', '"kk"'),
    ):
        with pytest.raises(CorruptFile, match="spec"):
            EncodeSpec.from_json(text)


def test_options_by_name_are_those_of_the_spec(tmp_path: Path) -> None:
    """A name is a field of the spec, of its source or of its coder; the bytes are those of the spec."""
    named, spec = tmp_path / "named.touch", tmp_path / "spec.touch"
    encode(ball(), named, nw=3, k=0.2, unit_m=0.5, thickness_m=0.01)
    whole = EncodeSpec(nw=3, thickness_m=0.01, touch=TouchSpec(k=0.2), source=SourceOptions(unit_m=0.5))
    encode(ball(), spec, whole)
    assert named.read_bytes() == spec.read_bytes()
    assert prepare(ball(), whole, nw=4, k=0.3).spec == replace(whole, nw=4, touch=TouchSpec(k=0.3))
    assert prepare(ball(), coder="paper", nq=5, nw=3).spec.paper.nq == 5
    with pytest.raises(InvalidArgument, match=r"stiffness: .*Is stiffness_n_per_m meant"):
        encode(ball(), named, stiffness=300.0)
    with pytest.raises(InvalidArgument, match=r"nq: .*an option of EncodeSpec"):
        prepare(ball(), nq=5)


def test_an_empty_scene_is_valid(tmp_path: Path) -> None:
    grid = prepare(ball(), EncodeSpec(nw=3)).medium.grid
    scene = StoredScene(HapticMedium.from_frames([ForceField.empty(grid)] * 2, 30.0))
    encode(scene, tmp_path / "s.touch", EncodeSpec(nw=3, allow_empty=True))
    compared = compare(scene, tmp_path / "s.touch")
    assert compared.summary()["supported_voxels"] == 0 and compared.summary()["nmse_db"] is None
    compared.draw(tmp_path / "s.png")
    assert (tmp_path / "s.png").stat().st_size > 1000
