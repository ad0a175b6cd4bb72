"""The effect for CHAI3D, built against a stand-in, feels what Python feels."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from builders import ATOL_N, FAULTY, OBJECTS, VOXELS, asked_at, made, needs, python_forces, run, stream_of

pytestmark = needs("make", "cc", "c++")


@pytest.fixture(scope="module")
def effect(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("chai3d")
    return made("chai3d", folder, "CXXFLAGS=-O1", "CFLAGS=-O1") / "try_effect"


@pytest.mark.parametrize("name", [*VOXELS, *OBJECTS])
def test_forces_are_those_of_python(effect: Path, name: str) -> None:
    frames, points, forces = asked_at(name, [effect, stream_of(name)])
    assert np.abs(forces).max() > 0.05
    np.testing.assert_allclose(forces, python_forces(name, frames, points), atol=ATOL_N, rtol=0)


def test_a_force_is_no_longer_than_the_device_can_bear(effect: Path) -> None:
    name = "objects-touch"
    frames, points, forces = asked_at(name, [effect, stream_of(name), 0.25])
    assert np.linalg.norm(forces, axis=-1).max() == pytest.approx(0.25)
    np.testing.assert_allclose(forces, python_forces(name, frames, points, 0.25), atol=ATOL_N, rtol=0)


def test_a_file_that_cannot_be_played_is_told_in_words(effect: Path) -> None:
    done = run(effect, FAULTY)
    assert done.returncode == 65 and "end too early" in done.stderr
    assert "cannot be read" in run(effect, "/nowhere.touch").stderr
