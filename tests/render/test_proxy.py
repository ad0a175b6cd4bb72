"""The proxy: thin plates hold, thick bodies keep the force of the field, friction drags, motion carries."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
import pytest
from heap_makers import behind_surface, heap_of_boxes
from player_makers import laid_out
from proxy_makers import DT_S, STRONG, Held, field_of, ramp_n
from seam_makers import Played

from touchfield.devices.drivers.simulated import SimHand
from touchfield.errors import InvalidArgument
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.medium.deformation import Deformation
from touchfield.medium.medium import HapticObject, HapticScene, VibrationFrame
from touchfield.medium.pose_track import PoseTrack
from touchfield.medium.trace import Trace
from touchfield.pipeline import prepare
from touchfield.pipeline.spec import EncodeSpec
from touchfield.render.feeder import FrameSource
from touchfield.render.offline import run_offline
from touchfield.render.spec import RenderSpec, stated_n_per_m, wall_of
from touchfield.render.tool import Tool
from touchfield.sources.shapes.shapes import Box, Sphere

UNTURNED = (1.0, 0.0, 0.0, 0.0)
BALL = Sphere((0.0, 0.0, 0.0), 0.025)
BLOCK = Box((0.0, 0.0, 0.0), (0.03, 0.02, 0.015))


def plate(thickness_m: float, nw: int = 7) -> ForceField:
    return field_of(Box((0.0, 0.0, 0.0), (0.03, 0.02, thickness_m / 2)), nw=nw)


def into(rendered: Held, start: np.ndarray, end: np.ndarray, steps: int = 60) -> np.ndarray:
    """The force after a straight path of the hand."""
    for weight in np.linspace(0, 1, steps):
        force = rendered.tick(start + weight * (end - start))
    return force


@pytest.mark.parametrize("thickness_mm", [1, 2, 5])
def test_a_thin_plate_holds_three_newtons_and_the_plain_field_does_not(thickness_mm: int) -> None:
    field = plate(1e-3 * thickness_mm)
    start, push = (0.004, -0.003, 0.006), ramp_n((0, 0, -1))
    hand, forces, proxy = Held(field).pushed(start, push, 1.0)
    assert proxy[:, 2].min() > 0.0  # never beyond the plate
    assert np.linalg.norm(forces[-1] - [0, 0, 3.0]) < 0.05 and abs(hand[-1, 2] - hand[-50, 2]) < 2e-5
    hand, _, _ = Held(field, is_proxy=False).pushed(start, push, 1.0)
    assert hand[-1, 2] < -0.02


def test_edges_and_corners_hold() -> None:
    thin, level = plate(0.002), 6 * 0.05
    hand, _, proxy = Held(thin).pushed((0.028, 0.0, 0.006), ramp_n((0, 0, -1)), 1.0)  # 2 mm from the edge
    assert proxy[:, 2].min() > 0 and hand[-1, 2] > -0.02
    corner = field_of(Box((0, 0, 0), (0.03, 0.02, 0.004)), Box((0.02, 0, 0.012), (0.004, 0.02, 0.016)))
    hand, forces, proxy = Held(corner).pushed((0.005, 0.0, 0.012), ramp_n((1, 0, -1)), 1.2)
    assert (np.linalg.norm(corner.sample_n(proxy), axis=1) < level).all()
    assert np.linalg.norm(forces[-1] - 3.0 * np.array([-1, 0, 1]) / np.sqrt(2)) < 0.15
    assert 0.0145 < proxy[-1, 0] < 0.017 and -0.009 < proxy[-1, 2] < -0.0065  # the centre is at 0
    block = field_of(BLOCK)
    push = ramp_n((-1, 0, -1), guided_n_per_m=500.0)
    hand, forces, proxy = Held(block).pushed((0.036, 0.0, 0.021), push, 1.0)  # onto an edge
    assert (np.linalg.norm(block.sample_n(proxy), axis=1) < level).all() and np.linalg.norm(forces[-1]) > 2.0
    assert (
        np.linalg.norm(hand[-1] - hand[-200]) < 1e-3 and proxy[-1, 2] > 0.0145
    )  # it stays on the edge or above it


def test_forces_of_thick_bodies_are_those_of_the_field() -> None:
    rng = np.random.default_rng(1)
    ball, block = Held(field_of(BALL)), Held(field_of(BLOCK))
    errors = []
    for depth in (0.002, 0.004, 0.006):
        for _ in range(10):
            unit = rng.normal(size=3)
            unit /= np.linalg.norm(unit)
            ball.memory.receiver["state"]["proxy"]["is_active"] = 0.0
            force = into(ball, 0.03 * unit, (0.025 - depth) * unit)
            errors.append(np.linalg.norm(force / (500 * depth) - unit))
            x, y = rng.uniform(-0.6, 0.6, 2) * (0.02, 0.01)
            block.memory.receiver["state"]["proxy"]["is_active"] = 0.0
            force = into(block, np.array([x, y, 0.02]), np.array([x, y, 0.015 - depth]))
            assert np.linalg.norm(force / (500 * depth) - [0, 0, 1]) < 0.01
    assert np.mean(errors) < 0.01 and max(errors) < 0.02


@pytest.mark.parametrize(
    ("stiffness", "spacing_m"), [(500, 0.0044), (2000, 0.00125), (1000, 0.0022), (500, 0.001)]
)
def test_a_wall_saturated_within_two_samples_starts_at_its_surface(
    stiffness: float, spacing_m: float
) -> None:
    grid = Grid((24, 24, 24), (spacing_m,) * 3, (-11.5 * spacing_m,) * 3)
    forces = np.zeros((*grid.shape, 3), np.float32)
    forces[..., 2] = np.minimum(stiffness * np.maximum(-grid.axis_m(2), 0.0), 3.3)
    rendered = Held(ForceField.from_dense(grid, forces), stiffness=stiffness)
    for fraction in (0.3, 0.5, 0.8):
        rendered.memory.receiver["state"]["proxy"]["is_active"] = 0.0
        depth = fraction * 3.3 / stiffness
        force = into(rendered, np.array([0.0, 0.0, 2 * spacing_m]), np.array([0.0, 0.0, -depth]))
        assert force[2] == pytest.approx(stiffness * depth, rel=0.3, abs=0.1)


def test_a_resting_hand_on_a_rough_surface_gets_no_step() -> None:
    smooth, rng = field_of(BLOCK), np.random.default_rng(3)
    noise = rng.normal(size=smooth.forces_n.shape) * np.linalg.norm(smooth.forces_n, axis=-1, keepdims=True)
    rough = Held(ForceField(smooth.grid, smooth.bricks, (smooth.forces_n + 0.2 * noise).astype(np.float32)))
    for _ in range(40):
        rough.memory.receiver["state"]["proxy"]["is_active"] = 0.0
        x, y = rng.uniform(-0.7, 0.7, 2) * (0.03, 0.02)
        end = np.array([x, y, rng.uniform(0.008, 0.012)])
        assert into(rough, np.array([x, y, 0.019]), end, 100).any()
        forces = np.array([rough.tick(end) for _ in range(150)])
        assert np.linalg.norm(np.diff(forces[100:], axis=0), axis=1).max() < 0.008  # was 0.4 N


@pytest.mark.parametrize("shape", [Box((0, 0, 0), (0.02, 0.02, 0.02)), Sphere((0, 0, 0), 0.02)])
def test_a_hand_that_slides_off_is_released_once(shape: Box | Sphere) -> None:
    """From contact to release the force is never zero; before and after, it is the stored force.

    A damper may fade for a while, of less than 5 mN here (`touch_proxy_damping.h`). Outside a surface the
    stored force oscillates around zero, below the level of the proxy.
    """
    field, rng = field_of(shape, nw=6 if isinstance(shape, Box) else 7), np.random.default_rng(0)
    releases = 0
    for _ in range(60):
        rendered = Held(field)
        inwards = rng.normal(size=3)
        inwards /= np.linalg.norm(inwards)
        along = np.cross(inwards, rng.normal(size=3))
        along /= np.linalg.norm(along)
        path = [(0.036 - 0.019 * weight) * inwards for weight in np.linspace(0, 1, 200)]
        path += [path[-1] + s * along for s in np.arange(0.0, 0.04, 0.00025)]
        rows = [(rendered.tick(point), rendered.value("state.proxy.is_in_contact")) for point in path]
        forces, stored = np.array([force for force, _ in rows]), field.sample_n(path)
        sizes = np.linalg.norm(forces, axis=1)
        first = [bool(is_in_contact) for _, is_in_contact in rows].index(True)
        last = np.flatnonzero(sizes > rendered.wall.level_n)[-1] + 1
        assert (sizes[first:last] > 0).all()
        if last > len(path) - 20:  # a corner of the box is longer than the way
            continue
        releases += 1
        eased = np.linalg.norm(forces - stored, axis=1)
        assert eased[:first].max() < 1e-6 and (np.diff(eased[last:]) <= 1e-7).all()
        assert eased[last] < 2 * rendered.wall.level_n and eased[last + 10 :].max() < 5e-3
    assert releases > 30


def test_a_hand_that_slips_round_a_rim_feels_nothing_in_free_space() -> None:
    """It was braked for 0.7 s by what was still owed from the plate."""
    field, rim_m = field_of(Box((0.0, 0.0, 0.0), (0.0025, 0.03, 0.02))), np.array([0.006, 0.0, -0.018])
    rendered = Held(field)

    def push(t: float, hand_m: np.ndarray) -> np.ndarray:
        """A spring of 200 N/m, whose end goes straight into the plate."""
        way_m = min(1.0, t / 0.4) * (0.0035 + 2.4 / 200.0)
        return 200.0 * (rim_m - np.array([way_m, 0.0, 0.0]) - hand_m)

    hand, forces, proxy = rendered.pushed(rim_m, push, 1.5)
    is_free = (hand[:, 0] < -0.003) & (np.linalg.norm(proxy - hand, axis=1) < 1e-6)
    is_free &= np.linalg.norm(field.sample_n(hand), axis=1) < 0.4 * rendered.wall.level_n
    first = np.flatnonzero(is_free)[0]
    is_felt = is_free & (np.linalg.norm(forces, axis=1) > rendered.wall.level_n)
    assert is_free[-1] and not is_felt[first + 100 :].any()


@pytest.mark.parametrize("thickness_mm", [1, 2, 5])
def test_a_thin_plate_is_little_stiffer_than_its_field(thickness_mm: int) -> None:
    """Behind the middle of a plate the stored force falls, and that of the proxy's spring takes over."""
    rendered, step_m = Held(plate(1e-3 * thickness_mm)), 2e-5
    path = np.array([(0.004, -0.003, z) for z in np.arange(0.004, -0.006, -step_m)])
    forces, stored = (
        np.array([rendered.tick(hand) for hand in path])[:, 2],
        rendered.field.sample_n(path)[:, 2],
    )
    steepest_n = np.abs(np.diff(stored)).max()
    assert 0 < np.diff(forces).max() < 1.6 * steepest_n  # 3 to 4.3 where the one is switched for the other
    assert (np.maximum.accumulate(forces) - forces).max() < 0.15
    assert forces[-1] > rendered.wall.stiffness_n_per_m * 0.006


def test_a_coupling_softens_a_thick_wall() -> None:
    for coupling_n_per_m in (150.0, 500.0):
        rendered = Held(field_of(BALL))
        rendered.memory.receiver["settings"]["coupling_n_per_m"] = coupling_n_per_m
        force = into(rendered, np.array([0.0, 0.0, 0.03]), np.array([0.0, 0.0, 0.022]))
        expected_n = 0.003 / (1 / rendered.wall.stiffness_n_per_m + 1 / coupling_n_per_m)
        assert abs(force[2] / expected_n - 1) < 0.03


def test_a_proxy_that_jumps_pulls_a_hand_at_rest_slowly() -> None:
    """As where a surface vanishes: the force goes down to that of the other one within seconds."""
    rendered, hand = Held(plate(0.002)), np.array([0.004, -0.003, -0.003])
    before = into(rendered, np.array([0.004, -0.003, 0.006]), hand)
    rendered.memory.receiver["state"]["proxy"]["position_m"] = (0.004, -0.003, -0.002)
    forces = np.array([before, *(rendered.tick(hand) for _ in range(4000))])
    steps = np.linalg.norm(np.diff(forces, axis=0), axis=1)
    assert before[2] > 0.5 and steps.max() < 1.05e-3 * rendered.wall.large_n
    assert np.linalg.norm(forces[-1]) < 0.01 and (np.diff(forces[:, 2]) <= 1e-9).all()


def test_a_proxy_that_slides_about_turns_no_force_on_a_hand_at_rest() -> None:
    """While the field gets weaker, the force on a hand at rest changes along the field's own change."""
    strong, hand = field_of(BLOCK), np.array([0.0, 0.0, 0.012])
    weak = replace(strong, forces_n=0.2 * strong.forces_n)
    medium = HapticMedium.from_frames([strong, strong, strong, weak, weak], 10.0)
    played = Played(medium, spec=RenderSpec(render="proxy", up="lattice"))
    for weight in np.linspace(0.0, 1.0, 100):
        played.tick((1 - weight) * np.array([0.0, 0.0, 0.02]) + weight * hand)
    played.at_rest(hand, 120)
    forces, stored = [], []
    for n in range(60):
        played.memory.receiver["state"]["proxy"]["position_m"] = (0.008 * (-1) ** n, 0.0, 0.015)
        forces.append(played.tick(hand))
        stored.append(played.value("state.proxy.stored_n"))
    own, steps = np.diff(stored, axis=0), np.diff(forces, axis=0)
    own_n = np.linalg.norm(own, axis=1, keepdims=True)
    across = steps - (steps * own).sum(axis=1, keepdims=True) * own / own_n**2
    owed_n = 1.05e-3 * played.value("settings.wall_force_n")  # what is owed comes at most so fast
    assert own_n.min() > 3 * owed_n and np.linalg.norm(across, axis=1).max() < owed_n


def test_a_proxy_comes_to_rest_with_its_hand() -> None:
    """Between the surfaces of a heap of boxes a proxy went to and fro for ever, by up to 15 mN a tick."""
    field = heap_of_boxes()
    starts_m, goals_m = behind_surface(field, 30)
    for start, goal in zip(starts_m, goals_m, strict=True):
        rendered = Held(field)
        into(rendered, start, goal, 100)
        forces = np.array([rendered.tick(goal) for _ in range(4000)])
        assert np.linalg.norm(np.diff(forces[-100:], axis=0), axis=1).max() < 1e-4


def test_random_pressing_adds_no_energy() -> None:
    rng = np.random.default_rng(2)
    for shape, depth_m in ((BALL, 0.025), (BLOCK, 0.015)):
        rendered = Held(field_of(shape), damping=0.3)
        x, v, energy = np.array([0.0, 0.0, 0.035]), np.zeros(3), [0.0]
        way, goal = rng.normal(size=3), np.zeros(3)
        for n in range(6000):
            if n % 250 == 0:
                way = 0.7 * way + rng.normal(size=3) + [0, 0, 1.0]
                goal = (depth_m - rng.uniform(-0.004, 0.006)) * way / np.linalg.norm(way)
            force = rendered.tick(x)
            before = x
            for _ in range(4):
                v = v + (500 * (goal - x) - 14 * v + force) / 0.1 * 2.5e-4
                x = x + v * 2.5e-4
            energy.append(energy[-1] + float(force @ (x - before)))
        assert max(energy) < 1e-3 and min(energy) < -1e-3


def test_a_body_that_moves_past_a_hand_at_rest_brings_nothing_of_what_is_owed() -> None:
    """What a jump of the proxy owes comes with the motion of the hand, or slowly."""
    slides = [(UNTURNED, (0.002 * n, 0.0, 0.0)) for n in range(4)]  # 2 mm a frame, the plate 2 mm
    rendered, hand = Held(plate(0.002), poses=slides), np.array([0.0, 0.0, -0.001])
    into(rendered, np.array([0.0, 0.0, 0.004]), hand)
    proxy = rendered.memory.receiver["state"]["proxy"]
    proxy["eased_n"] = (0.0, 0.3, 0.0)
    owed = []
    for n in range(100):
        rendered.at = n / 40  # a frame in 40 ms: 0.05 m/s
        rendered.tick(hand)
        owed.append(float(np.linalg.norm(proxy["eased_n"])))
    assert owed[-1] > 0.2 and np.abs(np.diff(owed)).max() < 1.05e-3 * rendered.wall.large_n


def test_a_plate_that_rises_carries_the_hand() -> None:
    lifts = [(UNTURNED, (0.0, 0.0, 0.01 * n)) for n in range(4)]  # 10 mm a frame, the plate 2 mm
    rendered = Held(plate(0.002), poses=lifts)
    into(rendered, np.array([0.0, 0.0, 0.004]), np.array([0.0, 0.0, -0.001]))
    steps, force = [], rendered.tick(np.array([0.0, 0.0, -0.001]))
    for n in range(120):
        rendered.at = n / 40  # a frame in 40 ms: 0.25 m/s
        after = rendered.tick(np.array([0.0, 0.0, -0.001 + 0.01 * rendered.at]))  # the hand moves with it
        steps.append(np.linalg.norm(after - force))
        force = after
    assert rendered.proxy_m[2] > 0.029 and force[2] > 0.3
    assert max(steps) < 0.05


@pytest.mark.parametrize("turn_deg", [0, 30, 90, 200])
def test_friction_holds_on_a_body_that_turns(turn_deg: int) -> None:
    """Where the hand goes with the surface, friction is zero and the proxy stays where it is on the body."""
    half = np.radians(np.arange(turn_deg - 30, turn_deg + 1, 10)) / 2  # three frames of ten degrees up to it
    axis, place = np.array([1.0, 2.0, 2.0]) / 3, np.array([0.005, -0.003, 0.002])
    poses = [((np.cos(a), *(np.sin(a) * axis)), tuple(place)) for a in half]
    rendered = Held(field_of(BALL), mu=0.7, poses=poses)
    pressed = np.array([0.0, 0.6, 0.8])  # in the axes of the body

    def of_body(vector: np.ndarray) -> np.ndarray:
        n = min(int(rendered.at), len(half) - 1)
        angle = 2 * (half[n] + (rendered.at - n) * np.radians(5))
        parallel = (axis @ vector) * axis
        turned = np.cos(angle) * (vector - parallel) + np.sin(angle) * np.cross(axis, vector)
        return np.asarray(turned + parallel)

    into(rendered, place + of_body(0.03 * pressed), place + of_body(0.022 * pressed))
    for tick, at in enumerate(np.linspace(0, 3, 151)):
        rendered.at = at
        rendered.tick(place + of_body(0.022 * pressed))
        normal, force = of_body(pressed), rendered.value("state.field_force_n")
        assert force @ normal > 1.0 and force @ normal == pytest.approx(np.linalg.norm(force), rel=0.01)
        # both start at once, and the damper takes the velocity of the body low-passed
        assert np.linalg.norm(rendered.value("state.friction_n")) < (0.1 if tick < 30 else 0.05)
        assert np.cross(rendered.proxy_m - place, normal) == pytest.approx(np.zeros(3), abs=1e-4)


def test_a_proxy_without_contact_follows_the_hand_without_force() -> None:
    rendered = Held(field_of(BALL), mu=0.5)
    for z in np.linspace(0.05, 0.03, 40):
        assert not rendered.tick(np.array([0.0, 0.0, z])).any()
    assert np.allclose(rendered.proxy_m, [0, 0, 0.03])
    assert into(rendered, np.array([0.0, 0.0, 0.03]), np.array([0.0, 0.0, 0.022]))[2] > 1.0
    assert not into(rendered, np.array([0.0, 0.0, 0.022]), np.array([0.0, 0.0, 0.03])).any()
    for position in (np.array([np.nan, 0, 0]), np.array([1e9, 0, 0])):
        assert np.isfinite(rendered.tick(position)).all()


def test_walls_are_detected() -> None:
    ball = field_of(BALL, nw=6)
    wall = wall_of(ball)
    assert wall is not None and wall.stiffness_n_per_m == pytest.approx(500, rel=0.02)
    steady = np.where(ball.forces_n.any(axis=-1, keepdims=True), np.float32([0, 0, 1]), np.float32(0))
    assert wall_of(ForceField(ball.grid, ball.bricks, steady)) is None
    assert wall_of(ForceField(ball.grid, ball.bricks, -ball.forces_n)) is None  # it attracts the hand
    empty = ForceField.empty(ball.grid)
    assert wall_of(empty) is None
    late = HapticMedium.from_frames([empty, ball], 30.0)  # nothing in its first frame
    for stated, stiffness in (
        (None, 500),
        (700, 700),
        (1.0, 1),
        (5001, 500),
    ):  # a valid stated stiffness takes precedence
        provenance = (
            {} if stated is None else {"spec": json.dumps({"law": "penalty", "stiffness_n_per_m": stated})}
        )
        found = FrameSource(replace(late, provenance=provenance)).wall()
        assert found is not None and found.stiffness_n_per_m == pytest.approx(stiffness, rel=0.02)
    for law, more in (("constant", {}), ("penalty", {"edits": "gain 2"})):
        assert stated_n_per_m({"spec": json.dumps({"law": law, "stiffness_n_per_m": 700}), **more}) is None
    track = PoseTrack([[1.0, 0, 0, 0]], [[0.0, 0, 0]])
    bodies = [
        HapticObject(str(n), HapticMedium.from_frames([ball.scaled(n)], 30.0), track) for n in (0.1, 3, 2)
    ]
    found = FrameSource(HapticScene(ball.grid, 30.0, tuple(bodies), 20.0)).wall()
    assert found is not None and found.stiffness_n_per_m == pytest.approx(1500, rel=0.02)  # of the stiffest
    weakest = wall_of(ball.scaled(0.1))  # and the force of the weakest
    assert weakest is not None and found.level_n == weakest.level_n < wall.level_n
    coarse = HapticObject("coarse", HapticMedium.from_frames([field_of(BALL, nw=5)], 30.0), track)
    found = FrameSource(HapticScene(ball.grid, 30.0, (coarse, bodies[1]), 20.0)).wall()
    assert found is not None and found.spacing_m == (min(ball.grid.spacing_m),) * 3  # in any orientation
    silence = VibrationFrame.empty(ball.grid)
    found = FrameSource(HapticMedium(ball.grid, 30.0, 1, lambda i: ball, vibration=lambda i: silence)).wall()
    assert found == wall  # a vibration is no second body


def test_a_terrain_whose_rim_overshoots_is_a_wall() -> None:
    terrain = prepare("sample:terrain", EncodeSpec(nw=6)).medium[0]
    wall = wall_of(terrain)
    assert wall is not None and wall.stiffness_n_per_m == pytest.approx(500, rel=0.1)


def through(rendered: Held, points_mm: Sequence[Sequence[float]], speed_m_s: float = 0.15) -> np.ndarray:
    """The forces along straight ways from point to point."""
    points, forces = np.array(points_mm) / 1000, []
    for start, end in pairwise(points):
        steps = max(2, round(float(np.linalg.norm(end - start)) / speed_m_s / DT_S))
        forces += [rendered.tick(start + weight * (end - start)) for weight in np.linspace(0, 1, steps)]
    return np.array(forces)


@pytest.mark.parametrize(
    "behind_mm",
    [
        [[8.6, 57.7, -10.2], [7.2, 52.8, -7.1], [4, 37, -4.9]],  # back in behind the rim, out in front
        [[8.6, 57.7, -10.2], [-48, -12, -32], [-48, -12, -4]],  # far along within the shell, from one rim
        [[8.6, 57.7, -10.2], [8.6, 62, -32], [0, 0, -32]],  # below, and through the whole shell
    ],
)
def test_a_proxy_does_not_stay_behind_a_shell(behind_mm: list[list[float]]) -> None:
    """A terrain has a front only: a hand that goes round its rim and out in front feels it as at first."""
    terrain = prepare("sample:terrain", EncodeSpec(nw=7)).medium[0]
    travelled, fresh = Held(terrain), Held(terrain)
    above = [behind_mm[-1][0], behind_mm[-1][1], 30.0]
    pressed = through(travelled, [[8, 50, 20], [8, 50, -3], [8.5, 57.3, -3.5]])
    assert np.linalg.norm(pressed, axis=1).max() > 1.0
    through(travelled, [[8.5, 57.3, -3.5], *behind_mm, above])
    through(travelled, [above, above])
    assert np.allclose(travelled.proxy_m, np.array(above) / 1000)
    press = [[18, -38, 30], [18, -38, -3.4], [18, -20, -3.4], [18, -20, 10]]
    through(travelled, [above, press[0]])
    assert np.allclose(through(travelled, press), through(fresh, press), atol=1e-6)


def test_a_hand_that_came_round_a_rim_is_not_drawn_back() -> None:
    """Its proxy hung at the rim, and drew it there when it came nearer to the far side again."""
    rendered = Held(field_of(Box((0.0, 0.0, 0.0), (0.04, 0.001, 0.025)), nw=6))
    over_mm = [[38.6, 6, 0.3], [38.6, -2, 0.3], [39.3, -2.8, 0.3], [38.5, -3.9, 1.1], [36.1, -10.3, 1.6]]
    assert through(rendered, over_mm, 0.02)[:, 1].max() > 0.3
    through(rendered, [over_mm[-1], [35.3, -11.4, 3.9]], 0.02)
    behind_mm = [[35.3, -11.4, 3.9], [35, -8.9, 5.2], [35.1, -5.6, 6.7], [36.8, -4.2, 5]]
    forces = through(rendered, behind_mm, 0.02)
    assert np.linalg.norm(forces, axis=1).max() < rendered.wall.level_n


def test_what_is_owed_of_a_force_falls_with_it() -> None:
    """A hand that left a wall faster than it was given back felt nothing in it, or was drawn in."""
    rendered, ways_m = Held(field_of(BALL)), np.linspace(0.020, 0.0245, 40)
    before = into(rendered, np.array([0.0, 0.0, 0.03]), np.array([0.0, 0.0, ways_m[0]]))
    rendered.memory.receiver["state"]["proxy"]["eased_n"] = (0.0, 0.0, 0.85 * before[2])
    forces = np.array([rendered.tick(np.array([0.0, 0.0, z])) for z in ways_m])[:, 2]
    stored = rendered.field.sample_n(np.column_stack([np.zeros((len(ways_m), 2)), ways_m]))[:, 2]
    assert forces[0] < 0.2 * stored[0] and (np.diff(forces) <= 5e-3).all()
    assert (forces > 0.12 * stored).all()


def _peak_n(medium: HapticMedium | HapticScene, spec: RenderSpec) -> tuple[float, tuple[str, ...]]:
    way = Trace(np.array([0.0, 0.2, 0.3]), np.array([[0, 0, 0.02], [0, 0, -0.005], [0, 0, -0.005]]))
    run = run_offline(medium, STRONG, partial(SimHand, way), spec, seconds=0.3)
    return float(run.log["field_force_n"][260:290, 2].mean()), run.notes


def test_a_session_selects_the_proxy_and_notes_it() -> None:
    field = plate(0.002)
    medium = HapticMedium(field.grid, 30.0, 1, lambda i: field, axes=STRONG.axes)
    rendered, notes = _peak_n(medium, RenderSpec())
    assert rendered > 1.0 and any("proxy" in note for note in notes)
    soft = RenderSpec(wall_n_per_m=300.0)
    assert _peak_n(medium, soft)[0] == pytest.approx(300 * 0.006, rel=0.1)
    session, memory = laid_out(medium, soft)
    settings = memory.receiver["settings"]
    selected = settings[["brake_n_s_per_m", "coupling_n_per_m"]].copy()
    session.feeder(memory).fill_lookahead(1)  # its stiffest slope is that of the field, which the proxy hides
    assert settings[["brake_n_s_per_m", "coupling_n_per_m"]] == selected
    for spec in (RenderSpec(render="field"), RenderSpec(coupling_n_per_m=300.0)):
        plain, notes = _peak_n(medium, spec)
        assert abs(plain) < 0.5 and not any("a proxy holds" in note for note in notes)
        assert any(note.startswith("no proxy") for note in notes) == (spec.render == "auto")
    tool, bent = Tool.sphere(0.001, 10), Deformation.at_rest((-0.02,) * 3, (0.02,) * 3)
    for spec in (RenderSpec(tool=tool), RenderSpec(deformation=bent)):  # these render the field itself
        notes = laid_out(medium, spec)[0].notes
        assert not any("a proxy holds" in note for note in notes)
        assert any(note.startswith("no proxy") for note in notes)
        with pytest.raises(InvalidArgument, match="proxy"):
            replace(spec, render="proxy")
    track = PoseTrack(np.array([UNTURNED]), np.zeros((1, 3)))
    body = HapticScene(field.grid, 30.0, (HapticObject("plate", medium, track),), 3.3, axes=STRONG.axes)
    assert _peak_n(body, RenderSpec())[0] > 1.0
    drawn = ForceField(field.grid, field.bricks, -field.forces_n)
    with pytest.raises(InvalidArgument, match="a field without walls"):
        _peak_n(
            HapticMedium(field.grid, 30.0, 1, lambda i: drawn, axes=STRONG.axes), RenderSpec(render="proxy")
        )
    with pytest.raises(InvalidArgument, match="render"):
        RenderSpec(render="both")
