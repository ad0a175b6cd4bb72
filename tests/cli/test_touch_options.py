"""The options of coder `touch` on the command line."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import pytest

from touchfield.cli.main import _exit_code

SPHERE = '[[shape]]\nkind = "sphere"\ncenter_m = [0.0, 0.0, 0.0]\nradius_m = 0.05\n'


@pytest.fixture
def sphere(tmp_path: Path) -> str:
    path = tmp_path / "sphere.toml"
    path.write_text(SPHERE)
    return str(path)


def printed_by(capsys: pytest.CaptureFixture[str], arguments: list[str]) -> str:
    """Standard output of a command that must succeed."""
    capsys.readouterr()
    assert _exit_code(arguments) == 0
    return capsys.readouterr().out


@pytest.fixture
def output_path(tmp_path: Path) -> str:
    return str(tmp_path / "o.touch")


def test_options_are_stored_in_the_file(
    sphere: str, output_path: str, capsys: pytest.CaptureFixture[str]
) -> None:
    options = (
        "--nw 4 --k 0.2 --f0-n 0.1 --mode mask-direction --direction-jnd-deg 25 --support exact --effort fast"
    )
    assert _exit_code(["encode", sphere, output_path, *options.split()]) == 0
    capsys.readouterr()
    assert _exit_code(["info", output_path, "--json"]) == 0
    values = json.loads(capsys.readouterr().out)
    assert (
        values["coder"] == "touch" and values["promise_kept"] is True and 0 <= values["worst_mask_ratio"] <= 1
    )
    expected = {"k": 0.2, "f0_n": 0.1, "mode": "mask-direction", "direction_jnd_deg": 25, "support": "exact"}
    assert {key: values[key] for key in expected} == expected
    assert values["effort"] == "fast" and len(values["worst_voxel"]) == 3
    assert _exit_code(["info", output_path]) == 0
    assert "promise_kept" in capsys.readouterr().out
    assert (
        _exit_code(["encode", sphere, output_path, "--nw", "4", "--coder", "paper-literal", "--nq", "5"]) == 0
    )
    capsys.readouterr()
    assert _exit_code(["info", output_path, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["directions"] == "octa3"


def test_spatial_masking_is_stored_and_used_by_compare(
    sphere: str, output_path: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["encode", sphere, output_path, "--nw", "5", "--thickness-m", "0.02"]
    plain = str(tmp_path / "plain.touch")
    assert _exit_code(["encode", sphere, plain, *arguments[3:]]) == 0
    assert _exit_code([*arguments, "--masking", "0.3", "--body-site", "palm"]) == 0
    assert "masking_radius_m" not in json.loads(printed_by(capsys, ["info", plain, "--json"]))
    values = json.loads(printed_by(capsys, ["info", output_path, "--json"]))
    assert (values["masking"], values["masking_radius_m"], values["promise_kept"]) == (0.3, 0.01, True)
    assert Path(output_path).stat().st_size < Path(plain).stat().st_size
    compared = json.loads(printed_by(capsys, ["compare", sphere, output_path, "--json"]))
    assert compared["mask_violations"] == 0 and 0.5 < compared["worst_mask_ratio"] <= 1
    assert compared["worst_mask_ratio"] == pytest.approx(values["worst_mask_ratio"], abs=1e-4)
    # with the explicit plain mask there are violations: spatial masking allows more error
    unmasked_compare = ["compare", sphere, output_path, "--k", "0.1", "--no-picture", "--json"]
    assert json.loads(printed_by(capsys, unmasked_compare))["mask_violations"] > 0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("--nq 5", "--nq works with --coder paper, not with touch"),
        ("--directions ico3", "--directions"),
        ("--deadband none", "--deadband"),
        ("--amplitude weber", "--amplitude"),
        ("--interframe closed", "interframe"),
        ("--coder paper --f0-n 0.1", "--f0-n works with --coder touch, not with paper"),
        ("--coder paper --effort fast", "--effort"),
        ("--coder paper-literal --mode nmse", "--mode"),
        ("--coder paper --lossless-quantised", "--lossless-quantised"),
        ("--coder paper --target-bytes 5000", "--target-bytes"),
        ("--coder mp3", "--coder"),
        ("--step-n 0.1", "--step-n: found it in mode mask"),
        ("--direction-jnd-deg 20 --mode nmse", "--direction-jnd-deg"),
        ("--lossless-quantised --k 0.2", "--k"),
        ("--lossless-quantised --target-bytes 4000", "--target-bytes"),
        ("--target-bytes 4000 --target-nmse-db -20", "both"),
        ("--mode best", "mode"),
        ("--effort heroic", "effort"),
        ("--k 1", "--k: found 1.0"),
        ("--f0-n -1", "--f0-n: found -1.0"),
        ("--masking 2", "masking: found 2.0"),
        ("--masking 0.1 --mode nmse", "masking: found it in mode nmse"),
        ("--body-site palm", "--body-site: found it without --masking"),
        ("--masking 0.1 --body-site ear", "finger, palm"),
        ("--masking 0.1", "radius_m: found 0.0025"),
    ],
)
def test_contradictory_options_are_one_line(
    options: str, message: str, sphere: str, output_path: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _exit_code(["encode", sphere, output_path, "--nw", "3", *options.split()]) == 2
    error = capsys.readouterr().err
    assert message in error and len(error.strip().splitlines()) == 1
    assert not Path(output_path).exists()


def test_target_is_reached_and_reported(
    sphere: str, output_path: str, capsys: pytest.CaptureFixture[str]
) -> None:
    options = "--nw 5 --thickness-m 0.01 --effort fast --target-nmse-db -20 --json"
    assert _exit_code(["encode", sphere, output_path, *options.split()]) == 0
    values = json.loads(capsys.readouterr().out)
    assert values["mode"] == "nmse" and values["nmse_db"] == pytest.approx(-20, abs=0.13)
    assert any("found in" in note for note in values["notes"])


def test_plan_for_a_budget(sphere: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture = tmp_path / "plan.png"
    options = f"--nw 4 --thickness-m 0.01 --budget 1Mbit/s --plot {picture} --device phantom-omni --k 0.1"
    assert _exit_code(["plan", sphere, *options.split()]) == 0
    report = capsys.readouterr().out
    assert "->" in report and "touchfield encode" in report and "within mask" in report
    assert picture.stat().st_size > 5000
    printed = shlex.split(next(line for line in report.splitlines() if "touchfield encode" in line))
    assert printed[3:5] == [sphere, "OUT.touch"] and printed[printed.index("--thickness-m") + 1] == "0.01"
    assert printed[printed.index("--effort") + 1] == "fast", "as it was tried"
    assert _exit_code(["encode", sphere, str(tmp_path / "planned.touch"), *printed[5:]]) == 0
    capsys.readouterr()
    assert _exit_code(["plan", sphere, "--nw", "3", "--budget", "1Mbit/s", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert {"chosen", "front", "trials", "encode_options", "lambda_bytes"} <= set(found), (
        "a still medium has bytes"
    )
    for options in ("--budget 1bit/s", "--budget fast", "--budget 64kbit/s --nominal"):
        assert _exit_code(["plan", sphere, "--nw", "3", *options.split()]) == 2
        assert len(capsys.readouterr().err.strip().splitlines()) == 1
