"""The CHAI3D effect, built against a stub, renders the forces of the Python player."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from builders import (
    ATOL_N,
    ENGINE,
    FAULTY,
    INTEGRATIONS,
    OBJECTS,
    TICKS,
    VOXELS,
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

pytestmark = needs("make", "cc", "c++")


@pytest.fixture(scope="module")
def effect(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("chai3d")
    return build_integration("chai3d", folder, "CXXFLAGS=-O1", "CFLAGS=-O1") / "try_effect"


@pytest.mark.parametrize("name", [*VOXELS, *OBJECTS])
def test_forces_agree_with_the_python_player(effect: Path, name: str) -> None:
    points, expected_n = player_forces(stream_of(name), slow_way(name, TICKS), **ENGINE)
    options = ["-l", "-k", 800, "-d", 0.5, "-c", 0]
    forces_n, _ = ticks_of(effect, *options, stream_of(name), points=points)
    assert np.abs(forces_n).max() > 0.05
    np.testing.assert_allclose(forces_n, expected_n, atol=ATOL_N, rtol=0)


def test_forces_are_limited_to_the_device(effect: Path) -> None:
    way = slow_way("objects-touch", TICKS)
    points, expected_n = player_forces(stream_of("objects-touch"), way, 0.25, **ENGINE)
    options = ["-l", "-k", 800, "-d", 0.5, "-c", 0, "-p", 0.25]
    forces_n, _ = ticks_of(effect, *options, stream_of("objects-touch"), points=points)
    assert np.linalg.norm(forces_n, axis=-1).max() == pytest.approx(0.25)
    np.testing.assert_allclose(forces_n, expected_n, atol=ATOL_N, rtol=0)


@pytest.mark.parametrize("clock", [[], ["-r"]])
def test_thin_plate_resists_the_hand_until_a_stop(effect: Path, plate: Path, clock: list[str]) -> None:
    forces_n, released_n = ticks_of(effect, "-p", 3.3, *clock, plate, points=press_plate())
    assert_resists(forces_n, 3.3)
    assert_is_released(released_n, forces_n[-1], 3.3)


def test_friction_resists_the_hand_on_the_plate(effect: Path, plate: Path) -> None:
    forces_n, _ = ticks_of(effect, "-p", 3.3, "-m", 0.3, plate, points=slide_on_plate())
    assert_has_friction(forces_n, 0.3)


def test_unplayable_file_is_refused_with_a_message(effect: Path) -> None:
    done = run(effect, FAULTY)
    assert done.returncode == 65 and "end too early" in done.stderr
    assert "cannot be read" in run(effect, "/nowhere.touch").stderr
    assert run(effect).returncode == 64


def test_orders_and_tools(effect: Path) -> None:
    program, folder = effect.parent / "effect_orders", INTEGRATIONS / "chai3d"
    objects = [effect.parent / name for name in ("cTouchfieldEffect.o", "touch.o")]
    headers = ["-I", folder, "-I", folder / "stub"]
    source = Path(__file__).parent / "effect_orders.cpp"
    done = run("c++", "-std=c++11", *headers, "-o", program, source, *objects, "-lpthread")
    assert done.returncode == 0, done.stderr
    done = run(program, stream_of("touch-block"))
    assert done.returncode == 0, done.stderr
