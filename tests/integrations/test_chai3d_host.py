"""The CHAI3D effect in a scene of CHAI3D itself (`CHAI3D_DIR`): world, tool and a simulated device."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from builders import (
    ATOL_N,
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
    ticks_of,
)

CHAI3D = Path(os.environ.get("CHAI3D_DIR", "/nowhere"))
IS_BUILT = next(CHAI3D.rglob("libchai3d.a"), None) is not None
pytestmark = [
    needs("make", "cc", "c++"),
    pytest.mark.skipif(not IS_BUILT, reason="the variable CHAI3D_DIR names no folder of CHAI3D, built"),
]


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("chai3d")
    return build_integration("chai3d", folder, f"CHAI3D_DIR={CHAI3D}", "CXXFLAGS=-O1", "scene") / "scene"


@pytest.mark.parametrize("name", ["touch-block", "touch-lossless", "objects-touch-deforming"])
def test_forces_on_the_device_agree_with_the_python_player(scene: Path, name: str) -> None:
    points, expected_n = player_forces(stream_of(name), slow_way(name, TICKS), 0.5, **ENGINE)
    options = ["-l", "-k", 800, "-d", 0.5, "-c", 0, "-p", 0.5]
    forces_n, _ = ticks_of(scene, *options, stream_of(name), points=points)
    assert np.abs(forces_n).max() > 0.05
    np.testing.assert_allclose(forces_n, expected_n, atol=ATOL_N, rtol=0)


def test_thin_plate_resists_the_device_until_a_stop(scene: Path, plate: Path) -> None:
    forces_n, released_n = ticks_of(scene, "-p", 3.3, plate, points=press_plate())
    assert_resists(forces_n, 3.3)
    assert_is_released(released_n, forces_n[-1], 3.3)


def test_friction_resists_the_device_on_the_plate(scene: Path, plate: Path) -> None:
    forces_n, _ = ticks_of(scene, "-p", 3.3, "-m", 0.3, plate, points=slide_on_plate())
    assert_has_friction(forces_n, 0.3)


def test_unplayable_file_is_refused_with_a_message(scene: Path) -> None:
    done = run(scene, FAULTY)
    assert done.returncode == 65 and "end too early" in done.stderr
    assert "cannot be read" in run(scene, "/nowhere.touch").stderr
    assert run(scene).returncode == 64
