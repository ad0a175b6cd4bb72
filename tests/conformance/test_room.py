"""`touch_room` never asks for too little memory, nor for much more than files with a full lattice take."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from second import GOLDEN, make_golden
from test_c import COMPILER, C, built, is_paper, run_with

from touchfield.codec.registry import field_encoder
from touchfield.codec.touch.spec import TouchSpec
from touchfield.container import TouchWriter
from touchfield.medium import ForceField, Grid

GRID = Grid((96, 96, 96), (0.001,) * 3, (0.0,) * 3)
FIXED_BYTES = 7 << 20  # what is asked for models and tables, at most

pytestmark = pytest.mark.skipif(COMPILER is None, reason="there is no C compiler here")


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Prints what each file is asked for and takes."""
    return built(
        tmp_path_factory.mktemp("room"), "room", "-O2", f"-I{C}", source=Path(__file__).parent / "room.c"
    )


def room(program: Path, *paths: Path) -> list[tuple[int, ...]]:
    """Bytes asked for the decoder and for a frame, and bytes taken by both, of each file."""
    code, output = run_with(program, *paths)
    assert code == 0, output
    return [tuple(map(int, line.split())) for line in output.splitlines()]


def full() -> ForceField:
    """A force at every sample."""
    return ForceField.from_dense(GRID, np.broadcast_to(np.float32([0, 0, 1]), (*GRID.shape, 3)))


def ball() -> ForceField:
    """A ball, of which a spline is the base layer."""
    points = np.moveaxis(np.indices(GRID.shape), 0, -1) - 47.5
    far = np.linalg.norm(points, axis=-1, keepdims=True)
    return ForceField.from_dense(GRID, (points / far * np.maximum(0, 1 - far / 70)).astype(np.float32))


@pytest.mark.parametrize(
    ("frame", "spec"),
    [
        (full, TouchSpec(guess="off")),
        (full, TouchSpec(mode="lossless")),
        (ball, TouchSpec(mode="nmse", step_n=0.2)),
    ],
    ids=["lossy", "lossless", "spline"],
)
def test_full_lattices_take_most_of_what_is_asked_for(frame, spec, program: Path, tmp_path: Path) -> None:
    """Two frames of 1700 bricks in some hundred bytes, the second one with the first as reference."""
    encoder, path = field_encoder(GRID, spec), tmp_path / "full.touch"
    with TouchWriter(path) as writer:
        writer.write_head(make_golden.head_of(GRID, 30.0, 2, encoder))
        writer.write_segment(0, 2, encoder.encode_segment([frame()] * 2).body)
    ((decoder_room, frame_room, decoder_bytes, frame_bytes),) = room(program, path)
    assert decoder_bytes <= decoder_room <= 1.6 * decoder_bytes + FIXED_BYTES
    assert frame_bytes <= frame_room <= 1.1 * frame_bytes + 4096


def test_golden_files_take_no_more_than_is_asked_for(program: Path) -> None:
    paths = [path for path in GOLDEN if not is_paper(path)]
    rooms = room(program, *paths)
    assert len(rooms) == len(paths) and all(row[2] <= row[0] and row[3] <= row[1] for row in rooms)
