"""The extension of `integrations/godot` renders the forces of the Python player, in Godot itself."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest
from builders import (
    ENGINE,
    FAULTY,
    TICKS,
    assert_has_friction,
    assert_is_released,
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

pytestmark = needs("make", "cc", "godot")
WORLD = np.array([1.0, -1.0, -1.0])
"""The axes of the medium (right, down, forward) in those of the world (right, up, back)."""


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_integration("godot", tmp_path_factory.mktemp("godot"), "CFLAGS=-O1", "try")


def run_script(project: Path, script: Path | str, *arguments: object) -> subprocess.CompletedProcess[str]:
    """Run a script with the project; `--fixed-fps` lets simulated time run as fast as it can."""
    return run("godot", "--headless", "--fixed-fps", 60, "--path", project, "-s", script, "--", *arguments)


def forces_of(
    project: Path, path: Path, points: np.ndarray, folder: Path, **options: float
) -> tuple[np.ndarray, np.ndarray]:
    """Forces on a hand, and those on the way to zero, newtons, float64 [count, 3] and [released, 3]."""
    hand, out = folder / "hand.txt", folder / "forces.txt"
    np.savetxt(hand, points, fmt="%.17g")
    words = [f"{name}={value}" for name, value in options.items()]
    done = run_script(project, "try_touchfield.gd", *words, path, hand, out)
    assert done.returncode == 0 and not done.stderr, done.stdout + done.stderr
    forces_n = np.loadtxt(out)
    return forces_n[: len(points)], forces_n[len(points) :]


@pytest.mark.parametrize("name", ["touch-block", "touch-lossless", "objects-touch-deforming"])
def test_forces_agree_with_the_python_player(project: Path, tmp_path: Path, name: str) -> None:
    way_m = slow_way(name, TICKS).astype(np.float32).astype(np.float64)  # as in a Vector3 of Godot
    points, expected_n = player_forces(stream_of(name), way_m, 0.5, **ENGINE)
    options = {"wall_n_per_m": 800.0, "damping_n_s_per_m": 0.5, "coupling_n_per_m": 0.0, "is_loop": 1}
    forces_n, _ = forces_of(project, stream_of(name), points, tmp_path, force_max_n=0.5, **options)
    assert np.abs(forces_n).max() > 0.05
    np.testing.assert_allclose(forces_n, expected_n, atol=np.spacing(np.float32(0.5)), rtol=0)


def test_thin_plate_resists_the_hand_until_a_stop(project: Path, plate: Path, tmp_path: Path) -> None:
    forces_n, released_n = forces_of(project, plate, press_plate(), tmp_path, force_max_n=3.3)
    assert_resists(forces_n, 3.3)
    assert_is_released(released_n, forces_n[-1], 3.3)


def test_physics_steps_of_the_node_render_the_ticks_between_them(
    project: Path, plate: Path, tmp_path: Path
) -> None:
    points = WORLD * slide_on_plate()[::17]  # a step of the physics takes 17 ticks
    options = {"force_max_n": 3.3, "friction": 0.3, "steps": 1}
    forces_n, _ = forces_of(project, plate, points, tmp_path, **options)
    every_tick_n = np.repeat(WORLD * forces_n, 17, axis=0)
    assert (every_tick_n[400:, 2] > 0.5).all()
    assert_has_friction(every_tick_n, 0.3)


def test_calls_of_scripts_are_checked(project: Path) -> None:
    done = run_script(project, Path(__file__).with_name("godot_calls.gd"), stream_of("touch-block"))
    assert done.returncode == 0 and done.stdout.split()[-1] == "ok", done.stdout + done.stderr
    assert "leaked" not in done.stdout + done.stderr


def test_unplayable_file_is_refused_with_a_message(project: Path, tmp_path: Path) -> None:
    (tmp_path / "hand.txt").write_text("0 0 0\n")
    arguments = [tmp_path / "hand.txt", tmp_path / "forces.txt"]
    done = run_script(project, "try_touchfield.gd", FAULTY, *arguments)
    assert done.returncode == 65 and "end too early" in done.stderr
    done = run_script(project, "try_touchfield.gd", "/nowhere.touch", *arguments)
    assert done.returncode == 65 and "cannot be read" in done.stderr
    done = run_script(project, "try_touchfield.gd", "colour=1", stream_of("touch-block"), *arguments)
    assert done.returncode == 65 and "no option colour" in done.stderr
    assert run_script(project, "try_touchfield.gd").returncode == 64
    assert not (tmp_path / "forces.txt").exists()
