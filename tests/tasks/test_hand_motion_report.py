"""The hand motion of a stream: figures of `compare` and the command line, on scenes with a formula."""

import json

import numpy as np
import pytest

from touchfield.cli.main import _exit_code, run
from touchfield.codec.touch.spec import TouchSpec
from touchfield.medium import HapticMedium, PoseTrack
from touchfield.perception.hand_motion import margin_of
from touchfield.pipeline import Target, compare, compare_prepared, encode, encode_to_target, prepare
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.physics.body_scene import BodyScene
from touchfield.sources.scene import Body
from touchfield.sources.shapes.analytic_scene import AnalyticScene
from touchfield.sources.shapes.shapes import Sphere
from touchfield.sources.stored import StoredScene
from touchfield.viewer.page import is_our_picture

BALL = AnalyticScene((Sphere((0.0, 0.0, 0.0), 0.03),))
SPEC = EncodeSpec(nw=5)


@pytest.fixture(scope="module")
def ball(tmp_path_factory):
    path = tmp_path_factory.mktemp("ball") / "ball.touch"
    encode(BALL, path, SPEC)
    return path


def test_compare_reports_the_loudest_slide(ball):
    found = compare(BALL, ball).summary()
    assert found["hold"] is None  # one frame
    assert 0 < found["hand_vibration_mn"] < 100
    loudest = max(found["slides"], key=lambda s: s["error_mn"])
    assert found["hand_vibration_mn"] == loudest["error_mn"]
    assert found["hand_vibration_lattice_mn"] == loudest["lattice_mn"]
    min_margin = min(margin_of(np.array(s["error_thirds_mn"])) for s in found["slides"])
    assert (found["threshold_margin_db"], found["threshold_margin_third_hz"]) == min_margin


def test_vibration_of_a_ball_is_due_to_its_lattice(ball):
    found = compare(BALL, ball).hand.slides
    assert found
    for slide in found:  # the exact force is constant around a ball
        assert slide.lattice_mn == pytest.approx(slide.source_mn, rel=0.02)


def test_the_exact_field_is_that_of_the_lattice_at_its_samples():
    prepared = prepare(BALL, EncodeSpec(nw=6))
    field = prepared.medium[0]
    inner = field.positions()[np.linalg.norm(field.vectors_n(), axis=1) > 0.5][::50]
    points = field.grid.to_m(inner)
    off_n = np.linalg.norm(prepared.exact(points) - field.sample_n(points), axis=1)
    assert np.median(off_n) < 0.02  # the low-pass changes more near the centre and where the force saturates
    assert prepare(BALL, EncodeSpec(nw=5, filters=(("gaussian", "2mm"),))).exact is None


def test_a_medium_of_many_frames_has_a_hold(tmp_path):
    field = prepare(BALL, EncodeSpec(nw=4)).medium[0]
    scene = StoredScene(HapticMedium.from_frames([field] * 12, 30.0))
    path = tmp_path / "still.touch"
    encode(scene, path, EncodeSpec(nw=4))
    hold = compare(scene, path).hand.hold
    assert hold.points > 0 and hold.step_source_mn == 0 and hold.still_step_mn == hold.step_mn


def test_a_step_at_a_segment_start_is_reported_as_such(tmp_path):
    field = prepare(BALL, EncodeSpec(nw=4)).medium[0]
    scene = StoredScene(HapticMedium.from_frames([field, field.scaled(0.5)], 30.0))
    steps = []
    for length in (1, 2):
        spec = EncodeSpec(nw=4, touch=TouchSpec(segment_frames=length))
        encode(scene, tmp_path / "two.touch", spec)
        steps.append(compare(scene, tmp_path / "two.touch").hand.hold.start_step_source_mn)
    assert steps[0] > 0 == steps[1]


def test_objects_are_measured_by_the_receiver_s_query(tmp_path):
    turning = PoseTrack(np.tile([1.0, 0.0, 0.0, 0.0], (6, 1)), np.zeros((6, 3)))
    scene = BodyScene((Body("ball", BALL, turning),), 30.0)
    encode(scene, tmp_path / "o.touch", EncodeSpec(nw=5, representation="object"))
    found = compare(scene, tmp_path / "o.touch").hand
    assert found.hold.step_mn == 0  # a body at rest
    assert all(slide.paths for slide in found.slides)


def test_the_command_line_reports_the_figures_and_their_threshold(tmp_path, capsys):
    scene = tmp_path / "ball.toml"
    scene.write_text('[[shape]]\nkind = "sphere"\ncenter_m = [0.0, 0.0, 0.0]\nradius_m = 0.03\n')
    out = tmp_path / "ball.touch"
    encode(str(scene), out, SPEC)
    arguments = ["compare", str(scene), str(out), "--no-picture"]
    with pytest.raises(SystemExit) as ended:
        run([*arguments, "--json"])
    assert not ended.value.code
    report = json.loads(capsys.readouterr().out)
    assert report["hand"] == "stylus" and report["hand_vibration_mn"] > 0 and len(report["slides"]) == 3
    with pytest.raises(SystemExit):
        run(arguments)
    output = capsys.readouterr().out
    assert "threshold_margin_db" in output and "speed_mm_s" in output and "error_thirds" not in output


def test_encode_reports_what_compare_reports(tmp_path, capsys):
    """The report is measured against what was coded; `compare` prepares the source again."""
    scene, out, plot = tmp_path / "ball.toml", tmp_path / "ball.touch", tmp_path / "ball.png"
    scene.write_text('[[shape]]\nkind = "sphere"\ncenter_m = [0.0, 0.0, 0.0]\nradius_m = 0.03\n')
    arguments = [str(scene), str(out), "--nw", "5"]
    assert _exit_code(["encode", *arguments, "--json"]) == 0
    plain = json.loads(capsys.readouterr().out)
    assert _exit_code(["encode", *arguments, "--report", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    compared = json.loads(json.dumps(compare(str(scene), out).summary()))
    # the ratio is that which the file states
    stated, measured = report["worst_mask_ratio"], compared.pop("worst_mask_ratio")
    assert stated == plain["worst_mask_ratio"] == pytest.approx(measured, abs=1e-4)
    assert {**plain, **compared, "encode_s": 0, "notes": 0} == {**report, "encode_s": 0, "notes": 0}
    assert report["nmse_db"] < -15 and report["promise_kept"] and set(plain["notes"]) <= set(report["notes"])
    assert _exit_code(["encode", *arguments, "--report"]) == 0
    output = capsys.readouterr().out
    assert "nmse_db" in output and "speed_mm_s" in output and "error_bound" in output
    pytest.importorskip("matplotlib", reason="pictures need the extra report")
    assert _exit_code(["encode", *arguments, "--plot", str(plot)]) == 0
    assert f"the picture is {plot}" in capsys.readouterr().out.replace("\n", "") and is_our_picture(plot)


def test_objects_and_a_requested_size_are_reported_too(tmp_path):
    turning = PoseTrack(np.tile([1.0, 0.0, 0.0, 0.0], (3, 1)), np.zeros((3, 3)))
    scene = BodyScene((Body("ball", BALL, turning),), 30.0)
    done = encode(scene, tmp_path / "o.touch", EncodeSpec(nw=5, representation="object"))
    report = compare_prepared(done.prepared, tmp_path / "o.touch").summary()
    assert report == compare(scene, tmp_path / "o.touch").summary() and report["bits_poses"] > 0
    done = encode_to_target(BALL, tmp_path / "b.touch", SPEC, Target(bytes=2500))
    report = compare_prepared(done.prepared, tmp_path / "b.touch").summary()
    assert report == compare(BALL, tmp_path / "b.touch").summary() and report["file_bytes"] <= 2500


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["ball.zarr", "--report"], "work with OUT.touch, not with .zarr"),
        (["s3://bucket/ball.touch", "--plot", "ball.png"], "not with an address"),
        (["ball.touch", "--plot", "ball.touch"], "found the name of two results"),
        (["ball.touch", "--plot", "nowhere/ball.png"], "no folder nowhere"),
    ],
)
def test_a_report_that_cannot_be_made_is_refused_before_the_work(
    tmp_path, monkeypatch, capsys, arguments, message
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "ball.toml").write_text('[[shape]]\nkind = "sphere"\ncenter_m = [0, 0, 0]\nradius_m = 0.03\n')
    assert _exit_code(["encode", "ball.toml", *arguments]) == 2
    assert message in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["ball.toml"]
