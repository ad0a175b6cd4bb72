"""The device of a stream, and the walls stated by its file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import touchfield as tf
from touchfield.devices import device
from touchfield.pipeline.stream import stream_device
from touchfield.render.block import FLAGS
from touchfield.render.feeder import FrameSource
from touchfield.render.spec import stated_n_per_m
from touchfield.tasks.editing import edit
from touchfield.tasks.play import _before_end

GRID = tf.Grid((24, 24, 24), (0.002,) * 3, (-0.023,) * 3)
PLATE = """
[[shape]]
kind = "box"
center_m = [0, 0, 0]
half_extents_m = [0.05, 0.04, 0.001]
"""


def test_a_stream_names_a_profile_and_never_a_file(tmp_path: Path) -> None:
    declared = replace(device("phantom-omni"), title="as the stream tells", force_max_n=2.0)
    assert stream_device(SimpleNamespace(declared_device=declared)) == device("phantom-omni")
    path = tmp_path / "profile.toml"
    path.write_text("no profile")
    for name in (str(path), "mine", ""):
        named = replace(declared, name=name)
        assert stream_device(SimpleNamespace(declared_device=named)) is named
    array = replace(declared, type=2)
    assert stream_device(SimpleNamespace(declared_device=array)) is array


def test_stalls_after_the_end_of_a_live_stream_are_not_counted() -> None:
    rows = np.zeros(10, [("flags", np.int64)])
    rows["flags"][:6], rows["flags"][2] = FLAGS["running"], FLAGS["stalled"]
    rows["flags"][6:] = FLAGS["stalled"]
    statistics = _before_end({"stalled_ticks": 5, "stalled_share": 0.5, "ticks": 10}, rows)
    assert statistics == {"stalled_ticks": 1, "stalled_share": 1 / 6, "ticks": 10}


@pytest.mark.parametrize("stiffness", [150.0, 1500.0])
def test_a_file_of_custom_forces_has_the_stiffness_of_its_walls(stiffness: float, tmp_path: Path) -> None:
    forces = np.zeros((*GRID.shape, 3))
    forces[..., 2] = np.maximum(-stiffness * GRID.axis_m(2), 0.0)
    medium = tf.HapticMedium.from_array(forces, GRID)
    out = tmp_path / "own.touch"
    for source in (medium, medium.filtered("gaussian:1mm")):
        tf.encode(source, out, tf.EncodeSpec(touch=tf.codec.TouchSpec(k=0.02, f0_n=0.01)))
        wall = FrameSource(tf.decode(out)).wall()
        assert wall is not None and wall.stiffness_n_per_m == pytest.approx(stiffness, rel=0.05)
    tf.pipeline.write_field(tmp_path / "own.npz", medium)
    tf.encode(tmp_path / "own.npz", out, tf.EncodeSpec(nw=5, mapping="crop"))
    assert stated_n_per_m(tf.decode(out).provenance) is None


def test_reencoding_preserves_stated_walls_and_editing_remeasures_them(
    tmp_path: Path,
) -> None:
    plate, again, edited = tmp_path / "plate.toml", tmp_path / "again.touch", tmp_path / "edited.touch"
    plate.write_text(PLATE)
    first = tmp_path / "first.touch"
    tf.encode(plate, first, tf.EncodeSpec(nw=5, mapping="crop", stiffness_n_per_m=800.0))
    tf.encode(first, again)
    edit(first, edited, operators=["gain:0.2"])
    stated = [stated_n_per_m(tf.decode(path).provenance) for path in (first, again, edited)]
    assert stated == [800.0, 800.0, None]
