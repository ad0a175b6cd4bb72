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


def said(capsys: pytest.CaptureFixture[str], words: list[str]) -> str:
    """Output of a command that ends well."""
    capsys.readouterr()
    assert _exit_code(words) == 0
    return capsys.readouterr().out


@pytest.fixture
def out(tmp_path: Path) -> str:
    return str(tmp_path / "o.touch")


def test_what_is_asked_is_in_the_file(sphere: str, out: str, capsys: pytest.CaptureFixture[str]) -> None:
    words = (
        "--nw 4 --k 0.2 --f0-n 0.1 --mode mask-direction --direction-jnd-deg 25 --support exact --effort fast"
    )
    assert _exit_code(["encode", sphere, out, *words.split()]) == 0
    capsys.readouterr()
    assert _exit_code(["info", out, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["coder"] == "touch" and told["promise_kept"] is True and 0 <= told["worst_mask_ratio"] <= 1
    expected = {"k": 0.2, "f0_n": 0.1, "mode": "mask-direction", "direction_jnd_deg": 25, "support": "exact"}
    assert {key: told[key] for key in expected} == expected
    assert told["effort"] == "fast" and len(told["worst_voxel"]) == 3
    assert _exit_code(["info", out]) == 0
    assert "promise_kept" in capsys.readouterr().out
    assert _exit_code(["encode", sphere, out, "--nw", "4", "--coder", "paper-literal", "--nq", "5"]) == 0
    capsys.readouterr()
    assert _exit_code(["info", out, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["directions"] == "octa3"


def test_spatial_masking_is_in_the_file_and_compare_holds_it(
    sphere: str, out: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["encode", sphere, out, "--nw", "5", "--thickness-m", "0.02"]
    plain = str(tmp_path / "plain.touch")
    assert _exit_code(["encode", sphere, plain, *words[3:]]) == 0
    assert _exit_code([*words, "--masking", "0.3", "--body-site", "palm"]) == 0
    assert "masking_radius_m" not in json.loads(said(capsys, ["info", plain, "--json"]))
    told = json.loads(said(capsys, ["info", out, "--json"]))
    assert (told["masking"], told["masking_radius_m"], told["promise_kept"]) == (0.3, 0.01, True)
    assert Path(out).stat().st_size < Path(plain).stat().st_size
    held = json.loads(said(capsys, ["compare", sphere, out, "--json"]))
    assert held["mask_violations"] == 0 and 0.5 < held["worst_mask_ratio"] <= 1
    assert held["worst_mask_ratio"] == pytest.approx(told["worst_mask_ratio"], abs=1e-4)
    # the plain mask, asked for by name, is left: more is hidden only because of what is around
    plainly = ["compare", sphere, out, "--k", "0.1", "--no-picture", "--json"]
    assert json.loads(said(capsys, plainly))["mask_violations"] > 0


@pytest.mark.parametrize(
    ("words", "said"),
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
def test_what_does_not_go_together_is_one_line(
    words: str, said: str, sphere: str, out: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _exit_code(["encode", sphere, out, "--nw", "3", *words.split()]) == 2
    told = capsys.readouterr().err
    assert said in told and len(told.strip().splitlines()) == 1
    assert not Path(out).exists()


def test_a_size_is_reached_and_told(sphere: str, out: str, capsys: pytest.CaptureFixture[str]) -> None:
    words = "--nw 5 --thickness-m 0.01 --effort fast --target-nmse-db -20 --json"
    assert _exit_code(["encode", sphere, out, *words.split()]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["mode"] == "nmse" and told["nmse_db"] == pytest.approx(-20, abs=0.13)
    assert any("found in" in note for note in told["notes"])


def test_a_plan_for_a_budget(sphere: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture = tmp_path / "plan.png"
    words = f"--nw 4 --thickness-m 0.01 --budget 1Mbit/s --plot {picture} --device phantom-omni --k 0.1"
    assert _exit_code(["plan", sphere, *words.split()]) == 0
    told = capsys.readouterr().out
    assert "->" in told and "touchfield encode" in told and "mask kept" in told
    assert picture.stat().st_size > 5000
    printed = shlex.split(next(line for line in told.splitlines() if "touchfield encode" in line))
    assert printed[3:5] == [sphere, "OUT.touch"] and printed[printed.index("--thickness-m") + 1] == "0.01"
    assert printed[printed.index("--effort") + 1] == "fast", "as it was tried"
    assert _exit_code(["encode", sphere, str(tmp_path / "planned.touch"), *printed[5:]]) == 0
    capsys.readouterr()
    assert _exit_code(["plan", sphere, "--nw", "3", "--budget", "1Mbit/s", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert {"chosen", "front", "trials", "encode_options", "lambda_bytes"} <= set(found), (
        "a still medium has bytes"
    )
    for words in ("--budget 1bit/s", "--budget fast", "--budget 64kbit/s --nominal"):
        assert _exit_code(["plan", sphere, "--nw", "3", *words.split()]) == 2
        assert len(capsys.readouterr().err.strip().splitlines()) == 1
