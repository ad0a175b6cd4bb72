"""The C program with its own loop computes the forces of Python, at frames and between them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from builders import (
    ATOL_N,
    FAULTY,
    OBJECTS,
    VOXELS,
    build_integration,
    frame_count,
    needs,
    python_forces,
    run,
    some_points,
    stream_of,
)

import touchfield as tf

pytestmark = needs("make", "cc")
TICKS = 300


@pytest.fixture(scope="module")
def loop(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_integration("c-loop", tmp_path_factory.mktemp("c-loop")) / "loop"


def run_loop(loop: Path, name: str, *options: object, points: np.ndarray | None = None) -> np.ndarray:
    """Rows of the loop: frame, position, force."""
    lines = "" if points is None else "".join(f"{x!r} {y!r} {z!r}\n" for x, y, z in points.tolist())
    done = run(loop, *options, *([] if points is None else ["-i"]), stream_of(name), stdin=lines)
    assert done.returncode == 0, done.stderr
    assert "the latest by" in done.stderr
    return np.array([line.split() for line in done.stdout.splitlines()], np.float64)


def speed_for(name: str, ticks: int) -> float:
    """The speed at which a medium lasts `ticks` ticks."""
    with tf.open_stream(stream_of(name)) as stream:
        return frame_count(name) / stream.reader.head.rate_hz / (1e-3 * ticks)


@pytest.mark.parametrize("name", [*VOXELS, *OBJECTS])
def test_forces_agree_with_python(loop: Path, name: str) -> None:
    points = some_points(name, TICKS)
    rows = run_loop(loop, name, "-s", 10, "-x", speed_for(name, TICKS), points=points)
    finite_rows = rows[np.isfinite(rows[:, 1])]
    assert len(finite_rows) >= TICKS and np.isfinite(finite_rows).all()
    np.testing.assert_allclose(np.unique(finite_rows[:, 1:4], axis=0), np.unique(points, axis=0), atol=1e-9)
    assert finite_rows[-1, 0] == pytest.approx(frame_count(name) - 1)
    assert frame_count(name) == 1 or (finite_rows[:, 0] % 1 > 0.1).any()
    assert np.abs(finite_rows[:, 4:]).max() > 0.05
    np.testing.assert_allclose(
        finite_rows[:, 4:], python_forces(name, finite_rows[:, 0], finite_rows[:, 1:4]), atol=ATOL_N, rtol=0
    )
    assert not rows[~np.isfinite(rows[:, 1]), 4:].any()  # before the first position


def test_forces_are_limited_to_the_device(loop: Path) -> None:
    points = some_points("touch-block", TICKS)
    rows = run_loop(
        loop, "touch-block", "-s", 10, "-p", 0.25, "-x", speed_for("touch-block", TICKS), points=points
    )
    sizes = np.linalg.norm(rows[:, 4:], axis=-1)
    assert sizes.max() == pytest.approx(0.25)
    expected = python_forces("touch-block", rows[:, 0], rows[:, 1:4], 0.25)
    np.testing.assert_allclose(rows[:, 4:], expected, atol=ATOL_N, rtol=0)


def test_simulated_hand_moves_through_the_medium(loop: Path) -> None:
    rows = run_loop(loop, "touch-block", "-s", 0.2)
    assert len(rows) == 200
    assert (np.abs(np.diff(rows[:, 1:4], axis=0)) > 0).any()
    np.testing.assert_allclose(
        rows[:, 4:], python_forces("touch-block", rows[:, 0], rows[:, 1:4]), atol=ATOL_N, rtol=0
    )


def test_damaged_file_is_refused_with_a_message(loop: Path) -> None:
    done = run(loop, FAULTY)
    assert done.returncode == 65 and "end too early" in done.stderr and not done.stdout
    assert run(loop, "/nowhere.touch").returncode == 64
    assert run(loop).returncode == 64
