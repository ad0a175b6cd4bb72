"""k as a function of force, and the bound of a grip: encoded, recorded in the file, checked by `compare`."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from touchfield.cli.main import _exit_code
from touchfield.codec.paper.spec import PaperSpec
from touchfield.codec.touch.spec import TouchSpec
from touchfield.container import TouchReader, TouchWriter
from touchfield.errors import CorruptFile, InvalidArgument
from touchfield.perception.grip import WeberCurve, grip, grips
from touchfield.perception.human import VERIFIED, human, vibration_threshold, vibration_thresholds
from touchfield.perception.mask import excess_n, mask_n, violations
from touchfield.perception.vibrotactile import Crossover
from touchfield.pipeline import compare, encode
from touchfield.pipeline.spec import DEFAULT_F0_N, EncodeSpec
from touchfield.pipeline.stream import VoxelStream
from touchfield.sources.shapes.analytic_scene import AnalyticScene
from touchfield.sources.shapes.shapes import Sphere

BALL = AnalyticScene((Sphere((0.0, 0.0, 0.0), 0.03),))
CURVE = WeberCurve(((0.2, 0.3), (2.0, 0.12)))


def test_a_curve_is_log_linear_between_its_points_and_flat_beyond():
    middle_n = np.sqrt(0.2 * 2.0)
    forces_n = [0.0, 0.2, middle_n, 2.0, -2.0, 9.0]
    np.testing.assert_allclose(CURVE(forces_n), [0.3, 0.3, 0.21, 0.12, 0.12, 0.12])
    assert (CURVE.least, CURVE.largest) == (0.12, 0.3)


@pytest.mark.parametrize(
    ("points", "expected"),
    [
        ((), "1 to 64"),
        (((1.0, 0.1), (1.0, 0.2)), "ascend"),
        (((1.0, 0.9), (1.1, 0.01)), r"grows with the force"),
        (((0.0, 0.1),), "force_n"),
        (((1.0, 1.0),), "k"),
        ("ab", "pairs"),
        (((1.0,),), "pairs"),
    ],
)
def test_a_curve_that_is_no_bound_is_refused(points, expected):
    with pytest.raises(InvalidArgument, match=expected):
        WeberCurve.of(points)


def test_the_bound_of_a_curve_never_falls_as_the_force_grows():
    force_n = np.geomspace(1e-3, 1e2, 5001)
    for known in (*(own.weber for own in grips().values()), CURVE):
        assert (np.diff(mask_n(force_n, known, 0.01)) >= 0).all()


def test_the_allowance_of_the_encoder_never_exceeds_the_curve():
    force_n = np.random.default_rng(1).lognormal(0, 2, 20_000)
    allowed_n = CURVE.least * force_n + excess_n(force_n, CURVE).astype(np.float64)
    exact_n = CURVE(force_n) * force_n
    assert (allowed_n <= exact_n * (1 + 1e-12)).all()
    assert (allowed_n >= exact_n * (1 - 1e-6)).all()


def test_violations_of_a_curve_are_those_of_its_mask():
    forces_n = np.array([[0.2, 0, 0], [2.0, 0, 0]], np.float32)
    decoded_n = forces_n + np.array([[0.05, 0, 0], [0.3, 0, 0]], np.float32)
    found = violations(forces_n, decoded_n, CURVE)
    assert found.count == 1  # 0.06 N are allowed at 0.2 N, and 0.24 N at 2 N
    assert found.worst_ratio == pytest.approx(1.25, rel=1e-5)


def test_every_number_has_source_condition_and_criterion():
    for entry in human().values():
        assert entry.verified in ("read", "secondary", "setting"), f"{entry.name}: nothing here is recalled"
        assert entry.source and entry.criterion, entry.name
        assert entry.verified == "setting" or (entry.year and entry.condition), entry.name
    for known in grips().values():
        assert len(known.numbers) == 1 + len(known.weber.points)
        for number in known.numbers:
            assert number.verified in ("read", "secondary"), f"{known.name}: {number.name}"
            assert number.source and number.year and number.condition and number.criterion
            assert (number.name in known.note) == (number.verified != "read")
    for profile in vibration_thresholds().values():
        assert len(profile.verified) == len(profile.frequency_hz) and set(profile.verified) <= set(VERIFIED)
        assert profile.impedance_verified in VERIFIED
        assert profile.source and profile.year and profile.conditions and profile.criterion


def test_a_number_without_a_procedure_is_one_in_use():
    without = {name for name, entry in human().items() if "no procedure" in entry.criterion}
    in_use = {
        "direction_jnd_deg",
        "direction_jnd_seen_deg",
        "direction_jnd_fingerpad_deg",
        "force_change_finger",
    }
    assert without == in_use, "withdraw the others, or name their use in docs/perception.md"


def test_a_number_used_unasked_is_one_of_the_table_and_no_other():
    encoding = TouchSpec()
    used = {
        "deadband_default": encoding.k,
        "force_threshold_n": encoding.f0_n,
        "direction_jnd_seen_deg": encoding.direction_jnd_deg,
        "two_point_threshold_mm": 1000 * encoding.masking_radius_m,
        "force_bandwidth_hz": Crossover(2000.0).cutoff_hz,
    }
    assert used == {name: pytest.approx(human()[name].value) for name in used}
    assert (PaperSpec().k, DEFAULT_F0_N) == (encoding.k, encoding.f0_n)
    assert set(vibration_threshold().verified) == {"secondary"}, "no point of the default is recalled"


def test_the_page_of_thresholds_has_every_number():
    page = (Path(__file__).resolve().parents[2] / "docs/perception.md").read_text()
    rows = [line for line in page.splitlines() if line.startswith("|")]
    for entry in human().values():
        author = re.split(r"[ ,:;]", entry.source.removeprefix("The "))[0].lower()
        values = ", ".join(f"{value:g}" for value in entry.values)
        found = [row for row in rows if values in row and author in row.lower() and entry.verified in row]
        assert found, f"{entry.name}: {values} of {author}, {entry.verified}"
    for known in grips().values():
        for number in known.numbers:
            kind = ".2f" if number.name != "F_0" else "g"
            start = f"| {known.name} | {number.name.split()[0]} = {number.value:{kind}} "
            assert any(row.startswith(start) and number.verified in row for row in rows), start


@pytest.mark.parametrize(("frequency_hz", "octaves_db"), [(40, 0), (80, -7), (160, -23), (320, -23)])
def test_the_model_of_a_hand_is_within_what_its_source_measured(frequency_hz, octaves_db):
    """Of the hand alone 12.6 to 15.8 N s/m below 40 Hz, then falling; its phase was not read (docs)."""
    model, w = vibration_threshold(), 2 * np.pi * frequency_hz
    device = w * model.mass_kg
    hand = np.array([12.6, 15.8]) * 10 ** (octaves_db / 20)
    force_n_s_per_m = abs(model.stiffness_n_per_m / w - device + 1j * model.damping_n_s_per_m)
    assert np.abs(device - hand).min() <= force_n_s_per_m <= device + hand.max()


@pytest.fixture(scope="module")
def coded(tmp_path_factory):
    path = tmp_path_factory.mktemp("grip") / "ball.touch"
    touch = TouchSpec(k=CURVE.least, f0_n=0.01, k_by_force=CURVE.points)
    return path, encode(BALL, path, EncodeSpec(nw=5, touch=touch))


def test_a_file_records_its_curve_and_compare_measures_against_it(coded):
    path, encoded = coded
    assert "k(|F|) = 0.3 at 0.2 N, 0.12 at 2 N" in encoded.bound["error_bound"]
    found = compare(BALL, path)
    assert found.summary()["threshold_verified"] == "unverified"  # the margin in decibels is beside a model
    assert found.meter.weber == CURVE
    assert found.summary()["mask_violations"] == 0
    assert 0.9 < found.summary()["worst_mask_ratio"] <= 1
    # the same file against its smallest k alone: weak forces use what the curve allows
    assert compare(BALL, path, k=CURVE.least, f0_n=0.01).summary()["mask_violations"] > 0
    # HEAD bounds every force for a reader that knows no curve
    assert compare(BALL, path, k=0.3, f0_n=0.01).summary()["mask_violations"] == 0
    with TouchReader(path) as reader:
        assert reader.head.weber_fraction == 0.3
        assert VoxelStream(reader).error_bound()["error_bound"] == encoded.bound["error_bound"]


def test_a_curve_costs_fewer_bytes_than_its_smallest_k(coded, tmp_path):
    strict = encode(BALL, tmp_path / "strict.touch", EncodeSpec(nw=5, touch=TouchSpec(k=0.12, f0_n=0.01)))
    assert coded[1].file_bytes < strict.file_bytes


def test_without_a_curve_the_provenance_has_no_word_of_it():
    assert "k_by_force" not in EncodeSpec().to_json()
    spec = EncodeSpec(touch=TouchSpec.for_grip("stylus"))
    assert EncodeSpec.from_json(spec.to_json()) == spec


def test_a_curve_in_a_file_that_is_none_is_a_corrupt_file(coded, tmp_path):
    path = tmp_path / "wrong.touch"
    with TouchReader(coded[0]) as reader:
        spec = json.loads(reader.provenance["spec"])
        spec["touch"]["k_by_force"] = [[1.0, 0.9], [1.1, 0.01]]
        provenance = {**reader.provenance, "spec": json.dumps(spec)}
        with TouchWriter(path) as writer:
            writer.write_head(reader.head, provenance)
            for i, entry in enumerate(reader.segments):
                writer.write_segment(entry.first_frame, entry.frame_count, reader.read_segment(i))
    with TouchReader(path) as reader, pytest.raises(CorruptFile, match="k_by_force"):
        VoxelStream(reader).error_bound()


def test_a_grip_excludes_what_it_sets():
    assert TouchSpec.for_grip("finger").f0_n == grip("finger").f0_n == 0.0335
    with pytest.raises(InvalidArgument, match="--k: "):
        TouchSpec.for_grip("finger", k=0.1)
    with pytest.raises(InvalidArgument, match="stylus"):
        TouchSpec.for_grip("elbow")
    with pytest.raises(InvalidArgument, match="smallest"):
        TouchSpec(k=0.1, k_by_force=CURVE.points)
    with pytest.raises(InvalidArgument, match="mode mask only"):
        TouchSpec.for_grip("finger", mode="nmse")


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--profile", "stylus"], "grip=stylus"),
        (["--profile", "grip=elbow"], "stylus"),
        (["--profile", "grip=ball", "--k", "0.1"], "--k"),
        (["--profile", "grip=ball", "--target-bytes", "9000"], "--profile"),
        (["--profile", "grip=ball", "--coder", "paper"], "--profile"),
    ],
)
def test_a_profile_that_cannot_be_is_one_error_and_no_file(arguments, expected, tmp_path, capsys):
    out = tmp_path / "out.touch"
    common = ["encode", "sample:shapes", str(out), "--nw", "4", "--representation", "voxel"]
    assert _exit_code([*common, *arguments])
    message = capsys.readouterr().err
    assert expected in message and "Traceback" not in message and message.count("\n") == 1
    assert not out.exists()


def test_encode_with_a_profile_names_the_numbers_that_were_not_measured(tmp_path, capsys):
    out = tmp_path / "out.touch"
    common = ["encode", "sample:shapes", str(out), "--nw", "4", "--representation", "voxel", "--json"]
    assert not _exit_code([*common, "--profile", "grip=stylus"])
    answer = json.loads(capsys.readouterr().out)
    assert "k(|F|)" in answer["error_bound"]
    assert any("secondary: F_0, k at 1 N, k at 2.5 N" in note for note in answer["notes"])
