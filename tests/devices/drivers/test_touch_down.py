"""The automatic probe: free space, contact, a slide at constant force, and release, for any field."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from touchfield.devices.drivers.simulated import STIFFNESS_N_PER_M, SimHand
from touchfield.devices.drivers.touch_down import touch_down
from touchfield.medium import ForceField, Grid, HapticMedium, HapticObject, HapticScene, PoseTrack

GRID = Grid.over_box((-0.05,) * 3, (0.05,) * 3, (40, 40, 40))
POSITIONS_M = np.stack(np.meshgrid(*(GRID.axis_m(a) for a in range(3)), indexing="ij"), axis=-1)
RADIUS = np.linalg.norm(POSITIONS_M, axis=-1, keepdims=True)
SOLID = np.clip(500 * (0.03 - RADIUS), 0, 3.3) * POSITIONS_M / RADIUS
WALL = np.zeros((40, 40, 40, 3))
WALL[:, 20:23, :, 1] = -2.0
DENSE = {
    "solid": SOLID,
    "shell": np.where(RADIUS > 0.03 - 0.0066, SOLID, 0),
    "room": np.clip(500 * (RADIUS - 0.03), 0, 3.3) * -POSITIONS_M / RADIUS,
    "wall": WALL,
    "guide": np.where(RADIUS > 0.03, np.clip(0.8 * (1 - (RADIUS - 0.03) / 0.006), 0, 1), 0)
    * POSITIONS_M
    / RADIUS,
}


def single_frame_medium(field: ForceField) -> HapticMedium:
    return HapticMedium.from_frames([field], 30.0)


def forces_of(field: ForceField, positions_m: np.ndarray) -> np.ndarray:
    return np.linalg.norm(field.sample_n(positions_m).astype(float), axis=-1)


@pytest.mark.parametrize("name", DENSE)
def test_trace_has_contact_slide_and_release(name) -> None:
    field = ForceField.from_dense(GRID, DENSE[name])
    trace = touch_down(single_frame_medium(field))
    forces = forces_of(field, trace.positions_m)
    assert len(trace) == 3001 and trace.times_s[-1] == 3.0
    assert not forces[:500].any() and not forces[2900:].any()  # the probe starts and ends in free space
    pressed = forces[950:2350]
    assert pressed.min() > 0.85 * pressed.max() > 0.5 * np.linalg.norm(DENSE[name], axis=-1).max() * 0.85
    slid = np.linalg.norm(np.diff(trace.positions_m[1050:2250], axis=0), axis=1).sum()
    assert slid > 0.015


@pytest.mark.parametrize("name", ["solid", "shell", "wall", "room"])
def test_probe_approaches_against_the_force(name) -> None:
    field = ForceField.from_dense(GRID, DENSE[name])
    trace = touch_down(single_frame_medium(field))
    come = trace.positions_m[700] - trace.positions_m[0]
    assert field.sample_n(trace.positions_m[960]).astype(float) @ come < 0


def test_probe_force_is_limited() -> None:
    field = ForceField.from_dense(GRID, SOLID)
    forces = forces_of(field, touch_down(single_frame_medium(field), force_max_n=0.7).positions_m)
    assert 0.65 < forces[1000] < 0.75 and forces[950:2350].max() < 0.8


def test_slide_on_an_inclined_wall_has_the_same_length() -> None:
    normal = np.full(3, 3**-0.5)
    trace = touch_down(
        single_frame_medium(
            ForceField.from_dense(GRID, np.clip(-500 * POSITIONS_M @ normal, 0, 3.3)[..., None] * normal)
        )
    )
    slid = np.linalg.norm(np.diff(trace.positions_m[1050:2250], axis=0), axis=1).sum()
    assert slid == pytest.approx(0.2 * np.linalg.norm(np.subtract(*GRID.box_m)), rel=0.02)


def test_probe_moves_without_jumps() -> None:
    trace = touch_down(single_frame_medium(ForceField.from_dense(GRID, SOLID)))
    assert np.linalg.norm(np.diff(trace.positions_m, axis=0), axis=1).max() < 0.0004  # 0.4 m/s


def test_hand_on_a_spring_reaches_the_same_force() -> None:
    field = ForceField.from_dense(GRID, SOLID)
    hand = SimHand(touch_down(single_frame_medium(field), stiffness_n_per_m=STIFFNESS_N_PER_M), "spring")
    hand.open()
    forces = []
    for _ in range(3000):
        force = field.sample_n(hand.position_m())
        hand.put_force_n(*force.tolist())
        forces.append(float(np.linalg.norm(force)))
        hand.advance(0.001)
    rigid = forces_of(field, touch_down(single_frame_medium(field)).positions_m)
    assert forces[1040] == pytest.approx(rigid[1040], rel=0.05)
    assert forces[0] == forces[-1] == 0


def test_probe_rests_in_the_centre_of_an_empty_field() -> None:
    trace = touch_down(single_frame_medium(ForceField.empty(GRID)))
    assert len(trace) == 3001 and np.abs(trace.positions_m).max() < 1e-6


def test_probe_uses_the_frame_of_its_arrival() -> None:
    empty, wall = ForceField.empty(GRID), ForceField.from_dense(GRID, WALL)
    medium = HapticMedium.from_frames([empty] * 3 + [wall] * 12, 10.0)
    trace = touch_down(medium)
    assert trace.times_s[-1] == 1.5
    assert forces_of(wall, trace.positions_m).max() > 1
    # the first frame is empty on arrival: the probe uses the other one
    late = HapticMedium.from_frames([empty] * 14 + [wall], 10.0)
    assert forces_of(wall, touch_down(late).positions_m).max() > 1
    assert touch_down(HapticMedium.from_frames([wall], 1000.0)).times_s[-1] == 3.0
    assert touch_down(medium, start_s=0.5, speed=2.0).times_s[-1] == 0.5
    other = ForceField.from_dense(GRID, np.roll(WALL, -12, axis=1))  # the frame on arrival, at 0.6 s
    quick = touch_down(HapticMedium.from_frames([wall] * 4 + [other] * 26, 10.0), speed=2.0)
    assert forces_of(other, quick.positions_m[len(quick) // 2]) > 1


def test_probe_touches_the_object_of_a_scene() -> None:
    body = HapticMedium.from_frames([ForceField.from_dense(GRID, SOLID)], 10.0)
    track = PoseTrack(np.tile([1.0, 0, 0, 0], (4000, 1)), np.linspace([0, 0, 0], [0.4, 0, 0], 4000))
    scene = HapticScene(GRID, 1000.0, (HapticObject("ball", body, track),), 3.3)
    trace = touch_down(scene)
    arrived = int(0.2 * 3.0 * 1000)
    # just before contact
    assert np.linalg.norm(scene.sample_n(arrived, trace.positions_m[600]), axis=-1) == 0
    assert forces_along(scene, trace)[950:2350].min() > 1


@pytest.mark.parametrize(("start_s", "speed"), [(0.0, 1.0), (0.5, 1.0), (0.0, 0.5)])
def test_probe_stays_on_a_moving_object(start_s: float, speed: float) -> None:
    body = HapticMedium.from_frames([ForceField.from_dense(GRID, SOLID)], 1000.0)
    angles = np.linspace(0, 2, 4000)
    quaternions = np.stack([np.cos(angles), 0 * angles, np.sin(angles), 0 * angles], axis=1)
    positions_m = np.stack([0.3 * np.sin(3 * angles), 0.1 * angles, -0.2 * angles], axis=1)
    # a second body next to it
    weak = HapticMedium.from_frames([ForceField.from_dense(GRID, SOLID).scaled(0.3)], 1000.0)
    static_track = PoseTrack(np.tile([1.0, 0, 0, 0], (4000, 1)), np.tile([-0.3, 0.0, 0.0], (4000, 1)))
    objects = (
        HapticObject("weak", weak, static_track),
        HapticObject("ball", body, PoseTrack(quaternions, positions_m)),
    )
    scene = HapticScene(GRID, 1000.0, objects, 3.3)
    forces = forces_along(scene, touch_down(scene, start_s=start_s, speed=speed), start_s, speed)
    assert not forces[:500].any()
    assert forces[950:2350].min() > 0.85 * forces[950:2350].max() > 1


def forces_along(scene: HapticScene, trace, start_s: float = 0.0, speed: float = 1.0) -> np.ndarray:
    """|F| at the positions of the trace in the frame of each time, newtons."""
    frames = np.rint((start_s + speed * trace.times_s) * scene.rate_hz).astype(int).clip(0, len(scene) - 1)
    forces = [
        scene.sample_n(frame, position_m) for frame, position_m in zip(frames.tolist(), trace.positions_m)
    ]
    return np.linalg.norm(forces, axis=-1)


@pytest.mark.parametrize(
    "axes", ["x right, y down, z forward", "x right, y up, z towards the viewer", "x east, y north, z up"]
)
@pytest.mark.parametrize("name", ["solid", "shell"])
def test_probe_approaches_from_the_user(name: str, axes: str) -> None:
    medium = HapticMedium.from_frames([ForceField.from_dense(GRID, DENSE[name])], 30.0, axes)
    trace = touch_down(medium)
    way = trace.positions_m[0] - trace.positions_m[1000]
    viewer = -1 if "forward" in axes else 1
    assert viewer * way[2] > 0.7 * np.linalg.norm(way)


def test_wall_that_pushes_away_from_the_user_is_approached_from_behind() -> None:
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
    trace = touch_down(single_frame_medium(field), stiffness_n_per_m=math.inf if seed % 2 else 300.0)
    assert len(trace) == 3001
