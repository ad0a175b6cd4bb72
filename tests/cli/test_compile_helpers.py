"""Helper processes that compile in advance: started on demand, ended with the command, and optional."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from numba import njit

from touchfield.cli import compile_ahead
from touchfield.cli.output import announce_compilation

Started = list["subprocess.Popen[bytes]"]


@pytest.fixture
def started_helpers(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Started:
    """The helper processes that are started, on a machine of three cores with an empty cache."""
    found: Started = []

    class RecordingPopen(subprocess.Popen[bytes]):
        def __init__(self, *arguments: object, **options: object) -> None:
            super().__init__(*arguments, **options)  # type: ignore[call-overload]
            found.append(self)

    monkeypatch.setattr(compile_ahead.subprocess, "Popen", RecordingPopen)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setenv("TOUCHFIELD_THREADS", "3")
    monkeypatch.delenv("TOUCHFIELD_HELPERS")
    return found


def compiled_measures(cache: Path) -> list[Path]:
    """Cache files of the kernel that the group `measures` compiles last."""
    return list(cache.rglob("points.field_at_points*.nbc"))


def test_helpers_start_with_the_first_compilation_and_end_with_the_command(
    started_helpers: Started, tmp_path: Path
) -> None:
    kernel = njit(lambda x: x + 1)
    with announce_compilation(lambda line: None, ("measures", "filters", "other")):
        assert not started_helpers
        assert kernel(2) == 3
        assert [helper.args[-2:] for helper in started_helpers] == [
            ["measures", "other"],
            ["touchfield.cli.compile_ahead", "filters"],
        ]
        assert all(helper.poll() is None for helper in started_helpers)
    assert all(helper.returncode is not None for helper in started_helpers)
    assert not compiled_measures(tmp_path)
    with announce_compilation(lambda line: None, ("measures",)):
        assert kernel(2) == 3
    assert len(started_helpers) == 2


@pytest.mark.parametrize(("name", "value"), [("TOUCHFIELD_HELPERS", "0"), ("TOUCHFIELD_THREADS", "1")])
def test_no_helper_if_disabled_or_on_a_single_core(
    started_helpers: Started, monkeypatch: pytest.MonkeyPatch, name: str, value: str
) -> None:
    monkeypatch.setenv(name, value)
    with compile_ahead.helpers(["measures"]) as start:
        start()
    assert not started_helpers


def test_broken_helper_is_ignored(
    started_helpers: Started, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    with compile_ahead.helpers(["no such group"]) as start:
        start()
        assert started_helpers[0].wait(60) == 1
    monkeypatch.setattr(sys, "executable", str(tmp_path / "nobody"))
    with compile_ahead.helpers(["measures"]) as start:
        start()
    assert len(started_helpers) == 1


@pytest.mark.skipif(
    not Path("/proc/self/stat").exists(), reason="what has become of a process is read from /proc"
)
def test_helper_ends_when_its_parent_is_killed(tmp_path: Path) -> None:
    code = """if True:
        import subprocess, time
        from touchfield.cli import compile_ahead

        class Told(subprocess.Popen):
            def __init__(self, *arguments, **options):
                super().__init__(*arguments, **options)
                print(self.pid, flush=True)

        compile_ahead.subprocess.Popen = Told
        with compile_ahead.helpers(["measures"]) as start:
            start()
            time.sleep(600)
    """
    environment = {
        **os.environ,
        "NUMBA_CACHE_DIR": str(tmp_path),
        "TOUCHFIELD_THREADS": "2",
        "TOUCHFIELD_HELPERS": "1",
    }
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, env=environment) as parent:
        assert parent.stdout is not None
        helper = Path("/proc") / parent.stdout.readline().decode().strip() / "stat"
        while not list(tmp_path.rglob("*.nbc")):  # it is at work
            assert helper.exists()
            time.sleep(0.05)
        parent.send_signal(signal.SIGKILL)
    while helper.exists() and ") Z " not in helper.read_text():
        time.sleep(0.05)
    assert not compiled_measures(tmp_path)
