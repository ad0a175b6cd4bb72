"""The object representation through the complete pipeline: selection, encode, decode, cut,
re-encode, measure.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from touchfield import pipeline, tasks
from touchfield.errors import InvalidArgument, SourceError
from touchfield.filters.resample import low_pass
from touchfield.medium import PoseTrack
from touchfield.pipeline.spec import DEFAULT_F0_N, EncodeSpec
from touchfield.sources.physics.body_scene import BodyScene
from touchfield.sources.scene import Body
from touchfield.sources.shapes.analytic_scene import AnalyticScene
from touchfield.sources.shapes.shapes import Box, Sphere
from touchfield.sources.stored import StoredScene

SPEC = EncodeSpec(nw=5)
FRAMES = 12


def falling() -> BodyScene:
    """A box that tumbles while it falls, and a ball at rest."""
    t = np.arange(FRAMES) / 1000
    turn = np.stack([np.cos(4 * t), np.sin(4 * t), 0 * t, 0 * t], axis=1)
    way = np.stack([0 * t, 0.02 + 0 * t, 0.06 - 4.905 * t**2], axis=1)
    box = AnalyticScene((Box((0.0, 0.0, 0.0), (0.03, 0.02, 0.01)),))
    ball = AnalyticScene((Sphere((0.0, 0.0, 0.0), 0.02),))
    rest = PoseTrack.constant(FRAMES, (0.08, 0.0, 0.02))
    return BodyScene((Body("box", box, PoseTrack(turn, way)), Body("ball", ball, rest)), 1000.0)


@pytest.fixture(scope="module")
def stream(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("objects") / "falling.touch"
    pipeline.encode(falling(), path, SPEC)
    return path


def test_moving_bodies_are_objects_unless_voxels_are_requested() -> None:
    assert pipeline.prepare(falling(), SPEC).objects is not None
    assert pipeline.prepare(falling(), replace(SPEC, representation="voxel")).objects is None
    assert pipeline.prepare(falling(), replace(SPEC, device="tshirt-32x32")).objects is None
    resting = AnalyticScene((Sphere((0.0, 0.0, 0.0), 0.02),))
    assert pipeline.prepare(resting, SPEC).objects is None
    scene = pipeline.prepare(resting, replace(SPEC, representation="object")).objects
    assert scene is not None and [obj.name for obj in scene.objects] == ["scene"]


def test_a_rotating_body_has_cubic_samples_and_a_sliding_one_those_of_the_device() -> None:
    """Spacings are 3/4 of the device's; the margin is the reach of the low-pass and two samples."""
    box, ball = falling().bodies()
    sliding = replace(box, track=PoseTrack(np.tile([1.0, 0, 0, 0], (FRAMES, 1)), box.track.positions_m))
    for moving in (box, sliding):
        prepared = pipeline.prepare(BodyScene((moving, ball), 1000.0), SPEC)
        assert prepared.objects is not None
        grid, device_m = prepared.objects.objects[0].medium.grid, np.array(prepared.objects.grid.spacing_m)
        usual = 0.75 * (device_m if moving is sliding else np.full(3, device_m.prod() ** (1 / 3)))
        assert grid.spacing_m == pytest.approx(usual)
        half_m = prepared.placement.scale * np.array([0.03, 0.02, 0.01])
        margin = (np.abs(np.stack(grid.box_m)) - half_m) / usual - 0.5
        min_margin = 2 * low_pass("spline").half_width + 2
        assert (margin >= min_margin - 1e-9).all() and (margin < min_margin + 1).all()


def test_objects_are_refused_for_an_array(tmp_path: Path) -> None:
    with pytest.raises(InvalidArgument, match="array"):
        pipeline.encode(
            falling(), tmp_path / "x.touch", replace(SPEC, representation="object", device="tshirt-32x32")
        )
    assert not list(tmp_path.iterdir())


def test_a_resting_body_has_the_forces_of_the_voxel_representation() -> None:
    voxels = pipeline.prepare(falling(), replace(SPEC, representation="voxel")).medium
    scene = pipeline.prepare(falling(), SPEC).objects
    assert scene is not None
    ball = next(obj for obj in scene.objects if obj.name == "ball")
    x = ball.field(0).positions()[:, 0].min()  # the box is farther left
    np.testing.assert_allclose(ball.field(0).to_dense()[x:], voxels[3].to_dense()[x:], atol=1e-5)


def test_both_representations_agree_to_the_voxel_size() -> None:
    spec = replace(SPEC, nw=6)
    voxels = pipeline.prepare(falling(), replace(spec, representation="voxel")).medium
    objects = pipeline.prepare(falling(), spec).medium
    for frame in (0, 7):
        a, b = voxels[frame].to_dense(), objects[frame].to_dense()
        diagonal_m = float(np.linalg.norm(voxels.grid.spacing_m))
        # a force K d displaced by a diagonal is off by K times it; inside both bodies that is all
        deep = (np.linalg.norm(a, axis=-1) > 0.5) & (np.linalg.norm(b, axis=-1) > 0.5)
        error = np.abs(np.linalg.norm(a, axis=-1) - np.linalg.norm(b, axis=-1))[deep]
        assert deep.any() and error.max() < spec.stiffness_n_per_m * diagonal_m


def test_the_file_describes_its_objects_and_keeps_poses_within_the_mask(stream: Path) -> None:
    source_scene = pipeline.prepare(falling(), SPEC).objects
    with pipeline.open_file(stream) as opened:
        summary, decoded = opened.summary(), opened.scene
        assert summary["representation"] == "object" and summary["object_names"] == ["box", "ball"]
        assert source_scene is not None and decoded is not None
        points_m = np.random.default_rng(1).uniform(-0.01, 0.01, (500, 3))
        box = decoded.objects[0]
        for frame in (0, 5, FRAMES - 1):
            # the decoded field at the decoded pose, and at the requested pose
            at = source_scene.objects[0].track.to_scene(points_m, frame)
            quantised = box.field(0).sample_n(box.track.to_body(at, frame)) @ box.track.rotation(frame).T
            exact = box.field(0).sample_n(points_m) @ source_scene.objects[0].track.rotation(frame).T
            assert np.abs(exact).max() > 0.1
            assert np.linalg.norm(quantised - exact, axis=1).max() <= DEFAULT_F0_N / 2


def test_a_stream_can_be_cut_and_encoded_again(stream: Path, tmp_path: Path) -> None:
    part, again = tmp_path / "part.touch", tmp_path / "again.touch"
    pipeline.encode(falling(), part, replace(SPEC, frames=(4, 9), fit_frames=(0, None)))
    done = pipeline.encode(stream, again)
    assert done.prepared.objects is not None
    with (
        pipeline.open_file(stream) as complete,
        pipeline.open_file(part) as cut,
        pipeline.open_file(again) as twice,
    ):
        assert len(cut.medium) == 5
        box = [opened.scene.objects[0].track for opened in (complete, cut, twice)]  # type: ignore[union-attr]
        # each encoding may move a body by 10 um, and change a force within the mask
        np.testing.assert_allclose(box[1].positions_m, box[0].positions_m[4:9], atol=2.1e-5)
        np.testing.assert_allclose(box[2].positions_m, box[0].positions_m, atol=1.1e-5)
        a, b = cut.medium[0].to_dense(), complete.medium[4].to_dense()
        allowed = np.maximum(0.05, 0.1 * np.maximum(*(np.linalg.norm(x, axis=-1) for x in (a, b))))
        assert a.any() and (np.linalg.norm(a - b, axis=-1) < 2.5 * allowed).all()


def test_a_stream_of_objects_is_compared_and_measured(stream: Path) -> None:
    values = pipeline.compare(falling(), stream).summary()
    assert values["nmse_db"] < -20 and values["bits_poses"] > 0
    assert values["mask_violations"] == 0 and values["worst_place_um"] <= values["place_tolerance_um"]
    figures = (values[f"bits_{kind}"] for kind in ("support", "amplitude", "direction", "side", "poses"))
    assert sum(figures) == 8 * stream.stat().st_size
    measured = tasks.measure.measure_medium(stream)
    assert measured.frames == FRAMES and measured.object.value > 0
    with pipeline.open_file(stream) as opened:
        figures = opened.summary()
        assert (
            opened.scene is not None and opened.scene.file_bytes == opened.file_bytes == stream.stat().st_size
        )
        assert all(obj.medium.rate_hz == 1000.0 for obj in opened.scene.objects)
        assert figures["bits_fields"] + figures["bits_poses"] == opened.bits.total < 8 * opened.file_bytes
    assert figures["frame_kinds"] == {"object": FRAMES} and figures["place_tolerance_um"] == pytest.approx(10)


def test_a_body_beyond_the_position_tolerance_has_no_bound(stream: Path) -> None:
    compared = pipeline.compare(falling(), stream)
    assert compared.composed is not None
    found = replace(compared.composed[0], violations=7)
    within_tolerance, beyond_tolerance = (
        replace(compared, composed=(found, away_m)).summary() for away_m in (1e-5, 1.1e-5)
    )
    assert within_tolerance["mask_violations"] == 7 and beyond_tolerance["worst_place_um"] == pytest.approx(
        11
    )
    assert (
        beyond_tolerance["mask_violations"]
        == beyond_tolerance["mask_violations_in_place"]
        == within_tolerance["mask_violations_in_place"]
        < 7
    )
    assert beyond_tolerance["worst_mask_ratio"] == beyond_tolerance["worst_mask_ratio_in_place"]


def test_the_picture_of_a_long_stream_states_its_rate(
    stream: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[str] = []
    module = sys.modules["touchfield.pipeline.comparison"]
    monkeypatch.setattr(module, "draw_comparison", lambda *rest: drawn.append(rest[3]))
    compared = pipeline.compare(falling(), stream)
    compared.stream["cr_full"] = 3.7e-6
    compared.draw(tmp_path / "drawn.png")
    assert "CR 3.7e-06" in drawn[0]


def test_objects_too_small_for_the_lattice_are_named(tmp_path: Path) -> None:
    grain = AnalyticScene((Sphere((0.0, 0.0, 0.0), 1e-5),))
    track = PoseTrack(
        np.tile([1.0, 0, 0, 0], (FRAMES, 1)), np.linspace((0, 0, 0.02), (0.01, 0, 0.02), FRAMES)
    )
    scene = BodyScene((*falling().bodies(), Body("grain", grain, track)), 1000.0)
    unfelt = [note for note in pipeline.prepare(scene, SPEC).notes if "Objects without any force" in note]
    assert len(unfelt) == 1 and "'grain'" in unfelt[0] and "box" not in unfelt[0]
    assert not [
        note for note in pipeline.prepare(falling(), SPEC).notes if "Objects without any force" in note
    ]
    alone = BodyScene((Body("grain", grain, track),), 1000.0)
    with pytest.raises(SourceError, match=r"Nothing can be felt: .*try --fit-frames 0:1"):
        pipeline.encode(alone, tmp_path / "a.touch", SPEC)
    spec = replace(SPEC, mapping="1", allow_empty=True)
    assert "The result is empty" in pipeline.encode(alone, tmp_path / "a.touch", spec).notes[-1]
    voxels = replace(spec, representation="voxel")
    assert "The result is empty" in pipeline.encode(alone, tmp_path / "a.touch", voxels).notes[-1]


def test_voxels_are_suggested_only_if_no_representation_was_requested(stream: Path) -> None:
    assert "--representation voxel" in pipeline.prepare(falling(), SPEC).notes[-1]
    assert (
        "--representation"
        not in pipeline.prepare(falling(), replace(SPEC, representation="object")).notes[-1]
    )
    assert "--representation" not in pipeline.compare(falling(), stream).notes[-1]


@pytest.mark.parametrize(
    ("name", "stored"),
    [("two\nlines", "two lines"), ("\u00e9" * 200, "\u00e9" * 128), ("\ud800", " "), ("", "")],
)
def test_any_name_of_a_body_can_be_stored(name: str, stored: str, tmp_path: Path) -> None:
    box, ball = falling().bodies()
    named = BodyScene((replace(box, name=name), replace(ball, name=name)), 1000.0)
    pipeline.encode(named, tmp_path / "a.touch", SPEC)
    with pipeline.open_file(tmp_path / "a.touch") as opened:
        assert opened.summary()["object_names"] == [stored, stored]


def test_a_body_far_larger_than_the_workspace_is_refused_as_an_object(tmp_path: Path) -> None:
    out = tmp_path / "a.touch"
    with pytest.raises(InvalidArgument, match=r"body box, mapping: found 6e\+04 x .*--representation voxel"):
        pipeline.encode(falling(), out, replace(SPEC, mapping="1000"))
    assert not out.exists()


def test_a_filter_acts_on_each_object_in_its_own_frame() -> None:
    plain = pipeline.prepare(falling(), SPEC).objects
    smooth = pipeline.prepare(falling(), replace(SPEC, filters=(("gaussian", "4mm"),))).objects
    assert plain is not None and smooth is not None
    for before, after in zip(plain.objects, smooth.objects, strict=True):
        assert after.track == before.track
        assert after.field(0).support_count > before.field(0).support_count


def test_a_filter_wider_than_a_body_extends_the_lattice() -> None:
    plain = pipeline.prepare(falling(), replace(SPEC, nw=6)).objects
    smooth = pipeline.prepare(falling(), replace(SPEC, nw=6, filters=(("gaussian", "4mm"),))).objects
    assert plain is not None and smooth is not None
    before, after = plain.objects[0].field(0), smooth.objects[0].field(0)
    assert not np.array_equal(before.grid.shape, after.grid.shape)
    positions, shape = after.positions(), np.array(after.grid.shape)
    assert (positions > 0).all() and (positions < shape - 1).all()  # the force vanishes within the lattice
    # the filter preserves the sum of the forces; their moment about the body's origin shows that nothing
    # was shifted
    for field in (before, after):
        points = field.grid.to_m(field.positions())
        spread = np.einsum("na,na->", points, field.vectors_n().astype(np.float64))
        np.testing.assert_allclose(field.vectors_n().sum(axis=0, dtype=np.float64), 0.0, atol=0.05)
        if field is before:
            expected = spread
    np.testing.assert_allclose(spread, expected, rtol=1e-3)


def test_the_report_of_a_filter_describes_the_encoded_objects(tmp_path: Path) -> None:
    plain = replace(SPEC, stiffness_n_per_m=20.0)
    spec = replace(plain, filters=(("gaussian", "3mm"),))
    report = pipeline.filter_report(falling(), spec).figures["stages"]
    coded = pipeline.prepare(falling(), spec).medium
    assert report[0]["supported_voxels"] == sum(
        f.support_count for f in pipeline.prepare(falling(), plain).medium
    )
    greatest_n = max(float(f.support().amplitudes_n.max()) for f in coded)
    assert report[1]["greatest_n"] == pytest.approx(greatest_n) and greatest_n < 1
    assert report[1]["supported_voxels"] == sum(f.support_count for f in coded)
    assert report[1]["rms_n"] == pytest.approx(
        np.sqrt(np.mean(np.concatenate([(f.vectors_n() ** 2).sum(axis=1) for f in coded], dtype=np.float64)))
    )


def test_interpolated_codewords_are_measured_by_the_ladder(stream: Path, tmp_path: Path) -> None:
    voxels = tmp_path / "voxels.touch"
    spec = replace(SPEC, representation="voxel", frames=(0, 1))
    pipeline.encode(falling(), voxels, replace(spec, coder="paper"))
    pipeline.encode(falling(), tmp_path / "touch.touch", spec)
    paths = (stream, voxels, tmp_path / "touch.touch")
    quantisers = {
        path: tasks.measure.measure_medium(path, tasks.measure.MeasureSpec(limits=False)).quantiser
        for path in paths
    }
    assert quantisers[voxels] == "distinct" and quantisers[stream].startswith("weber")
    assert quantisers[paths[2]] == quantisers[stream], "coder touch has no codewords"
    as_voxels = tasks.measure.MeasureSpec(
        limits=False, encode=EncodeSpec(representation="voxel", frames=(0, 1))
    )
    assert tasks.measure.measure_medium(stream, as_voxels).quantiser == quantisers[stream]


def test_a_stored_medium_as_an_object_keeps_its_metadata() -> None:
    medium = replace(
        pipeline.prepare(falling(), replace(SPEC, representation="voxel", frames=(0, 2))).medium,
        friction=0.3,
        damping_n_s_per_m=0.7,
        tags=("symbolic",),
    )
    scene = pipeline.prepare(StoredScene(medium), replace(SPEC, representation="object")).objects
    assert scene is not None
    assert (scene.friction, scene.damping_n_s_per_m, scene.tags) == (0.3, 0.7, ("symbolic",))


def spinning(scale_m: float) -> BodyScene:
    """A box off its body's origin, far from the scene's origin, that moves and spins."""
    t = np.arange(FRAMES) / 1000
    turn = np.stack([np.cos(6 * t), 0.6 * np.sin(6 * t), 0.8 * np.sin(6 * t), 0 * t], axis=1)
    way = scale_m * np.stack([5.0 + 2.5 * t, -10.0 + 0 * t, 15.0 + 1.5 * t], axis=1)
    box = AnalyticScene((Box((0.25 * scale_m, 0.0, 0.0), (1.5 * scale_m, scale_m, 0.5 * scale_m)),))
    return BodyScene((Body("box", box, PoseTrack(turn, way)),), 1000.0)


@pytest.mark.parametrize("scale_m", [0.002, 0.2])
def test_surface_damping_is_proportional_to_the_velocity_at_the_hand(scale_m: float) -> None:
    """A small and a large scene in one workspace: b (v + omega x r) in metres of the hand, for both
    representations.
    """
    scene, damping, frame = spinning(scale_m), 2.0, 6
    spec = replace(SPEC, stiffness_n_per_m=20.0, thickness_m=1.0)  # solid, and far from F_max

    def prepared(representation: str, b: float) -> pipeline.Prepared:
        return pipeline.prepare(
            scene, replace(spec, representation=representation, surface_damping_n_s_per_m=b)
        )

    track = scene.bodies()[0].track
    for representation in ("object", "voxel"):
        damped, plain = prepared(representation, damping), prepared(representation, 0.0)
        grid, placement = damped.medium.grid, damped.placement
        points = grid.to_m(np.moveaxis(np.indices(grid.shape), 0, -1)) / placement.scale + placement.offset_m
        assert placement.scale != 1 and np.abs(placement.offset_m).max() > scale_m
        velocity, spin = (values[frame] for values in track.velocities(1000.0))
        expected = damping * placement.scale * (velocity + np.cross(spin, points - track.positions_m[frame]))
        depth_m = np.array([1.5, 1.0, 0.5]) * scale_m - np.abs(
            track.to_body(points, frame) - [0.25 * scale_m, 0, 0]
        )
        deep = depth_m.min(axis=-1) > 3.5 * max(grid.spacing_m) / placement.scale
        before = plain.medium[frame].to_dense()
        added = damped.medium[frame].to_dense() - before
        deep &= before.any(axis=-1)  # the device filter drops a weak force, but not a damped one
        assert deep.sum() > 20
        error = np.linalg.norm(added - expected, axis=-1)[deep]
        assert error.max() < 1e-5 * np.linalg.norm(expected[deep], axis=-1).max()
