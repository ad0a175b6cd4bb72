"""Which device a stream is played for."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

from touchfield.devices import device
from touchfield.job.play import stream_device


def test_a_stream_names_a_profile_and_never_a_file(tmp_path: Path) -> None:
    told = replace(device("phantom-omni"), title="as the stream tells", force_max_n=2.0)
    assert stream_device(SimpleNamespace(told_device=told)) == device("phantom-omni")
    path = tmp_path / "profile.toml"
    path.write_text("no profile")
    for name in (str(path), "mine", ""):
        named = replace(told, name=name)
        assert stream_device(SimpleNamespace(told_device=named)) is named
    array = replace(told, type=2)
    assert stream_device(SimpleNamespace(told_device=array)) is array
