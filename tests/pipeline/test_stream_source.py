"""A stream as a source: decoded, encoded, compared and written again."""

from __future__ import annotations

from pathlib import Path

import pytest

from touchfield import pipeline, tasks
from touchfield.errors import FormatError
from touchfield.pipeline.source import StreamScene
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.tiny_scenes import tiny_scenes


@pytest.fixture(scope="module")
def stream(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("streams") / "ramp.touch"
    pipeline.encode(tiny_scenes()[0], path, EncodeSpec(nw=5))
    return path


def test_a_stream_keeps_its_lattice_regardless_of_options(stream: Path, tmp_path: Path) -> None:
    prepared = pipeline.prepare(stream, EncodeSpec(nw=7, device="tshirt-32x32"))
    with pipeline.open_file(stream) as opened:
        assert prepared.medium.grid == opened.grid and prepared.device.name == "phantom-omni"
        assert list(prepared.medium) == list(opened.medium)
    assert any("keeps its own" in note for note in prepared.notes)


def test_a_stream_of_a_stream_compares_with_it(stream: Path, tmp_path: Path) -> None:
    again = tmp_path / "again.touch"
    done = pipeline.encode(stream, again, EncodeSpec(frames=(1, 2)))
    assert done.summary()["frames"] == 1
    values = pipeline.compare(stream, again).summary()
    assert values["mask_violations"] == 0


def test_the_file_is_closed_with_its_scene(stream: Path) -> None:
    scene = StreamScene(stream)
    frame, file = scene.stored[0], scene.stored.make_frame._reader._source._file
    assert frame.support_count and not file.closed
    del scene
    assert file.closed


def test_a_stream_of_a_custom_device_needs_no_profile(tmp_path: Path) -> None:
    from touchfield.devices import profile

    path = tmp_path / "home-made.toml"
    shipped = Path(profile.__file__).parent / "profiles" / "phantom-omni.toml"
    path.write_text(shipped.read_text())
    stream = tmp_path / "own.touch"
    pipeline.encode(tiny_scenes()[0], stream, EncodeSpec(nw=4, device=str(path)))
    prepared = pipeline.prepare(stream)
    with pipeline.open_file(stream) as opened:
        assert prepared.device.name == opened.reader.head.device_name
        assert prepared.device.force_max_n == opened.reader.head.force_max_n == pytest.approx(3.3)
    assert tasks.measure.measure_medium(stream).voxel.value > 0


def test_a_broken_stream_is_a_format_error(stream: Path, tmp_path: Path) -> None:
    broken = tmp_path / "broken.touch"
    broken.write_bytes(stream.read_bytes()[:100])
    with pytest.raises(FormatError):
        pipeline.prepare(broken)
