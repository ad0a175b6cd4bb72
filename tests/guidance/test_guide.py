"""The situation around a wearer against scenes with ground truth."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import corridor_makers as makers
from corridor_makers import Body, Corridor, box, cylinder
from touchfield.errors import InvalidArgument
from touchfield.guidance import Guide, GuideSpec, Situation
from touchfield.guidance.contact import ContactTimer
from touchfield.guidance.guide import State
from touchfield.guidance.view import DepthView
from touchfield.sources.camera import Intrinsics

SIZE, CAMERA = makers.REDUCED, makers.kinect(makers.REDUCED)
FLOOR = Body((-20.0, -0.3, -20.0), (20.0, 0.0, 20.0), "floor")
HALL = [
    FLOOR,
    Body((-20.0, -1.0, -4.2), (20.0, 3.0, -4.0), "wall"),
    Body((-20.0, -1.0, 4.0), (20.0, 3.0, 4.2), "wall"),
    Body((-4.2, -1.0, -20.0), (-4.0, 3.0, 20.0), "wall"),
    Body((4.0, -1.0, -20.0), (4.2, 3.0, 20.0), "wall"),
]
"""A hall of 8 x 8 m, whose walls are out of the way of a person in the middle."""


def pose_at(
    x: float, z: float, yaw_deg: float, pitch_deg: float = 20.0, height_m: float = 1.35
) -> np.ndarray:
    """World from camera at a place, turned to the right by `yaw_deg`, left-handed as in the makers."""
    still = Corridor([FLOOR], 3.0, 1.0, 0.0, height_m, pitch_deg, look_deg=0.0)
    pose = still.pose(0.0)
    angle = math.radians(yaw_deg) - math.atan2(pose[0, 2], pose[2, 2])
    turn = np.array(
        [[math.cos(angle), 0, math.sin(angle)], [0, 1, 0], [-math.sin(angle), 0, math.cos(angle)]]
    )
    pose[:3, :3] = turn @ pose[:3, :3]
    pose[:3, 3] = (x, height_m, z)
    return pose


def picture(bodies: list[Body], pose: np.ndarray, seed: int | None = 0) -> np.ndarray:
    """What a Kinect sees, or the exact depth up to 5 m without a seed."""
    exact, _ = makers.exact_depth(bodies, pose, CAMERA, SIZE)
    if seed is None:
        return np.where(exact < makers.LONGEST_M, exact, 0).astype(np.float32)
    return makers.with_noise(exact, np.random.default_rng(seed))


def seen(bodies: list[Body], pose: np.ndarray, frames: int = 4, spec: GuideSpec | None = None) -> Situation:
    """The situation after some noisy frames without poses."""
    guide = Guide(CAMERA, *SIZE, spec)
    for n in range(frames):
        situation = guide.update(picture(bodies, pose, n), n / 30)
    return situation


# -- ground ------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("pitch_deg", [5.0, 20.0, 45.0])
@pytest.mark.parametrize("height_m", [0.8, 1.35, 1.7])
def test_the_ground_is_the_floor_below_furniture(pitch_deg: float, height_m: float) -> None:
    table = Body((-0.5, 0.45, 1.5), (0.5, 0.5, 2.5), "table")  # a smaller plane, and nearer
    pose = pose_at(0, 0, 0, pitch_deg, height_m)
    ground = seen([*HALL, table], pose, spec=GuideSpec(pitch_deg=min(pitch_deg, 30.0))).ground
    assert ground.is_seen and ground.height_m == pytest.approx(height_m, abs=0.03)
    assert ground.up @ (pose[:3, :3].T @ [0, 1, 0]) > math.cos(math.radians(1.5))


def test_a_wall_is_no_ground() -> None:
    wall = [Body((-9, -9, 1.5), (9, 9, 1.7), "wall")]
    situation = seen(wall, pose_at(0, 0, 0, 20.0))
    assert not situation.ground.is_seen and situation.ahead == (math.inf, math.inf)


def test_a_stated_height_excludes_other_planes() -> None:
    desk = [*HALL, Body((-3, 0.6, 0.5), (3, 0.75, 3.9), "desk")]  # hides the floor
    pose = pose_at(0, 0, 0, 30.0)
    spec = GuideSpec(pitch_deg=25.0)
    assert seen(desk, pose, spec=spec).ground.height_m == pytest.approx(0.6, abs=0.03)
    assert not seen(desk, pose, spec=replace(spec, camera_height_m=1.35)).ground.is_seen


# -- directions --------------------------------------------------------------------------------------------
def test_an_empty_hall_is_free_ahead_and_unknown_behind() -> None:
    situation = seen(HALL, pose_at(0, 0, 0))
    assert situation.states[3:5] == (State.FREE, State.FREE)
    assert situation.states[:2] + situation.states[6:] == (State.UNKNOWN,) * 4


@pytest.mark.parametrize("body", ["box", "low box", "pole", "person"])
@pytest.mark.parametrize(("azimuth_deg", "direction"), [(-24, 3), (-8, 3), (8, 4), (24, 4)])
def test_an_obstacle_is_near_in_its_direction_only(body: str, azimuth_deg: int, direction: int) -> None:
    x, z = 1.8 * math.sin(math.radians(azimuth_deg)), 1.8 * math.cos(math.radians(azimuth_deg))
    made = {
        "box": box(x, z, 0.3, 0.8, "box"),
        "low box": box(x, z, 0.3, 0.35, "low box"),
        "pole": cylinder(x, z, 0.04, 2.0, "pole"),
        "person": cylinder(x, z, 0.2, 1.7, "person"),
    }[body]
    situation = seen([*HALL, made], pose_at(0, 0, 0))
    assert situation.states[direction] == State.NEAR
    distance_m, _ = makers.nearest_point(made, pose_at(0, 0, 0))
    assert situation.distances_m[direction] == pytest.approx(distance_m, abs=0.1)
    assert situation.states[7 - direction] == State.FREE


def test_a_sign_above_the_head_is_not_in_the_way() -> None:
    sign = [*HALL, Body((-0.5, 2.1, 1.5), (0.5, 2.4, 1.6), "sign")]
    spec = GuideSpec(pitch_deg=-10.0, camera_height_m=1.35)  # no floor in the picture
    assert State.NEAR not in seen(sign, pose_at(0, 0, 0, pitch_deg=-10), spec=spec).states
    lower = [*HALL, Body((-0.5, 1.5, 1.5), (0.5, 1.9, 1.6), "sign")]
    assert seen(lower, pose_at(0, 0, 0, pitch_deg=5)).states[3:5] == (State.NEAR, State.NEAR)


def test_poses_remember_all_eight_directions() -> None:
    """A person turns once; poles stand in every second direction."""
    poles = [
        cylinder(1.6 * math.sin(a), 1.6 * math.cos(a), 0.1, 1.8, "pole")
        for a in np.radians([-157.5, -67.5, 22.5, 112.5])
    ]
    bodies, guide = [*HALL, *poles], Guide(CAMERA, *SIZE)
    for n in range(73):
        pose = pose_at(0, 0, 5.0 * n)
        situation = guide.update(picture(bodies, pose, n), n / 30, makers.as_pose(pose))
    assert situation.states == (State.NEAR, State.FREE) * 4
    assert situation.distances_m[::2] == pytest.approx(1.5, abs=0.12)
    for n in range(3):
        later = guide.update(picture(bodies, pose, n), 14 + n / 30, makers.as_pose(pose))
    assert later.states[:2] == (State.UNKNOWN,) * 2, "after memory_s, somebody may have come"


def test_a_jump_of_the_poses_forgets() -> None:
    guide, pose = Guide(CAMERA, *SIZE), pose_at(0, 0, 0)
    pillar = [*HALL, cylinder(0.5, 1.5, 0.2, 1.8, "person")]
    for n in range(4):
        guide.update(picture(pillar, pose, n), n / 30, makers.as_pose(pose))
    moved = pose_at(2.0, 0, 180)
    situation = guide.update(picture(HALL, moved, 5), 5 / 30, makers.as_pose(moved))
    assert guide.pose_jumps == 1 and State.NEAR not in situation.states


# -- what is not known is never free -----------------------------------------------------------------------
def test_a_blind_picture_is_unknown_everywhere() -> None:
    guide = Guide(CAMERA, *SIZE)
    for n in range(3):
        guide.update(picture(HALL, pose_at(0, 0, 0), n), n / 30)
    depth = picture(HALL, pose_at(0, 0, 0), 3)
    depth[: int(0.85 * SIZE[1])] = 0
    situation = guide.update(depth, 0.1)
    assert situation.is_blind and situation.states == (State.UNKNOWN,) * 8


@pytest.mark.parametrize("side", [3, 4])
def test_a_blind_half_is_unknown_and_the_other_free(side: int) -> None:
    guide = Guide(CAMERA, *SIZE)
    for n in range(4):
        depth = picture(HALL, pose_at(0, 0, 0), n)
        depth[:, slice(None, 80) if side == 3 else slice(80, None)] = 0
        situation = guide.update(depth, n / 30)
    assert situation.states[side] == State.UNKNOWN and situation.states[7 - side] == State.FREE


@pytest.mark.parametrize("value", [np.nan, np.inf, -1.0])
def test_values_that_are_no_depth_are_unknown(value: float) -> None:
    guide = Guide(CAMERA, *SIZE)
    assert guide.update(np.full(SIZE[::-1], value, np.float32), 0.0).is_blind


def test_pictures_that_do_not_fit_are_refused() -> None:
    with pytest.raises(InvalidArgument, match="24 pixels"):
        Guide(Intrinsics(9, 9, 5, 4), 12, 9)
    with pytest.raises(InvalidArgument, match="shape"):
        Guide(CAMERA, *SIZE).update(np.ones((10, 10), np.float32), 0.0)
    view = DepthView(makers.kinect(makers.VGA), *makers.VGA)
    assert view.size_px == (120, 160) and view.stride == 4


# -- contact -----------------------------------------------------------------------------------------------
def test_time_to_contact_of_a_surface_that_comes_nearer() -> None:
    rng, timer = np.random.default_rng(0), ContactTimer()
    times = np.arange(30) / 30
    contact = [timer.update(t, 2.5 - 0.9 * t + 0.01 * rng.normal()) for t in times]
    assert contact[-1] == pytest.approx((2.5 - 0.9 * times[-1]) / 0.9, rel=0.15)
    assert math.isinf(contact[0]) and math.isinf(timer.update(1.0, 0.8)), "a jump is another surface"


def test_a_surface_at_rest_has_no_time_to_contact() -> None:
    rng, timer = np.random.default_rng(0), ContactTimer()
    assert all(math.isinf(timer.update(n / 30, 1.0 + 0.01 * rng.normal())) for n in range(60))


# -- steps -------------------------------------------------------------------------------------------------
def floors(height_m: float, low: float = 2.0, high: float = 6.0) -> list[Body]:
    """A floor whose height changes from z = `low` to `high`."""
    near = Body((-3.9, -0.3, -3.9), (3.9, 0.0, low), "floor")
    other = Body((-3.9, height_m - 1.0, low), (3.9, height_m, high), "floor")
    return [*HALL[1:], near, other, Body((-3.9, -0.3, high), (3.9, 0.0, 9.0), "floor")]


@pytest.mark.parametrize("height_m", [0.12, 0.2])
def test_a_step_up_is_found_at_its_distance(height_m: float) -> None:
    ahead = seen(floors(height_m), pose_at(0, 0, 0, 25.0)).ahead
    assert ahead.step_m == pytest.approx(2.0, abs=0.2) and math.isinf(ahead.drop_m)


@pytest.mark.parametrize(("height_m", "high"), [(-0.15, 6.0), (-0.5, 3.0), (-2.5, 6.0)])
def test_a_drop_is_found_at_its_distance(height_m: float, high: float) -> None:
    ahead = seen(floors(height_m, 2.0, high), pose_at(0, 0, 0, 25.0)).ahead
    assert ahead.drop_m == pytest.approx(2.0, abs=0.25) and math.isinf(ahead.step_m)


def test_a_flat_floor_and_a_person_are_no_step() -> None:
    for n in range(5):
        person = [*HALL, cylinder(0.1, 1.9, 0.2, 1.7, "person")]
        assert seen(person, pose_at(0, 0, 3.0 * n)).ahead == (math.inf, math.inf)


def test_a_drop_that_left_the_picture_is_held_until_it_is_passed() -> None:
    guide, bodies = Guide(CAMERA, *SIZE), floors(-0.3, 2.0, 2.8)
    shown = []
    for n in range(90):
        pose = pose_at(0, n / 30, 0, 25.0)
        situation = guide.update(picture(bodies, pose, n), n / 30, makers.as_pose(pose))
        shown.append(situation.ahead.drop_m)
    edges = 2.0 - np.arange(90) / 30  # distance of the edge
    assert all(math.isfinite(d) for d, edge in zip(shown, edges, strict=True) if 0.2 < edge < 1.6)
