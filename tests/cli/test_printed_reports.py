"""The printed reports of commands have the figures and notes of their JSON."""

from __future__ import annotations

import json
import os
import sys
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import touchfield as tf
from touchfield.cli.main import _exit_code
from touchfield.cli.play import _starved_note
from touchfield.cli.view import _free_name
from touchfield.codec.paper.spec import PaperSpec
from touchfield.codec.touch.spec import TouchSpec
from touchfield.compute import jit
from touchfield.devices.drivers.registry import Check
from touchfield.pipeline.result import Result
from touchfield.pipeline.spec import EncodeSpec
from touchfield.tasks.live import LiveSpec, Sent
from touchfield.tasks.plan import Plan, Trial, amount
from touchfield.tasks.setup import host_checks, library_checks

Capture = pytest.CaptureFixture[str]


def notes_of(text: str) -> list[str]:
    return [line.removeprefix("note: ") for line in text.splitlines() if line.startswith("note: ")]


@pytest.mark.parametrize("count", [0, 1, 20, 21, 23])
def test_faults_of_a_folder_are_listed_up_to_twenty_and_then_counted(
    count: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    faults = {f"{n:02d}.touch": f"fault {n}" for n in range(count)}
    done = SimpleNamespace(faults=faults, summary=lambda: {"media": 7}, path=tmp_path / "i.npz")
    done.notes = ("a note",)
    monkeypatch.setattr("touchfield.tasks.library.index_folder", lambda *_: done)
    assert _exit_code(["index", str(tmp_path)]) == 0
    notes = notes_of(capsys.readouterr().out)
    rest = [f"{count - 20} more are left out; --json tells them all"] if count > 20 else []
    assert notes == ["a note", *(f"left out: {n:02d}.touch: fault {n}" for n in range(min(count, 20))), *rest]
    assert _exit_code(["index", str(tmp_path), "--json"]) == 0
    values = json.loads(capsys.readouterr().out)
    assert values["faults"] == faults and values["media"] == 7 and values["notes"] == ["a note"]


def test_search_results_are_printed_in_order(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    found = (1, "b.touch", 0.25), (2, "a.touch", 1.5)
    rows = [{"rank": n, "name": name, "distance": d} for n, name, d in found]
    done = Result({"media": 9, "query_ms": 1.25, "matches": rows}, ("1 files changed since",))
    calls: list[Any] = []
    monkeypatch.setattr("touchfield.tasks.library.search", lambda *arguments: calls.append(arguments) or done)
    weighted = ["--any-pose", "--weight", "amplitude=2", "--weight", "direction=0.5"]
    assert _exit_code(["search", str(tmp_path), "x.touch", *weighted]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines == [
        "like x.touch, of 9 media (1.2 ms)", "   1  0.2500  b.touch", "   2  1.5000  a.touch",
        "note: 1 files changed since",
    ]  # fmt: skip
    weights = calls[0][3]
    assert weights["amplitude"] == 2 and weights["direction"] == 0.5 and 0 in weights.values()
    for wrong in ("amplitude", "amplitude=", "amplitude=many"):
        assert _exit_code(["search", str(tmp_path), "x.touch", "--weight", wrong]) == 2
        assert f"--weight: found '{wrong}'; expected PART=NUMBER" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("stream", "expected"),
    [
        ("ws://host/live?token=secret", "lower --rate-hz or a smaller --nw (touchfield live)"),
        ("https://host/a.touch?token=secret", "download the file"),
        ("a room.touch", "touchfield play 'a room.touch' --check tells"),
    ],
)
def test_a_starved_playback_names_causes_and_a_remedy(stream: str, expected: str) -> None:
    note = _starved_note(stream, 0.0695)
    assert note.startswith("6.95 % of the time there was no force") and expected in note
    assert "secret" not in note


def test_doctor_prints_fixes_for_missing_parts_only(monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    checks = [
        Check("this", True, "1.2", "Do nothing."),
        Check("that", False, "none", "Get it"),
        Check("x", False, "-"),
    ]
    monkeypatch.setattr("touchfield.tasks.setup.examine", lambda name, delay: {f"for {name}": checks})
    assert _exit_code(["doctor", "--device", "pins"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "for pins", "  ok       this: 1.2", "  missing  that: none. Get it", "  missing  x: -",
    ]  # fmt: skip
    assert _exit_code(["doctor", "--json"]) == 0
    reported = json.loads(capsys.readouterr().out)["for None"]
    assert reported[1] == {"what": "that", "is_there": False, "found": "none", "mend": "Get it"}


def host_check(text: str) -> Check:
    (match,) = [check for check in host_checks() if text in check.what]
    return match


@pytest.mark.skipif(sys.platform == "win32", reason="this system has no such limits")
def test_host_checks_report_each_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each check just below and just above its limit."""
    import resource
    import shutil

    setup = import_module("touchfield.tasks.setup")
    for cores in (1, 2, 7):
        monkeypatch.setattr(setup, "worker_count", lambda cores=cores: cores)
        assert (host_check("two cores").is_there, host_check("two cores").found) == (cores > 1, str(cores))
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    min_bytes = 1 << 28
    for soft, is_enough, found in (
        (min_bytes - 1, False, "up to 256 MiB"), (min_bytes, True, "up to 256 MiB"),
        (1 << 20, False, "up to 1 MiB"),
        (resource.RLIM_INFINITY, True, "no limit"),
    ):  # fmt: skip
        monkeypatch.setattr(resource, "getrlimit", lambda _, soft=soft: (soft, soft))
        assert (host_check("locked memory").is_there, host_check("locked memory").found) == (is_enough, found)
    if Path("/dev/shm").is_dir():
        for free in (min_bytes - 1, min_bytes, 3 << 30):
            usage = SimpleNamespace(free=free, total=0, used=0)
            monkeypatch.setattr(shutil, "disk_usage", lambda _, usage=usage: usage)
            check = host_check("shared memory")
            assert (check.is_there, check.found) == (free >= min_bytes, f"{free / 2**20:.0f} MiB free")
    for kernels, is_there, found in ((None, False, "not writeable"), (tmp_path, True, str(tmp_path))):
        monkeypatch.setattr(jit, "kernel_folder", lambda kernels=kernels: kernels)
        check = host_check("compiled kernels")
        assert (check.is_there, check.found, "NUMBA_CACHE_DIR" in check.mend) == (is_there, found, True)

    def raise_permission_error(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    if hasattr(os, "sched_setscheduler"):
        policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
        calls: list[Any] = []
        monkeypatch.setattr(os, "sched_setscheduler", lambda *arguments: calls.append(arguments))
        check = host_check("SCHED_FIFO")
        assert (check.is_there, check.found) == (True, "allowed")
        assert [arguments[1] for arguments in calls] == [os.SCHED_FIFO, policy], "and as it was before"
        assert calls[1][2].sched_priority == parameters.sched_priority
        monkeypatch.setattr(os, "sched_setscheduler", raise_permission_error)
        check = host_check("SCHED_FIFO")
        assert (check.is_there, check.found) == (False, "Operation not permitted") and "rtprio" in check.mend
    libraries = {check.what: check for check in library_checks()}
    assert libraries["python"].is_there and libraries["python"].found == sys.version.split()[0]
    needed = [check for name, check in libraries.items() if name.startswith(("numpy", "scipy", "numba"))]
    assert len(needed) == 3 and all(check.is_there for check in needed)


def test_plan_prints_the_values_of_its_json(monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    def touch_spec(**options: Any) -> EncodeSpec:
        return EncodeSpec(nw=4, touch=TouchSpec(effort="fast", **options))

    paper = EncodeSpec(nw=5, coder="paper", paper=PaperSpec(k=0.15, nq=5, directions="ico3"))
    trials = (
        Trial(touch_spec(k=0.25, f0_n=0.125), 1000, 10, 0.01, 20.0, 0.97),
        Trial(paper, 4000, 10, 0.001, 20.0, 0.5),
        Trial(touch_spec(mode="nmse", step_n=0.05), 2000, 10, 0.005, 20.0, 0.9),
        Trial(touch_spec(), 9000, 10, 0.0, 20.0, 1.0),
        Trial(touch_spec(k=0.3, f0_n=0.15), 1500, 10, 0.02, 20.0, 0.2),
    )  # fmt: skip
    plan = Plan(trials, 0.1, 0.05, 70000.0, "scene.stl", 6)
    monkeypatch.setattr("touchfield.tasks.plan.plan", lambda *_: plan)
    arguments = ["plan", "scene.stl", "--budget", "70kbit/s", "--nw", "5", "--unit-m", "0.01"]
    assert _exit_code([*arguments, "--json"]) == 0
    values = json.loads(capsys.readouterr().out)
    assert (values["front"], values["chosen"], values["budget_bits_per_s"]) == ([0, 2, 1, 3], 1, 70000.0)
    assert [row["bits_per_s"] for row in values["trials"]] == [16000, 64000, 32000, 144000, 24000]
    assert [row["bits_per_frame"] for row in values["trials"]] == [800, 3200, 1600, 7200, 1200]
    assert values["trials"][0]["nmse_db"] == pytest.approx(-20) and values["trials"][3]["nmse_db"] is None
    assert (values["k"], values["f0_n"], values["frames_tried"], values["source"]) == (
        0.1,
        0.05,
        6,
        "scene.stl",
    )
    assert _exit_code(arguments) == 0
    printed = capsys.readouterr().out
    title, heading, *lines = printed.splitlines()
    assert title == "scene.stl: 6 frames under 5 settings; the frontier"
    assert heading.split() == ["nw", "coder", "k", "or", "step", "bit/s", "NMSE", "dB", "within", "mask"]
    rows = [line.split() for line in lines if "%" in line and not line.startswith("note")]
    assert rows == [
        ["4", "touch", "mask", "0.25", "16,000", "-20.00", "97.00", "%"],
        ["4", "touch", "nmse", "0.05", "N", "32,000", "-23.01", "90.00", "%"],
        ["->", "5", "paper", "ico3", "0.15", "64,000", "-30.00", "50.00", "%"],
        ["4", "touch", "mask", "0.1", "144,000", "exact", "100.00", "%"],
    ]
    notes = notes_of(printed)
    assert notes[0].startswith(
        "the choice is beyond the bound: only 50 % of the voxels are within the mask; "
    )
    assert notes[0].endswith("keeps it, for 16 kbit/s")
    assert "within max(0.05 N, 0.1 |F|) on the finest lattice" in notes[1]
    assert f"lambda is {values['lambda_bits_per_s']:.4g} bit/s for a unit of NMSE" in notes[2]
    assert notes[3] == (
        "touchfield encode scene.stl OUT.touch --nw 5 --coder paper --k 0.15 --nq 5 --directions ico3 "
        "--representation voxel --unit-m 0.01"
    )
    assert values["encode_options"] == notes[3].partition("OUT.touch ")[2]


def test_amounts_as_text() -> None:
    for cost, unit, text in (
        (999, "bit/s", "999 bit/s"), (1000, "bit/s", "1 kbit/s"), (999999, "bit/s", "1000 kbit/s"),
        (1e6, "bit/s", "1 Mbit/s"), (1234567, "bytes", "1,234,567 bytes"),
    ):  # fmt: skip
        assert amount(cost, unit) == text


@pytest.mark.parametrize("ratio", [0.25, None])
def test_broadcast_into_a_pipe_reports_what_it_sent(
    ratio: float | None, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    sent = Sent(frames=1234, segments=5, sent_bytes=67890, left_out=2, worst_mask_ratio=ratio)
    specs: list[Any] = []

    def fake_broadcast(prepared: object, send: object, spec: LiveSpec, say: Any) -> Sent:
        specs.append(spec)
        say("in time")
        return sent

    opened = SimpleNamespace(coding=TouchSpec(k=0.2, f0_n=0.07)), SimpleNamespace(opening=b"opening")
    monkeypatch.setattr("touchfield.tasks.live.open_sender", lambda *_: opened)
    monkeypatch.setattr("touchfield.tasks.live.broadcast", fake_broadcast)
    assert _exit_code(["live", "scene.stl", "-", "--segment-s", "0.5", "--loop", "--on-air-s", "7"]) == 0
    printed = capsys.readouterr()
    assert printed.out == "\7\0\0\0opening\0\0\0\0", "the opening, and the end"
    notes = notes_of(printed.err)
    assert notes[:2] == [
        "in time",
        "1,234 frames, 5 segments, 67,890 sent_bytes, 2 left_out, 0 coarse_bytes, 0 coarse_left_out",
    ]
    bound = sent.error_bound(opened[0])  # type: ignore[arg-type]
    bound_notes = [f"error bound: {bound['error_bound']}; largest error 0.250 of it"]
    bound_notes += ["error bound: it holds for the frames that were sent; 2 of 1236 frames were left out"]
    unproved = [f"error bound: {bound['error_bound_note']}"]
    assert notes[2:] == (bound_notes if ratio else unproved) and (bound["error_bound"] is None) == (
        ratio is None
    )
    assert specs == [LiveSpec(0.5, True, 7.0)]


def test_picture_is_placed_next_to_its_stream_or_in_the_current_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert _free_name("a.ply", "folder/b.touch") == Path("folder/b.png")
    assert _free_name("a.ply", "https://host/deep/b.touch?token=c") == Path("b.png")
    (tmp_path / "b.png").write_bytes(b"not ours")
    assert _free_name("a.ply", "https://host/deep/b.touch") == Path("b.compare.png")


def test_coding_limits_are_bits_per_supported_voxel_of_all_frames(capsys: Capture, tmp_path: Path) -> None:
    """A medium of two frames, one of which has twice as many forces as the other."""
    forces = np.zeros((2, 8, 8, 8, 3), np.float32)
    forces[0, :4, :, :, 2] = np.random.default_rng(0).integers(1, 4, (4, 8, 8))
    forces[1, :, :, :, 0] = np.random.default_rng(1).integers(1, 4, (8, 8, 8))
    medium = tf.HapticMedium.from_array(forces, tf.Grid((8, 8, 8), (0.001,) * 3, (0.0,) * 3), 30.0)
    tf.write_field(tmp_path / "two.npz", medium)
    assert (
        _exit_code(["measure", str(tmp_path / "two.npz"), "--nw", "4", "--quantiser", "uniform:1", "--json"])
        == 0
    )
    values = json.loads(capsys.readouterr().out)
    assert _exit_code(["measure", str(tmp_path / "two.npz"), "--nw", "4", "--quantiser", "uniform:1"]) == 0
    printed = capsys.readouterr().out
    (row,) = [line.split() for line in printed.splitlines() if "no neighbours" in line]
    voxels = values["frames"] * values["voxels_per_frame"]
    bits = values["entropy_voxel"]["value"] * voxels / values["supported_voxels"]
    assert values["frames"] == 2 and float(row[1]) == pytest.approx(bits, rel=1e-3)
