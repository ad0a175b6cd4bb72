"""The effect for CHAI3D, built against a stand-in, feels what Python feels."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from builders import ATOL_N, OBJECTS, VOXELS, frame_count, made, needs, python_forces, run, some_points, stream_of

from touchfield.job import open_stream

pytestmark = needs("make", "cc", "c++")
POINTS = 200


@pytest.fixture(scope="module")
def effect(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("chai3d")
    return made("chai3d", folder, "CXXFLAGS=-O1", "CFLAGS=-O1") / "try_effect"


def asked(effect: Path, name: str, *words: object) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frames, points, and the forces of the effect: each frame twice, and moments between."""
    places = np.sort(np.random.default_rng(3).uniform(0, frame_count(name) - 1, POINTS))
    places[::4] = np.round(places[::4])
    places.sort()
    points = some_points(name, POINTS)
    with open_stream(stream_of(name)) as stream:
        seconds = places / stream.reader.head.rate_hz
    lines = "".join(f"{t!r} {x!r} {y!r} {z!r}\n" for t, (x, y, z) in zip(seconds.tolist(), points.tolist()))
    done = run(effect, stream_of(name), *words, given=lines)
    assert done.returncode == 0, done.stderr
    return places, points, np.array([line.split() for line in done.stdout.splitlines()], np.float64)


@pytest.mark.parametrize("name", [*VOXELS, *OBJECTS])
def test_forces_are_those_of_python(effect: Path, name: str) -> None:
    places, points, forces = asked(effect, name)
    assert np.abs(forces).max() > 0.05
    np.testing.assert_allclose(forces, python_forces(name, places, points), atol=ATOL_N, rtol=0)


def test_a_force_is_no_longer_than_the_device_can_bear(effect: Path) -> None:
    places, points, forces = asked(effect, "objects-touch", 0.25)
    assert np.linalg.norm(forces, axis=-1).max() == pytest.approx(0.25)
    np.testing.assert_allclose(forces, python_forces("objects-touch", places, points, 0.25), atol=ATOL_N, rtol=0)


def test_a_file_that_cannot_be_played_is_told_in_words(effect: Path) -> None:
    done = run(effect, stream_of("touch-block").parents[1] / "faulty" / "cut-at-end.touch")
    assert done.returncode == 65 and "end too early" in done.stderr
    assert "cannot be read" in run(effect, "/nowhere.touch").stderr
