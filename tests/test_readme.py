"""The Python code of the README runs, and its commands exist."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

import touchfield
from touchfield.cli.main import _exit_code

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text()
MOVING = (ROOT / "docs" / "moving-scenes.md").read_text()
DEVICES = (ROOT / "docs" / "devices.md").read_text()
NEW_DEVICE = (ROOT / "docs" / "how-to" / "new-device.md").read_text()


def test_the_five_lines_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (code,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    exec(compile(code, "README.md", "exec"), {})
    output = capsys.readouterr().out
    assert "newtons" in output and "dB" in output
    assert (tmp_path / "shapes.touch").exists()


def test_the_page_on_scenes_that_move_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("mujoco", reason="sample:falling-7 is simulated by MuJoCo: the extra physics")
    monkeypatch.chdir(tmp_path)
    (table,) = re.findall(r"```toml\n(.*?)```", MOVING, re.DOTALL)
    (tmp_path / "falling.toml").write_text(table)
    scene = touchfield.open_source(tmp_path / "falling.toml")
    assert scene.frame_count == 2000 and [b.name for b in scene.bodies()] == ["brick", "ball", "floor"]
    (code,) = re.findall(r"```python\n(.*?)```", MOVING, re.DOTALL)
    line = 'tf.encode("sample:falling-7", "falling.touch"'
    assert f"{line})\n" in code
    shorter = code.replace(
        line, f"{line}, tf.EncodeSpec(frames=(0, 501))"
    )  # of 2000; the page uses frame 500
    exec(compile(shorter, "moving-scenes.md", "exec"), {})
    output = capsys.readouterr().out
    assert "newtons" in output and "[0. 0. 0.]" not in output


def test_the_device_in_one_file_plays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("matplotlib", reason="sample:terrain comes with matplotlib")
    monkeypatch.chdir(tmp_path)
    device, *_, played = re.findall(r"```python\n(.*?)```", NEW_DEVICE, re.DOTALL)
    names: dict[str, Any] = {}
    exec(compile(device, "devices.md", "exec"), names)
    exec(compile(played, "devices.md", "exec"), names)
    assert "newtons of" in capsys.readouterr().out
    assert names["KIND"].make("", None) is names["Ring"]


def test_the_commands_exist(capsys: pytest.CaptureFixture[str]) -> None:
    pages = README + "".join(page.read_text() for page in sorted((ROOT / "docs").glob("**/*.md")))
    blocks = re.findall(r"^```sh\n(.*?)^```", pages, re.DOTALL | re.MULTILINE)
    commands = set(re.findall(r"^touchfield (\w+)", "".join(blocks), re.MULTILINE))
    assert len(commands) > 10 and {"encode", "compare", "play"} <= commands
    for command in commands:
        assert _exit_code([command, "--help"]) == 0
        assert capsys.readouterr().out


def test_links_lead_somewhere() -> None:
    for text, folder in ((README, ROOT), (DEVICES, ROOT / "docs")):
        targets = re.findall(r"\]\(([^)#]+)\)", text)
        assert targets
        for target in targets:
            assert (folder / target).exists(), target


def test_everything_public_is_documented() -> None:
    for name in touchfield.__all__:
        if name != "__version__":
            assert (getattr(touchfield, name).__doc__ or "").strip(), name
    assert sorted(touchfield.__all__) == touchfield.__all__


def test_the_map_of_the_paper_names_existing_files() -> None:
    root = Path(__file__).resolve().parents[1]
    named = set(re.findall(r"`([\w/]+(?:\.py|/))`", (root / "docs" / "paper-map.md").read_text()))
    assert len(named) > 20
    for name in named - {"src/touchfield/"}:
        base = root if name.startswith(("tests/", "bench/", "reproduction/")) else root / "src" / "touchfield"
        assert (base / name).exists(), name
