"""The command line end to end: results, one-line errors, exit codes, and no partial files."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

import touchfield as tf
from touchfield import pipeline
from touchfield.cli.main import _exit_code, load_commands
from touchfield.medium.stores.npz import write_npz
from touchfield.pipeline.comparison import Comparison
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.options import SourceOptions
from touchfield.sources.samples import SAMPLES
from touchfield.tasks.plan import Plan, PlanGrid, Trial

SPHERE = '[[shape]]\nkind = "sphere"\ncenter_m = [0.0, 0.0, 0.0]\nradius_m = 0.05\n'

COMPARE_KEYS = {
    "file_bytes", "frames", "grid_shape", "supported_voxels", "cr_full", "cr_literal", "nmse_db",
    "nmse_literal_db", "k", "f0_n", "mask_violations", "mask_violation_share", "worst_mask_ratio",
    "bits_per_supported_voxel", "bits_support", "bits_amplitude", "bits_direction", "bits_side",
}  # fmt: skip


@pytest.fixture
def sphere(tmp_path: Path) -> Path:
    path = tmp_path / "sphere.toml"
    path.write_text(SPHERE)
    return path


def test_encode_info_decode_compare(sphere: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    stream, field, back = tmp_path / "s.touch", tmp_path / "field.npz", tmp_path / "back.npz"
    common = [str(sphere), "--nw", "5", "--thickness-m", "0.01"]
    assert _exit_code(["encode", common[0], str(stream), *common[1:], "--json"]) == 0
    encoded = json.loads(capsys.readouterr().out)
    assert encoded["file_bytes"] == stream.stat().st_size
    assert _exit_code(["field", common[0], str(field), *common[1:]]) == 0
    assert _exit_code(["decode", str(stream), str(back)]) == 0
    capsys.readouterr()
    with np.load(field) as original, np.load(back) as decoded:
        assert original["forces_n"].dtype == np.float32
        assert original["forces_n"].shape == (1, 32, 32, 32, 3)
        for key in ("origin_m", "spacing_m", "rate_hz"):
            np.testing.assert_array_equal(original[key], decoded[key])
        x, y = original["forces_n"].astype(float), decoded["forces_n"].astype(float)
    assert _exit_code(["compare", str(sphere), str(stream), "--json"]) == 0
    compared = json.loads(capsys.readouterr().out)
    assert set(compared) >= COMPARE_KEYS
    assert compared["nmse_db"] == pytest.approx(10 * np.log10(((x - y) ** 2).sum() / (x**2).sum()), abs=1e-3)
    supported = (x != 0).any(-1)
    assert compared["supported_voxels"] == supported.sum()
    assert compared["cr_full"] == pytest.approx(8 * stream.stat().st_size / (96 * 32**3))
    parts = sum(compared[f"bits_{p}"] for p in ("support", "amplitude", "direction", "side"))
    assert parts == 8 * stream.stat().st_size
    picture = Image.open(stream.with_suffix(".png"))
    assert min(picture.size) > 800
    assert len(np.unique(np.asarray(picture.convert("L")))) > 50, "the picture shows something"
    # comparing with the field that was encoded gives the same result
    assert _exit_code(["compare", str(field), str(stream), "--json", "--no-picture"]) == 0
    compared_field = json.loads(capsys.readouterr().out)
    assert compared_field["nmse_db"] == pytest.approx(compared["nmse_db"], abs=1e-9)
    assert _exit_code(["info", str(stream), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["frames"] == 1


def test_options_reach_the_task(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    specs: list[EncodeSpec] = []
    answer = SimpleNamespace(summary=dict, notes=())
    monkeypatch.setattr(pipeline, "encode", lambda source, out, spec, *_, **__: specs.append(spec) or answer)
    defaults = EncodeSpec()
    for options, expected in (
        ("--nw 5 --frames 3", {"nw": 5, "frames": (3, 4)}),
        ("--frames :4 --fit-frames 2:", {"frames": (0, 4), "fit_frames": (2, None)}),
        ("--nominal --law proximity --band-m 0.003", {"nw": None, "law": "proximity", "band_m": 0.003}),
        ("--thickness-m inf --mapping 0.25", {"thickness_m": math.inf, "mapping": "0.25"}),
        ("--friction 0 --damping-n-s-per-m 2", {"friction": 0.0, "damping_n_s_per_m": 2.0}),
        ("--unit-m 0.01 --as stl", {"source": SourceOptions(kind="stl", unit_m=0.01)}),
    ):
        assert _exit_code(["encode", "no.stl", "out.touch", *options.split()]) == 0, capsys.readouterr().err
        assert specs.pop() == replace(defaults, **expected), options
    for command, message in (
        ("encode no.stl s3://b/out.touch --target-bytes 9000", "not with an address"),
        (
            "encode no.stl out.touch --target-bytes 9 --workers processes:2",
            "--workers works without --target-bytes",
        ),
        ("encode no.stl out.zarr --target-nmse-db -20", "not with .zarr"),
        ("live no.stl - --coarse", "--coarse: found a pipe"),
        ("live no.stl out.touch", "OUT: found 'out.touch'"),
    ):
        assert _exit_code(command.split()) == 2 and not specs
        assert message in capsys.readouterr().err


def test_plan_reports_options_of_encode(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fake_plan(source: str, budget: object, spec: EncodeSpec, search: PlanGrid, *_: object) -> Plan:
        assert search.nw == (3, 4) and spec.touch.effort == "fast"
        return Plan((Trial(replace(spec, nw=4), 100, 1, 0.1),), 0.1, 0.05, 200.0, source, 1, "bytes")

    monkeypatch.setattr("touchfield.tasks.plan.plan", fake_plan)
    scene = "--mapping 0.25 --stiffness-n-per-m 300.0 --exaggeration 2.0"
    assert _exit_code(["plan", "no.stl", "--budget", "200B", "--nw", "4", *scene.split(), "--json"]) == 0
    encode_options = json.loads(capsys.readouterr().out)["encode_options"]
    assert encode_options.startswith("--nw 4 ") and "--representation voxel --effort fast" in encode_options
    assert sorted(encode_options.partition("fast")[2].split()) == sorted(scene.split())


def test_default_output_is_a_table(sphere: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    stream = tmp_path / "s.touch"
    assert _exit_code(["encode", str(sphere), str(stream), "--nw", "4"]) == 0
    out = capsys.readouterr().out
    assert "bits_per_supported_voxel" in out and "mm of the scene" in out
    assert _exit_code(["info", str(stream)]) == 0
    assert "phantom-omni" in capsys.readouterr().out
    assert _exit_code(["devices"]) == 0
    assert "novint-falcon" in capsys.readouterr().out
    assert _exit_code(["devices", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)
    assert all(source for device in listed["profiles"].values() for source in device["sources"].values())
    assert _exit_code(["sources"]) == 0
    assert "redwood" in capsys.readouterr().out


def _bad_inputs(folder: Path) -> dict[str, tuple[list[str], int]]:
    """Name -> (arguments, exit code)."""
    sphere = folder / "sphere.toml"
    sphere.write_text(SPHERE)
    out = str(folder / "out.touch")
    ramp = (np.arange(64 * 48).reshape(48, 64) % 900 + 1000).astype(np.uint16)

    def depth_folder(name: str) -> Path:
        path = folder / name
        path.mkdir()
        Image.fromarray(ramp).save(path / "000.png")
        return path

    truncated = depth_folder("truncated")
    (truncated / "001.png").write_bytes((truncated / "000.png").read_bytes()[:90])
    mixed = depth_folder("mixed")
    Image.fromarray(ramp[:20]).save(mixed / "001.png")
    (folder / "nothing").mkdir()
    plain = depth_folder("plain")
    (folder / "empty.obj").write_text("# no triangles\n")
    (folder / "points.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\n")
    (folder / "nan.obj").write_text("v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (folder / "foreign.touch").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(100))
    camera = ["--depth-scale", "1000", "--intrinsics", "60,60,32,24"]
    return {
        "nothing there": (["encode", str(folder / "no"), out], 1),
        "folder with no depth": (["encode", str(folder / "nothing"), out], 1),
        "folder with no depth, named": (["encode", str(folder / "nothing"), out, "--as", "tum"], 1),
        "truncated picture": (["encode", str(truncated), out, "--as", "depth-folder", *camera], 1),
        "mixed sizes": (["encode", str(mixed), out, "--as", "depth-folder", *camera], 1),
        "missing intrinsics": (
            ["encode", str(plain), out, "--as", "depth-folder", "--depth-scale", "1000"],
            1,
        ),
        "missing scale": (
            ["encode", str(plain), out, "--as", "depth-folder", "--intrinsics", "60,60,32,24"],
            1,
        ),
        "no triangle": (["encode", str(folder / "empty.obj"), out], 1),
        "points only": (["encode", str(folder / "points.obj"), out], 1),
        "NaN vertex": (["encode", str(folder / "nan.obj"), out], 1),
        "unknown device": (["encode", str(sphere), out, "--device", "phantom-omnibus"], 2),
        "unknown kind": (["encode", str(sphere), out, "--as", "hologram"], 2),
        "k zero": (["encode", str(sphere), out, "--k", "0"], 2),
        "k one": (["encode", str(sphere), out, "--k", "1"], 2),
        "nw two": (["encode", str(sphere), out, "--nw", "2"], 2),
        "nw eleven": (["encode", str(sphere), out, "--nw", "11"], 2),
        "nq": (["encode", str(sphere), out, "--nq", "0"], 2),
        "directions": (["encode", str(sphere), out, "--directions", "ico5000"], 2),
        "frames": (["encode", str(sphere), out, "--frames", "5:2"], 2),
        "frames beyond": (["encode", str(sphere), out, "--nw", "3", "--frames", "3:5"], 2),
        "not a number": (["encode", str(sphere), out, "--nw", "many"], 2),
        "no such option": (["encode", str(sphere), out, "--colour"], 2),
        "no such command": (["embroider"], 2),
        "missing folder": (["encode", str(sphere), str(folder / "no" / "out.touch"), "--nw", "3"], 2),
        "foreign stream": (["info", str(folder / "foreign.touch")], 1),
        "missing stream": (["info", str(folder / "no.touch")], 1),
        "unknown ending": (["field", str(sphere), str(folder / "field.xyz"), "--nw", "3"], 2),
        "ending of a field": (["encode", str(sphere), str(folder / "field.npz"), "--nw", "3"], 2),
        "unknown sample": (["encode", "sample:moon", out], 2),
        "a stream without an ending": (["encode", str(sphere), str(folder / "out"), "--nw", "3"], 2),
        "a scene is no medium": (["edit", "sample:shapes", out, "--operator", "erase"], 2),
        "an effect of another ending": (["import", str(sphere), str(folder / "out.npz")], 2),
        "no recording": (["texture", str(folder / "none.wav"), "-o", str(folder / "none.json")], 1),
    }


def test_every_invalid_input_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, (arguments, code) in _bad_inputs(tmp_path).items():
        before = sorted(tmp_path.rglob("*"))
        capsys.readouterr()
        assert _exit_code(arguments) == code, name
        captured = capsys.readouterr()
        assert len(captured.err.strip().splitlines()) == 1, f"{name}: {captured.err}"
        assert captured.err.startswith("touchfield: ") and "Traceback" not in captured.err, (
            f"{name}: {captured.err}"
        )
        assert sorted(tmp_path.rglob("*")) == before, f"{name} left something behind"


HEEDFUL = """
import signal, sys
from touchfield.cli.main import run
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs are started deaf to it
run(sys.argv[1:])
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interruption_leaves_no_file(tmp_path: Path, number: signal.Signals) -> None:
    # a superquadric on a fine lattice takes long enough to be interrupted
    source = tmp_path / "long.toml"
    source.write_text(
        '[[shape]]\nkind = "superquadric"\ncenter_m = [0.0, 0.0, 0.0]\nhalf_extents_m = [0.1, 0.1, 0.1]\n'
        "exponents = [0.5, 0.5]\n"
    )
    arguments = ["encode", str(source), str(tmp_path / "out.touch"), "--nw", "8", "--oversample", "3"]
    running = subprocess.Popen(
        [sys.executable, "-c", HEEDFUL, *arguments], stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    deadline = time.monotonic() + 60
    while len(list(tmp_path.iterdir())) < 2 and time.monotonic() < deadline:
        time.sleep(0.02)  # until the temporary file exists
    assert running.poll() is None
    running.send_signal(number)
    _, stderr = running.communicate(timeout=60)
    assert running.returncode == 1
    assert stderr.strip() == "touchfield: interrupted; nothing was written under the final name"
    assert list(tmp_path.iterdir()) == [source]


def test_interrupt_during_imports_is_one_line() -> None:
    program = """
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell may have it ignored behind its back
class Interrupting:
    def find_spec(self, name, *_):
        if name == "typer":
            signal.raise_signal(signal.SIGINT)
sys.meta_path.insert(0, Interrupting())
import touchfield.__main__
assert "typer" not in sys.modules and "numpy" not in sys.modules, "nothing heavy is loaded yet"
touchfield.__main__.main()
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (1, "", "touchfield: interrupted\n")


def test_interrupted_command_without_output_mentions_no_file(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("touchfield.tasks.play.play", interrupt)
    assert _exit_code(["play", "room.touch"]) == 1
    assert capsys.readouterr().err == "touchfield: interrupted\n"
    monkeypatch.setattr("touchfield.tasks.library.index_folder", interrupt)
    assert _exit_code(["index", "media"]) == 1
    assert capsys.readouterr().err == "touchfield: interrupted\n", "what was described is saved"


def test_truncated_file_is_not_reported_as_interruption(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def raise_eof(*_: object, **__: object) -> None:
        raise EOFError("marshal data too short")

    monkeypatch.setattr("touchfield.tasks.library.index_folder", raise_eof)
    assert _exit_code(["index", "media"]) == 1
    error = capsys.readouterr().err.strip()
    assert error == "touchfield: a file ended too early: marshal data too short. Make it anew"


LIMITED = """
import contextlib, io, json, resource, sys
sys.dont_write_bytecode = True  # Python would keep modules that were cut at the limit
from touchfield.cli.main import _exit_code
resource.setrlimit(resource.RLIMIT_FSIZE, (600, 600))
for line in sys.stdin:
    with contextlib.redirect_stderr(io.StringIO()) as said, contextlib.redirect_stdout(io.StringIO()):
        code = _exit_code(json.loads(line))
    print(json.dumps([code, said.getvalue()]), flush=True)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="this system has no limit on the size of files")
def test_full_disk_is_one_line(sphere: Path, tmp_path: Path) -> None:
    stream = tmp_path / "s.touch"
    assert _exit_code(["encode", str(sphere), str(stream), "--nw", "4"]) == 0
    assert stream.stat().st_size > 600
    before = sorted(tmp_path.iterdir())
    command = [sys.executable, "-c", LIMITED]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as limited:
        assert limited.stdin is not None and limited.stdout is not None
        for arguments in (
            ["encode", str(sphere), str(tmp_path / "new.touch"), "--nw", "4"],
            ["encode", str(sphere), str(stream), "--nw", "4"],
            ["decode", str(stream), str(tmp_path / "new.npz")],
            ["decode", str(stream), str(tmp_path / "new.vti")],
            ["compare", str(sphere), str(stream), "--picture", str(tmp_path / "new.png")],
        ):
            limited.stdin.write(json.dumps(arguments) + "\n")
            limited.stdin.flush()
            code, error = json.loads(limited.stdout.readline())
            assert code == 1, arguments
            assert len(error.strip().splitlines()) == 1, error
            assert "too large" in error and "Traceback" not in error, error
            assert sorted(tmp_path.iterdir()) == before, arguments
    assert _exit_code(["info", str(stream)]) == 0, "the older file is as it was"


def test_no_command_overwrites_its_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, stream, field = (tmp_path / name for name in ("relief.png", "relief.touch", "relief.npz"))
    Image.fromarray((np.arange(32 * 32).reshape(32, 32) % 200).astype(np.uint8)).save(source)
    before = source.read_bytes()
    assert _exit_code(["encode", str(source), str(stream), "--nw", "3"]) == 0
    assert _exit_code(["compare", str(source), str(stream)]) == 0
    assert source.read_bytes() == before
    assert (tmp_path / "relief.compare.png").stat().st_size > 1000
    assert _exit_code(["field", str(source), str(field), "--nw", "3"]) == 0
    contents = {path: path.read_bytes() for path in (source, stream, field)}
    for arguments in (
        ["compare", str(source), str(stream), "--picture", str(source)],
        ["compare", str(source), str(stream), "--picture", str(stream)],
        ["encode", str(source), str(source), "--nw", "3"],
        ["encode", str(field), str(field), "--nw", "3"],
        ["field", str(field), str(tmp_path / "." / "relief.npz"), "--nw", "3"],
        ["decode", str(stream), str(stream)],
    ):
        capsys.readouterr()
        assert _exit_code(arguments) == 2, arguments
        assert "the file that is read" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in contents} == contents


def test_compare_does_not_overwrite_foreign_pictures(
    sphere: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    stream, default_path, fallback_path = (tmp_path / name for name in ("s.touch", "s.png", "s.compare.png"))
    assert _exit_code(["encode", str(sphere), str(stream), "--nw", "3"]) == 0
    Image.new("RGB", (9, 9)).save(default_path)
    foreign_bytes = default_path.read_bytes()
    assert _exit_code(["compare", str(sphere), str(stream)]) == 0
    assert default_path.read_bytes() == foreign_bytes and fallback_path.stat().st_size > 1000
    drawn = fallback_path.read_bytes()
    monkeypatch.setattr(Comparison, "draw", lambda self, path: Path(path).write_bytes(drawn + b"again"))
    assert _exit_code(["compare", str(sphere), str(stream)]) == 0
    assert default_path.read_bytes() == foreign_bytes and fallback_path.read_bytes() == drawn + b"again", (
        "its own it may draw again"
    )
    capsys.readouterr()
    assert _exit_code(["compare", str(sphere), str(stream), "--picture", str(default_path)]) == 2
    assert "left as it is" in capsys.readouterr().err
    fallback_path.write_bytes(foreign_bytes)
    assert _exit_code(["compare", str(sphere), str(stream)]) == 2
    assert _exit_code(["compare", str(sphere), str(stream), "--no-picture"]) == 0
    assert default_path.read_bytes() == fallback_path.read_bytes() == foreign_bytes
    default_path.unlink()
    assert _exit_code(["compare", str(sphere), str(stream)]) == 0
    assert default_path.read_bytes() == drawn + b"again"


def test_errors_of_json_commands_are_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, (arguments, code) in _bad_inputs(tmp_path).items():
        if arguments == ["embroider"]:
            continue
        capsys.readouterr()
        assert _exit_code([*arguments, "--json"]) == code, name
        captured = capsys.readouterr()
        error = json.loads(captured.err)
        assert captured.out == "" and error["exit_code"] == code and error["error"] and error["kind"], name


def test_bits_of_a_supported_voxel_are_the_same_in_info_and_compare(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stream, field = tmp_path / "s.touch", tmp_path / "field.npz"
    forces = np.zeros((3, 8, 8, 8, 3))
    for frame, height in enumerate((2, 5, 3)):  # each frame has forces at other voxels
        forces[frame, :, :, :height] = 0, 0, 1.0
    grid = tf.Grid.over_box((0, 0, 0), (0.08, 0.08, 0.08), (8, 8, 8))
    write_npz(field, tf.HapticMedium.from_array(forces, grid))
    assert _exit_code(["encode", str(field), str(stream), "--nw", "5"]) == 0
    capsys.readouterr()
    assert _exit_code(["info", str(stream), "--voxels", "--json"]) == 0
    info = json.loads(capsys.readouterr().out)
    assert _exit_code(["compare", str(field), str(stream), "--no-picture", "--json"]) == 0
    compared = json.loads(capsys.readouterr().out)
    for key in ("decoded_supported_voxels", "bits_per_decoded_voxel"):
        assert info[key] == compared[key] > 0
    for of in (
        {**info, "n": info["decoded_supported_voxels"]},
        {**compared, "n": compared["supported_voxels"]},
    ):
        each = of.get("bits_per_supported_voxel", of["bits_per_decoded_voxel"])
        assert each * of["n"] == pytest.approx(8 * stream.stat().st_size)


def test_internal_error_is_one_line(
    sphere: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from touchfield.codec.touch.encoder import TouchEncoder

    def raise_internal_error(self: TouchEncoder, frames: object, anchor: object = None) -> None:
        raise ZeroDivisionError("by nothing")

    monkeypatch.setattr(TouchEncoder, "encode_segment", raise_internal_error)
    arguments = ["encode", str(sphere), str(tmp_path / "o.touch"), "--nw", "3"]
    assert _exit_code(arguments) == 1
    error = capsys.readouterr().err
    assert len(error.splitlines()) == 1 and "ZeroDivisionError: by nothing" in error
    assert list(tmp_path.iterdir()) == [sphere]
    monkeypatch.setenv("TOUCHFIELD_TRACEBACK", "1")
    with pytest.raises(ZeroDivisionError):
        _exit_code(arguments)


def test_no_arguments_show_the_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert _exit_code([]) == 0
    assert "compare" in capsys.readouterr().out
    assert _exit_code(["--version"]) == 0
    assert capsys.readouterr().out.startswith("touchfield 0")


def test_help_names_every_sample(capsys: pytest.CaptureFixture[str]) -> None:
    assert _exit_code(["encode", "--help"]) == 0
    printed = capsys.readouterr().out
    assert all(f"sample:{name}" in printed for name in SAMPLES)


def test_help_has_groups_and_examples(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _exit_code(["--help"]) == 0
    printed = capsys.readouterr().out
    indices = [printed.index(f"─ {group} ─") for group in ("Make", "Look", "Feel", "Study", "Set up")]
    assert indices == sorted(indices)
    assert _exit_code(["encode", "--help"]) == 0
    printed = capsys.readouterr().out
    groups = ("What most people need", "Device and lattice", "Force", "Scene", "Coder", "The paper's coder")
    indices = [printed.index(f"─ {group} ─") for group in groups]
    assert indices == sorted(indices)
    first = printed[indices[0] : indices[1]]
    assert sum(line.lstrip("│ ").startswith("--") for line in first.splitlines()) == 10
    assert "[default: half" in printed, "what stands in brackets is no markup"
    assert "touchfield encode scan.ply" in printed.split("Examples:")[1]
    commands = (
        "filter",
        "field",
        "plan",
        "decode",
        "export",
        "import",
        "edit",
        "splice",
        "resample",
        "lod",
        "partition",
    )
    for command in (*commands, "info", "compare", "measure", "play"):
        assert _exit_code([command, "--help"]) == 0
        assert f"touchfield {command} " in capsys.readouterr().out.split("Examples:")[1], command


def test_usage_error_names_the_help_of_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    for arguments, hint in (
        (["plan", "x.ply"], "touchfield plan --help"),
        (["embroider"], "touchfield --help"),
    ):
        assert _exit_code(arguments) == 2
        assert f"({hint} tells more)" in capsys.readouterr().err


def test_terminal_that_cannot_encode_a_name(sphere: Path, tmp_path: Path) -> None:
    stream = tmp_path / "kühe.touch"
    assert _exit_code(["encode", str(sphere), str(stream), "--nw", "3"]) == 0
    command = [sys.executable, "-m", "touchfield", "info", str(stream)]
    environment = {**os.environ, "PYTHONIOENCODING": "ascii"}
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    assert "k\\xfche.touch" in done.stdout and not done.stderr


def test_help_and_version_run_in_a_fresh_interpreter() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "touchfield", "encode", "--help"],
        capture_output=True, text=True, check=True, env={**os.environ, "COLUMNS": "200"},
    )  # fmt: skip
    assert "--stiffness-n-per-m" in done.stdout and "--directions" in done.stdout


def test_import_is_light() -> None:
    heavy = ("numba", "PIL", "trimesh", "matplotlib", "scipy", "rich", "typer")
    code = f"import sys, touchfield; print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_each_command_loads_only_its_module() -> None:
    """The package is imported anew for each command, so that only the module of that command is loaded."""
    from touchfield.cli.main import COMMANDS

    program = (
        "import sys\n"
        "for name in sys.argv[1:]:\n"
        "    for old in [one for one in sys.modules if one.partition('.')[0] == 'touchfield']: del "
        "sys.modules[old]\n"
        "    from touchfield.cli.main import COMMANDS, load_commands\n"
        "    names = [one.name or one.callback.__name__ for one in "
        "load_commands([name]).registered_commands]\n"
        "    rooms = {room for room in COMMANDS.values() if f'touchfield.cli.{room}' in sys.modules}\n"
        "    assert name in names and rooms == {COMMANDS[name]}, (name, names, rooms)\n"
    )
    names = {module: name for name, module in COMMANDS.items()}.values()
    subprocess.run([sys.executable, "-c", program, *names], check=True)
    all_names = [
        command.name or getattr(command.callback, "__name__", "")
        for command in load_commands().registered_commands
    ]
    assert all_names == list(COMMANDS)
