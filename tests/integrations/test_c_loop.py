"""The C program with its own loop computes the forces of the Python player."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from builders import (
    ATOL_N,
    FAULTY,
    OBJECTS,
    TICKS,
    VOXELS,
    assert_has_friction,
    assert_resists,
    build_integration,
    needs,
    player_forces,
    press_plate,
    run,
    slide_on_plate,
    slow_way,
    stream_of,
)

pytestmark = needs("make", "cc")


@pytest.fixture(scope="module")
def loop(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_integration("c-loop", tmp_path_factory.mktemp("c-loop")) / "loop"


def run_loop(loop: Path, path: Path, *options: object, points: np.ndarray | None = None) -> np.ndarray:
    """Rows of the loop: media time, position, force."""
    lines = "" if points is None else "".join(f"{x!r} {y!r} {z!r}\n" for x, y, z in points.tolist())
    done = run(loop, *options, *([] if points is None else ["-i"]), path, stdin=lines)
    assert done.returncode == 0, done.stderr
    assert "the latest by" in done.stderr
    return np.array([line.split() for line in done.stdout.splitlines()], np.float64)


@pytest.mark.parametrize("name", [*VOXELS, *OBJECTS])
def test_forces_agree_with_the_python_player(loop: Path, name: str) -> None:
    points, expected = player_forces(stream_of(name), slow_way(name, TICKS), loop=True, wall_n_per_m=800.0)
    rows = run_loop(loop, stream_of(name), "-t", "-l", "-k", 800, points=points)
    assert len(rows) == TICKS
    np.testing.assert_array_equal(rows[:, 1:4], points)
    assert np.abs(rows[:, 4:]).max() > 0.05
    np.testing.assert_allclose(rows[:, 4:], expected, atol=ATOL_N, rtol=0)


def test_forces_are_limited_to_the_device(loop: Path) -> None:
    points, expected = player_forces(
        stream_of("touch-block"), slow_way("touch-block", TICKS), 0.25, loop=True
    )
    rows = run_loop(loop, stream_of("touch-block"), "-t", "-l", "-p", 0.25, points=points)
    sizes = np.linalg.norm(rows[:, 4:], axis=-1)
    assert sizes.max() == pytest.approx(0.25)
    np.testing.assert_allclose(rows[:, 4:], expected, atol=ATOL_N, rtol=0)


def test_thin_plate_holds_the_hand(loop: Path, plate: Path) -> None:
    assert_resists(run_loop(loop, plate, "-s", 1, "-p", 3.3, points=press_plate())[:, 4:], 3.3)


def test_friction_resists_the_hand_on_the_plate(loop: Path, plate: Path) -> None:
    points = slide_on_plate()
    rows = run_loop(loop, plate, "-t", "-s", 1, "-p", 3.3, "-m", 0.3, points=points)
    assert_has_friction(rows[:, 4:], 0.3)
    without_n = run_loop(loop, plate, "-t", "-s", 1, "-p", 3.3, "-m", 0, points=points)[600:, 4:]
    assert np.abs(without_n[:, 0]).max() < 0.01


def test_simulated_hand_moves_through_the_medium(loop: Path) -> None:
    rows = run_loop(loop, stream_of("touch-block"), "-s", 0.2)
    assert len(rows) == 200
    assert (np.abs(np.diff(rows[:, 1:4], axis=0)) > 0).any()
    assert rows[-1, 0] > 0.05  # the medium plays in real time


def test_damaged_file_is_refused_with_a_message(loop: Path) -> None:
    done = run(loop, FAULTY)
    assert done.returncode == 65 and "end too early" in done.stderr and not done.stdout
    assert run(loop, "/nowhere.touch").returncode == 64
    assert run(loop).returncode == 64
