"""The demo with a minimal installation."""

from __future__ import annotations

import importlib.util
import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from touchfield.cli import demo
from touchfield.cli.main import _exit_code

HIDDEN = ("matplotlib", "skimage", "mujoco")


def test_demo_runs_with_the_core_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def find_spec(name: str) -> Any:
        return None if name in HIDDEN else importlib.util.find_spec(name)

    for name in [*sys.modules, *HIDDEN]:
        if name.partition(".")[0] in HIDDEN:
            monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.setattr(demo, "find_spec", find_spec)
    monkeypatch.setattr(demo, "has_braille", lambda: False)
    source, spec = demo.SCENES["shapes"]
    monkeypatch.setitem(demo.SCENES, "shapes", (source, replace(spec, nw=6)))
    assert _exit_code(["demo", str(tmp_path / "out")]) == 0
    out = capsys.readouterr().out
    assert "left out: the motorcycle scene" in out and "left out: the bundled elevation model" in out
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "shapes.forces.csv", "shapes.html", "shapes.json", "shapes.touch",
        "map.html", "map.json", "map.svg", "map.touch",
    }  # fmt: skip
    values = json.loads((tmp_path / "out" / "shapes.json").read_text())
    assert values["mask_violations"] == 0 and values["worst_mask_ratio"] <= 1
    assert ".png" not in out and "no Braille" in out
