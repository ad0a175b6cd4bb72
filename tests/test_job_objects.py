"""The object representation through the whole job: chosen, coded, decoded, cut, coded again, measured."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from touchfield import job
from touchfield.errors import InvalidArgument
from touchfield.job import EncodeSpec
from touchfield.medium import PoseTrack
from touchfield.sources.analytic_scene import AnalyticScene
from touchfield.sources.body_scene import BodyScene
from touchfield.sources.scene import Body
from touchfield.sources.shapes import Box, Sphere

SPEC = EncodeSpec(nw=5)
FRAMES = 12


def falling() -> BodyScene:
    """A box that tumbles as it falls, and a ball that lies still."""
    t = np.arange(FRAMES) / 1000
    turn = np.stack([np.cos(4 * t), np.sin(4 * t), 0 * t, 0 * t], axis=1)
    way = np.stack([0 * t, 0.02 + 0 * t, 0.06 - 4.905 * t**2], axis=1)
    box = AnalyticScene((Box((0.0, 0.0, 0.0), (0.03, 0.02, 0.01)),))
    ball = AnalyticScene((Sphere((0.0, 0.0, 0.0), 0.02),))
    still = PoseTrack.still(FRAMES, (0.08, 0.0, 0.02))
    return BodyScene((Body("box", box, PoseTrack(turn, way)), Body("ball", ball, still)), 1000.0)


@pytest.fixture(scope="module")
def stream(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("objects") / "falling.touch"
    job.encode(falling(), path, SPEC)
    return path


def test_bodies_in_motion_are_objects_unless_voxels_are_asked_for() -> None:
    assert job.prepare(falling(), SPEC).scene is not None
    assert job.prepare(falling(), replace(SPEC, representation="voxel")).scene is None
    assert job.prepare(falling(), replace(SPEC, device="tshirt-32x32")).scene is None
    still = AnalyticScene((Sphere((0.0, 0.0, 0.0), 0.02),))
    assert job.prepare(still, SPEC).scene is None
    asked = job.prepare(still, replace(SPEC, representation="object")).scene
    assert asked is not None and [one.name for one in asked.objects] == ["scene"]


@pytest.mark.parametrize(
    ("spec", "word"),
    [
        (replace(SPEC, representation="objects"), "representation"),
        (replace(SPEC, representation="object", device="tshirt-32x32"), "array"),
    ],
)
def test_what_cannot_be_represented_so_is_refused(spec: EncodeSpec, word: str, tmp_path: Path) -> None:
    with pytest.raises(InvalidArgument, match=word):
        job.encode(falling(), tmp_path / "x.touch", spec)
    assert not list(tmp_path.iterdir())


def test_a_body_that_stays_has_the_forces_of_the_voxel_representation() -> None:
    voxels = job.prepare(falling(), replace(SPEC, representation="voxel")).medium
    scene = job.prepare(falling(), SPEC).scene
    assert scene is not None
    ball = next(one for one in scene.objects if one.name == "ball")
    x = ball.field(0).positions()[:, 0].min()  # nothing of the box lies so far to the right
    np.testing.assert_allclose(ball.field(0).to_dense()[x:], voxels[3].to_dense()[x:], atol=1e-5)


def test_both_representations_agree_to_the_voxel_size() -> None:
    spec = replace(SPEC, nw=6)
    voxels = job.prepare(falling(), replace(spec, representation="voxel")).medium
    objects = job.prepare(falling(), spec).medium
    for frame in (0, 7):
        a, b = voxels[frame].to_dense(), objects[frame].to_dense()
        diagonal_m = float(np.linalg.norm(voxels.grid.spacing_m))
        # a force K d whose place is off by a diagonal is off by K times it; where both are deep that is all
        deep = (np.linalg.norm(a, axis=-1) > 0.5) & (np.linalg.norm(b, axis=-1) > 0.5)
        error = np.abs(np.linalg.norm(a, axis=-1) - np.linalg.norm(b, axis=-1))[deep]
        assert deep.any() and error.max() < spec.stiffness_n_per_m * diagonal_m


def test_the_file_tells_its_objects_and_keeps_their_poses_within_the_mask(stream: Path) -> None:
    asked = job.prepare(falling(), SPEC).scene
    with job.open_stream(stream) as opened:
        told, decoded = opened.summary(), opened.scene
        assert told["representation"] == "object" and told["object_names"] == ["box", "ball"]
        assert asked is not None and decoded is not None
        near = np.random.default_rng(1).uniform(-0.01, 0.01, (500, 3))
        box = decoded.objects[0]
        for frame in (0, 5, FRAMES - 1):
            # the decoded field at the decoded pose, and at the pose that was asked for
            at = asked.objects[0].track.to_scene(near, frame)
            quantised = box.field(0).sample_n(box.track.to_body(at, frame)) @ box.track.rotation(frame).T
            exact = box.field(0).sample_n(near) @ asked.objects[0].track.rotation(frame).T
            assert np.abs(exact).max() > 0.1
            assert np.linalg.norm(quantised - exact, axis=1).max() <= job.spec.DEFAULT_F0_N / 2


def test_frames_may_be_cut_and_a_stream_be_a_source(stream: Path, tmp_path: Path) -> None:
    part, again = tmp_path / "part.touch", tmp_path / "again.touch"
    job.encode(falling(), part, replace(SPEC, frames=(4, 9)))
    done = job.encode(stream, again)
    assert done.prepared.scene is not None
    with job.open_stream(stream) as whole, job.open_stream(part) as cut, job.open_stream(again) as twice:
        assert len(cut.medium) == 5
        box = [opened.scene.objects[0].track for opened in (whole, cut, twice)]  # type: ignore[union-attr]
        np.testing.assert_array_equal(box[1].positions_m, box[0].positions_m[4:9])
        np.testing.assert_array_equal(box[2].positions_m, box[0].positions_m)
        np.testing.assert_allclose(cut.medium[0].to_dense(), whole.medium[4].to_dense(), atol=1e-6)


def test_a_stream_of_objects_compares_with_its_source_and_is_measured(stream: Path) -> None:
    values = job.compare(falling(), stream).summary()
    assert values["nmse_db"] < -20 and values["bits_poses"] > 0
    told = (values[f"bits_{kind}"] for kind in ("support", "amplitude", "direction", "side", "poses"))
    assert sum(told) == 8 * stream.stat().st_size
    measured = job.measure_medium(stream)
    assert measured.frames == FRAMES and measured.object.value > 0


def test_a_filter_acts_on_each_object_in_its_own_frame() -> None:
    plain = job.prepare(falling(), SPEC).scene
    smooth = job.prepare(falling(), replace(SPEC, filters=(("gaussian", "4mm"),))).scene
    assert plain is not None and smooth is not None
    for before, after in zip(plain.objects, smooth.objects, strict=True):
        assert after.track == before.track
        assert after.field(0).support_count > before.field(0).support_count
