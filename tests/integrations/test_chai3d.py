"""The CHAI3D effect, built against a stub, computes the forces of Python."""

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
    needs,
    python_forces,
    query_program,
    run,
    stream_of,
)

pytestmark = needs("make", "cc", "c++")


@pytest.fixture(scope="module")
def effect(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("chai3d")
    return build_integration("chai3d", folder, "CXXFLAGS=-O1", "CFLAGS=-O1") / "try_effect"


@pytest.mark.parametrize("name", [*VOXELS, *OBJECTS])
def test_forces_agree_with_python(effect: Path, name: str) -> None:
    frames, points, forces = query_program(name, [effect, stream_of(name)])
    assert np.abs(forces).max() > 0.05
    np.testing.assert_allclose(forces, python_forces(name, frames, points), atol=ATOL_N, rtol=0)


def test_forces_are_limited_to_the_device(effect: Path) -> None:
    name = "objects-touch"
    frames, points, forces = query_program(name, [effect, stream_of(name), 0.25])
    assert np.linalg.norm(forces, axis=-1).max() == pytest.approx(0.25)
    np.testing.assert_allclose(forces, python_forces(name, frames, points, 0.25), atol=ATOL_N, rtol=0)


def test_unplayable_file_is_refused_with_a_message(effect: Path) -> None:
    done = run(effect, FAULTY)
    assert done.returncode == 65 and "end too early" in done.stderr
    assert "cannot be read" in run(effect, "/nowhere.touch").stderr
