"""Metadata of a medium survive each task: rate, axes, tags, friction, damping, history.

All values differ from their defaults, on a lattice with unequal axes, in several segments with a shorter last
one.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import touchfield as tf
from object_makers import head_of, moving_scene
from touchfield.codec.objects.encoder import ObjectsEncoder
from touchfield.codec.touch.spec import TouchSpec
from touchfield.container import TouchReader, TouchWriter
from touchfield.errors import InvalidArgument
from touchfield.medium import Grid, HapticMedium
from touchfield.medium.selection import select_frames
from touchfield.network.live import LiveReceiver, Opened
from touchfield.pipeline import encode, prepare
from touchfield.pipeline.encoding import write_objects
from touchfield.pipeline.spec import EncodeSpec
from touchfield.render.material import KEY, Material, stored_materials
from touchfield.sources.recordings.recording import Recording
from touchfield.tasks.editing import edit, levels_of_detail, resample_file, splice
from touchfield.tasks.live import coarse_layer, open_sender
from touchfield.tasks.reduction import fewest_points, reduce_medium
from touchfield.tasks.texture import merge_materials, store_materials, texture_of

GRID = Grid((24, 16, 8), (0.002, 0.003, 0.004), (-0.023, -0.0225, -0.014))
EXACT = EncodeSpec(touch=TouchSpec(mode="lossless", segment_frames=3))
COUNT = 7
METADATA: dict[str, Any] = {
    "rate_hz": 12.5, "axes": "x right, y down, z forward", "friction": 0.3, "damping_n_s_per_m": 0.4,
    "tags": ("symbolic", "mine"),
}  # fmt: skip


def medium() -> HapticMedium:
    """A block of noise that rises a little; forces far below what a device clips."""
    frames = np.zeros((COUNT, *GRID.shape, 3), np.float32)
    noise = np.random.default_rng(1).uniform(0.2, 1, (20, 12, 8, 3))
    for n in range(COUNT):
        frames[n, 2:22, 2:14, : 2 + n // 2] = (1 + 0.1 * n) * noise[:, :, : 2 + n // 2]
    created = HapticMedium.from_array(frames, GRID, METADATA["rate_hz"], METADATA["axes"])
    return replace(created, **METADATA)


@pytest.fixture(scope="module")
def stream(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("companions") / "own.touch"
    encode(medium(), path, EXACT)
    return path


def assert_metadata(path: Path, **changed: Any) -> None:
    """The head of the file and its medium have all metadata, except for the changed ones."""
    with TouchReader(path) as reader:
        head = reader.head
    decoded = tf.decode(path)
    for name, value in {**METADATA, **changed}.items():
        assert getattr(head, name) == getattr(decoded, name) == value, name
    assert (head.device_name, head.device_type, head.force_max_n) == ("phantom-omni", 1, 3.3)


def test_a_file_of_a_medium_and_of_a_file(stream: Path, tmp_path: Path) -> None:
    assert_metadata(stream)
    out = tmp_path / "again.touch"
    for spec, changed in (
        (EXACT, {}), (replace(EXACT, friction=0.0), {"friction": 0.0}), (replace(EXACT, frames=(2, 6)), {}),
        (replace(EXACT, damping_n_s_per_m=0.0, friction=0.7), {"damping_n_s_per_m": 0.0, "friction": 0.7}),
        (replace(EXACT, filters=(("gaussian", "2mm"),)), {}),
        (replace(EXACT, vibration="gain=0.1,frequency=99"), {}),
    ):  # fmt: skip
        encode(stream, out, spec)
        assert_metadata(out, **changed)
    assert list(tf.decode(out)) == list(medium()), "a vibration beside changes no force"
    encode(stream, out, replace(EXACT, frames=(2, 6)))
    assert list(tf.decode(out)) == [medium()[n] for n in range(2, 6)]
    assert list(tf.decode(stream)) == list(medium())


def test_a_stored_field_keeps_its_time_and_position(stream: Path, tmp_path: Path) -> None:
    path = tf.pipeline.decoding.write_field(tmp_path / "field.npz", tf.decode(stream))
    stored = prepare(path, replace(EXACT, device="omega.3")).medium
    assert stored.rate_hz == METADATA["rate_hz"] and stored.axes == METADATA["axes"] and len(stored) == COUNT
    assert stored.grid == GRID and list(stored) == list(medium())


def test_tasks_on_a_file(stream: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.touch"
    edit(stream, out, operators=["gain:0.5"], spec=EXACT)
    assert_metadata(out)
    assert tf.decode(out)[COUNT - 1] == medium()[COUNT - 1].scaled(0.5)
    splice([f"{stream}@:2", f"{stream}@4:"], out, spec=EXACT)
    assert_metadata(out)
    assert [tf.decode(out)[n] for n in range(5)] == [medium()[n] for n in (0, 1, 4, 5, 6)]
    resample_file(stream, out, (None, (12, 8, 4), None), 25.0, spec=EXACT)
    assert_metadata(out, rate_hz=25.0)
    levels_of_detail(stream, tmp_path / "levels", levels=1, spec=EXACT)
    for level in (0, 1):
        assert_metadata(tmp_path / "levels" / f"level-{level}.touch")
    reduce_medium(stream, out, tmp_path / "culled.touch", coder=EXACT)
    assert_metadata(out)
    assert_metadata(tmp_path / "culled.touch")
    fewest_points(stream, 9, out, spec=EXACT)
    assert_metadata(out)


def test_selected_frames_keep_their_order(stream: Path) -> None:
    some = select_frames(tf.decode(stream), [6, 0, 3])
    assert len(some) == 3 and list(some) == [medium()[n] for n in (6, 0, 3)]
    assert {name: getattr(some, name) for name in METADATA} == METADATA


def test_a_live_stream_opens_with_all_metadata(stream: Path) -> None:
    prepared, sender = open_sender(stream, EncodeSpec(touch=TouchSpec(k=0.3, f0_n=0.07)))
    coarse, under = coarse_layer(stream, prepared)
    for opening, grid, k, f0_n in (
        (sender.opening, GRID, 0.3, 0.07), (under.opening, coarse.medium.grid, 0.5, 0.14),
    ):  # fmt: skip
        (opened,) = LiveReceiver().receive(opening)
        assert isinstance(opened, Opened)
        assert {name: getattr(opened.head, name) for name in METADATA} == METADATA
        assert (opened.head.grid_shape, opened.head.spacing_m, opened.head.origin_m) == (
            grid.shape, pytest.approx(grid.spacing_m), pytest.approx(grid.origin_m),
        )  # fmt: skip
        assert (opened.head.weber_fraction, opened.head.force_threshold_n) == (k, f0_n)
        assert opened.provenance["source"] == "own.touch"


# -- materials put into a file ------------------------------------------------------------------------------


def records_of(path: Path) -> dict[str, Any]:
    with TouchReader(path) as reader:
        return {
            "head": reader.head,
            "objects": [reader.read_object(n) for n in range(reader.object_count)],
            "segments": [(entry.first_frame, entry.frame_count) for entry in reader.segments],
            "bodies": [reader.read_segment(n) for n in range(len(reader.segments))],
            "vibrations": [reader.read_vibration(n) for n in range(len(reader.segments))],
            "provenance": dict(reader.provenance),
        }


@pytest.mark.parametrize("kind", ["voxels", "bodies"])
def test_materials_change_nothing_else_in_a_file(kind: str, tmp_path: Path) -> None:
    before, after = tmp_path / "a.touch", tmp_path / "b.touch"
    if kind == "voxels":
        encode(medium(), before, replace(EXACT, vibration="gain=0.25,frequency=80..240"))
    else:
        scene = moving_scene(7)
        coder = ObjectsEncoder(scene, TouchSpec(effort="fast", segment_frames=3), 0.05)
        with TouchWriter(before) as writer:
            writer.write_head(head_of(scene, coder), {"source": "bodies"})
            write_objects(writer, coder, 7)
    table = (Material("oak", 0.3), Material("ice", 0.05))
    store_materials(before, table, after)
    old, new = records_of(before), records_of(after)
    assert len(old["segments"]) > 1 and (kind == "bodies") == bool(old["objects"])
    assert (kind == "voxels") == all(old["vibrations"])
    text = new["provenance"].pop(KEY)
    assert new == old and stored_materials({KEY: text}) == table
    store_materials(after, table[1:], before)
    assert stored_materials(records_of(before)["provenance"]) == table[1:], "the later table takes the place"


def test_the_last_of_several_materials_of_one_name_is_used() -> None:
    oak, ice, other = Material("oak", 0.3), Material("ice", 0.05), Material("oak", 0.9)
    assert merge_materials((oak, ice), (other,)) == (other, ice) and merge_materials(
        (other,), (ice, oak)
    ) == (oak, ice)


def test_each_recording_is_stored_at_its_speed_and_force() -> None:
    """Amplitudes grow with speed, and by another factor with force; recordings are in any order."""
    rng, rate_hz = np.random.default_rng(2), 2000.0
    noise = rng.normal(0, 1, (4000, 3))
    speeds_and_forces = [(0.2, 1.0), (0.1, 3.0), (0.1, 1.0), (0.2, 3.0), (0.05, 3.0), (0.05, 1.0)]
    recordings = [Recording(rate_hz, 100 * speed * force**2 * noise) for speed, force in speeds_and_forces]
    material = texture_of(recordings, *zip(*speeds_and_forces, strict=True), "oak", 0.4)  # type: ignore[arg-type]
    assert (material.name, material.friction) == ("oak", 0.4)
    assert (material.speeds_m_s, material.forces_n) == ((0.05, 0.1, 0.2), (1.0, 3.0))
    levels = material.levels_n
    for i, speed in enumerate(material.speeds_m_s):
        for j, force in enumerate(material.forces_n):
            np.testing.assert_allclose(levels[i, j], levels[0, 0] * (speed / 0.05) * force**2, rtol=1e-9)
    for wrong in (speeds_and_forces[:5], [*speeds_and_forces[:5], speeds_and_forces[0]]):
        with pytest.raises(InvalidArgument, match="recordings: found"):
            texture_of(recordings[: len(wrong)], *zip(*wrong, strict=True))  # type: ignore[arg-type]
    with pytest.raises(InvalidArgument, match="6 recordings, 1 speeds and 6 forces"):
        texture_of(recordings, [0.1], [1.0] * 6)
