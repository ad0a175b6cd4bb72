"""Small files with a large grid: the sparse field is read in little memory, the dense one refused."""

from __future__ import annotations

import dataclasses
import resource
import sys
from pathlib import Path

import numpy as np
import pytest

from object_makers import F0_N, head_of, moving_scene
from touchfield import pipeline
from touchfield.codec.objects.encoder import ObjectsEncoder
from touchfield.codec.paper.spec import PaperSpec
from touchfield.codec.registry import field_encoder
from touchfield.codec.touch.spec import TouchSpec
from touchfield.container import TouchWriter
from touchfield.errors import InvalidArgument
from touchfield.medium import ForceField, Grid
from touchfield.pipeline.encoding import write_objects

LARGEST = (4096, 4096, 4096)
THIN = (1, 1 << 20, 1 << 13)


def grid_of(shape: tuple[int, int, int]) -> Grid:
    return Grid(shape, (0.0001, 0.0001, 0.0001), (0.0, 0.0, 0.0))


def peak_bytes() -> int:
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


def written(path: Path, grid: Grid, spec: PaperSpec | TouchSpec, fields: list[ForceField]) -> Path:
    """A file of one segment; the head is that of a scene on the grid."""
    scene = dataclasses.replace(moving_scene(len(fields)), grid=grid)
    encoder = field_encoder(grid, spec)
    with TouchWriter(path) as writer:
        head = head_of(scene, ObjectsEncoder(scene, PaperSpec(), F0_N))
        writer.write_head(dataclasses.replace(head, coder=encoder.name, coder_parameters=encoder.parameters))
        writer.write_segment(0, len(fields), encoder.encode_segment(fields).body)
    return path


@pytest.mark.parametrize("spec", [PaperSpec(), TouchSpec()], ids=["paper", "touch"])
@pytest.mark.parametrize("shape", [LARGEST, THIN], ids=["cube", "thin"])
def test_fields(tmp_path: Path, shape: tuple[int, int, int], spec: PaperSpec | TouchSpec) -> None:
    grid = grid_of(shape)
    forces = np.zeros((1, 8, 8, 8, 3), np.float32)
    forces[0, 0, 4:, :, 2] = 1.0
    field = ForceField.from_bricks(grid, np.array([[0, 511, 511]]), forces)
    path = written(tmp_path / "a.touch", grid, spec, [field, ForceField.empty(grid)])
    before = peak_bytes()
    with pipeline.open_file(path) as opened:
        medium = opened.medium
        np.testing.assert_array_equal(medium[0].bricks, field.bricks)
        assert len(medium[1].bricks) == 0 and opened.summary()["frames"] == 2
    assert peak_bytes() - before < 1 << 30


def test_objects(tmp_path: Path) -> None:
    scene = dataclasses.replace(moving_scene(3), grid=grid_of(THIN))
    encoder = ObjectsEncoder(scene, PaperSpec(), F0_N)
    with TouchWriter(tmp_path / "a.touch") as writer:
        writer.write_head(head_of(scene, encoder))
        write_objects(writer, encoder, len(scene))
    before = peak_bytes()
    with pipeline.open_file(tmp_path / "a.touch") as opened:
        field = opened.medium[1]
        assert len(field.bricks) and (field.bricks[:, 0] == 0).all()
    assert peak_bytes() - before < 1 << 30


@pytest.mark.parametrize("ending", [".npz", ".vti"])
def test_a_dense_frame_beyond_memory_is_refused(
    tmp_path: Path, ending: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TOUCHFIELD_MEMORY_GIB", "1")
    grid = grid_of(LARGEST)
    path = written(tmp_path / "a.touch", grid, TouchSpec(), [ForceField.empty(grid)])
    with (
        pipeline.open_file(path) as opened,
        pytest.raises(InvalidArgument, match=r"768\.0 GiB of each dense frame"),
    ):
        pipeline.write_field(tmp_path / f"b{ending}", opened.medium)
    assert [p.name for p in tmp_path.iterdir()] == ["a.touch"]


def test_a_larger_grid_is_not_written(tmp_path: Path) -> None:
    grid = grid_of((4097, 4096, 4096))
    with pytest.raises(
        InvalidArgument, match=r"HEAD\.grid_shape: found \(4097, 4096, 4096\); expected .* bricks"
    ):
        written(tmp_path / "a.touch", grid, TouchSpec(), [ForceField.empty(grid)])
