"""The C program with its own loop feels what Python feels, at the frames and between them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from builders import (
    ATOL_N,
    FAULTY,
    OBJECTS,
    VOXELS,
    frame_count,
    made,
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
    return made("c-loop", tmp_path_factory.mktemp("c-loop")) / "loop"


def felt(loop: Path, name: str, *options: object, points: np.ndarray | None = None) -> np.ndarray:
    """Rows of the loop: frame, place, force."""
    lines = "" if points is None else "".join(f"{x!r} {y!r} {z!r}\n" for x, y, z in points.tolist())
    done = run(loop, *options, *([] if points is None else ["-i"]), stream_of(name), given=lines)
    assert done.returncode == 0, done.stderr
    assert "the latest by" in done.stderr
    return np.array([line.split() for line in done.stdout.splitlines()], np.float64)


def speed_for(name: str, ticks: int) -> float:
    """So fast that a medium takes so many ticks."""
    with tf.open_stream(stream_of(name)) as stream:
        return frame_count(name) / stream.reader.head.rate_hz / (1e-3 * ticks)


@pytest.mark.parametrize("name", [*VOXELS, *OBJECTS])
def test_forces_are_those_of_python(loop: Path, name: str) -> None:
    points = some_points(name, TICKS)
    rows = felt(loop, name, "-s", 10, "-x", speed_for(name, TICKS), points=points)
    here = rows[np.isfinite(rows[:, 1])]
    assert len(here) >= TICKS and (here[:, 1] == here[:, 1]).all()
    np.testing.assert_allclose(np.unique(here[:, 1:4], axis=0), np.unique(points, axis=0), atol=1e-9)
    assert here[-1, 0] == pytest.approx(frame_count(name) - 1)
    assert frame_count(name) == 1 or (here[:, 0] % 1 > 0.1).any()
    assert np.abs(here[:, 4:]).max() > 0.05
    np.testing.assert_allclose(
        here[:, 4:], python_forces(name, here[:, 0], here[:, 1:4]), atol=ATOL_N, rtol=0
    )
    assert not rows[~np.isfinite(rows[:, 1]), 4:].any()  # before the hand is known


def test_a_force_is_no_longer_than_the_device_can_bear(loop: Path) -> None:
    points = some_points("touch-block", TICKS)
    rows = felt(
        loop, "touch-block", "-s", 10, "-p", 0.25, "-x", speed_for("touch-block", TICKS), points=points
    )
    sizes = np.linalg.norm(rows[:, 4:], axis=-1)
    assert sizes.max() == pytest.approx(0.25)
    expected = python_forces("touch-block", rows[:, 0], rows[:, 1:4], 0.25)
    np.testing.assert_allclose(rows[:, 4:], expected, atol=ATOL_N, rtol=0)


def test_a_simulated_hand_wanders_through_the_medium(loop: Path) -> None:
    rows = felt(loop, "touch-block", "-s", 0.2)
    assert len(rows) == 200
    assert (np.abs(np.diff(rows[:, 1:4], axis=0)) > 0).any()
    np.testing.assert_allclose(
        rows[:, 4:], python_forces("touch-block", rows[:, 0], rows[:, 1:4]), atol=ATOL_N, rtol=0
    )


def test_a_damaged_file_is_refused_in_words(loop: Path) -> None:
    done = run(loop, FAULTY)
    assert done.returncode == 65 and "end too early" in done.stderr and not done.stdout
    assert run(loop, "/nowhere.touch").returncode == 64
    assert run(loop).returncode == 64
