"""Patterns of arrays: which actuators show a situation, and that no pattern is another one."""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np
import pytest

from touchfield.devices import device
from touchfield.errors import InvalidArgument
from touchfield.guidance import GuideSpec, Patterns, Situation
from touchfield.guidance.directions import DIRECTIONS
from touchfield.guidance.ground import Ground
from touchfield.guidance.guide import State
from touchfield.guidance.steps import GroundAhead

VEST = device("tactsuit-x40")
GROUND = Ground(np.array([0.0, -1.0, 0.0]), 1.3)
PLACES = {
    "left front": (0, 0), "front left": (0, 1), "front right": (0, 2), "right front": (0, 3),
    "left back": (1, 0), "back left": (1, 1), "back right": (1, 2), "right back": (1, 3),
}  # fmt: skip
"""Panel and column of the vest of each direction, from the wearer's left."""


def situation(near: str = "", state: State = State.FREE, **parts: object) -> Situation:
    """All directions in a state, but for one that is near at 1 m."""
    states, distances = [state] * 8, np.full(8, np.inf)
    if near:
        states[DIRECTIONS.index(near)] = State.NEAR
        distances[DIRECTIONS.index(near)] = 1.0
    values = {
        "time_s": 0.0, "states": tuple(states), "distances_m": distances, "contact_s": np.full(8, np.inf),
        "ground": GROUND, "ahead": GroundAhead(), "is_blind": False, "known_fraction": 1.0, **parts,
    }  # fmt: skip
    return Situation(**values)  # type: ignore[arg-type]


def over_time(shown: Situation, patterns: Patterns | None = None) -> np.ndarray:
    """The drives over four seconds, [times, panels, rows, columns]."""
    return np.stack([(patterns or Patterns(VEST)).drives(shown, t) for t in np.arange(0, 4, 0.05)])


@pytest.mark.parametrize("direction", PLACES)
def test_a_surface_has_the_column_of_its_direction(direction: str) -> None:
    drives = over_time(situation(direction))
    panel, column = PLACES[direction]
    assert (drives[:, panel, :4, column] > 0.25).all(), "all rows but the lowest, without a pause"
    drives[:, panel, :4, column] = 0
    assert not drives.any()


def test_the_front_panel_may_start_at_the_right() -> None:
    drives = over_time(situation("left front"), Patterns(VEST, GuideSpec(first_column="right")))
    assert drives[:, 0, 0, 3].all() and not drives[:, 0, 0, 0].any()
    back = over_time(situation("left back"), Patterns(VEST, GuideSpec(first_column="right")))
    assert back[:, 1, 0, 0].all()


SHOWN = {
    "free": situation(),
    "near": situation("front left"),
    "unknown": situation(state=State.UNKNOWN),
    "no ground": situation(ground=Ground(GROUND.up, 1.3, math.inf, False)),
    "step": situation(ahead=GroundAhead(1.5, math.inf)),
    "drop": situation(ahead=GroundAhead(math.inf, 1.5)),
    "blind": situation(state=State.UNKNOWN, is_blind=True),
}


@pytest.mark.parametrize("name", ["tactsuit-x40", "tactsuit-x16", "tactile-vest-8x8"])
def test_every_pattern_differs_from_every_other_and_only_free_is_off(name: str) -> None:
    patterns = Patterns(device(name))
    shown = {key: over_time(value, patterns) for key, value in SHOWN.items()}
    for (a, drives), (b, others) in combinations(shown.items(), 2):
        assert not np.array_equal(drives, others), (a, b)
    assert [key for key, drives in shown.items() if not drives.any()] == ["free"]
    assert all(drives.min() >= 0 and drives.max() <= 1 for drives in shown.values())


def test_the_warning_is_all_columns_above_and_below() -> None:
    drives = Patterns(VEST).warning(0.0)
    assert drives[:, (0, -1)].all() and not drives[:, 1:-1].any()
    assert np.array_equal(Patterns(VEST).drives(SHOWN["blind"], 0.0), drives)
    assert not Patterns(VEST).warning(0.3).any()


def test_strength_grows_with_nearness_and_with_the_time_to_contact() -> None:
    strength = Patterns(VEST).strength
    by_distance = [strength(d, math.inf) for d in (2.0, 1.5, 1.0, 0.5, 0.2)]
    assert by_distance == sorted(by_distance) and by_distance[0] == 0.25 and by_distance[-1] == 0.5
    by_time = [strength(2.0, t) for t in (5.0, 3.0, 2.0, 1.0, 0.1)]
    assert by_time == sorted(by_time) and by_time[-1] == 1.0


def test_a_drop_hides_no_surface_and_no_step_hides_a_drop() -> None:
    both = over_time(situation("front left", ahead=GroundAhead(1.0, 1.5)))
    assert np.array_equal(both[:, 0, -1], over_time(SHOWN["drop"])[:, 0, -1])
    assert np.array_equal(both[:, :, :-1], over_time(SHOWN["near"])[:, :, :-1])


def test_arrays_that_cannot_show_it_are_refused_or_noted() -> None:
    for name in ("dotpad", "phantom-omni"):
        with pytest.raises(InvalidArgument, match="vibrate"):
            Patterns(device(name))
    assert "behind" in Patterns(device("tactile-vest-8x8")).notes[0] and not Patterns(VEST).notes


@pytest.mark.parametrize(
    "options", [{"warn_m": 0.0}, {"pitch_deg": 91.0}, {"first_column": "top"}, {"camera_height_m": math.nan}]
)
def test_options_out_of_range_are_refused(options: dict[str, float]) -> None:
    with pytest.raises(InvalidArgument, match=next(iter(options))):
        GuideSpec(**options)  # type: ignore[arg-type]
