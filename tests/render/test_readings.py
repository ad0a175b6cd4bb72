"""Readings of a driver in any numeric type reach the renderer as floats; other forms end playback at zero."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from player_makers import AXES, GRID, Simulated, numbered_field

from touchfield.devices import device
from touchfield.errors import DeviceError
from touchfield.medium import HapticMedium
from touchfield.render.offline import run_offline
from touchfield.render.readings import (
    buttons_reading,
    gripper_reading,
    orientation_reading,
    position_reading,
)
from touchfield.render.spec import RenderSpec
from touchfield.render.ticked_player import TickedPlayer

SIGMA = replace(device("sigma.7"), axes=AXES, torque_continuous_nm=None)
AT = 100  # the tick with an odd reading


class Odd(Simulated):
    """Reports one reading of another type at one tick; None stands for the usual one."""

    def __init__(self, name: str, reading: Any) -> None:
        super().__init__()
        self.name, self.reading = name, reading

    def _get(self, name: str, usual: Any) -> Any:
        return self.reading if name == self.name and len(self.forces) == AT else usual

    def position_m(self) -> Any:
        return self._get("position", super().position_m())

    def orientation(self) -> Any:
        return self._get("orientation", (1.0, 0.0, 0.0, 0.0))

    def buttons(self) -> Any:
        return self._get("buttons", 0)

    def gripper_m(self) -> Any:
        return self._get("gripper", 0.0)


def played(name: str, reading: Any) -> tuple[np.ndarray, Any]:
    """Forces at the device, and rows of the log, or the error that ended playback."""
    made: list[Odd] = []

    def opener() -> Odd:
        made.append(Odd(name, reading))
        return made[0]

    medium = HapticMedium(GRID, 50.0, 20, numbered_field, AXES)
    result: Any
    try:
        result = run_offline(medium, SIGMA, opener, RenderSpec(), seconds=0.2).log
    except DeviceError as error:
        result = error
    assert made[0].closed == 1
    return np.array(made[0].forces), result


ZERO = np.zeros(3)
SAME_POSITIONS = [
    (0, 0, 0), [0.0, 0.0, 0.0], [0, 0.0, 0], ZERO, ZERO.astype("f4"), ZERO.astype("i8"), np.zeros(3, "u2"),
    tuple(ZERO), tuple(np.zeros(3, "i4")), (False, 0, 0.0),
]  # fmt: skip


@pytest.fixture(scope="module")
def usual() -> np.ndarray:
    """Forces of a device whose readings are floats."""
    return played("", None)[0]


@pytest.mark.parametrize("reading", SAME_POSITIONS, ids=lambda r: f"{type(r).__name__} {np.asarray(r).dtype}")
def test_a_position_of_other_numbers_changes_no_force(reading: Any, usual: np.ndarray) -> None:
    forces, _ = played("position", reading)
    assert np.linalg.norm(usual, axis=1).max() > 0.3
    np.testing.assert_array_equal(forces, usual)


@pytest.mark.parametrize(
    ("name", "reading", "column", "expected"),
    [
        ("buttons", np.uint8(5), "buttons", 5),
        ("buttons", True, "buttons", 1),
        ("buttons", 1 << 62, "buttons", 1 << 62),
        ("gripper", 1, "gripper_m", 1.0),
        ("gripper", np.float32(0.25), "gripper_m", 0.25),
        ("gripper", np.int16(2), "gripper_m", 2.0),
        ("gripper", math.nan, "gripper_m", math.nan),
        ("orientation", [0, 1, 0, 0], "orientation", [0, 1, 0, 0]),
        ("orientation", np.array([0, 0, 1, 0]), "orientation", [0, 0, 1, 0]),
    ],
)
def test_readings_of_other_types_are_logged(name: str, reading: Any, column: str, expected: Any) -> None:
    _, log = played(name, reading)
    np.testing.assert_array_equal(log[column][AT], expected)
    assert not np.array_equal(log[column][AT - 1], log[column][AT]), "the usual reading is another one"


@pytest.mark.parametrize(
    ("name", "reading"),
    [
        ("position", None), ("position", (0.0, 0.0)), ("position", (0.0, 0.0, 0.0, 0.0)), ("position", 0.0),
        ("position", "000"), ("position", (None, 0, 0)), ("position", (1j, 0, 0)),
        ("position", (10**400, 0, 0)),
        ("position", np.zeros((3, 2))), ("orientation", None), ("orientation", (1.0, 0.0, 0.0)),
        ("buttons", None), ("buttons", 1.0), ("buttons", [True]), ("buttons", -1), ("buttons", 1 << 63),
        ("gripper", None), ("gripper", "1"), ("gripper", (0.0,)),
    ],
)  # fmt: skip
def test_a_reading_of_another_form_is_named_and_ends_at_zero_force(name: str, reading: Any) -> None:
    forces, error = played(name, reading)
    assert re.match(f"{name} of the device: found .*; expected .*driver", str(error))
    sizes = np.linalg.norm(forces, axis=1)
    assert sizes[AT - 1] > 0.3 and sizes[-1] == 0.0
    assert np.abs(np.diff(sizes)).max() <= SIGMA.force_max_n / 0.005 * 1e-3 * 1.001


def test_positions_that_are_not_finite_stay_a_reading_and_release() -> None:
    assert math.isnan(position_reading((math.nan, 0, 0))[0])
    assert position_reading([math.inf, 0, np.int8(-3)]) == (math.inf, 0.0, -3.0)
    forces, _ = played("position", (math.nan, 0, 0))
    sizes = np.linalg.norm(forces, axis=1)
    assert sizes[AT] < sizes[AT - 1], "one tick of the ramp"


def test_results_are_plain_floats_and_whole_numbers() -> None:
    values = (
        *position_reading(np.arange(3)),
        *orientation_reading(np.arange(4)),
        gripper_reading(np.int8(1)),
    )
    assert {type(value) for value in values} == {float}
    assert type(buttons_reading(np.uint16(7))) is int


def test_ticks_of_a_callers_loop_take_the_same_readings() -> None:
    medium = HapticMedium(GRID, 50.0, 20, numbered_field, AXES)
    with TickedPlayer(medium, SIGMA, is_simulated=True) as player:
        player.play()
        for n, reading in enumerate(SAME_POSITIONS):
            assert len(player.tick(reading, (n + 1) * 1_000_000)) == 3  # type: ignore[arg-type]
        with pytest.raises(DeviceError, match="position of the device"):
            player.tick((0.0, 0.0), 20_000_000)  # type: ignore[arg-type]
