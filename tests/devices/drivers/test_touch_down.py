"""The probe that touches a field by itself: free, contact, a slide at one force, release; for any field."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from touchfield.devices.drivers.simulated import STIFFNESS_N_PER_M, SimHand
from touchfield.devices.drivers.touch_down import touch_down
from touchfield.medium import ForceField, Grid, HapticMedium, HapticObject, HapticScene, PoseTrack

GRID = Grid.over_box((-0.05,) * 3, (0.05,) * 3, (40, 40, 40))
PLACES = np.stack(np.meshgrid(*(GRID.axis_m(a) for a in range(3)), indexing="ij"), axis=-1)
RADIUS = np.linalg.norm(PLACES, axis=-1, keepdims=True)
SOLID = np.clip(500 * (0.03 - RADIUS), 0, 3.3) * PLACES / RADIUS
WALL = np.zeros((40, 40, 40, 3))
WALL[:, 20:23, :, 1] = -2.0
DENSE = {
    "solid": SOLID,
    "shell": np.where(RADIUS > 0.03 - 0.0066, SOLID, 0),
    "room": np.clip(500 * (RADIUS - 0.03), 0, 3.3) * -PLACES / RADIUS,
    "wall": WALL,
    "guide": np.where(RADIUS > 0.03, np.clip(0.8 * (1 - (RADIUS - 0.03) / 0.006), 0, 1), 0) * PLACES / RADIUS,
}


def still(field: ForceField) -> HapticMedium:
    return HapticMedium.from_frames([field], 30.0)


def forces_of(field: ForceField, places: np.ndarray) -> np.ndarray:
    return np.linalg.norm(field.sample_n(places).astype(float), axis=-1)


@pytest.mark.parametrize("name", DENSE)
def test_contact_slide_and_release_are_there(name) -> None:
    field = ForceField.from_dense(GRID, DENSE[name])
    trace = touch_down(still(field))
    forces = forces_of(field, trace.positions_m)
    assert len(trace) == 3001 and trace.times_s[-1] == 3.0
    assert not forces[:500].any() and not forces[2900:].any()  # comes and goes through free space
    pressed = forces[950:2350]
    assert pressed.min() > 0.85 * pressed.max() > 0.5 * np.linalg.norm(DENSE[name], axis=-1).max() * 0.85
    slid = np.linalg.norm(np.diff(trace.positions_m[1050:2250], axis=0), axis=1).sum()
    assert slid > 0.015


@pytest.mark.parametrize("name", ["solid", "shell", "wall", "room"])
def test_it_comes_against_the_force(name) -> None:
    field = ForceField.from_dense(GRID, DENSE[name])
    trace = touch_down(still(field))
    come = trace.positions_m[700] - trace.positions_m[0]
    assert field.sample_n(trace.positions_m[960]).astype(float) @ come < 0


def test_it_presses_no_harder_than_it_may() -> None:
    field = ForceField.from_dense(GRID, SOLID)
    forces = forces_of(field, touch_down(still(field), force_max_n=0.7).positions_m)
    assert 0.65 < forces[1000] < 0.75 and forces[950:2350].max() < 0.8


def test_on_a_wall_that_leans_the_slide_is_as_long_as_on_any() -> None:
    normal = np.full(3, 3**-0.5)
    trace = touch_down(
        still(ForceField.from_dense(GRID, np.clip(-500 * PLACES @ normal, 0, 3.3)[..., None] * normal))
    )
    slid = np.linalg.norm(np.diff(trace.positions_m[1050:2250], axis=0), axis=1).sum()
    assert slid == pytest.approx(0.2 * np.linalg.norm(np.subtract(*GRID.box_m)), rel=0.02)


def test_it_moves_without_jumps() -> None:
    trace = touch_down(still(ForceField.from_dense(GRID, SOLID)))
    assert np.linalg.norm(np.diff(trace.positions_m, axis=0), axis=1).max() < 0.0004  # 0.4 m/s


def test_a_hand_on_a_spring_comes_to_the_same_force() -> None:
    field = ForceField.from_dense(GRID, SOLID)
    hand = SimHand(touch_down(still(field), stiffness_n_per_m=STIFFNESS_N_PER_M), "spring")
    hand.open()
    forces = []
    for _ in range(3000):
        force = field.sample_n(hand.position_m())
        hand.put_force_n(*force.tolist())
        forces.append(float(np.linalg.norm(force)))
        hand.advance(0.001)
    rigid = forces_of(field, touch_down(still(field)).positions_m)
    assert forces[1040] == pytest.approx(rigid[1040], rel=0.05)
    assert forces[0] == forces[-1] == 0


def test_in_an_empty_field_the_probe_rests_in_the_middle() -> None:
    trace = touch_down(still(ForceField.empty(GRID)))
    assert len(trace) == 3001 and np.abs(trace.positions_m).max() < 1e-6


def test_a_medium_is_touched_as_it_is_when_the_probe_arrives_and_within_its_time() -> None:
    empty, wall = ForceField.empty(GRID), ForceField.from_dense(GRID, WALL)
    medium = HapticMedium.from_frames([empty] * 3 + [wall] * 12, 10.0)
    trace = touch_down(medium)
    assert trace.times_s[-1] == 1.5
    assert forces_of(wall, trace.positions_m).max() > 1
    late = HapticMedium.from_frames(
        [empty] * 14 + [wall], 10.0
    )  # empty when it arrives: the frame that is not
    assert forces_of(wall, touch_down(late).positions_m).max() > 1
    assert touch_down(HapticMedium.from_frames([wall], 1000.0)).times_s[-1] == 3.0
    assert touch_down(medium, start_s=0.5, speed=2.0).times_s[-1] == 0.5
    other = ForceField.from_dense(GRID, np.roll(WALL, -12, axis=1))  # there when the probe arrives, at 0.6 s
    quick = touch_down(HapticMedium.from_frames([wall] * 4 + [other] * 26, 10.0), speed=2.0)
    assert forces_of(other, quick.positions_m[len(quick) // 2]) > 1


def test_a_scene_of_objects_is_touched_where_the_object_is() -> None:
    body = HapticMedium.from_frames([ForceField.from_dense(GRID, SOLID)], 10.0)
    track = PoseTrack(np.tile([1.0, 0, 0, 0], (4000, 1)), np.linspace([0, 0, 0], [0.4, 0, 0], 4000))
    scene = HapticScene(GRID, 1000.0, (HapticObject("ball", body, track),), 3.3)
    trace = touch_down(scene)
    arrived = int(0.2 * 3.0 * 1000)
    assert np.linalg.norm(scene.sample_n(arrived, trace.positions_m[600]), axis=-1) == 0  # it is just before
    assert met(scene, trace)[950:2350].min() > 1


@pytest.mark.parametrize(("start_s", "speed"), [(0.0, 1.0), (0.5, 1.0), (0.0, 0.5)])
def test_an_object_that_moves_and_turns_is_met_all_the_time(start_s: float, speed: float) -> None:
    body = HapticMedium.from_frames([ForceField.from_dense(GRID, SOLID)], 1000.0)
    turns = np.linspace(0, 2, 4000)
    quaternions = np.stack([np.cos(turns), 0 * turns, np.sin(turns), 0 * turns], axis=1)
    places = np.stack([0.3 * np.sin(3 * turns), 0.1 * turns, -0.2 * turns], axis=1)
    weak = HapticMedium.from_frames(
        [ForceField.from_dense(GRID, SOLID).scaled(0.3)], 1000.0
    )  # a body beside it
    beside = PoseTrack(np.tile([1.0, 0, 0, 0], (4000, 1)), np.tile([-0.3, 0.0, 0.0], (4000, 1)))
    objects = HapticObject("weak", weak, beside), HapticObject("ball", body, PoseTrack(quaternions, places))
    scene = HapticScene(GRID, 1000.0, objects, 3.3)
    forces = met(scene, touch_down(scene, start_s=start_s, speed=speed), start_s, speed)
    assert not forces[:500].any()
    assert forces[950:2350].min() > 0.85 * forces[950:2350].max() > 1


def met(scene: HapticScene, trace, start_s: float = 0.0, speed: float = 1.0) -> np.ndarray:
    """|F| where the hand is, in the frame of that moment, newtons."""
    frames = np.rint((start_s + speed * trace.times_s) * scene.rate_hz).astype(int).clip(0, len(scene) - 1)
    forces = [scene.sample_n(frame, place) for frame, place in zip(frames.tolist(), trace.positions_m)]
    return np.linalg.norm(forces, axis=-1)


@pytest.mark.parametrize(
    "axes", ["x right, y down, z forward", "x right, y up, z towards the viewer", "x east, y north, z up"]
)
@pytest.mark.parametrize("name", ["solid", "shell"])
def test_the_hand_comes_from_where_the_user_sits(name: str, axes: str) -> None:
    medium = HapticMedium.from_frames([ForceField.from_dense(GRID, DENSE[name])], 30.0, axes)
    trace = touch_down(medium)
    way = trace.positions_m[0] - trace.positions_m[1000]
    viewer = -1 if "forward" in axes else 1
    assert viewer * way[2] > 0.7 * np.linalg.norm(way)


def test_a_wall_that_pushes_away_from_the_user_is_met_from_behind() -> None:
    dense = np.zeros((40, 40, 40, 3))
    dense[:, :, 20:23, 2] = -2.0
    trace = touch_down(
        HapticMedium.from_frames([ForceField.from_dense(GRID, dense)], 30.0, "x right, y up, z back")
    )
    assert trace.positions_m[0][2] < trace.positions_m[1000][2]


@given(st.integers(0, 6), st.integers(0, 1000), st.sampled_from([(1, 1, 1), (9, 1, 5), (12, 10, 8)]))
def test_any_field_gives_a_trace(count, seed, shape) -> None:
    chance = np.random.default_rng(seed)
    grid = Grid(shape, (0.001, 0.002, 0.5), (0.0, 1.0, 2.0))
    positions = chance.integers(0, shape, (count, 3))
    field = ForceField.from_support(grid, positions, chance.normal(size=(count, 3)).astype(np.float32))
    trace = touch_down(still(field), stiffness_n_per_m=math.inf if seed % 2 else 300.0)
    assert len(trace) == 3001
