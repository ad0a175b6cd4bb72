"""A distribution adds a source, a coder, a driver and a filter by entry points; commands list and
use them.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from importlib.metadata import EntryPoints
from pathlib import Path

import numpy as np
import pytest

from child_environment import environment_with
from touchfield import plugins

PLUGIN = Path(__file__).parent / "plugin"
Command = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the package of `tests/plugin`, as installed by pip."""
    folder = tmp_path_factory.mktemp("site")
    options = ("--quiet", "--disable-pip-version-check", "--no-deps", "--no-build-isolation", "--target")
    subprocess.run([sys.executable, "-m", "pip", "install", *options, folder, PLUGIN], check=True)
    return folder


@pytest.fixture
def touchfield(installed: Path, tmp_path: Path) -> Command:
    """Runs a command in an empty folder with the plug-in installed."""
    environment = environment_with(installed)

    def run(*arguments: str, status: int = 0) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "touchfield", *arguments]
        done = subprocess.run(
            command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == status, done.stderr
        return done

    return run


def test_commands_list_the_parts_of_a_plugin(touchfield: Command) -> None:
    assert json.loads(touchfield("sources", "--json").stdout)["ball"].startswith("A ball")
    devices = json.loads(touchfield("devices", "--json").stdout)
    assert (
        devices["drivers"]["still"] == "a hand that does not move" and "phantom-omni" in devices["profiles"]
    )
    doctor = json.loads(touchfield("doctor", "--device", "still", "--json").stdout)
    assert any("built in" in check["found"] for checks in doctor.values() for check in checks)
    text = touchfield("encode", "--help").stdout
    assert "--scale" in text and "raw" in text
    assert "--halve" in touchfield("filter", "--help").stdout


def test_a_stream_by_its_source_filter_and_coder_plays_on_its_device(
    touchfield: Command, tmp_path: Path
) -> None:
    (tmp_path / "b.ball").write_text("0.02")
    options = ("--nw", "4", "--representation", "voxel", "--json")
    touchfield("encode", "b.ball", "full.touch", "--coder", "raw", *options)
    touchfield("filter", "full.touch", "less.touch", "--halve", "0.25", "--coder", "raw", "--scale", "2")
    info = json.loads(touchfield("info", "less.touch", "--json").stdout)
    assert (info["coder"], info["scale"]) == ("raw", 2.0)
    for name in ("full", "less"):
        touchfield("decode", f"{name}.touch", f"{name}.npz")
    full, less = (np.load(tmp_path / f"{name}.npz")["forces_n"] for name in ("full", "less"))
    assert np.abs(full).max() > 1
    np.testing.assert_allclose(less, full / 4, atol=1e-5)
    played = json.loads(
        touchfield("play", "full.touch", "--device", "still", "--seconds", "0.2", "--json").stdout
    )
    assert played["ticks"] > 0


def test_error_of_a_stream_without_its_plugin_names_the_coder(touchfield: Command, tmp_path: Path) -> None:
    (tmp_path / "b.ball").write_text("0.02")
    touchfield("encode", "b.ball", "b.touch", "--coder", "raw", "--nw", "3", "--representation", "voxel")
    done = subprocess.run(
        [sys.executable, "-m", "touchfield", "info", "b.touch"], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode != 0 and "'raw'" in done.stderr and "plug-in" in done.stderr


def test_a_failing_plugin_is_skipped_with_a_warning(tmp_path: Path) -> None:
    """Both a plug-in that cannot be imported and one of a wrong type."""
    metadata = tmp_path / "broken-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: broken\nVersion: 1.0\n")
    entries = "[touchfield.sources]\ngone = no_such_module:KIND\nother = json:dumps\n"
    (metadata / "entry_points.txt").write_text(entries)
    code = "from touchfield.sources.registry import kinds; print(*(kind.name for kind in kinds()))"
    environment = environment_with(tmp_path)
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
    )
    assert "tum" in done.stdout.split() and not {"gone", "other"} & {*done.stdout.split()}
    assert "'gone'" in done.stderr and "no_such_module" in done.stderr
    assert "'other'" in done.stderr and "is no SourceKind" in done.stderr


def test_installed_distributions_are_scanned_once_for_all_groups(monkeypatch: pytest.MonkeyPatch) -> None:
    scans: list[object] = []
    monkeypatch.setattr(plugins, "entry_points", lambda **group: scans.append(group) or EntryPoints())
    plugins.installed_entry_points.cache_clear()
    try:
        found = [plugins.plugins.__wrapped__(group, object) for group in plugins.GROUPS]
        assert found == [{}] * len(plugins.GROUPS)
    finally:
        plugins.installed_entry_points.cache_clear()
    assert len(scans) == 1
