"""Where a medium does not continue, as after a loop or a seek, the force fades (c/touch_seam.h)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from player_makers import numbered_medium
from proxy_makers import field_of
from seam_makers import Played, steps_n

from touchfield.filters.resample import pyramid, rebuild_level
from touchfield.medium import ForceField, HapticMedium, HapticObject, HapticScene, PoseTrack
from touchfield.medium.deformation import Deformation
from touchfield.render.block import layout
from touchfield.render.spec import RenderSpec
from touchfield.render.tool import Tool
from touchfield.sources.shapes.shapes import Box, Sphere

RATE_HZ, FRAMES, FADE = 100.0, 50, 100
"""A loop of half a second; ticks of a fade."""
BALL, PLATE = field_of(Sphere((0.0, 0.0, 0.0), 0.012), nw=6), field_of(Box((0, 0, 0), (0.02, 0.02, 0.001)))
UP = np.array([0.0, 0.0, 1.0])


def body(field: ForceField, positions_m: np.ndarray, turns: np.ndarray | None = None) -> HapticObject:
    """A rigid body at positions [frames, 3], turned about z by angles [frames], rad."""
    half = np.zeros(len(positions_m)) if turns is None else turns / 2
    quaternions = np.stack([np.cos(half), 0 * half, 0 * half, np.sin(half)], axis=1)
    medium = HapticMedium.from_frames([field], RATE_HZ)
    return HapticObject("body", medium, PoseTrack(quaternions, positions_m))


def scene(*bodies: HapticObject) -> HapticScene:
    return HapticScene(BALL.grid, RATE_HZ, bodies, 3.3)


def falling(start_m: float = 0.04) -> HapticScene:
    """A ball that stays up for 0.18 s, falls for 0.06 s, and rests at z = 0 from then on."""
    height = np.zeros((FRAMES, 3))
    height[:, 2] = start_m * np.clip((24 - np.arange(FRAMES)) / 6, 0, 1)
    return scene(body(BALL, height))


ON_BALL = np.array([0.001, 0.002, 0.009])
"""Some 3 mm below its surface."""


def worst_around(forces: np.ndarray, tick: int) -> float:
    return float(steps_n(forces)[tick - 30 : tick + FADE + 20].max())


@pytest.mark.parametrize("render", ["field", "proxy"])
@pytest.mark.parametrize("is_spring", [False, True])
def test_a_looped_body_leaves_the_hand_without_a_click(render: str, is_spring: bool) -> None:
    force_n = Played(falling(), start_s=0.3, loop=True).at_rest(ON_BALL, 150)[-1]
    played = Played(falling(), start_s=0.3, loop=True, spec=RenderSpec(render=render))
    if is_spring:
        forces, _ = played.on_spring(ON_BALL, ON_BALL - force_n / 200, 200 + FADE + 30)
    else:
        forces = played.at_rest(ON_BALL, 200 + FADE + 30)
    assert np.linalg.norm(forces[199]) > 0.9
    size = np.linalg.norm(forces[199])
    steepest = np.pi / 2 * size / FADE  # of a raised cosine
    assert worst_around(forces, 200) < 1.15 * steepest
    assert np.linalg.norm(forces[200] - forces[199]) < 0.002 * size
    if not is_spring:
        assert not forces[200 + FADE + 1].any()


@pytest.mark.parametrize("render", ["field", "proxy"])
def test_friction_after_a_seam_fades_in_with_the_force(render: str) -> None:
    """A ball is suddenly below a hand, and moves past it: it drags no harder than it pushes."""
    positions = np.zeros((FRAMES, 3))
    positions[:, 0] = 0.02 * np.arange(FRAMES) / RATE_HZ
    positions[40:] = [0.0, 0.0, 0.04]
    spec, mu = RenderSpec(render=render, friction=0.5), 0.5
    played = Played(scene(body(BALL, positions)), start_s=0.45, loop=True, spec=spec)
    forces, frictions, pressing = [], [], []
    for _ in range(50 + FADE):
        forces.append(played.tick(ON_BALL))
        frictions.append(np.linalg.norm(played.value("state.friction_n")))
        pressing.append(np.linalg.norm(played.value("state.field_force_n")))
    assert not np.any(forces[:50]) and frictions[-1] > 0.4 * pressing[-1] > 0.2
    weights = 0.5 - 0.5 * np.cos(np.pi * np.arange(FADE) / FADE)
    assert (frictions[50:] <= mu * np.array(pressing[50:]) * weights + 1e-6).all()
    assert steps_n(np.array(forces))[45:55].max() < 0.01


def test_a_body_does_not_pass_the_hand_on_its_way_back() -> None:
    between = np.array([0.0, 0.0, 0.02])  # off the ball at both ends of the seam
    played = Played(falling(), start_s=0.4, loop=True)
    assert not played.at_rest(between, 150).any()


def test_a_seek_to_the_seam_starts_a_loop_again() -> None:
    played = Played(falling(), start_s=0.495, loop=True)  # the frame before the last one was never there
    forces = played.at_rest(ON_BALL, 200)
    assert worst_around(forces, 30) < 0.03


def test_a_loop_that_goes_on_is_interpolated() -> None:
    turns = np.linspace(0, 2 * np.pi, FRAMES, endpoint=False)
    offset = np.stack([0.02 * np.cos(turns), 0.02 * np.sin(turns), 0 * turns], axis=1)
    once, twice = (scene(body(BALL, np.tile(offset, (n, 1)), np.tile(turns, n))) for n in (1, 2))
    hand = np.array([0.028, 0.001, 0.002])  # the ball comes here at the seam
    looped = Played(once, start_s=0.3, loop=True).at_rest(hand, 400)
    straight = Played(twice, start_s=0.3).at_rest(hand, 400)
    assert np.linalg.norm(straight[195:205], axis=1).min() > 0.5
    np.testing.assert_allclose(looped, straight, atol=1e-6)


def test_what_is_the_same_on_both_sides_is_rendered_as_it_is() -> None:
    resting = body(BALL, np.zeros((FRAMES, 3)))
    away = np.tile([0.05, 0.0, 0.0], (FRAMES, 1))
    away[:, 1] = np.linspace(0, 0.02, FRAMES)
    both = scene(resting, body(BALL, away))
    hand = ON_BALL + np.outer(np.linspace(0, 1, 400), [0.0, 0.0, 0.002])
    played, still = Played(both, start_s=0.3, loop=True), Played(scene(resting), start_s=0.3, loop=True)
    for position in hand:
        np.testing.assert_allclose(played.tick(position), still.tick(position), rtol=0, atol=1e-5)
    assert played.value("state.seam.frame") > 0


def test_a_jump_at_the_seam_takes_no_proxy_through_a_plate() -> None:
    """The plate rests; a ball, far away, jumps. The hand is 2 mm beyond the plate, and the proxy above it."""
    away = np.tile([0.05, 0.0, 0.0], (FRAMES, 1))
    away[:, 1] = np.linspace(0, 0.02, FRAMES)
    both = scene(body(PLATE, np.zeros((FRAMES, 3))), body(BALL, away))
    played = Played(both, start_s=0.3, loop=True, spec=RenderSpec(render="proxy"))
    path = np.interp(np.arange(500), [0, 150, 500], [0.004, -0.0035, -0.0035])
    forces = np.array([played.tick(np.array([0.001, 0.002, z])) for z in path])
    assert forces[199:, 2].min() > 0.5 and played.value("state.proxy.position_m")[2] > 0.0
    assert steps_n(forces[180:]).max() < 0.01


def test_a_plate_that_jumps_leaves_the_proxy_behind() -> None:
    """The hand is beyond the plate, as is the place where the plate is next: the proxy does not go there."""
    height = np.zeros((FRAMES, 3))
    height[:40, 2] = 0.03
    played = Played(scene(body(PLATE, height)), start_s=0.41, loop=True, spec=RenderSpec(render="proxy"))
    path = np.interp(np.arange(300), [0, 60, 300], [0.004, -0.0035, -0.0035])
    forces = np.array([played.tick(np.array([0.001, 0.002, z])) for z in path])
    assert forces[85, 2] > 0.5
    assert not forces[91 + FADE :].any()
    assert played.value("state.proxy.position_m") == pytest.approx([0.001, 0.002, -0.0035], abs=1e-6)


@pytest.mark.parametrize("late", [0, 12, 60])
def test_a_seek_takes_no_proxy_through_a_plate(late: int) -> None:
    spec = RenderSpec(render="proxy")
    played = Played(scene(body(PLATE, np.zeros((FRAMES, 3)))), late, start_s=0.1, spec=spec)
    path = np.interp(np.arange(150), [0, 100, 150], [0.004, -0.0035, -0.0035])
    before = np.array([played.tick(np.array([0.001, 0.002, z])) for z in path])[-1]
    assert before[2] > 0.5
    played.seek(0.1)
    forces = played.at_rest(np.array([0.001, 0.002, -0.0035]), late + 150)
    assert forces[-1] == pytest.approx(before, rel=0.1)
    assert steps_n(forces).max() < 1.1 * np.pi / 2 * np.linalg.norm(before) / FADE


@pytest.mark.parametrize("late", [0, 12, 40])
def test_seeks_and_late_frames_let_no_hand_through_a_plate(late: int) -> None:
    """A hand on a spring presses with some 1.5 N while the player seeks, again within a fade, and stalls."""
    away = np.tile([0.05, 0.0, 0.0], (FRAMES, 1))
    away[:, 1] = np.linspace(0, 0.02, FRAMES)
    both = scene(body(PLATE, np.zeros((FRAMES, 3))), body(BALL, away))
    played = Played(both, late, start_s=0.1, loop=True, spec=RenderSpec(render="proxy"))
    rng = np.random.default_rng(late)
    events: dict[int, Any] = {n: float(rng.uniform(0, 0.5)) for n in (500, 620, 660, 690, 900, 1000)}
    events |= {1200: Played.pause, 1230: 0.2, 1300: Played.play, 1500: lambda p: p.hold_back_frames(60)}
    start, goal = np.array([0.001, 0.002, 0.004]), np.array([0.001, 0.002, -0.010])
    forces, hands = played.on_spring(start, goal, 2200, events)
    assert hands[2000:, 2] == pytest.approx(hands[450:500, 2].mean(), abs=2e-4)
    assert forces[2000:, 2].min() > 1.2 and played.value("state.proxy.position_m")[2] > 0.0
    assert played.value("state.proxy.is_in_contact")


@pytest.mark.parametrize("is_spring", [False, True])
def test_a_seek_into_falling_bodies_steps_as_the_field_does(is_spring: bool) -> None:
    """The hand is deep in a wall or near another, where the proxy would change over from one to the other."""
    fall = np.zeros((FRAMES, 3))
    fall[:, 2] = 0.03 - 0.15 * np.maximum(np.arange(FRAMES) / RATE_HZ - 0.1, 0)
    turning = body(PLATE, fall, np.linspace(0, 0.5, FRAMES))
    both = scene(turning, body(BALL, fall - [0.008, 0.0, 0.012]))
    worst = {"field": 0.0, "auto": 0.0}
    for render in worst:
        for n, hand in enumerate(np.random.default_rng(3).uniform(-0.01, 0.01, (8, 3))):
            played = Played(both, 12, loop=True, spec=RenderSpec(render=render, up="lattice"))
            seeks = {40: 0.3 + 0.01 * n, 200: 0.1, 260: 0.4}
            forces = (
                played.on_spring(hand, hand, 380, seeks)[0] if is_spring else played.at_rest(hand, 380, seeks)
            )
            steps = steps_n(forces)
            worst[render] = max(worst[render], *(float(steps[tick + 11 :][:104].max()) for tick in seeks))
    assert worst["field"] > 0.1
    assert worst["auto"] < 1.25 * worst["field"]


def test_each_end_of_a_loop_fades() -> None:
    forces = Played(falling(), start_s=0.3, loop=True).at_rest(ON_BALL, 1700)
    size = np.linalg.norm(forces[199])
    for end in (200, 700, 1200):
        assert np.linalg.norm(forces[end - 1]) == pytest.approx(size, abs=1e-6)
        assert worst_around(forces, end) < 1.1 * np.pi / 2 * size / FADE
        assert not forces[end + FADE + 1 : end + 150].any()


@pytest.mark.parametrize("speed", [0.5, 2.0])
def test_a_fade_takes_as_long_at_any_speed(speed: float) -> None:
    played = Played(falling(), start_s=0.3, loop=True, speed=speed)
    end = round(200 / speed)
    forces = played.at_rest(ON_BALL, end + 130)
    size = np.linalg.norm(forces[end - 1])
    assert size > 0.9
    passed = np.linalg.norm(forces[end : end + 50], axis=1)  # the bodies are away for 90 ms or more
    assert passed == pytest.approx(size * (0.5 + 0.5 * np.cos(np.pi * np.arange(50) / FADE)), abs=0.02)


def test_a_seek_during_a_pause_fades() -> None:
    played = Played(falling(), 12, start_s=0.3)
    events: dict[int, Any] = {120: Played.pause, 150: 0.0, 300: Played.play}
    forces = played.at_rest(ON_BALL, 340, events)
    size = np.linalg.norm(forces[119])
    assert size > 0.9 and worst_around(forces, 150) < 1.1 * np.pi / 2 * size / FADE
    assert not forces[150 + FADE + 13 :].any()


def test_a_coarse_layer_starts_and_ends_without_a_step() -> None:
    """As in a live stream that loses its fine layer for a while (`LiveFrames.is_seam`)."""
    fine = BALL
    coarse = rebuild_level(pyramid(fine, 1)[1], fine.grid)

    class Layers:
        def __call__(self, frame: int) -> ForceField:
            return coarse if 20 <= frame < 35 else fine

        @staticmethod
        def is_seam(frame: int) -> bool:
            return frame in (20, 35)

    medium = HapticMedium(fine.grid, RATE_HZ, FRAMES, Layers())
    for render in ("field", "auto"):
        played = Played(medium, start_s=0.05, spec=RenderSpec(render=render, up="lattice"))
        forces = played.at_rest(np.array([0.001, 0.002, 0.011]), 430)
        change = np.linalg.norm(forces[149] - forces[280])
        assert change > 0.01
        assert steps_n(forces)[110:].max() < 1.1 * np.pi / 2 * change / FADE + 1e-4


@pytest.mark.parametrize("render", ["field", "proxy"])
def test_without_blend_the_force_steps_at_a_seam(render: str) -> None:
    spec = RenderSpec(render=render, blend=False)
    forces = Played(falling(), start_s=0.3, loop=True, spec=spec).at_rest(ON_BALL, 250)
    size = np.linalg.norm(forces[199])
    assert size > 0.9 and not forces[210:].any()  # the slew limit takes some ticks
    played = Played(falling(), 30, start_s=0.3, spec=spec)
    forces = played.at_rest(ON_BALL, 250, {120: 0.35})
    assert not forces[142:149].any()  # the ramp of 20 ms while the frames are missing, and then back
    assert forces[-1] == pytest.approx(forces[119], abs=1e-6)


@pytest.mark.parametrize("late", [0, 12, 60, 150])
def test_a_seek_fades_and_brings_the_force_back(late: int) -> None:
    medium = falling()
    steady = Played(medium, start_s=0.3).at_rest(ON_BALL, 150)[-1]
    size = float(np.linalg.norm(steady))
    played = Played(medium, late=late, start_s=0.3, loop=False)
    forces = played.at_rest(ON_BALL, 120)
    played.seek(0.3)
    forces = np.concatenate([forces, played.at_rest(ON_BALL, late + 150)])
    assert forces[119] == pytest.approx(steady, abs=1e-6) and forces[-1] == pytest.approx(steady, abs=1e-6)
    assert steps_n(forces[110:]).max() < 1.1 * np.pi / 2 * size / FADE
    assert np.linalg.norm(forces, axis=1).max() < size * (1 + 1e-6)
    if late >= FADE:
        assert not forces[121 + FADE : 120 + late].any()


def test_frames_that_come_after_a_stall_fade_in() -> None:
    played = Played(scene(body(BALL, np.zeros((2 * FRAMES, 3)))))
    forces = [*played.at_rest(ON_BALL, 130)]
    played.fed_from = played.ticks + 45  # the frames that are decoded last for some 40 ms
    forces += [*played.at_rest(ON_BALL, 110 + FADE)]
    sizes = np.linalg.norm(forces, axis=1)
    assert played.value("counts.underruns") == 1 and sizes[-1] == pytest.approx(sizes[129])
    least = int(sizes[130:].argmin()) + 130
    assert sizes[least] < 0.9 * sizes[129]
    assert steps_n(np.array(forces))[least:].max() < 1.1 * np.pi / 2 * sizes[129] / FADE


def test_a_seek_while_the_force_ramps_down_lets_it_go_on() -> None:
    played = Played(scene(body(BALL, np.zeros((2 * FRAMES, 3)))), late=60)
    forces = [*played.at_rest(ON_BALL, 130)]
    size = float(np.linalg.norm(forces[-1]))
    while np.linalg.norm(forces[-1]) > 0.8 * size:
        forces.append(played.tick(np.full(3, np.nan)))
    assert played.value("state.gain") < 1.0
    played.seek(0.3)
    forces += [*played.at_rest(ON_BALL, 50)]
    ramp_ticks = 1e3 * played.value("settings.ramp_s")
    assert not forces[-1].any() and steps_n(np.array(forces[130:])).max() < 1.1 * size / ramp_ticks


def test_the_force_of_a_fade_is_within_that_of_both_sides() -> None:
    """The ball is 1 mm lower from the seam on, and the hand goes 3 mm deeper meanwhile."""
    positions = np.zeros((FRAMES, 3))
    positions[:, 2] = np.where(np.arange(FRAMES) < 25, -0.001, 0.0)
    spec = RenderSpec(render="field", damping_n_s_per_m=0.0, coupling_n_per_m=0.0)
    played = Played(scene(body(BALL, positions)), start_s=0.3, loop=True, spec=spec)
    before = np.linalg.norm(played.at_rest(ON_BALL, 200)[-1])
    has_more = False
    for n in range(60):
        force = np.linalg.norm(played.tick(ON_BALL - 0.003 * n / 60 * UP))
        field_n = np.linalg.norm(played.value("state.field_force_n"))
        assert force <= max(before, field_n) * (1 + 1e-6)
        has_more |= before < field_n and played.value("state.seam.left_s") > 0.04
    assert has_more


def test_voxels_that_jump_at_the_end_of_a_loop_fade() -> None:
    slow = Played(replace(numbered_medium(60, 100.0)), start_s=0.3, loop=True)
    forces = slow.at_rest(np.zeros(3), 450)
    change = 59 / 64
    assert steps_n(forces)[280:].max() < 1.1 * np.pi / 2 * change / FADE + 0.002


def test_a_frame_marked_as_a_seam_fades_where_it_jumps() -> None:
    def jumps(frame: int) -> ForceField:
        return numbered_medium(100).make_frame(0 if frame < 30 else 64)

    forces = {}
    for is_marked in (False, True):
        make = jumps
        if is_marked:

            class Marked:
                __call__ = staticmethod(jumps)

                @staticmethod
                def is_seam(frame: int) -> bool:
                    return frame == 30

            make = Marked()  # type: ignore[assignment]
        medium = replace(numbered_medium(100, 100.0), make_frame=make)
        forces[is_marked] = Played(medium, start_s=0.1).at_rest(np.zeros(3), 400)
    assert steps_n(forces[False])[110:].max() == pytest.approx(0.1, rel=0.01)
    assert steps_n(forces[True])[110:].max() < 1.1 * np.pi / 2 / FADE
    np.testing.assert_allclose(forces[True][-1], forces[False][-1], atol=1e-9)


def test_a_deformed_medium_that_jumps_at_the_end_of_a_loop_fades() -> None:
    medium = HapticMedium.from_frames([BALL], RATE_HZ)
    shape = (FRAMES, 4, 4, 4, 3)
    lift = np.zeros(shape)
    lift[..., 2] = -0.004 * (np.arange(FRAMES) >= 20)[:, None, None, None]
    deformation = Deformation(lift, (-0.1,) * 3, (0.2,) * 3, RATE_HZ)
    played = Played(medium, start_s=0.3, loop=True, spec=RenderSpec(render="field", deformation=deformation))
    forces = played.at_rest(np.array([0.001, 0.002, 0.011]), 330)
    change = float(np.linalg.norm(forces[330 - 1] - forces[199]))
    assert change > 0.5
    assert worst_around(forces, 200) < 1.1 * np.pi / 2 * change / FADE


def test_the_torque_of_a_tool_fades_too() -> None:
    rod = Tool(np.array([[0.01, 0.0, 0.0]]), np.array([[0.0, 0.0, -1.0]]))
    played = Played(falling(), start_s=0.3, loop=True, spec=RenderSpec(render="field", tool=rod))
    hand, torques = ON_BALL - [0.01, 0.0, 0.0], []
    played.memory.receiver["grip"]["orientation"] = 1.0, 0.0, 0.0, 0.0
    for _ in range(330):
        played.tick(hand)
        torques.append(played.value("state.torque.desired"))
    size = float(np.linalg.norm(torques[199]))
    assert size > 1e-3
    assert steps_n(np.array(torques))[150:].max() < 1.1 * np.pi / 2 * size / FADE
    assert np.linalg.norm(torques[-1]) < 1e-9


def test_a_stop_during_a_fade_ends_in_zero() -> None:
    played = Played(falling(), start_s=0.4, loop=True)
    played.at_rest(ON_BALL, 120)
    played.session.order(played.memory, is_stopping=True)
    assert not played.at_rest(ON_BALL, 60)[-1].any() and played.value("clock.is_released")


def test_a_pause_is_no_seam() -> None:
    played = Played(falling(), start_s=0.3)
    before = played.at_rest(ON_BALL, 120)[-1]
    for mode in (layout.PAUSED, layout.PLAYING):
        played.session.order(played.memory, mode=mode)
        np.testing.assert_allclose(played.at_rest(ON_BALL, 30), np.tile(before, (30, 1)), atol=1e-9)
