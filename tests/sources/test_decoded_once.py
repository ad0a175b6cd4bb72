"""What opening a source costs: a picture is decoded once, and modules of other kinds are not imported."""

from __future__ import annotations

import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

import layout_makers as layouts
import scene_makers as scenes
from touchfield.pipeline import encode
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources import camera
from touchfield.sources.images.pictures import PictureFrames


@pytest.mark.parametrize("is_small", [True, False])
def test_each_depth_picture_is_decoded_once_if_memory_allows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_small: bool
) -> None:
    decoded: Counter[int] = Counter()
    values = PictureFrames.values

    def counted(frames: PictureFrames, frame: int) -> object:
        decoded[frame] += 1
        return values(frames, frame)

    monkeypatch.setattr(PictureFrames, "values", counted)
    monkeypatch.setattr(camera, "_STORED_BYTES", 1 << 20 if is_small else 2 * 96 * 72)
    folder = layouts.write_tum(tmp_path / "tum")
    encode(str(folder), tmp_path / "a.touch", EncodeSpec(nw=4))
    assert set(decoded) == {0, 1, 2, 3}
    assert (max(decoded.values()) == 1) == is_small
    assert min(decoded.values()) == 1  # the one that fits stays


def test_a_mesh_imports_no_module_of_depth_and_terrain(tmp_path: Path) -> None:
    program = (
        "import sys; from touchfield.sources.registry import open_source; open_source(sys.argv[1]); "
        "print([name for name in sys.modules if name.startswith('touchfield.sources.terrain')])"
    )
    path = scenes.write_obj(tmp_path / "mesh")
    done = subprocess.run(
        [sys.executable, "-c", program, str(path)], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"
