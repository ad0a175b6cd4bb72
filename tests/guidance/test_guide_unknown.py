"""What is beside the picture: movers, lost surfaces, borders of directions, and the level of poses."""

from __future__ import annotations

import math

import numpy as np
import pytest
from test_guide import CAMERA, HALL, SIZE, floors, picture, pose_at

import corridor_makers as makers
from corridor_makers import Body, Corridor, cylinder
from touchfield.guidance import Guide, Situation
from touchfield.guidance.directions import MIN_SAMPLES, nearest_beside_m
from touchfield.guidance.guide import State
from touchfield.guidance.lost import HOLD_S, LostSurfaces
from touchfield.guidance.movers import Movers
from touchfield.guidance.parallel import parallel_normal, parallel_scores, plane_height_m


def turned_away(speed_m_s: float) -> list[Situation]:
    """A person ahead, for 1 s, from whom a wearer turns away to the right; one second later."""
    guide, shown = Guide(CAMERA, *SIZE), []
    person = cylinder(0.0, 2.6, 0.22, 1.7, "person", -speed_m_s)
    for n in range(75):
        pose = pose_at(0, 0, float(np.clip(4.0 * (n - 30), 0, 80)))
        seen = picture([*HALL, person.at(min(n, 45) / 30)], pose, n)
        shown.append(guide.update(seen, n / 30, makers.as_pose(pose)))
    return shown


def test_who_walks_out_of_the_picture_is_unknown_and_neither_near_nor_free() -> None:
    states = turned_away(0.8)[-1].states
    assert states[0] == states[1] == states[2] == State.UNKNOWN


def test_who_stands_is_remembered() -> None:
    guide = Guide(CAMERA, *SIZE)
    person = cylinder(0.0, 1.7, 0.22, 1.7, "person")
    for n in range(75):
        pose = pose_at(0, 0, float(np.clip(4.0 * (n - 30), 0, 80)))
        situation = guide.update(picture([*HALL, person], pose, n), n / 30, makers.as_pose(pose))
    assert situation.states[2] == State.NEAR


def test_who_walked_and_stands_for_some_seconds_is_remembered() -> None:
    guide = Guide(CAMERA, *SIZE)
    person = cylinder(0.0, 2.9, 0.22, 1.7, "person", -0.8)
    for n in range(75):
        pose = pose_at(0, 0, float(np.clip(6.0 * (n - 55), 0, 80)))
        seen = picture([*HALL, person.at(min(n, 15) / 10)], pose, n)
        situation = guide.update(seen, n / 10, makers.as_pose(pose))
    assert situation.states[2] == State.NEAR


def test_a_mover_reaches_more_directions_the_longer_it_is_gone() -> None:
    movers, shape = Movers((40, 40)), (40, 40)
    columns = np.stack(np.meshgrid(range(19, 22), range(35, 38)), -1).reshape(-1, 2)
    has_changed = np.arange(len(columns)) < 5
    movers.update(columns, has_changed, np.ones(shape, np.bool_), 0.0)
    assert movers.has_moved(columns).all(), "a neighbourhood decides, and no single sample"
    x, z = np.meshgrid(np.arange(40) - 20.0, np.arange(40) - 20.0, indexing="ij")
    places = (0.1 * np.stack([x, 0 * x, z], -1)).reshape(-1, 3).astype(np.float32)
    counts = [int(movers.reached_bins(places, age_s, 2.0).sum()) for age_s in (0.0, 0.1, 0.5, 2.0)]
    assert counts[0] == 0 < counts[1] < counts[2] < counts[3] == 72
    movers.update(columns, np.zeros(len(columns), np.bool_), np.ones(shape, np.bool_), 2.0)
    assert not movers.has_moved(columns).any() and not movers.reached_bins(places, 3.0, 2.0).any()


def test_few_changed_samples_are_errors_of_the_poses() -> None:
    movers = Movers((40, 40))
    columns = np.stack(np.meshgrid(range(10, 20), range(10, 20)), -1).reshape(-1, 2)
    movers.update(columns, np.arange(len(columns)) % 13 == 0, np.ones((40, 40), np.bool_), 0.0)
    assert not movers.has_moved(columns).any()


def test_a_direction_that_a_surface_left_is_not_free_until_it_may_be_passed() -> None:
    lost, distances = LostSurfaces(), np.full(8, np.inf)
    distances[4] = 2.5
    assert not lost.update(distances, 0.0, 2.0).any(), "it is seen"
    nothing = np.full(8, np.inf)
    later = [bool(lost.update(nothing, t, 2.0)[4]) for t in (0.1, 0.8, 1.8, 0.2 + HOLD_S)]
    assert later == [False, True, True, False]
    lost.update(distances, 3.0, 2.0)
    lost.update(nothing, 3.1, 2.0)
    lost.update(distances, 3.8, 2.0)
    assert not lost.update(distances, 3.9, 2.0).any(), "it is back"


def test_what_ends_at_a_border_may_reach_into_the_next_direction() -> None:
    """A pillar at 3 to 8 degrees to the left."""
    azimuths = np.radians(np.linspace(-8, -3, 20))
    points = np.stack([1.5 * np.sin(azimuths), np.ones(20), 1.5 * np.cos(azimuths)], 1).astype(np.float32)
    unseen, seen = np.zeros(72, np.bool_), np.zeros(72, np.bool_)
    seen[36] = True  # the 5 degrees of the right direction beside it
    assert nearest_beside_m(points, MIN_SAMPLES, unseen)[4] == pytest.approx(1.5, abs=0.01)
    assert math.isinf(nearest_beside_m(points, MIN_SAMPLES, seen)[4])


def test_the_ground_stays_level_before_a_raised_floor() -> None:
    """A plane across the edge is tilted by three degrees and fits as many points."""
    way = Corridor([], 3.0, 3.0)
    bodies: list[Body] = floors(0.15, 3.0, 4.4)
    guide = Guide(CAMERA, *SIZE)
    for n in range(70):
        pose = way.pose(n / 30)
        pose[1, 3] = 1.35 + 0.02 * math.sin(0.4 * n)
        ground = guide.update(picture(bodies, pose, n), n / 30, makers.as_pose(pose)).ground
        up = pose[:3, :3].T @ [0, 1, 0]
        assert ground.up @ up > math.cos(math.radians(1.0)), n
        assert ground.height_m == pytest.approx(pose[1, 3], abs=0.04)


@pytest.mark.parametrize("low_m", [2.0, 2.3])
def test_a_raised_floor_is_no_obstacle_without_poses(low_m: float) -> None:
    """The wearer steps up and down again; the floor is never near, and the camera bobs by 2 degrees."""
    bodies = [body for body in floors(0.15, low_m, low_m + 1.2) if body.kind == "floor"]
    way, guide = Corridor(bodies, 3.0, 5.0), Guide(CAMERA, *SIZE)
    shown = []
    for n in range(75):
        pose = way.pose(n / 15)
        situation = guide.update(picture(bodies, pose, n), n / 15)
        assert State.NEAR not in situation.states, n
        assert situation.ground.up @ (pose[:3, :3].T @ [0, 1, 0]) > math.cos(math.radians(1.0)), n
        if low_m + 0.2 < pose[2, 3] < low_m + 1.0:
            shown.append(situation.ahead.drop_m < 2.2)
    assert len(shown) > 10 and all(shown), "the lower floor ahead is no new ground"


def test_a_floor_and_a_step_have_one_tilt() -> None:
    """A single plane through both is tilted by 5 degrees."""
    rng = np.random.default_rng(0)
    x, z = rng.uniform(-1, 1, 3000), rng.uniform(1.4, 3.2, 3000)
    y = 1.35 - np.where(z > 2.2, 0.15, 0.0) + 0.003 * rng.normal(size=3000)
    points, tilted = np.stack([x, y, z], 1), np.array([0.0, -math.cos(0.05), -math.sin(0.05)])
    level = np.array([0.0, -1.0, 0.0])
    scores = parallel_scores(points, np.stack([level, tilted]), np.array([1.35, 1.45]))
    assert scores[0] > 1.2 * scores[1]
    up = parallel_normal(points, tilted)
    assert up is not None and up @ level > math.cos(math.radians(0.1))
    assert plane_height_m(points, up, 1.35, 0.07, 40) == pytest.approx(1.35, abs=0.003)
    assert plane_height_m(points, up, 1.2, 0.07, 40) == pytest.approx(1.2, abs=0.003)
    assert plane_height_m(points, up, 1.5, 0.07, 40) is None
